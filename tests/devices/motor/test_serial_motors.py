"""What all drivers on a serial line share, on each of them: the contract, losses, full lines, the stop as data."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from serial_motors import CAR, MECANUM, TWO_WHEELS, Motor, hold, motor, now_ns, when

from robotd.authoring.device import DeviceLost, DeviceMisconfigured, DeviceUnavailable, SerialStop
from robotd.testing import check_actuator, virtual_time
from robotd.world.kinematics import Kinematics
from robotd.world.messages import Drive, Odometry, Steer
from robotd_devices.motor import arduino_bridge_lines, roboclaw_packets, rosmaster_packets, vesc_packets
from robotd_devices.motor.arduino_bridge import ArduinoBridge
from robotd_devices.motor.arduino_bridge_fake import ArduinoBridgeFake
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McMotors
from robotd_devices.motor.roboclaw import RoboClaw
from robotd_devices.motor.roboclaw_fake import RoboClawFake
from robotd_devices.motor.rosmaster import Rosmaster
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.motor.vesc import Vesc
from robotd_devices.motor.vesc_fake import VescFake


@dataclass(frozen=True)
class Case:
    """A driver, its fake, what the fake's motors do now, and the robot that it belongs to."""

    cls: type[Motor]
    fake: type[Any]
    turns: Callable[[Any, int], float]
    """0 where the motors stand."""
    asks: Callable[[bytes], bool]
    """Whether a write is a question or a heartbeat."""
    body: Kinematics
    other: Kinematics
    config: dict[str, Any] = field(default_factory=dict)
    line_s: float = 0.0
    """Time of the stop's bytes on the wire."""
    boot_s: float = 0.0
    """How long it hears nothing after opening."""

    @property
    def command(self) -> Any:
        return Steer(0.5, 0.1) if self.cls.accepts is Steer else Drive(0.2, 0.3)


CASES = {
    "mc": Case(
        McMotors,
        McFake,
        lambda fake, at: fake.speed_mm_s(at),
        lambda data: len(data) == 13,
        CAR,
        TWO_WHEELS,
        line_s=0.0002,
    ),
    "vesc": Case(
        Vesc,
        VescFake,
        lambda fake, at: fake.erpm(at),
        lambda data: data in (vesc_packets.ask_values(), vesc_packets.ask_version()),
        CAR,
        TWO_WHEELS,
        line_s=0.0018,
    ),
    "rosmaster": Case(
        Rosmaster,
        RosmasterFake,
        lambda fake, at: fake.moving,
        lambda data: data == rosmaster_packets.auto_report(True),
        MECANUM,
        TWO_WHEELS,
        # the board may lose the first stop behind a command
        line_s=0.0022 + 0.0072,
    ),
    "roboclaw": Case(
        RoboClaw,
        RoboClawFake,
        lambda fake, at: float(sum(map(abs, fake.speed_qpps(at)))),
        lambda data: len(data) == 2 or data[1] == roboclaw_packets.SET_TIMEOUT,
        TWO_WHEELS,
        CAR,
        line_s=0.0052,
    ),
    "arduino_bridge": Case(
        ArduinoBridge,
        ArduinoBridgeFake,
        lambda fake, at: float(sum(map(abs, fake.ticks(at)))),
        lambda data: data == arduino_bridge_lines.encoders(),
        TWO_WHEELS,
        CAR,
        line_s=0.0013,
        boot_s=1.5,
    ),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def made(case: Case, **config: Any) -> Any:
    fake = case.fake()
    return fake, *motor(case.cls, fake, case.body, **case.config, **config)


@virtual_time
async def test_keeps_the_contract_of_actuators(case: Case) -> None:
    _, device, link, line = made(case)
    stop = device.stop_bytes()
    await check_actuator(
        device,
        written=lambda: [data for _, data in line.writes if not case.asks(data)],
        is_stop=lambda data: data == stop,
        command=case.command,
    )
    assert link.losses == []
    assert link.faults == []


@virtual_time
async def test_stop_comes_first_and_last(case: Case) -> None:
    fake, device, _, line = made(case)
    for _ in range(2):
        count = len(line.writes)
        await device.open()
        assert line.writes[count][1] == device.stop_bytes()
        await hold(device, case.command, 0.3)
        assert case.turns(fake, now_ns()) != 0.0
        began_s = asyncio.get_running_loop().time()
        await device.close()
        assert asyncio.get_running_loop().time() - began_s < 0.2
        assert line.writes[-1][1] == device.stop_bytes()
        assert case.turns(fake, now_ns()) == 0.0
        await device.close()


@virtual_time
async def test_halt_stops_the_motors_at_once_and_is_written_twice(case: Case) -> None:
    fake, device, _, line = made(case)
    await device.open()
    for _ in range(5):
        await hold(device, case.command, 0.3)
        assert case.turns(fake, now_ns()) != 0.0
        device.halt()
        assert await when(lambda: case.turns(fake, now_ns()) == 0.0) <= 0.002 + case.line_s
        count = sum(data == device.stop_bytes() for _, data in line.writes)
        await asyncio.sleep(0.05)
        assert sum(data == device.stop_bytes() for _, data in line.writes) == count + 1
        assert case.turns(fake, now_ns()) == 0.0
    await device.close()


@virtual_time
async def test_command_right_behind_a_stop_comes_after_both_stops(case: Case) -> None:
    fake, device, _, line = made(case)
    await device.open()
    await asyncio.sleep(0.1)
    count = len(line.writes)
    device.halt()
    for _ in range(3):
        device.apply(case.command)
    await when(lambda: case.turns(fake, now_ns()) != 0.0)
    stops = [i for i, (_, data) in enumerate(line.writes[count:]) if data == device.stop_bytes()]
    assert len(stops) == 2
    await device.close()


@virtual_time
async def test_full_line_keeps_the_newest_command_only_and_the_stop_goes_first(case: Case) -> None:
    fake, device, link, line = made(case, silent_s=10.0)
    await device.open()
    await hold(device, case.command, 0.1)
    line.is_stuck = True
    # the kernel's buffer fills; what waits behind it is thrown away with it and replaced
    for _ in range(2000):
        device.apply(case.command)
        if device.gap_s:
            await asyncio.sleep(device.gap_s)
    # one that fills slowly is given up before it is full
    assert "line full" in {name for name, _ in link.faults} or "takes no bytes" in str(link.losses[0])
    device.halt()
    line.is_stuck = False
    assert await when(lambda: case.turns(fake, now_ns()) == 0.0) <= 0.002 + case.line_s
    await asyncio.sleep(0.5)
    assert case.turns(fake, now_ns()) == 0.0
    await device.close()


@virtual_time
async def test_frame_that_was_cut_in_two_does_not_spoil_the_stop(case: Case) -> None:
    """A stop pre-empts a frame of which any number of bytes left already."""
    fake, device, _, line = made(case, silent_s=10.0)
    await device.open()
    await hold(device, case.command, 0.1)
    frame = device.frame(case.command)
    for cut in range(1, len(frame)):
        await hold(device, case.command, 0.08)
        assert case.turns(fake, now_ns()) != 0.0
        line.is_stuck = True
        await asyncio.sleep(0.012)
        fake.feed(frame[:cut], now_ns())
        device.halt()
        line.is_stuck = False
        assert await when(lambda: case.turns(fake, now_ns()) == 0.0, 0.05) <= 0.002 + case.line_s, cut
        await asyncio.sleep(0.03)
        assert case.turns(fake, now_ns()) == 0.0, cut
    await device.close()


@virtual_time
async def test_unplugged_and_back(case: Case) -> None:
    _, device, link, line = made(case)
    tasks = len(asyncio.all_tasks())
    for i in range(20):
        await device.open()
        await hold(device, case.command, 0.2 + 0.003 * i)
        line.unplug()
        await when(lambda i=i: len(link.losses) == i + 1, 0.05)
        assert isinstance(link.losses[-1], DeviceLost)
        device.apply(case.command)
        device.halt()
        await device.close()
        with pytest.raises(DeviceUnavailable, match="is the cable in"):
            await device.open()
        await device.close()
        line.plug()
        count = len(line.writes)
        began_s = asyncio.get_running_loop().time()
        await device.open()
        assert asyncio.get_running_loop().time() - began_s < 1.0 + case.boot_s
        assert line.writes[count][1] == device.stop_bytes()
        await device.close()
    assert len(asyncio.all_tasks()) == tasks


@virtual_time
async def test_silent_controller_is_a_loss_and_a_stop(case: Case) -> None:
    fake, device, link, _ = made(case, silent_s=0.4)
    await device.open()
    await hold(device, case.command, 0.3)
    fake.is_mute = True
    await when(lambda: bool(link.losses), 0.6)
    assert "silent for" in str(link.losses[0])
    await asyncio.sleep(0.05)
    assert case.turns(fake, now_ns()) == 0.0
    await device.close()
    with pytest.raises(DeviceUnavailable, match=r"motors: no answer on .* baud for [24] s: "):
        await device.open()
    await device.close()
    fake.is_mute = False
    await device.open()
    await device.close()


@virtual_time
async def test_stops_in_step_with_its_questions_do_not_keep_it_shut(case: Case) -> None:
    """A robot that stands repeats its stop, and for a moment after each of them no question may be written."""
    _, device, _, _ = made(case)
    loop = asyncio.get_running_loop()
    until_s = loop.time() + 3.0

    def stop_again() -> None:
        device.halt()
        if loop.time() < until_s:
            loop.call_later(0.05, stop_again)

    stop_again()
    began_s = loop.time()
    await device.open()
    assert loop.time() - began_s < case.boot_s + 0.5
    await device.close()


@virtual_time
async def test_loss_while_opening_is_known_at_once(case: Case) -> None:
    fake, device, _, line = made(case)
    fake.is_mute = True
    asyncio.get_running_loop().call_later(0.1, line.unplug)
    began_s = asyncio.get_running_loop().time()
    with pytest.raises(DeviceUnavailable, match="went away"):
        await device.open()
    assert asyncio.get_running_loop().time() - began_s < 0.2
    await device.close()


@virtual_time
async def test_command_that_is_no_number_stops(case: Case) -> None:
    fake, device, link, _ = made(case)
    await device.open()
    await hold(device, case.command, 0.2)
    device.apply(type(case.command)(math.nan, 0.0))
    await asyncio.sleep(0.02)
    assert case.turns(fake, now_ns()) == 0.0
    assert [name for name, _ in link.faults] == ["no finite command"]
    await device.close()


@virtual_time
async def test_refuses_other_bodies_and_other_commands(case: Case) -> None:
    device, _, _ = motor(case.cls, case.fake(), case.other, **case.config)
    with pytest.raises(DeviceMisconfigured, match=r"robot\.kinematics says"):
        await device.open()
    await device.close()
    wrong = Drive(0.1, 0.0) if case.cls.accepts is Steer else Steer(0.1, 0.0)
    with pytest.raises(TypeError, match="motors takes"):
        device.apply(wrong)
    device.apply(case.command)  # not open: nothing
    device.halt()


@virtual_time
async def test_stop_as_data_stops_the_motors(case: Case) -> None:
    fake, device, _, _ = made(case)
    await device.open()
    await hold(device, case.command, 0.2)
    stop = device.stop_line()
    assert isinstance(stop, SerialStop)
    assert stop.path == device.path
    # as the guardian writes it, into the middle of a frame
    fake.feed(device.frame(case.command)[:5] + stop.data, now_ns())
    assert case.turns(fake, now_ns()) == 0.0
    await device.close()


@virtual_time
async def test_frozen_program_wakes_up_to_a_stop(case: Case) -> None:
    """A command that waited behind a stop while the process stood still is not written any more."""
    fake, device, _, _ = made(case)
    await device.open()
    await hold(device, case.command, 0.2)
    device.halt()
    device.apply(case.command)
    inner = device._line
    inner._wanted_s -= 0.1
    await asyncio.sleep(0.1)
    assert case.turns(fake, now_ns()) == 0.0
    await device.close()


def test_declares_itself(case: Case) -> None:
    config = case.cls.config_type.model_validate(case.config)
    assert case.cls.sim_twin == ("sim_car" if case.cls.accepts is Steer else "sim_base")
    assert Odometry in case.cls.emits
    assert case.cls.watchdog.kind in ("firmware", "none")
    assert (case.cls.publish_period_s(config) or 0.0) > 0.0
