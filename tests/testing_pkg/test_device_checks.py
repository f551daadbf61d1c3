"""`connected`, `FakeLink`, `check_sensor` and `check_actuator`: the good pass, each broken device is named."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

from robotd import Battery, Config, Drive, LidarScan, Odometry, Sensor, Steer
from robotd.authoring.device import Actuator, DeviceLost
from robotd.testing import CheckFailed, ManualClock, check_actuator, check_sensor, connected, open_scan, virtual_time
from robotd.world.robot import Mount, Robot


class Rate(Config):
    period_s: float = 0.1


class Good(Sensor[Rate, LidarScan]):
    """Publishes from a timer until it is closed."""

    timer: asyncio.TimerHandle | None = None
    stamp_offset_ns = 0

    async def open(self) -> None:
        self.arm()

    def arm(self) -> None:
        self.timer = asyncio.get_running_loop().call_later(self.config.period_s, self.tick)

    def tick(self) -> None:
        self.publish(self.make(self.context.clock.now_ns() + self.stamp_offset_ns))
        self.arm()

    def make(self, stamp_ns: int) -> Any:
        return open_scan(stamp_ns=stamp_ns, beams=4)

    async def close(self) -> None:
        if self.timer is not None:
            self.timer.cancel()


class Silent(Good):
    async def open(self) -> None:
        pass


class WrongType(Good):
    def make(self, stamp_ns: int) -> Any:
        return Odometry(stamp_ns, 0.0, 0.0, 0.0)


class FromTheFuture(Good):
    stamp_offset_ns = 5


class GoesBack(Good):
    def make(self, stamp_ns: int) -> Any:
        self.stamp_offset_ns -= 200_000_000
        return super().make(stamp_ns)


class BackwardSweep(Good):
    def make(self, stamp_ns: int) -> Any:
        scan = open_scan(stamp_ns=stamp_ns, beams=4)
        return LidarScan(scan.stamp_ns, scan.ranges_m, scan.angles_rad, start_ns=stamp_ns + 1)


class Unrecordable(Good):
    def make(self, stamp_ns: int) -> Any:
        scan = open_scan(stamp_ns=stamp_ns, beams=4)
        return LidarScan(stamp_ns, scan.ranges_m, scan.angles_rad, intensities={1})  # type: ignore[arg-type]


class ClosesSlowly(Good):
    async def close(self) -> None:
        await super().close()
        await asyncio.sleep(0.3)


class NeverCloses(Good):
    async def close(self) -> None:
        await super().close()
        await asyncio.Event().wait()


class CloseRaises(Good):
    async def close(self) -> None:
        await super().close()
        raise OSError("on purpose")


class GoesOn(Good):
    async def close(self) -> None:
        asyncio.get_running_loop().call_later(0.01, self.publish, self.make(self.context.clock.now_ns()))
        await super().close()


class GetsLost(Good):
    def tick(self) -> None:
        self.lost("cable out")


class OpensOnce(Good):
    opened = False

    def arm(self) -> None:
        if self.opened and self.timer is not None and self.timer.cancelled():
            return
        self.opened = True
        super().arm()


class DeclaresNothing(Good):
    emits = ()


@virtual_time
async def test_a_good_sensor_passes_and_its_messages_come_back() -> None:
    sensor, _ = connected(Good, Rate())
    messages = await check_sensor(sensor, messages=4)
    assert len(messages) == 8
    assert asyncio.get_running_loop().time() == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (Silent, "after opening, waited 5 s in vain; so far 0 messages"),
        (WrongType, "published a Odometry, it declares LidarScan"),
        (FromTheFuture, "stamped a LidarScan 5 ns in the future"),
        (GoesBack, "the stamps of LidarScan went back by 100000000 ns"),
        (BackwardSweep, "a scan starts after its end"),
        (Unrecordable, "published a LidarScan that cannot be recorded: intensities"),
        (ClosesSlowly, r"close\(\) took 0\.300 s; 0\.2 s is the limit"),
        (NeverCloses, r"close\(\) took longer than 1 s"),
        (CloseRaises, r"close\(\) raised OSError: on purpose"),
        (GoesOn, r"published after close\(\)"),
        (GetsLost, "after opening it said that it was lost: device: cable out"),
        (OpensOnce, "after reopening, waited"),
        (DeclaresNothing, "declares no message type"),
    ],
)
@virtual_time
async def test_each_broken_sensor_is_named(cls: type[Good], complaint: str) -> None:
    sensor, _ = connected(cls, Rate())
    with pytest.raises(CheckFailed, match=complaint):
        await check_sensor(sensor)


async def test_a_device_without_a_fake_link_is_refused() -> None:
    with pytest.raises(CheckFailed, match=r"make it with robotd\.testing\.connected"):
        await check_sensor(Good(Rate()))


# ---------------------------------------------------------------------------------------------- the link


@virtual_time
async def test_the_link_collects_and_waits() -> None:
    sensor, link = connected(Good, Rate(period_s=1.0), name="lidar", robot=Robot(mounts={"lidar": Mount(x_m=0.1)}))
    assert sensor.context.mount.x_m == 0.1
    await sensor.open()
    assert len(await link.received(3)) == 3
    assert link.arrived_ns == [1_000_000_000, 2_000_000_000, 3_000_000_000]
    assert len(link.of(LidarScan)) == 3
    assert link.of(Battery) == []
    sensor.context.link.fault("checksum", "12 != 13")
    sensor.lost("cable out")
    assert link.faults == [("checksum", "12 != 13")]
    assert isinstance(link.losses[0], DeviceLost)
    link.clear()
    assert (link.messages, link.arrived_ns, link.faults, link.losses) == ([], [], [], [])
    await sensor.close()
    with pytest.raises(TimeoutError, match=r"waited 2 s in vain; so far 0 messages"):
        await link.received(1, within_s=2.0)


async def test_a_clock_can_be_given() -> None:
    sensor, link = connected(Good, Rate(), clock=ManualClock(42))
    sensor.publish(sensor.make(42))
    assert link.arrived_ns == [42]


async def test_publishing_from_a_thread_is_an_error_there() -> None:
    sensor, link = connected(Good, Rate())
    caught: list[BaseException] = []

    def publish() -> None:
        try:
            sensor.publish(sensor.make(1))
        except CheckFailed as error:
            caught.append(error)

    thread = threading.Thread(target=publish, name="grabber")
    thread.start()
    thread.join()
    assert "called on thread 'grabber'" in str(caught[0])
    assert link.messages == []


# ------------------------------------------------------------------------------------------- actuators


class Motor(Actuator[Rate, Drive]):
    """Writes to a list some time after it is told, as a driver with a queue does."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.bus: list[float] = []
        self.is_open = False

    def write(self, value: float) -> None:
        if self.is_open:
            self.bus.append(value)

    async def open(self) -> None:
        self.is_open = True
        self.write(0.0)

    def apply(self, command: Drive) -> None:
        asyncio.get_running_loop().call_later(0.001, self.write, command.vx_mps)

    def halt(self) -> None:
        self.write(0.0)

    async def close(self) -> None:
        self.write(0.0)
        self.is_open = False


class NoStopFirst(Motor):
    async def open(self) -> None:
        self.is_open = True
        self.write(0.1)


class NothingFirst(Motor):
    async def open(self) -> None:
        self.is_open = True


class NoStopLast(Motor):
    async def close(self) -> None:
        self.write(0.5)
        self.is_open = False


class HaltNeedsOpen(Motor):
    def halt(self) -> None:
        if not self.is_open:
            raise OSError("no port")
        super().halt()


class HaltDoesNothing(Motor):
    def halt(self) -> None:
        pass


class Deaf(Motor):
    def apply(self, command: Drive) -> None:
        pass


class ApplyRaises(Motor):
    def apply(self, command: Drive) -> None:
        raise OSError("no port")


class ApplyBlocks(Motor):
    def apply(self, command: Drive) -> None:
        time.sleep(0.008)


class ApplyWaits(Motor):
    async def apply(self, command: Drive) -> None:  # type: ignore[override]
        await asyncio.sleep(0)


class SteerMotor(Motor):
    accepts = Steer

    def apply(self, command: Any) -> None:
        super().apply(Drive(command.speed_mps))


async def check(cls: type[Motor], **more: Any) -> None:
    motor, _ = connected(cls, Rate())
    await check_actuator(motor, written=lambda: motor.bus, is_stop=lambda value: value == 0.0, **more)


@pytest.mark.parametrize("cls", [Motor, SteerMotor])
@virtual_time
async def test_a_good_actuator_passes(cls: type[Motor]) -> None:
    await check(cls)


@virtual_time
async def test_without_a_view_of_the_bus_only_the_calls_are_checked() -> None:
    motor, _ = connected(Deaf, Rate())
    await check_actuator(motor)


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (NoStopFirst, "the first write after opening is no stop but 0.1"),
        (NothingFirst, "nothing was written after opening"),
        (NoStopLast, "the last write before closing is no stop"),
        (HaltNeedsOpen, r"halt\(\) before opening raised OSError: no port; halt never raises"),
        (HaltDoesNothing, r"no stop was written after halt\(\)"),
        (Deaf, "after opening no command arrived"),
        (ApplyRaises, r"apply\(\) raised OSError: no port"),
        (ApplyBlocks, r"apply\(\) blocks for \d+\.\d ms"),
        (ApplyWaits, "apply is a coroutine"),
    ],
)
@virtual_time
async def test_each_broken_actuator_is_named(cls: type[Motor], complaint: str) -> None:
    with pytest.raises(CheckFailed, match=complaint):
        await check(cls)


@virtual_time
async def test_a_command_that_the_actuator_does_not_take_is_refused() -> None:
    with pytest.raises(CheckFailed, match="accepts Drive, the command to try is Steer"):
        await check(Motor, command=Steer(0.1))
    motor, _ = connected(Motor, Rate())
    with pytest.raises(ValueError, match="give both"):
        await check_actuator(motor, written=lambda: motor.bus)
