"""What motor controllers and their lines do wrong: the wheels stand within the bound, seen from the controller."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from fault_matrix import answers
from fault_robot import BODY, FaultRobot

from robotd.testing import FakeLink, connected, virtual_time
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Drive, Steer
from robotd.world.robot import Robot
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig
from robotd_devices.motor.mc import Kind
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McConfig, McMotors
from robotd_devices.motor.pca9685_fake import BridgeFake, Pca9685Fake
from robotd_devices.motor.rosmaster import Rosmaster, RosmasterConfig
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.motor.serial_motor import SerialMotor
from robotd_devices.motor.vesc import Vesc, VescConfig
from robotd_devices.motor.vesc_fake import VescFake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.memory_host import MemoryHost, now_ns

CAR = Robot(kinematics=Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.436))
TICK_S = 0.02


def on_line(cls: type[SerialMotor[Any, Any]], config: Any, fake: Any, body: Robot) -> tuple[Any, FakeLink, MemoryHost]:
    """A driver on a line in memory, not yet open."""
    line = MemoryHost(fake, config.baud)
    device, link = connected(partial(cls, make_port=line.port), config, robot=body, name="wheels")
    return device, link, line


async def hold(device: Any, command: Any, seconds: float) -> None:
    """Apply a command again and again, as the act tick does."""
    until_s = now_s() + seconds
    while now_s() < until_s:
        device.apply(command)
        await asyncio.sleep(TICK_S)


def now_s() -> float:
    return asyncio.get_running_loop().time()


# ------------------------------------------------------------------------------------------ 10, 11: the cable


@answers(10, "cable out")
def test_a_robot_whose_lidars_cable_falls_out_stands_within_50_ms(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(3.0, (2.0, lambda: robot.lidar_line.inject(fault)))
    assert robot.stood_after(2.0) <= 0.05
    assert not robot.drove_at(2.99)
    assert robot.device("lidar").losses == 1


@answers(10, "cable out")
@virtual_time
async def test_a_car_whose_own_cable_falls_out_is_stopped_by_its_controller(fault: str) -> None:
    fake = McFake()
    car, link, line = on_line(McMotors, McConfig(), fake, CAR)
    await car.open()
    await hold(car, Steer(1.0, 0.0), 0.3)
    assert fake.speed_mm_s(now_ns()) == 1000
    line.inject(fault)
    await link.until(lambda link: bool(link.losses), 0.05)
    await asyncio.sleep(car.config.ttl_ms / 1e3)
    assert fake.speed_mm_s(now_ns()) == 0
    await car.close()


@answers(11, "cable out")
def test_plugged_in_again_the_lidar_scans_within_1_s_and_the_robot_drives_when_somebody_arms_it(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch)
    times = [(2.0, 3.0), (5.0, 5.03), (7.0, 7.77)]
    events: list[tuple[float, Callable[[], object]]] = []
    for out_s, in_s in times:
        events += [(out_s, partial(robot.lidar_line.inject, fault)), (in_s, partial(robot.lidar_line.mend, fault))]
        events.append((in_s + 1.0, robot.arm))
    robot.run(9.5, *events)
    for out_s, in_s in times:
        assert robot.stood_after(out_s) <= 0.05
        assert next(now for now, _ in robot.scans if now > in_s * 1e9) / 1e9 - in_s <= 1.0
        assert not robot.drove_at(in_s + 0.99)
        assert robot.drove_at(in_s + 1.15)


@answers(11, "cable out")
def test_wheels_plugged_in_again_get_a_stop_first_and_drive_only_when_somebody_arms_the_robot(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(4.0, (2.0, lambda: robot.wheel_line.inject(fault)), (2.5, lambda: robot.wheel_line.mend(fault)))
    later = [(ns / 1e9, velocity) for ns, velocity in robot.wheels.told if ns > 2.5e9]
    assert later[0][0] <= 3.5
    assert not any(any(velocity) for _, velocity in later)
    assert robot.runtime.core.operator.armed is False


# ------------------------------------------------------------------------- 17, 18: the controller and its wheels


@answers(17, "controller silent")
@virtual_time
async def test_a_silent_controller_of_a_car_gets_no_motion_any_more_after_300_ms(fault: str) -> None:
    fake = McFake()
    car, link, _ = on_line(McMotors, McConfig(), fake, CAR)
    await car.open()
    driving = asyncio.ensure_future(hold(car, Steer(1.0, 0.0), 1.5))
    await asyncio.sleep(0.3)
    began_ns = now_ns()
    fake.inject(fault)
    await link.until(lambda link: bool(link.losses), 0.3 + TICK_S + 0.05)
    assert "is silent for 0.3 s" in str(link.losses[0])
    await car.close()
    await driving
    assert max(ns for ns, frame in fake.log if frame.kind == Kind.DRIVE) <= began_ns + 370_000_000
    assert fake.log[-1][1].payload == b"\x00", "the last word is the stop"
    assert fake.speed_mm_s(now_ns()) == 0


@answers(17, "controller silent")
def test_a_robot_whose_wheels_controller_falls_silent_stops_it_all_the_same(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(4.0, (2.0, lambda: robot.wheels.inject(fault)))
    assert robot.stood_after(2.0) <= robot.device("wheels").device.config.silent_s + 2 * TICK_S
    assert not robot.drove_at(3.99)
    assert robot.runtime.core.operator.armed is False


@answers(18, "wheel stuck")
def test_a_robot_with_a_stuck_wheel_stands_within_300_ms_until_somebody_arms_it(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(4.0, (2.0, lambda: robot.wheels.inject(fault)), (3.0, lambda: robot.wheels.mend(fault)))
    assert robot.stood_after(2.0) <= 0.3
    assert not any(robot.drove_at(2.31 + 0.1 * i) for i in range(17)), "the stop was not latched"
    assert robot.device("wheels").faults == {"wheels disagree": 1}
    assert robot.runtime.core.operator.armed is False


@answers(18, "wheel stuck")
@virtual_time
async def test_the_driver_itself_obeys_nothing_more_until_it_is_opened_anew(fault: str) -> None:
    fake = RosmasterFake()
    wheels, link, _ = on_line(Rosmaster, RosmasterConfig(), fake, BODY)
    await wheels.open()
    await hold(wheels, Drive(0.3, 0.0), 0.3)
    fake.inject(fault)
    await hold(wheels, Drive(0.3, 0.0), 1.0)
    assert fake.moving == 0.0
    assert len(link.losses) == 1
    await wheels.close()
    fake.mend(fault)
    await wheels.open()
    await hold(wheels, Drive(0.3, 0.0), 0.5)
    assert fake.velocity == (0.3, 0.0, 0.0)
    await wheels.close()


@answers(18, "over-current")
@virtual_time
async def test_a_controller_that_cut_its_motor_off_is_not_told_to_drive_on(fault: str) -> None:
    fake = VescFake()
    vesc, link, _ = on_line(Vesc, VescConfig(), fake, CAR)
    await vesc.open()
    await hold(vesc, Steer(1.0, 0.0), 0.3)
    assert fake.erpm(now_ns()) > 0
    fake.inject(fault, now_ns())
    await link.until(lambda link: bool(link.losses), 0.3)
    assert "the VESC reports over current" in str(link.losses[0])
    fake.fault = 0  # it takes its fault back by itself after half a second
    await hold(vesc, Steer(1.0, 0.0), 0.5)
    assert fake.erpm(now_ns()) == 0
    await vesc.close()


# --------------------------------------------------------------------------------------------- 19: a full line


@answers(19, "line full")
@virtual_time
async def test_of_a_full_line_the_stop_comes_first_and_nothing_old_behind_it(fault: str) -> None:
    fake = RosmasterFake()
    wheels, link, line = on_line(Rosmaster, RosmasterConfig(), fake, BODY)
    await wheels.open()
    await hold(wheels, Drive(0.1, 0.0), 0.2)
    line.inject(fault)
    for i in range(600):  # far more than the kernel takes
        wheels.apply(Drive(0.2 + 0.001 * (i % 100), 0.0))
        await asyncio.sleep(0.0003)
    halted_ns = now_ns()
    wheels.halt()
    assert line.written[-1][0] * 1e9 == pytest.approx(halted_ns, abs=1)
    line.mend(fault)
    before = len(fake.told)
    await asyncio.sleep(TICK_S)
    assert fake.told[before:]
    assert not any(any(velocity) for _, velocity in fake.told[before:])
    assert [name for name, _ in link.faults if name != "line full"] == []
    await wheels.close()


@answers(19, "line full")
def test_a_line_that_stays_full_is_given_up_after_200_ms(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(3.0, (2.0, lambda: robot.wheel_line.inject(fault)), (2.5, lambda: robot.wheel_line.mend(fault)))
    assert robot.device("wheels").losses >= 1
    after = [ns / 1e9 for ns, velocity in robot.wheels.told if ns > 2.0e9 and any(velocity)]
    assert after == [], "an old command came through"


# ------------------------------------------------------------------------------------------------- 20: the bus


async def turns(chip: Pca9685Fake) -> None:
    """Wait for the writer's thread: the left wheel turns."""
    async with asyncio.timeout(5.0):
        while True:
            if BridgeFake(chip, 8, 10, 9).voltage:
                return
            await asyncio.sleep(0.001)


@answers(20, "nack", "stuck", "arbitration")
async def test_a_bus_that_fails_is_tried_three_times_and_told_within_50_ms(fault: str) -> None:
    """The writer is a thread, so in real time."""
    chip = Pca9685Fake()
    bus = FakeI2cBus([chip])
    motors, link = connected(
        partial(JetBotMotors, open_bus=lambda: bus), JetBotMotorsConfig(check_s=10.0), name="wheels"
    )
    await motors.open()
    motors.apply(Drive(0.2, 0.0))
    await turns(chip)
    before = len(bus.log)
    bus.fail(fault)
    motors.apply(Drive(0.3, 0.0))
    await link.until(lambda link: bool(link.losses), 5.0)
    tried = [entry for entry in bus.log[before:] if entry.error]
    assert [entry.data for entry in tried[:3]] == [tried[0].data] * 3
    assert tried[2].now_ns - tried[0].now_ns <= 50_000_000
    assert [name for name, _ in link.faults] == ["I2C retry"] * 2
    bus.heal()
    await motors.close()


@answers(20, "nack", "stuck", "arbitration")
async def test_one_failure_of_a_bus_costs_5_ms_and_the_command_arrives(fault: str) -> None:
    chip = Pca9685Fake()
    bus = FakeI2cBus([chip])
    motors, link = connected(
        partial(JetBotMotors, open_bus=lambda: bus), JetBotMotorsConfig(check_s=10.0), name="wheels"
    )
    await motors.open()
    before = len(bus.log)
    bus.fail(fault, times=2)
    motors.apply(Drive(0.2, 0.0))
    await turns(chip)
    assert [bool(entry.error) for entry in bus.log[before : before + 3]] == [True, True, False]
    assert link.losses == []
    await motors.close()
