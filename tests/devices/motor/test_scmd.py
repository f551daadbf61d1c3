"""The SparkFun SCMD: its registers, its failsafe that any transaction puts off, locks, losses, the contract."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import Any

import pytest
from waiting import until

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable, I2cStop
from robotd.testing import FakeLink, ManualClock, check_actuator, connected
from robotd.world.kinematics import Mecanum
from robotd.world.messages import Drive, Odometry
from robotd.world.robot import Robot
from robotd_devices.motor import scmd
from robotd_devices.motor.jetbot_wheels import Speeds
from robotd_devices.motor.scmd import ScmdChip
from robotd_devices.motor.scmd_fake import ScmdFake
from robotd_devices.motor.scmd_motors import ScmdMotors, ScmdMotorsConfig
from robotd_devices.ports.i2c_bus import I2cWrite
from robotd_devices.ports.i2c_fake import FakeI2cBus

MS = 1_000_000
STOP = scmd.stop_writes(0x5D)


def motors(fake: FakeI2cBus, robot: Robot | None = None, **config: Any) -> tuple[ScmdMotors, FakeLink]:
    make = partial(ScmdMotors, open_bus=lambda: fake)
    return connected(make, ScmdMotorsConfig.model_validate(config), robot=robot, name="motors")


@pytest.mark.parametrize(
    ("told", "register"),
    [(0, 128), (1, 128), (2, 129), (255, 255), (128, 192), (-1, 128), (-2, 127), (-255, 1), (-128, 64)],
)
def test_levels(told: int, register: int) -> None:
    assert scmd.level(told) == register


def test_failsafe_of_the_board() -> None:
    clock = ManualClock()
    fake = ScmdFake(clock=clock.now_ns)
    bus = FakeI2cBus([fake], clock=clock.now_ns)
    chip = ScmdChip(0x5D, 0.2)
    chip.begin(bus)
    assert bus.writes[:2] == list(STOP)
    assert (fake.register(scmd.FSAFE_TIME), fake.register(scmd.FSAFE_CTRL)) == (20, 1)
    for write in chip.plan(None, Speeds(255, -255)):
        bus.write(*write)
    assert fake.voltages == (1.0, -1.0)
    clock.set_ns(clock.now_ns() + 199 * MS)
    assert fake.voltages == (1.0, -1.0)
    clock.set_ns(clock.now_ns() + 1 * MS)
    assert fake.voltages == (0.0, 0.0)
    assert fake.register(scmd.FSAFE_FAULTS) == 1
    # a read feeds it just as well: what the driver must not do
    for write in chip.plan(None, Speeds(255, 255)):
        bus.write(*write)
    for _ in range(10):
        clock.set_ns(clock.now_ns() + 150 * MS)
        bus.read(0x5D, scmd.STATUS, 1)
    assert fake.voltages == (1.0, 1.0)
    # longer writes than one register are thrown away
    bus.write(0x5D, scmd.MOTOR_A, b"\x80\x80")
    assert fake.voltages == (1.0, 1.0)
    assert fake.register(scmd.DUMPED) == 1


async def test_keeps_the_contract_of_actuators() -> None:
    bus = FakeI2cBus([ScmdFake()])
    device, link = motors(bus)

    def written() -> list[I2cWrite]:
        """Pairs of writes to the motors, as one each."""
        drives = [w for w in bus.writes if w.register in (scmd.MOTOR_A, scmd.MOTOR_B)]
        return [I2cWrite(0, 0, a.data + b.data) for a, b in zip(drives[::2], drives[1::2], strict=False)]

    await check_actuator(device, written=written, is_stop=lambda write: write.data == b"\x80\x80")
    assert link.losses == []
    assert link.faults == []


async def test_drives_turns_and_stops() -> None:
    fake = ScmdFake()
    device, link = motors(FakeI2cBus([fake]), right_reversed=True)
    await device.open()
    for drive, signs in [(Drive(0.2, 0.0), (1, -1)), (Drive(-0.2, 0.0), (-1, 1)), (Drive(0.0, 1.5), (-1, -1))]:
        device.apply(drive)
        await until(lambda signs=signs: tuple((v > 0) - (v < 0) for v in fake.voltages) == signs)
    device.halt()
    await until(lambda: fake.voltages == (0.0, 0.0))
    await device.close()
    assert link.losses == []


async def test_same_speed_is_written_again_and_silence_stops_even_though_the_thread_lives() -> None:
    fake = ScmdFake()
    device, _ = motors(FakeI2cBus([fake]), failsafe_s=0.1, check_s=0.05)
    await device.open()
    # four failsafe times on one speed
    for _ in range(20):
        device.apply(Drive(0.2, 0.0))
        await asyncio.sleep(0.02)
        assert min(fake.voltages) > 0.0
    began_s = time.monotonic()
    await until(lambda: fake.voltages == (0.0, 0.0), 1.0)
    assert time.monotonic() - began_s < 0.2
    await asyncio.sleep(0.1)
    assert fake.voltages == (0.0, 0.0)
    await device.close()


async def test_board_that_lost_its_supply_is_noticed_and_set_up_again() -> None:
    fake = ScmdFake()
    bus = FakeI2cBus([fake])
    device, link = motors(bus, check_s=0.05)
    await device.open()
    bus.power_cycle()
    await link.until(lambda link: bool(link.losses))
    assert "lost its settings (register 1F is 00, set was 01)" in str(link.losses[0])
    await device.close()
    await device.open()
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(fake.voltages) > 0.0)
    await device.close()


async def test_locks_are_opened_and_what_is_no_scmd_is_refused() -> None:
    fake = ScmdFake()
    fake.lock()
    device, _ = motors(FakeI2cBus([fake]))
    await device.open()
    assert fake.register(scmd.FSAFE_TIME) == 20
    await device.close()

    class Other(ScmdFake):
        def read(self, count: int) -> bytes:
            return b"\x00" * count

    device, _ = motors(FakeI2cBus([Other()]))
    with pytest.raises(DeviceUnavailable, match="motors: the chip at 0x5D says it is 00, an SCMD says A9"):
        await device.open()
    await device.close()
    starting = ScmdFake()
    starting.is_enumerated = False
    device, _ = motors(FakeI2cBus([starting]))
    with pytest.raises(DeviceUnavailable, match="still starts"):
        await device.open()
    await device.close()


async def test_bus_that_fails_is_a_loss() -> None:
    bus = FakeI2cBus([ScmdFake()])
    device, link = motors(bus)
    await device.open()
    bus.fail("nack", times=2)
    device.apply(Drive(0.1, 0.0))
    await link.until(lambda link: len(link.faults) == 2)
    bus.fail("nack", times=3)
    device.apply(Drive(0.1, 0.0))
    await link.until(lambda link: bool(link.losses))
    assert "no chip answers at address 0x5D" in str(link.losses[0])
    await device.close()


async def test_odometry_is_what_the_commands_lead_to() -> None:
    bus = FakeI2cBus([ScmdFake()])
    device, link = motors(bus, odometry_hz=200.0, lag_s=0.0)
    await device.open()
    device.apply(Drive(0.2, 0.0))
    await link.until(lambda link: bool(link.of(Odometry)) and link.of(Odometry)[-1].vx_mps > 0.0)
    assert link.of(Odometry)[-1].vx_mps == pytest.approx(0.198, abs=0.0025)
    device.apply(Drive(float("nan"), 0.0))
    await link.until(lambda link: link.of(Odometry)[-1].vx_mps == 0.0)
    assert [name for name, _ in link.faults] == ["no finite command"]
    await device.close()


async def test_declares_itself_and_refuses_other_bodies() -> None:
    device, _ = motors(FakeI2cBus([]), robot=Robot(kinematics=Mecanum(0.1, 0.1, 0.03)))
    with pytest.raises(DeviceMisconfigured, match=r"robot\.kinematics says mecanum"):
        await device.open()
    await device.close()
    assert device.stop_line() == I2cStop("/dev/i2c-1", ((0x5D, b"\x20\x80"), (0x5D, b"\x21\x80")))
    assert (ScmdMotors.watchdog.kind, ScmdMotors.watchdog.timeout_ms) == ("firmware", 500)
    assert ScmdMotors.publish_period_s(device.config) == 0.02
    device.apply(Drive(0.1, 0.0))  # not open: nothing
    device.halt()
