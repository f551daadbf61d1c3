"""The JetBot's motors as a device: on a fake chip in memory and behind a socket, with every fault of its bus."""

from __future__ import annotations

import asyncio
import threading
from functools import partial
from typing import Any

import pytest
from jetbot_board import STOP_WRITE, Board
from pydantic import ValidationError
from waiting import until

from robotd.authoring.device import DeviceLost, DeviceMisconfigured, DeviceUnavailable, I2cStop
from robotd.testing import FakeLink, check_actuator, connected
from robotd.world.kinematics import Mecanum
from robotd.world.messages import STOP, Drive, Odometry, Steer
from robotd.world.robot import Robot
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus


class GatedBus(Board):
    """A bus that stands still while its gate is closed, as a slow or stuck one does."""

    def __init__(self) -> None:
        super().__init__()
        self.gate = threading.Event()
        self.gate.set()
        self.waiting = threading.Event()

    def transfer(self, address: int, data: bytes, count: int = 0) -> bytes:
        if not self.gate.is_set():
            self.waiting.set()
            self.gate.wait(5.0)
        return super().transfer(address, data, count)


def motors(fake: FakeI2cBus, robot: Robot | None = None, **config: Any) -> tuple[JetBotMotors, FakeLink]:
    make = partial(JetBotMotors, open_bus=lambda: fake)
    return connected(make, JetBotMotorsConfig.model_validate(config), robot=robot, name="motors")


def on_bus(bus: str) -> tuple[JetBotMotors, FakeLink]:
    return connected(JetBotMotors, JetBotMotorsConfig(bus=bus), name="motors")


async def test_keeps_the_contract_of_actuators() -> None:
    bus = GatedBus()
    device, link = motors(bus)
    await check_actuator(device, written=lambda: bus.writes, is_stop=lambda write: write == STOP_WRITE)
    assert bus.writes[0] == STOP_WRITE
    assert link.losses == []
    assert link.faults == []


async def test_drives_turns_and_stops() -> None:
    bus = GatedBus()
    device, link = motors(bus)
    await device.open()
    assert bus.chip.pwm_hz == pytest.approx(1526, abs=1)
    for drive, signs in [(Drive(0.2, 0.0), (1, 1)), (Drive(-0.2, 0.0), (-1, -1)), (Drive(0.0, 1.5), (-1, 1))]:
        device.apply(drive)
        await until(lambda signs=signs: tuple((v > 0) - (v < 0) for v in bus.forward) == signs)
    device.apply(STOP)
    await until(lambda: bus.forward == (0.0, 0.0))
    assert bus.writes[-1] == STOP_WRITE
    await device.close()
    assert link.losses == []


async def test_slow_bus_gets_the_newest_command_only() -> None:
    bus = GatedBus()
    device, _ = motors(bus, check_s=10.0)
    await device.open()
    bus.gate.clear()
    device.apply(Drive(0.1, 0.0))
    await until(bus.waiting.is_set)
    for i in range(100):
        device.apply(Drive(0.2 + i * 0.001, 0.0))
    before = len(bus.writes)
    bus.gate.set()
    await until(lambda: bus.forward == (94 * 16 / 4096,) * 2)  # int(255 * (0.1 + 0.9 * 0.299))
    # the first command's five writes, of both boards, and the last one's three: nothing in between
    assert len(bus.writes) - before <= 8
    await device.close()


async def test_stop_overtakes_what_waits_and_breaks_off_what_is_half_written() -> None:
    bus = GatedBus()
    device, _ = motors(bus, check_s=10.0)
    await device.open()
    bus.gate.clear()
    device.apply(Drive(0.1, 0.0))
    await until(bus.waiting.is_set)
    device.apply(Drive(0.3, 0.0))
    before = len(bus.writes)
    device.halt()
    bus.gate.set()
    await until(lambda: bus.writes[-1] == STOP_WRITE)
    assert len(bus.writes) - before == 2  # the write that was under way, and the stop
    assert bus.forward == (0.0, 0.0)
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    await device.close()


async def test_command_behind_a_stop_comes_after_it() -> None:
    bus = GatedBus()
    device, _ = motors(bus, check_s=10.0)
    await device.open()
    bus.gate.clear()
    device.apply(Drive(0.1, 0.0))
    await until(bus.waiting.is_set)
    before = len(bus.writes)
    device.halt()
    device.apply(Drive(0.2, 0.0))
    bus.gate.set()
    await until(lambda: min(bus.forward) > 0.0)
    assert bus.writes[before + 1] == STOP_WRITE
    await device.close()


async def test_close_does_not_wait_for_a_stuck_bus_and_the_stop_comes_when_it_is_free() -> None:
    bus = GatedBus()
    device, link = motors(bus)
    await device.open()
    bus.gate.clear()
    device.apply(Drive(0.1, 0.0))
    await until(bus.waiting.is_set)
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    await device.close()
    assert loop.time() - began_s < 0.2
    bus.gate.set()
    await until(lambda: bus.writes[-1] == STOP_WRITE)
    assert bus.forward == (0.0, 0.0)
    assert link.losses == []


async def test_cancelled_opening_lets_go() -> None:
    bus = GatedBus()
    bus.gate.clear()
    device, _ = motors(bus)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await device.open()
    await device.close()
    bus.gate.set()
    await until(lambda: bus.writes and bus.writes[-1] == STOP_WRITE)
    await device.open()
    await device.close()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("nack", "no chip answers at address 0x60 on I2C bus /dev/i2c-1: is the board powered"),
        ("stuck", "nine clock pulses"),
        ("arbitration", "arbitration lost again and again"),
    ],
)
async def test_bus_faults(fault: Any, words: str) -> None:
    bus = GatedBus()
    device, link = motors(bus)
    bus.fail(fault)
    with pytest.raises(DeviceUnavailable, match=words):
        await device.open()
    await device.close()
    bus.heal()
    await device.open()

    # two failures are overcome
    bus.fail(fault, times=2)
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    assert [name for name, _ in link.faults] == ["I2C retry"] * 2
    assert link.losses == []

    # a third one is a loss, within 50 ms of the first; the stop is tried all the same
    bus.fail(fault, times=3)
    first = len(bus.log)
    device.apply(Drive(0.2, 0.0))
    await link.until(lambda link: bool(link.losses))
    assert isinstance(link.losses[0], DeviceLost)
    assert words in str(link.losses[0])
    await until(lambda: bus.writes[-1] == STOP_WRITE)
    failed = [entry for entry in bus.log[first:] if entry.error]
    assert len(failed) == 3
    assert bus.log[-1].now_ns - failed[0].now_ns < 50_000_000
    assert bus.forward == (0.0, 0.0)
    await device.close()
    assert len(link.losses) == 1


async def test_chip_that_lost_its_supply_is_noticed_and_set_up_again() -> None:
    bus = GatedBus()
    device, link = motors(bus, check_s=0.05)
    await device.open()
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    bus.power_cycle()
    await link.until(lambda link: bool(link.losses))
    assert "lost its settings (MODE1 11, PRESCALE 1E, set were 21, 03): its supply broke down" in str(link.losses[0])
    await device.close()
    await device.open()
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    await device.close()


async def test_something_else_at_the_address_is_refused() -> None:
    class Deaf(Pca9685Fake):
        def write(self, data: bytes, address: int) -> None:
            super().write(data[:1], address)

    device, _ = motors(FakeI2cBus([Deaf()]))
    with pytest.raises(DeviceUnavailable, match=r"motors: the chip at 0x60 .* or it is no PCA9685"):
        await device.open()
    await device.close()


async def test_error_in_the_writer_itself_is_a_loss_and_a_stop() -> None:
    class Broken(GatedBus):
        def transfer(self, address: int, data: bytes, count: int = 0) -> bytes:
            if data[:1] == b"\x2a":
                raise ZeroDivisionError("oops")
            return super().transfer(address, data, count)

    bus = Broken()
    device, link = motors(bus)
    await device.open()
    device.apply(Drive(0.1, 0.0))
    await link.until(lambda link: bool(link.losses))
    assert "the writer failed: ZeroDivisionError: oops" in str(link.losses[0])
    await until(lambda: bus.writes[-1] == STOP_WRITE)
    await device.close()


@pytest.mark.parametrize("drive", [Drive(float("nan"), 0.0), Drive(0.1, float("inf"))])
async def test_command_that_is_no_number_stops(drive: Drive) -> None:
    bus = GatedBus()
    device, link = motors(bus)
    await device.open()
    device.apply(Drive(0.1, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    device.apply(drive)
    await until(lambda: bus.forward == (0.0, 0.0))
    assert [name for name, _ in link.faults] == ["no finite command"]
    await device.close()


async def test_refuses_what_it_cannot_be() -> None:
    device, _ = motors(GatedBus(), robot=Robot(kinematics=Mecanum(0.1, 0.1, 0.03)))
    with pytest.raises(DeviceMisconfigured, match=r"robot\.kinematics says mecanum"):
        await device.open()
    with pytest.raises(TypeError, match="takes Drive, not Steer"):
        device.apply(Steer(0.1, 0.0))  # type: ignore[arg-type]
    device.apply(Drive(0.1, 0.0))  # not open: nothing
    device.halt()
    await device.close()


@pytest.mark.parametrize(
    ("bus", "words"),
    [("/none/i2c-1", r"motors: I2C bus /none/i2c-1: does not exist"), ("unix:/none/i2c", "I2C bus /none/i2c: does")],
)
async def test_absent_bus(bus: str, words: str) -> None:
    device, _ = on_bus(bus)
    with pytest.raises(DeviceUnavailable, match=words):
        await device.open()
    await device.close()


async def test_odometry_follows_what_was_written_and_not_what_was_asked() -> None:
    bus = GatedBus()
    device, link = motors(bus, odometry_hz=200.0, lag_s=0.0)
    await device.open()
    await link.received(3)
    bus.gate.clear()
    device.apply(Drive(0.2, 0.0))
    await until(bus.waiting.is_set)
    link.clear()
    await link.received(3)
    assert {m.vx_mps for m in link.of(Odometry)} == {0.0}
    bus.gate.set()
    await link.until(lambda link: link.of(Odometry)[-1].vx_mps > 0.0)
    # one of 255 steps below what was asked, at most
    assert link.of(Odometry)[-1].vx_mps == pytest.approx(0.198, abs=0.0025)
    device.halt()
    await link.until(lambda link: link.of(Odometry)[-1].vx_mps == 0.0)
    assert link.of(Odometry)[-1].x_m > 0.0
    await device.close()


async def test_odometry_can_be_switched_off() -> None:
    bus = GatedBus()
    device, link = motors(bus, odometry_hz=0.0)
    await device.open()
    device.apply(Drive(0.2, 0.0))
    await until(lambda: min(bus.forward) > 0.0)
    await asyncio.sleep(0)
    assert link.messages == []
    await device.close()
    assert JetBotMotors.publish_period_s(device.config) is None


def test_declares_itself() -> None:
    config = JetBotMotorsConfig()
    assert JetBotMotors.accepts is Drive
    assert JetBotMotors.emits == (Odometry,)
    assert JetBotMotors.sim_twin == "sim_base"
    assert (JetBotMotors.watchdog.kind, JetBotMotors.watchdog.timeout_ms) == ("none", None)
    assert JetBotMotors.publish_period_s(config) == 0.02
    assert JetBotMotors(config).stop_line() == I2cStop("/dev/i2c-1", ((0x60, b"\xfd\x10"),))


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"address": 0x80}, "address"),
        ({"wiring": "other"}, "wiring"),
        ({"top_speed_mps": 0.0}, "top_speed_mps"),
        ({"dead_band": 1.0}, "dead_band"),
        ({"speed": 1}, "speed"),
    ],
)
def test_config_refuses(config: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        JetBotMotorsConfig.model_validate(config)


@pytest.mark.parametrize(("bus", "meant"), [(0, 0), ("1", 1), ("/dev/i2c-7", "/dev/i2c-7"), ("unix:/tmp/x", "/tmp/x")])
def test_bus_in_the_config(bus: int | str, meant: int | str) -> None:
    assert JetBotMotorsConfig(bus=bus).bus == meant
