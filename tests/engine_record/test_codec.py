"""The codec: whatever a message may hold comes back bit for bit, and no bytes do harm."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydantic import Field

from robotd import CameraFrame, Detections, Drive, Goal, LidarScan, Message, Odometry, Target
from robotd.engine.codec import RecordError, allow, class_name, decode, encode, to_viewer_json, viewer_schema
from robotd.world.messages import ActiveGoal, Applied, Detection, Mode, ModeChange, Outcome


class Flags(enum.Flag):
    A = 1
    B = 2


class Level(enum.IntEnum):
    LOW = 1


class Visit(Goal):
    places: tuple[str, ...] = ()
    speed_mps: float = Field(default=0.2, gt=0.0)
    again: dict[str, list[int]] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Everything(Message):
    value: Any = None
    other: Any = None


CLASSES = allow(
    LidarScan, CameraFrame, Detections, ModeChange, ActiveGoal, Applied, Outcome, Everything, Visit, Odometry, Target,
    Flags, Level,
)  # fmt: skip


def same(one: Any, two: Any) -> bool:
    """Equal type by type and bit by bit."""
    if type(one) is not type(two):
        return False
    if isinstance(one, float):
        return struct.pack(">d", one) == struct.pack(">d", two)
    if isinstance(one, np.ndarray | np.generic):
        return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
    if isinstance(one, tuple | list):
        return len(one) == len(two) and all(same(a, b) for a, b in zip(one, two, strict=True))
    if isinstance(one, dict):
        return same(list(one.items()), list(two.items()))
    if isinstance(one, Goal):
        return same(dict(one), dict(two)) and one.model_fields_set == two.model_fields_set
    if dataclasses.is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(two, f.name)) for f in dataclasses.fields(one))
    return bool(one == two)


PLAIN = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=True, allow_infinity=True)
    | st.text(st.characters())
    | st.binary(max_size=20)
    | st.sampled_from([Mode.ESTOP, Flags.A | Flags.B, Flags(0), Level.LOW, -0.0, math.nan, -math.inf, 5e-324])
    | st.builds(Drive, st.floats(), st.floats(), st.floats())
)
ARRAYS = hnp.arrays(
    hnp.scalar_dtypes() | hnp.array_dtypes(max_size=3, allow_subarrays=True),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
VALUES = st.recursive(
    PLAIN | ARRAYS,
    lambda inner: (
        st.lists(inner, max_size=4).map(tuple)
        | st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=5), inner, max_size=3)
        | st.builds(Everything, stamp_ns=st.integers(0, 1 << 62), value=inner, other=inner)
    ),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(VALUES)
def test_every_value_comes_back_bit_for_bit(value: Any) -> None:
    assert same(decode(encode(value), CLASSES), value)


@pytest.mark.parametrize(
    "message",
    [
        Odometry(1, math.inf, -0.0, math.nan),
        ModeChange(2, Mode.MANUAL, "lease of 'page'"),
        ActiveGoal(3, "visit", Visit(places=("A", "Đà Nẵng"), again={"x": [1, 2]})),
        ActiveGoal(3, "visit", Visit()),
        Applied(4, Drive(0.1, -0.2), "follow", ("stop zone front",)),
        Detections(5, (Detection("stop", 0.9, 1.0, 2.0, 3.0, 4.0),), 640, 480),
        Target(6, 0.25),
        Everything(7, np.float32(0.1), np.float64(-0.0)),
        Everything(8, frozenset({1, "a"}), b"\x00\xff"),
        Everything(9, "lone surrogate \ud800", 1 << 200),
    ],
    ids=lambda message: type(message).__name__,
)
def test_messages_come_back(message: Message) -> None:
    assert same(decode(encode(message), CLASSES), message)


def test_a_scan_comes_back_read_only_and_aligned() -> None:
    ranges = np.array([1.0, np.inf, np.nan, -0.0, 0.05], np.float32)
    scan = LidarScan(7, ranges, np.linspace(0, 1, 5, dtype=np.float32), intensities=np.arange(5, dtype=np.uint8))
    back = decode(encode(scan), CLASSES)
    assert same(back, scan)
    for array in (back.ranges_m, back.angles_rad, back.intensities):
        assert not array.flags.writeable
        assert array.flags.aligned
        assert array.flags.c_contiguous


@pytest.mark.parametrize("order", ["C", "F"])
def test_memory_order_is_kept_and_strides_become_c(order: Any) -> None:
    array = np.asarray(np.arange(12.0).reshape(3, 4), order=order)
    back = decode(encode(array), {})
    assert (back.flags.c_contiguous, back.flags.f_contiguous) == (order == "C", order == "F")
    assert np.array_equal(back, array)
    strided = np.arange(20.0)[::-3]
    back = decode(encode(strided), {})
    assert back.flags.c_contiguous
    assert np.array_equal(back, strided)


def test_decoding_does_not_run_the_class() -> None:
    @dataclass(frozen=True)
    class Doubles:
        value: float

        def __post_init__(self) -> None:
            object.__setattr__(self, "value", self.value * 2.0)

    made = Doubles(1.0)
    assert made.value == 2.0
    assert decode(encode(made), {class_name(Doubles): Doubles}).value == 2.0


def test_a_field_that_came_later_takes_its_default() -> None:
    head = {"c": [class_name(Detection), {"name": "stop", "score": 1.0}]}
    with pytest.raises(RecordError, match="lacks its field 'left_px'"):
        decode(_with_head(head), CLASSES)
    head = {"c": [class_name(Drive), {"vx_mps": 0.5}]}
    assert decode(_with_head(head), CLASSES) == Drive(0.5)


@pytest.mark.parametrize(
    ("value", "where"),
    [
        (Everything(1, {1, 2}), "value: a builtins:set"),
        (Everything(1, (1, object())), r"value\[1\]: a builtins:object"),
        (Everything(1, {"a": lambda: None}), r"value\['a'\]: a builtins:function"),
        (Everything(1, np.array([None])), "value: an array of Python objects"),
        (Everything, "the value: a builtins:type"),
    ],
)
def test_what_cannot_be_recorded_is_named(value: Any, where: str) -> None:
    with pytest.raises(RecordError, match=where):
        encode(value)


def test_allow_finds_what_the_fields_name() -> None:
    assert set(allow(Detections)) == {class_name(Detections), class_name(Detection)}
    assert class_name(Mode) in allow(ModeChange)


def test_only_allowed_classes_are_made() -> None:
    data = encode(Target(1, 0.5))
    with pytest.raises(RecordError, match=r"class 'robotd\.world\.messages:Target' is not among"):
        decode(data, allow(Odometry))
    with pytest.raises(RecordError, match="not of the recorded kind"):
        decode(data, {class_name(Target): Mode})


def _with_head(head: Any, tail: bytes = b"") -> bytes:
    text = head if isinstance(head, bytes) else json.dumps(head).encode()
    return b"\x01" + len(text).to_bytes(4, "little") + text + tail


ODOMETRY = class_name(Odometry)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "byte 0: cut off"),
        (b"\x01\x00", "byte 2: cut off"),
        (b"\x09\x00\x00\x00\x00", "byte 0: version 9"),
        (b"\x01\xff\x00\x00\x00{}", "byte 7: cut off, the head should end at byte 260"),
        (_with_head(b'{"x": ]'), "byte 11: the head is no JSON"),
        (_with_head(b'"\xff"'), "byte 6: the head is no JSON"),
        (_with_head(b"[" * 100_000), "the head cannot be read"),
        (_with_head({"q": 1}), "unknown kind 'q'"),
        (_with_head({"x": "00", "b": 1}), "expected an object with one key"),
        (_with_head({"x": "00"}), "byte 16: error: unpack"),
        (_with_head({"b": 5}, b"abc"), "cut off, expected 5 more bytes, there are 3"),
        (_with_head({"b": -1}, b"abc"), "cut off"),
        (_with_head(1, b"abc"), "3 bytes too many"),
        (_with_head({"a": ["<f4", [2], "C", 7]}, b"0" * 8), "has not 7 bytes"),
        (_with_head({"a": ["|O8", [1], "C", 8]}, b"0" * 8), "no dtype"),
        (_with_head({"a": ["<f4", [-1, -2], "C", 8]}, b"0" * 8), "impossible array"),
        (_with_head({"a": ["<f4", [2], "K", 8]}, b"0" * 8), "impossible array"),
        (_with_head({"c": ["os:system", {}]}), "not among"),
        (_with_head({"c": [ODOMETRY, {"nonsense": 1}]}), "has no field 'nonsense'"),
        (_with_head({"c": [ODOMETRY, {}]}), "lacks its field 'stamp_ns'"),
        (_with_head({"m": [class_name(Visit), {"nonsense": 1}, []]}), "has no field 'nonsense'"),
        (_with_head({"e": [class_name(Mode), "NOWHERE"]}), "KeyError"),
    ],
)
def test_bytes_that_are_no_value_are_refused_with_the_place(data: bytes, complaint: str) -> None:
    with pytest.raises(RecordError, match=complaint.replace("[", r"\[")):
        decode(data, CLASSES)


SAMPLE = encode(
    (
        LidarScan(7, np.ones(4, np.float32), np.ones(4, np.float32)),
        ActiveGoal(3, "visit", Visit(places=("A",))),
        Mode.AUTO,
        np.zeros(2, [("a", "<f4", (2,)), ("b", "u1")]),
        {"k": [math.nan, b"raw", np.float32(1)]},
    )
)


@settings(max_examples=500, deadline=None)
@given(st.data())
def test_no_damage_raises_anything_but_a_record_error(data: st.DataObject) -> None:
    broken = bytearray(SAMPLE)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(broken) - 1))
        broken[at] = (
            data.draw(st.sampled_from(list(b'[]{}",:0123456789eE-+.abcCFl<f|'))) if data.draw(st.booleans()) else 0
        )
    if data.draw(st.booleans()):
        del broken[data.draw(st.integers(0, len(broken))) :]
    try:
        decode(bytes(broken), CLASSES)
    except RecordError as error:
        assert str(error).startswith("byte ")


# ----------------------------------------------------------------------------------------- for viewers


@given(VALUES)
@example(Everything(1, np.array(np.nan), np.zeros((480, 640, 3), np.uint8)))
@settings(max_examples=100, deadline=None)
def test_viewers_get_strict_json(value: Any) -> None:
    text = to_viewer_json(value)

    def refuse(token: str) -> None:
        raise AssertionError(token)

    json.loads(text, parse_constant=refuse)


def test_a_viewer_copy_is_thinned_rounded_and_null_where_there_is_no_number() -> None:
    ranges = np.full(1000, 0.1, np.float32)
    ranges[:4] = (np.inf, 1.0, 2.0, np.nan)
    copy = json.loads(to_viewer_json(LidarScan(7, ranges, np.zeros(1000, np.float32))))
    assert copy["ranges_m"][:3] == [None, None, 0.1]
    assert len(copy["ranges_m"]) == len(copy["angles_rad"]) == 334
    assert copy["range_max_m"] is None
    assert json.loads(to_viewer_json(ModeChange(1, Mode.AUTO)))["mode"] == "auto"
    frame = json.loads(to_viewer_json(CameraFrame(1, np.zeros((4, 6, 3), np.uint8))))
    assert frame["bgr"] == {"dtype": "uint8", "shape": [4, 6, 3]}


def test_a_viewer_schema_names_every_field() -> None:
    schema = viewer_schema(LidarScan)
    assert list(schema["properties"]) == [field.name for field in dataclasses.fields(LidarScan)]
    assert schema["properties"]["ranges_m"] == {"type": "array", "items": {"type": "number"}}
    assert viewer_schema(ModeChange)["properties"]["mode"] == {"type": "string"}
    assert viewer_schema(int)["type"] == "object"
