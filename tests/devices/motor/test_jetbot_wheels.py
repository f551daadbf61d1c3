"""Velocities to registers and back: the library's registers, the curve kept, never the old duty in a new direction."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.world.clock import ns
from robotd.world.kinematics import Differential
from robotd.world.messages import Drive
from robotd_devices.motor.jetbot_wheels import WIRINGS, Base, Bridge, Speeds, WheelModel, plan
from robotd_devices.motor.pca9685 import begin_writes
from robotd_devices.motor.pca9685_fake import BridgeFake, Pca9685Fake
from robotd_devices.motor.reckoning import CommandedOdometry
from robotd_devices.ports.i2c_fake import FakeI2cBus

ADDRESS = 0x60
BODY = Differential(track_m=0.118)
speeds = st.integers(-255, 255)


def library(chip: Pca9685Fake, motor: int, value: float) -> None:
    """What NVIDIA's jetbot does for `motor.value = value` (alpha 1, beta 0), after its source; written anew."""
    pwm, in1, in2 = {1: (8, 10, 9), 2: (13, 11, 12)}[motor]
    ina, inb = {1: (1, 0), 2: (2, 3)}[motor]

    def set_pwm(channel: int, on: int, off: int) -> None:
        for i, byte in enumerate((on & 0xFF, on >> 8, off & 0xFF, off >> 8)):
            chip.write(bytes((0x06 + 4 * channel + i, byte)), ADDRESS)

    mapped = int(255.0 * value)
    speed = min(max(abs(mapped), 0), 255)
    set_pwm(pwm, 0, speed * 16)
    if mapped < 0:  # FORWARD
        set_pwm(in2, 0, 4096)
        set_pwm(in1, 4096, 0)
        set_pwm(ina, 0, 0)
        set_pwm(inb, 0, speed * 16)
    else:  # BACKWARD
        set_pwm(in1, 0, 4096)
        set_pwm(in2, 4096, 0)
        set_pwm(ina, 0, speed * 16)
        set_pwm(inb, 0, 0)


def awake() -> tuple[Pca9685Fake, FakeI2cBus]:
    chip = Pca9685Fake(ADDRESS)
    bus = FakeI2cBus([chip])
    for write in begin_writes(ADDRESS, 1600.0):
        bus.write(*write)
    return chip, bus


@pytest.mark.parametrize("value", [1.0, 0.5, 0.16, 1 / 255, -1 / 255, -0.2, -1.0])
def test_outputs_are_those_of_the_library(value: float) -> None:
    theirs, _ = awake()
    library(theirs, 1, value)
    library(theirs, 2, -value)
    ours, bus = awake()
    wheel = WheelModel(top_mps=1.0)
    for write in plan(ADDRESS, "jetbot", None, Speeds(wheel.told(value), wheel.told(-value))):
        bus.write(*write)
    used = (0, 1, 2, 3, 8, 9, 10, 11, 12, 13)
    assert [ours.duty(c) for c in used] == [theirs.duty(c) for c in used]
    # where something is on, register by register
    for channel in used:
        if ours.duty(channel):
            assert ours.levels(channel) == theirs.levels(channel)


def test_128_backward_is_the_logged_128_forward_of_the_hat() -> None:
    _, bus = awake()
    for write in plan(ADDRESS, "adafruit", None, Speeds(-128, 0)):
        bus.write(*write)
    assert bus.read(ADDRESS, 0x26, 12) == bytes.fromhex("00000008 00000010 00100000")


@pytest.mark.parametrize("wiring", sorted(WIRINGS))
@given(st.lists(st.tuples(speeds, speeds), min_size=1, max_size=6))
def test_any_sequence_ends_where_it_should_and_never_shoots(wiring: str, commands: list[tuple[int, int]]) -> None:
    chip, bus = awake()
    before: Speeds | None = None
    for command in commands:
        wanted = Speeds(*command)
        allowed = [{0.0, _share(old), _share(new)} for old, new in zip(before or Speeds(), wanted, strict=True)]
        for write in plan(ADDRESS, wiring, before, wanted):
            bus.write(*write)
            for side, outputs in enumerate(WIRINGS[wiring]):
                for output in outputs:
                    assert _voltage(chip, output) in allowed[side]
        before = wanted
    assert before is not None
    for told, outputs in zip(before, WIRINGS[wiring], strict=True):
        for output in outputs:
            assert _voltage(chip, output) == _share(told)


def _share(told: int) -> float:
    return told * 16 / 4096


def _voltage(chip: Pca9685Fake, output: tuple[int, ...]) -> float:
    """Positive where the JetBot goes forward."""
    if isinstance(output, Bridge):
        return -BridgeFake(chip, *output).voltage
    ina, inb = output
    return chip.duty(ina) - chip.duty(inb)


@pytest.mark.parametrize(
    ("before", "wanted", "registers"),
    [
        # from the stop: directions of both wheels in one block, then their duties
        (None, (100, 100), [0x2A, 0x26, 0x3A]),
        ((100, 100), (120, 120), [0x26, 0x3A]),
        ((100, 100), (100, 101), [0x3A]),
        ((100, 100), (100, 100), []),
        # the left wheel turns round: quiet, direction, duty
        ((100, 100), (-100, 100), [0x26, 0x2A, 0x26]),
        ((100, 100), (0, 100), [0x26, 0x2A]),
        ((100, 100), (0, 0), [0xFD]),
        (None, (0, 0), []),
    ],
)
def test_writes_no_more_than_it_must(
    before: tuple[int, int] | None, wanted: tuple[int, int], registers: list[int]
) -> None:
    writes = plan(ADDRESS, "adafruit", Speeds(*before) if before else None, Speeds(*wanted))
    assert [write.register for write in writes] == registers


@pytest.mark.parametrize(
    ("drive", "signs"),
    [
        (Drive(0.2, 0.0), (1, 1)),
        (Drive(-0.2, 0.0), (-1, -1)),
        (Drive(0.0, 1.0), (-1, 1)),  # counter-clockwise: the right wheel goes forward
        (Drive(0.0, -1.0), (1, -1)),
        (Drive(0.0, 0.0), (0, 0)),
        (Drive(0.004, 0.0), (0, 0)),  # below still_mps
        (Drive(0.059, 1.0), (0, 1)),  # about the left wheel
    ],
)
def test_signs(drive: Drive, signs: tuple[int, int]) -> None:
    told = Base(BODY, WheelModel(), WheelModel()).speeds(drive)
    assert tuple((s > 0) - (s < 0) for s in told) == signs


models = st.builds(WheelModel, st.floats(0.2, 2.0), st.floats(0.0, 0.4), st.floats(0.5, 2.0), st.booleans())


@given(models, models, st.floats(-3.0, 3.0), st.floats(-20.0, 20.0))
def test_told_speeds_lead_back_to_the_command_or_to_a_slower_one_of_the_same_curve(
    left: WheelModel, right: WheelModel, vx_mps: float, wz_radps: float
) -> None:
    base = Base(BODY, left, right, still_mps=1e-9)
    wanted = BODY.rim_speeds(Drive(vx_mps, wz_radps))
    told = base.speeds(Drive(vx_mps, wz_radps))
    assert max(map(abs, told)) <= 255
    over = max(1.0, abs(wanted[0]) / left.fastest_mps, abs(wanted[1]) / right.fastest_mps)
    for model, got, want in zip((left, right), base.rims_mps(told), wanted, strict=True):
        # one of 255 steps, of which the fraction is dropped
        step = model.fastest_mps / (1.0 - model.dead_band) / 255.0
        assert abs(got) <= abs(want / over) + 1e-9
        assert abs(got - want / over) <= step + 1e-9


@given(st.floats(0.005, 1.0), st.floats(0.005, 1.0))
def test_faster_is_never_told_less_and_moving_is_above_the_dead_band(a_mps: float, b_mps: float) -> None:
    wheel = WheelModel(1.0, 0.1)
    slow, fast = sorted((a_mps, b_mps))
    assert 25 <= wheel.told(slow) <= wheel.told(fast) <= 255


def test_gain_turns_a_wheel_up() -> None:
    assert WheelModel(1.0, 0.1, gain=1.1).told(0.3) > WheelModel(1.0, 0.1).told(0.3)
    assert WheelModel(1.0, 0.1, reversed=True).told(0.3) == -WheelModel(1.0, 0.1).told(0.3)


# ------------------------------------------------------------------------------------------ odometry


def test_odometry_without_lag_is_the_arc() -> None:
    odometry = CommandedOdometry(Differential(track_m=0.118), lag_s=0.0)
    odometry.start(0)
    odometry.tell(BODY.rim_speeds(Drive(1.0, math.pi / 2.0)), 0)
    at = odometry.at(ns(1.0))
    assert (at.x_m, at.y_m, at.yaw_rad) == pytest.approx((2 / math.pi, 2 / math.pi, math.pi / 2), abs=1e-9)
    assert (at.vx_mps, at.wz_radps) == pytest.approx((1.0, math.pi / 2.0))


def test_odometry_lags_and_catches_up_after_the_stop() -> None:
    odometry = CommandedOdometry(BODY, lag_s=0.08)
    odometry.start(0)
    odometry.tell((0.2, 0.2), 0)
    at = odometry.at(ns(0.08))
    assert at.vx_mps == pytest.approx(0.2 * (1 - math.exp(-1)))
    # v * (t - tau (1 - e^(-t / tau)))
    assert at.x_m == pytest.approx(0.2 * 0.08 * math.exp(-1))
    odometry.tell((0.0, 0.0), ns(1.0))
    assert odometry.at(ns(3.0)).x_m == pytest.approx(0.2, abs=1e-4)  # as far as without a lag
    assert odometry.at(ns(3.0)).vx_mps == 0.0


def test_odometry_is_the_same_however_often_it_is_asked() -> None:
    often, once = CommandedOdometry(BODY, 0.08), CommandedOdometry(BODY, 0.08)
    for odometry in (often, once):
        odometry.start(0)
        odometry.tell((0.1, 0.3), 0)
    for tick in range(1, 1000):
        often.at(ns(tick * 0.001))
    a, b = often.at(ns(1.0)), once.at(ns(1.0))
    assert (a.x_m, a.y_m, a.yaw_rad) == pytest.approx((b.x_m, b.y_m, b.yaw_rad), abs=2e-4)


def test_odometry_stands_over_a_reconnect() -> None:
    odometry = CommandedOdometry(BODY, 0.0)
    odometry.start(0)
    odometry.tell((0.1, 0.1), 0)
    there = odometry.at(ns(1.0))
    odometry.start(ns(5.0))
    again = odometry.at(ns(6.0))
    assert (again.x_m, again.vx_mps) == (there.x_m, 0.0)
