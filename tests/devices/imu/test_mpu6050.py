"""The MPU family: bytes of the wire, ranges, base axes through the mount, zeroing, a chip that hangs, wrong chips."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import FakeLink, ManualClock, check_sensor, connected
from robotd.world.clock import ns
from robotd.world.messages import Imu
from robotd.world.robot import Mount, Robot
from robotd_devices.imu import Mpu6050, Mpu6050Config
from robotd_devices.imu import mpu_chip as chip
from robotd_devices.imu.mpu_fake import MpuFake
from robotd_devices.imu.zeroing import zero
from robotd_devices.ports.i2c_fake import FakeI2cBus

G = chip.GRAVITY_MPS2


def unit(fake: MpuFake, mount: Mount | None = None, **config: Any) -> tuple[Mpu6050, FakeLink, FakeI2cBus]:
    bus = FakeI2cBus([fake])
    made, link = connected(
        partial(Mpu6050, open_bus=lambda: bus),
        Mpu6050Config(**config),
        robot=Robot(mounts={"imu": mount or Mount()}),
        name="imu",
    )
    return made, link, bus


def test_bytes_of_a_sample() -> None:
    raw = chip.SAMPLE.unpack(bytes.fromhex("4000c00020000000008300000000"[:28]))
    assert chip.forces_mps2(raw, 2).tolist() == pytest.approx([G, -G, G / 2])
    # register map, section 4.19: 131 steps a degree a second at 250 degrees a second
    assert chip.rates_radps(raw, 250).tolist() == pytest.approx([math.radians(131 / 131.072), 0.0, 0.0])


@pytest.mark.parametrize(
    ("rate_hz", "setting"), [(500, 1), (368, 1), (200, 2), (100, 3), (50, 4), (20, 5), (10, 6), (5, 6)]
)
def test_low_pass_lies_below_half_the_rate(rate_hz: float, setting: int) -> None:
    assert chip.filter_for(rate_hz) == setting


@pytest.mark.parametrize(("identity", "filters"), [(0x68, False), (0x70, True), (0x71, True), (0x73, True)])
def test_settings_of_each_model(identity: int, filters: bool) -> None:
    fake = MpuFake(who_am_i=identity)
    Mpu6050(Mpu6050Config(gyro_range_dps=1000, accel_range_g=8)).begin(FakeI2cBus([fake]))
    kept = fake.registers
    assert (kept[chip.GYRO_CONFIG], kept[chip.ACCEL_CONFIG], kept[chip.CONFIG]) == (0x10, 0x10, 3)
    assert kept[chip.ACCEL_CONFIG_2] == (3 if filters else 0)
    assert kept[chip.POWER_1] == chip.CLOCK_GYRO


@pytest.mark.parametrize(("gyro", "accel"), [(250, 2), (500, 4), (1000, 8), (2000, 16)])
def test_every_range_gives_the_same_units(gyro: Any, accel: Any) -> None:
    fake, config = MpuFake(noise=0.0), Mpu6050Config(gyro_range_dps=gyro, accel_range_g=accel)
    fake.rates_radps, fake.forces_mps2 = (0.5, -1.0, 2.0), (1.0, -2.0, 9.0)
    bus = FakeI2cBus([fake])
    Mpu6050(config).begin(bus)
    raw = Mpu6050(config).read(bus)
    np.testing.assert_allclose(chip.rates_radps(raw, gyro), fake.rates_radps, atol=math.radians(gyro) / chip.FULL)
    np.testing.assert_allclose(chip.forces_mps2(raw, accel), fake.forces_mps2, atol=accel * G / chip.FULL)


@pytest.mark.parametrize(
    ("mount", "rates", "forces"),
    [
        (Mount(), (0.1, 0.2, 0.3), (1.0, 2.0, 9.0)),
        (Mount(yaw_rad=math.pi / 2), (-0.2, 0.1, 0.3), (-2.0, 1.0, 9.0)),
        (Mount(roll_rad=math.pi), (0.1, -0.2, -0.3), (1.0, -2.0, -9.0)),  # head down
        (Mount(pitch_rad=math.pi / 2), (0.3, 0.2, -0.1), (9.0, 2.0, -1.0)),
    ],
)
async def test_base_axes_through_the_mount(mount: Mount, rates: Any, forces: Any) -> None:
    fake = MpuFake()
    fake.rates_radps, fake.forces_mps2 = (0.1, 0.2, 0.3), (1.0, 2.0, 9.0)
    device, link, _ = unit(fake, mount, zero_s=0.0)
    await device.open()
    await link.received(1)
    await device.close()
    seen = link.of(Imu)[0]
    np.testing.assert_allclose((seen.wx_radps, seen.wy_radps, seen.wz_radps), rates, atol=0.005)
    np.testing.assert_allclose((seen.ax_mps2, seen.ay_mps2, seen.az_mps2), forces, atol=0.05)


async def test_offsets_and_factors_are_about_the_chips_own_axes() -> None:
    fake = MpuFake()
    fake.rates_radps, fake.forces_mps2 = (0.6, 0.0, 0.0), (0.0, 5.0, 0.0)
    device, link, _ = unit(
        fake,
        Mount(yaw_rad=math.pi / 2),
        zero_s=0.0,
        gyro_offset_radps=(0.1, 0.0, 0.0),
        gyro_scale=(2.0, 1.0, 1.0),
        accel_offset_mps2=(0.0, 1.0, 0.0),
        accel_scale=(1.0, 0.5, 1.0),
    )
    await device.open()
    await link.received(1)
    await device.close()
    assert link.of(Imu)[0].wy_radps == pytest.approx(1.0, abs=0.01)
    assert link.of(Imu)[0].ax_mps2 == pytest.approx(-2.0, abs=0.05)


async def test_keeps_the_contract_of_sensors() -> None:
    fake = MpuFake()
    device, link, _ = unit(fake, zero_s=0.05, rate_hz=200.0)
    published = await check_sensor(device, messages=5)
    assert link.losses == [] and link.faults == []
    assert {type(message) for message in published} == {Imu}
    # it was true before it was read, by the low-pass's delay
    assert link.arrived_ns[-1] - link.messages[-1].stamp_ns >= ns(chip.FILTERS[1][1])


async def test_rates_at_rest_are_measured_at_opening_and_taken_off() -> None:
    fake = MpuFake()
    fake.rates_radps = (0.05, -0.03, 0.12)
    device, link, _ = unit(fake, zero_s=0.1, rate_hz=500.0)
    await device.open()
    await link.received(1)
    fake.rates_radps = (0.05, -0.03, 1.12)
    count = len(link.messages)
    await link.received(count + 2)
    await device.close()
    first, last = link.of(Imu)[0], link.of(Imu)[-1]
    np.testing.assert_allclose((first.wx_radps, first.wy_radps, first.wz_radps), 0.0, atol=0.006)
    assert last.wz_radps == pytest.approx(1.0, abs=0.006)


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        (np.tile((0.0, 0.0, 0.9), (50, 1)), "the robot turned"),
        (np.outer(np.sin(np.arange(50.0)), (0.0, 0.1, 0.0)), "the robot moved"),
        (np.zeros((1, 3)), "fewer than two samples"),
    ],
)
def test_no_offset_from_a_robot_that_moves(rates: Any, words: str) -> None:
    found = zero(rates)
    assert found.offset_radps is None
    assert words in found.why_not


async def test_moving_at_opening_keeps_the_offsets_of_the_config() -> None:
    fake = MpuFake()
    fake.rates_radps = (0.0, 0.0, 1.5)
    device, link, _ = unit(fake, zero_s=0.05, rate_hz=500.0, gyro_offset_radps=(0.0, 0.0, 0.5))
    await device.open()
    await link.received(1)
    await device.close()
    assert [name for name, _ in link.faults] == ["moved while zeroing"]
    assert link.of(Imu)[0].wz_radps == pytest.approx(1.0, abs=0.006)


async def test_the_same_values_again_and_again_are_a_loss_and_it_comes_back() -> None:
    fake = MpuFake()
    device, link, bus = unit(fake, zero_s=0.0, frozen_s=0.1, rate_hz=200.0)
    await device.open()
    await link.received(2)
    bus.power_cycle()  # asleep again: it answers, and repeats itself
    await link.until(lambda link: bool(link.losses))
    assert "imu: the same values for 0.1 s: its supply broke down" in str(link.losses[0])
    await device.close()
    link.clear()
    await device.open()
    await link.received(5)
    await device.close()
    assert link.losses == []


async def test_unplugged() -> None:
    device, link, bus = unit(MpuFake(), zero_s=0.0)
    await device.open()
    await link.received(1)
    bus.fail("nack")
    await link.until(lambda link: bool(link.losses))
    assert "no chip answers at address 0x68" in str(link.losses[0])
    await device.close()


def test_a_rate_beyond_the_range_is_counted() -> None:
    device, link = connected(Mpu6050, Mpu6050Config(zero_s=0.0), clock=ManualClock(10**9))
    device.take((0, 0, 8192, 0, 0, 0, 32767), 10**9)
    assert [name for name, _ in link.faults] == ["beyond the range"]
    assert link.of(Imu)[0].wz_radps == pytest.approx(math.radians(500.0), rel=1e-3)
    assert link.of(Imu)[0].stamp_ns == 10**9 - 5_900_000


@pytest.mark.parametrize(("more", "opens"), [({}, False), ({"who_am_i": 0x98}, True), ({"who_am_i": 0x97}, False)])
async def test_other_chips_are_refused_unless_they_are_named(more: dict[str, Any], opens: bool) -> None:
    device, _, _ = unit(MpuFake(who_am_i=0x98), zero_s=0.0, **more)
    if opens:
        await device.open()
    else:
        with pytest.raises(DeviceUnavailable, match=r"says 0x98 when asked.*0x70 MPU-6500.*set `who_am_i: 152`"):
            await device.open()
    await device.close()


async def test_a_chip_that_forgets_is_refused() -> None:
    class Deaf(MpuFake):
        def write(self, data: bytes, address: int) -> None:
            super().write(data[:1] if data[0] == chip.GYRO_CONFIG else data, address)

    device, _, _ = unit(Deaf())
    with pytest.raises(DeviceUnavailable, match="does not keep what is written to register 0x1B"):
        await device.open()
    await device.close()
