"""JPEGs out of multipart streams: every cut, every fault of the bytes, the habits of real cameras."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mjpeg_server import chunked, jpeg, part

from robotd_devices.camera.mjpeg_parts import BrokenStream, Dechunker, PartSplitter

A, B, C = jpeg(1), jpeg(2), jpeg(3)
THUMBNAIL = A[:2] + b"\xff\xe1" + (2 + len(B)).to_bytes(2, "big") + B + A[2:]
TEXT = b"--frame\r\nContent-Type: text/plain\r\n\r\nhello\r\n"

STREAMS = {
    "plain": (part(A) + part(B) + part(C), [A, B, C], []),
    "no boundary before the first": (part(A)[9:] + part(B), [B], []),
    "a blank line first": (b"\r\n" + part(A) + part(B), [A, B], []),
    "boundary with dashes of its own": (part(A, boundary=b"--frame") + part(B, boundary=b"--frame"), [A, B], []),
    "another boundary than the header names": (part(A, boundary=b"other") + part(B, boundary=b"other"), [A, B], []),
    "length too short": (part(A, 10) + part(B), [A, B], []),
    "length too long": (part(A, 99_999) + part(B), [A, B], []),
    "no headers, only line feeds": (b"--frame\n\n" + A + b"\n--frame\n\n" + B + b"\n", [A, B], []),
    "padding behind a picture": (part(A + b"\0" * 9) + part(B), [A, B], []),
    "no line end behind a picture": (part(A)[:-2] + part(B), [A, B], []),
    "thumbnail inside": (part(THUMBNAIL) + part(B), [THUMBNAIL, B], []),
    "text between": (part(A) + TEXT + part(B), [A, B], ["part that is no picture"]),
    "cut off": (part(A) + part(B[:-300]) + part(C), [A, C], ["torn picture"]),
    "cut off in its markers": (part(A) + part(B[:100]) + part(C), [A, C], ["torn picture"]),
    "cut off at once": (part(A) + part(b"") + part(C), [A, C], ["part that is no picture"]),
    "a marker lost": (part(A[:2] + A[3:]) + part(B), [B], ["torn picture"]),
    "boundary inside of a picture": (part(A[:700] + b"--frame" + A[700:]), [A[:700] + b"--frame" + A[700:]], []),
    "closed": (part(A) + b"--frame--\r\n" + part(B), [A], []),
}


@pytest.mark.parametrize("name", STREAMS)
def test_streams(name: str) -> None:
    data, pictures, faults = STREAMS[name]
    splitter = PartSplitter("frame")
    assert [found.jpeg for found in splitter.feed(data)] == pictures
    assert splitter.faults == faults
    assert splitter.is_over == (name == "closed")


@given(name=st.sampled_from(sorted(STREAMS)), cuts=st.lists(st.integers(0, 6000), max_size=40), data=st.data())
def test_any_cut_gives_the_same(name: str, cuts: list[int], data: st.DataObject) -> None:
    stream, pictures, faults = STREAMS[name]
    edges = [0, *sorted(min(at, len(stream)) for at in cuts), len(stream)]
    splitter = PartSplitter("frame")
    found = [one.jpeg for a, b in pairwise(edges) for one in splitter.feed(stream[a:b])]
    assert (found, splitter.faults) == (pictures, faults)


@given(
    kind=st.sampled_from(["flip", "drop", "insert"]), at=st.integers(0, len(part(A) * 3) - 1), value=st.integers(1, 255)
)
def test_a_changed_byte_costs_two_pictures_at_most(kind: str, at: int, value: int) -> None:
    stream = bytearray(part(A) + part(B) + part(C) + part(A))
    if kind == "flip":
        stream[at] ^= value
    elif kind == "drop":
        del stream[at]
    else:
        stream.insert(at, value)
    found = [one.jpeg for one in PartSplitter("frame").feed(bytes(stream))]
    assert len(set(found) & {A, B, C}) >= 1
    assert found[-1] == A


def test_one_byte_at_a_time() -> None:
    splitter = PartSplitter("frame")
    stream = part(A) + part(B)
    found = [one for at in range(len(stream)) for one in splitter.feed(stream[at : at + 1], at)]
    assert [one.jpeg for one in found] == [A, B]
    assert found[0].began_ns == stream.index(A) - 1  # with the blank line before it
    # the second is complete with its last byte: not with the boundary that the next one would bring
    whole = PartSplitter("frame")
    assert len(whole.feed(part(A)[: -len(b"\r\n")])) == 1


def test_too_large_a_picture_is_dropped_and_memory_is_bounded() -> None:
    splitter = PartSplitter("frame", most_bytes=len(A) + 500)
    huge = jpeg(4, (300, 400))
    assert [one.jpeg for one in splitter.feed(part(A) + part(huge) + part(B))] == [A, B]
    assert splitter.faults == ["picture too large"]
    chunky = PartSplitter("frame", most_bytes=len(A) + 500)
    stream = part(A) + part(huge) + part(B)
    found = [one.jpeg for i in range(0, len(stream), 100) for one in chunky.feed(stream[i : i + 100])]
    assert found == [A, B]
    assert chunky.faults == ["picture too large"]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"x" * 100_000, "no boundary '--frame' in"),
        (b"--frame\r\n" + b"X: " + b"y" * 20_000, "headers do not end"),
    ],
)
def test_what_is_no_stream(data: bytes, words: str) -> None:
    with pytest.raises(BrokenStream, match=words):
        PartSplitter("frame", most_bytes=30_000).feed(data)


@given(body=st.binary(max_size=3000), size=st.integers(1, 900), cuts=st.lists(st.integers(0, 5000), max_size=20))
def test_chunks_under_any_cut(body: bytes, size: int, cuts: list[int]) -> None:
    stream = chunked(body, size) + b"0;last\r\n\r\n"
    edges = [0, *sorted(min(at, len(stream)) for at in cuts), len(stream)]
    chunks = Dechunker()
    assert b"".join(chunks.feed(stream[a:b]) for a, b in pairwise(edges)) == body
    assert chunks.is_over


@pytest.mark.parametrize("data", [b"zz\r\nx", b"\r\n", b"-5\r\n", b"123456789\r\n", b"1" * 20_000])
def test_what_is_no_chunk(data: bytes) -> None:
    with pytest.raises(BrokenStream):
        Dechunker().feed(data)


def test_the_pictures_are_pictures() -> None:
    for picture in (A, THUMBNAIL):
        decoded = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None and decoded.shape == (48, 64, 3)
