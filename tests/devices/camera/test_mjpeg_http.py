"""MJPEG over HTTP with our own client: answers of all kinds, passwords, redirects, hang-ups, newest picture only."""

from __future__ import annotations

import asyncio
import base64
import os
import threading
from typing import Any
from urllib.parse import urlsplit

import pytest
from mjpeg_server import HEAD, chunked, jpeg, number_of, part, served

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd.testing import FakeLink, ManualClock, check_sensor, connected
from robotd.world.messages import CameraFrame
from robotd_devices.camera import Camera, CameraConfig
from robotd_devices.camera.mjpeg_http import MjpegStream, parse_head, request
from robotd_devices.camera.mjpeg_parts import BrokenStream
from robotd_devices.camera.mjpeg_slot import JpegSlot


def camera(url: str, **config: Any) -> tuple[Camera, FakeLink]:
    return connected(Camera, CameraConfig(source=url, **config), name="camera")


def numbers(link: FakeLink) -> list[int]:
    return [number_of(frame.bgr) for frame in link.of(CameraFrame)]


def answer(status: str, *headers: str, body: bytes = b"") -> bytes:
    return "\r\n".join((f"HTTP/1.1 {status}", *headers, "", "")).encode() + body


@pytest.mark.parametrize("in_chunks", [False, True])
async def test_pictures_and_the_end(in_chunks: bool) -> None:
    pack = chunked if in_chunks else bytes
    head = HEAD.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n") if in_chunks else HEAD
    async with served() as server:
        server.respond = lambda request: head
        device, link = camera(server.url, latency_s=0.0)
        await device.open()
        for number in range(1, 5):
            server.send(pack(part(jpeg(number))))
            await link.received(number)
        assert numbers(link) == [1, 2, 3, 4]
        assert [frame.sequence for frame in link.of(CameraFrame)] == [1, 2, 3, 4]
        assert link.of(CameraFrame)[0].source == server.url
        server.cut()
        await link.until(lambda link: bool(link.losses))
        assert str(link.losses[0]) == f"camera: {server.url}: no picture came any more: the stream ended"
        await device.close()
        await device.open()  # and again
        server.send(pack(part(jpeg(7))))
        await link.received(5)
        await device.close()
        assert numbers(link)[-1] == 7
    assert server.requests[0].startswith(b"GET /video?size=small HTTP/1.1\r\nHost: 127.0.0.1:")


class RecordingSlot(JpegSlot):
    def __init__(self) -> None:
        super().__init__()
        self.puts: list[int] = []
        self.news = asyncio.Event()

    def put(self, jpeg: bytes, stamp_ns: int) -> None:
        super().put(jpeg, stamp_ns)
        self.grab()
        self.puts.append(self.number)
        self.news.set()


async def test_of_what_waited_while_the_loop_was_away_the_newest_picture_is_the_only_one() -> None:
    burst = b"".join(part(jpeg(number % 10, (240, 320))) for number in range(1, 30))
    assert len(burst) > 512 << 10  # three reads and more
    async with served() as server:
        slot = RecordingSlot()
        stream = MjpegStream(server.url, server.url, slot, ManualClock(), lambda name, detail: None)
        await stream.open()
        server.send(burst)
        await slot.news.wait()
        slot.news.clear()
        server.send(part(jpeg(11)))
        await slot.news.wait()
        stream.stop()
    assert slot.puts == [29, 30]


async def test_numbers_that_are_missing_were_skipped() -> None:
    async with served() as server:
        device, link = camera(server.url)
        await device.open()
        server.send(b"".join(part(jpeg(number)) for number in range(1, 8)))
        await link.received(1)
        server.send(part(jpeg(9)))
        await link.until(lambda link: numbers(link)[-1] == 9)
        await device.close()
    assert numbers(link) == [7, 9]
    assert [frame.sequence for frame in link.of(CameraFrame)] == [7, 8]


async def test_fifty_connections_leave_nothing_behind() -> None:
    def held() -> tuple[int, int, int]:
        files = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
        return files, threading.active_count(), len(asyncio.all_tasks())

    async with served() as server:
        before = held()
        device, link = camera(server.url)
        for turn in range(50):
            await device.open()
            server.send(part(jpeg(turn % 10))[: None if turn % 2 else -400])
            if turn % 2:
                await link.received(turn // 2 + 1)
            if turn % 3:
                server.cut()
            await device.close()
            server.cut()
        async with asyncio.timeout(5.0):
            # what was closed last is still on its way out
            while any(now > then for now, then in zip(held(), before, strict=True)):  # noqa: ASYNC110
                await asyncio.sleep(0.001)


class AskedClock(ManualClock):
    """Tells when it was asked, which the client does once for what it has read."""

    def __init__(self, now_ns: int) -> None:
        super().__init__(now_ns)
        self.asked = asyncio.Event()

    def now_ns(self) -> int:
        self.asked.set()
        return super().now_ns()


async def test_stamped_when_its_first_bytes_arrived() -> None:
    clock = AskedClock(10**10)
    async with served() as server:
        device, link = connected(Camera, CameraConfig(source=server.url, latency_s=0.0), clock=clock)
        await device.open()
        clock.asked.clear()
        whole = part(jpeg(3))
        server.send(whole[:400])
        await clock.asked.wait()
        clock.set_ns(10**10 + 300_000_000)
        server.send(whole[400:])
        await link.received(1)
        await device.close()
    assert link.messages[0].stamp_ns == 10**10


async def test_keeps_the_contract_of_sensors() -> None:
    async with served() as server:
        device, link = camera(server.url, rate_hz=100.0)

        async def feed() -> None:
            number = 0
            while True:
                number += 1
                server.send(part(jpeg(number % 10)))
                await asyncio.sleep(0.01)

        feeding = asyncio.create_task(feed())
        await check_sensor(device, messages=5)
        feeding.cancel()
        assert link.losses == []


async def test_torn_and_foreign_parts_are_counted_and_left_out() -> None:
    async with served() as server:
        device, link = camera(server.url)
        await device.open()
        server.send(part(jpeg(1)))
        await link.received(1)
        server.send(part(jpeg(2)[:-200]) + part(b"no picture") + part(jpeg(4)))
        await link.received(2)
        assert numbers(link) == [1, 4]
        # cut off, and closed with an end marker all the same: the decoder fills in grey
        server.send(part(jpeg(5)[:-700] + b"\xff\xd9") + part(jpeg(6)))
        await link.until(lambda link: numbers(link)[-1] == 6)
        await device.close()
    assert [name for name, _ in link.faults][:2] == ["torn picture", "part that is no picture"]
    assert 5 not in numbers(link)


async def test_a_camera_that_falls_silent_is_lost() -> None:
    async with served() as server:
        device, link = camera(server.url, silent_s=0.2)
        await device.open()
        server.send(part(jpeg(1)))
        await link.received(1)
        await link.until(lambda link: bool(link.losses))
        assert "no picture for 0.2 s" in str(link.losses[0])
        await device.close()


async def test_name_and_password_go_along_but_are_not_shown() -> None:
    async with served() as server:
        device, link = camera(f"http://me:s%40cret@127.0.0.1:{server.port}/video")
        await device.open()
        server.send(part(jpeg(1)))
        await link.received(1)
        await device.close()
    asked = base64.b64encode(b"me:s@cret")
    assert b"\r\nAuthorization: Basic " + asked + b"\r\n" in server.requests[0]
    assert link.of(CameraFrame)[0].source == f"http://127.0.0.1:{server.port}/video"


@pytest.mark.parametrize(("host", "goes_along"), [("127.0.0.1", True), ("localhost", False)])
async def test_one_redirect_is_followed_and_a_password_stays_with_its_host(host: str, goes_along: bool) -> None:
    async with served() as server:

        def respond(request: bytes) -> bytes:
            if request.startswith(b"GET /video "):
                return answer("302 Found", f"Location: http://{host}:{server.port}/real")
            return HEAD

        server.respond = respond
        device, link = camera(f"http://me:secret@127.0.0.1:{server.port}/video")
        await device.open()
        server.send(part(jpeg(1)))
        await link.received(1)
        await device.close()
    assert server.requests[1].startswith(b"GET /real ")
    assert (b"Authorization" in server.requests[1]) is goes_along


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (answer("401 Unauthorized", 'WWW-Authenticate: Basic realm="x"'), "wants a name and a password"),
        (answer("401 Unauthorized", 'WWW-Authenticate: Digest realm="x"'), "digest .*set `reader: opencv`"),
        (answer("404 Not Found"), "status 404: are address and path right"),
        (answer("302 Found", "Location: /again"), "status 302"),
        (answer("200 OK", "Content-Type: text/html"), "a web page: give the address of the stream itself"),
        (answer("200 OK", "Content-Type: image/jpeg"), "one picture: give the address of the stream"),
        (b"SSH-2.0-OpenSSH_9\r\n\r\n", "is no answer of HTTP"),
        (b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 8000, "the head of its answer does not end"),
        (b"HTTP/1.1 200 OK\r\nX: " + b"y" * 80_000, "the head of its answer does not end"),
    ],
)
async def test_answers_that_are_no_stream(reply: bytes, words: str) -> None:
    async with served() as server:
        server.respond = lambda request: reply
        device, link = camera(server.url)
        with pytest.raises(DeviceUnavailable, match="camera: `source`: no stream from http://127.*" + words):
            await device.open()
        await device.close()
    assert link.losses == []


async def test_nobody_there() -> None:
    device, _ = camera("http://me:secret@127.0.0.1:9/x")
    with pytest.raises(DeviceUnavailable, match=r"no stream from http://127.0.0.1:9/x: .*is the camera on") as raised:
        await device.open()
    assert "secret" not in str(raised.value)
    await device.close()


async def test_no_answer_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotd_devices.camera.mjpeg_http.OPEN_WITHIN_S", 0.1)
    async with served() as server:
        server.respond = lambda request: b""
        device, _ = camera(server.url)
        with pytest.raises(DeviceUnavailable, match=r"does not answer within 0\.1 s"):
            await device.open()
        await device.close()


@pytest.mark.parametrize("url", ["http://127.0.0.1:99999/", "http:///x", "http://[::1/x"])
async def test_impossible_addresses(url: str) -> None:
    with pytest.raises((DeviceMisconfigured, ValueError)):
        device, _ = camera(url)
        await device.open()


@pytest.mark.parametrize("forced", [False, True])
async def test_opencv_reads_what_is_no_mjpeg_and_what_it_is_told_to(
    monkeypatch: pytest.MonkeyPatch, forced: bool
) -> None:
    opened: list[str] = []

    def open_live(config: CameraConfig, shape: object) -> Any:
        opened.append(str(config.source))
        raise DeviceUnavailable("`source`: a stand-in")

    monkeypatch.setattr("robotd_devices.camera.driver.open_live", open_live)
    async with served() as server:
        server.respond = lambda request: answer("200 OK", "Content-Type: video/mp4")
        device, _ = camera(server.url, reader="opencv" if forced else "auto")
        with pytest.raises(DeviceUnavailable, match="a stand-in"):
            await device.open()
        await device.close()
    assert opened == [server.url]
    assert len(server.requests) == (0 if forced else 1)


@pytest.mark.parametrize(
    ("kind", "boundary"),
    [
        ("multipart/x-mixed-replace;boundary=frame", "frame"),
        ('Multipart/X-Mixed-Replace; charset=x; Boundary="a b"', "a b"),
        ("multipart/x-mixed-replace; boundary=--x; y=z", "--x"),
        ("multipart/x-mixed-replace", ""),
        ("image/jpeg", None),
    ],
)
def test_boundaries(kind: str, boundary: str | None) -> None:
    head = parse_head(f"HTTP/1.0 200 Everything is fine\r\nCONTENT-TYPE:{kind}\r\n\r\n".encode())
    assert (head.status, head.boundary) == (200, boundary)


@pytest.mark.parametrize("data", [b"HTTP/2 200\r\n\r\n", b"\r\n\r\n", b"HTTP/1.1 2000 OK\r\n\r\n"])
def test_no_answer_of_http(data: bytes) -> None:
    with pytest.raises(BrokenStream):
        parse_head(data)


@pytest.mark.parametrize(
    ("url", "first", "host"),
    [
        ("http://cam", "GET / HTTP/1.1", "Host: cam"),
        ("http://cam:81/a b?x=1&y=%20", "GET /a%20b?x=1&y=%20 HTTP/1.1", "Host: cam:81"),
        ("http://[::1]:8080/s", "GET /s HTTP/1.1", "Host: [::1]:8080"),
    ],
)
def test_requests(url: str, first: str, host: str) -> None:
    lines = request(urlsplit(url)).decode().split("\r\n")
    assert lines[:2] == [first, host]
    assert lines[-2:] == ["", ""]
