"""The INA219: words of the wire, volts and amperes with their signs, charge, low battery, and what goes wrong."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import FakeLink, ManualClock, check_sensor, connected
from robotd.world.messages import Battery
from robotd_devices.battery import Ina219, Ina219Config
from robotd_devices.battery import ina219_chip as chip
from robotd_devices.battery.charge import LITHIUM, charge
from robotd_devices.battery.ina219 import Reading
from robotd_devices.battery.ina219_fake import Ina219Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost


def monitor(fake: Ina219Fake, **config: Any) -> tuple[Ina219, FakeLink, FakeI2cBus]:
    bus = FakeI2cBus([fake])
    made, link = connected(partial(Ina219, open_bus=lambda: bus), Ina219Config(**config), name="battery")
    return made, link, bus


@pytest.mark.parametrize(
    ("raw", "shunt_v"),
    # data sheet, table 7 and section 8.6.3.1: 320 mV is 7D00h, -320 mV is 8300h
    [("7d00", 0.32), ("8300", -0.32), ("0000", 0.0), ("0001", 1e-5), ("ffff", -1e-5)],
)
def test_shunt_words(raw: str, shunt_v: float) -> None:
    assert chip.shunt_v(bytes.fromhex(raw)) == pytest.approx(shunt_v, abs=1e-9)


# data sheet, section 8.6.3.2: the voltage is in the upper 13 bits, steps of 4 mV; the lowest bits are flags
@pytest.mark.parametrize(("raw", "volts"), [("5dc2", 12.0), ("5dc3", 12.0), ("1f42", 4.0), ("0002", 0.0)])
def test_bus_words(raw: str, volts: float) -> None:
    assert chip.bus_v(bytes.fromhex(raw)) == pytest.approx(12.0 if volts == 12.0 else volts)


def test_settings_are_written_after_a_reset_big_end_first() -> None:
    bus = FakeI2cBus([Ina219Fake()])
    Ina219(Ina219Config(max_a=0.8)).begin(bus)
    assert [(write.register, write.data.hex()) for write in bus.writes] == [(0, "8000"), (0, "2eef")]


@pytest.mark.parametrize(
    ("config", "current_a", "gain", "step_a"),
    [({}, 2.9, 3, 1e-4), ({"max_a": 0.4}, 0.39, 0, 1e-4), ({"shunt_ohm": 0.01, "max_a": 8}, -7.5, 1, 1e-3)],
)
@pytest.mark.parametrize("swapped", [False, True])
def test_voltage_and_current(config: dict[str, Any], current_a: float, gain: int, step_a: float, swapped: bool) -> None:
    settings = Ina219Config(**config, reversed=swapped)
    fake = Ina219Fake(shunt_ohm=settings.shunt_ohm)
    across_v = current_a * settings.shunt_ohm
    # seen from the chip a swapped one has its supply at IN-, and the current runs the other way
    fake.current_a = -current_a if swapped else current_a
    fake.voltage_v = 11.1 - across_v if swapped else 11.1
    bus = FakeI2cBus([fake])
    Ina219(settings).begin(bus)
    assert settings.gain == gain
    found = Ina219(settings).read(bus)
    assert found.voltage_v == pytest.approx(11.1, abs=0.0021)
    assert found.current_a == pytest.approx(current_a, abs=0.51 * step_a)


@pytest.mark.parametrize("current_a", [0.41, -0.41, 9.0])
def test_a_current_beyond_the_range_is_unknown(current_a: float) -> None:
    fake, settings = Ina219Fake(), Ina219Config(max_a=0.4)
    fake.current_a = current_a
    bus = FakeI2cBus([fake])
    Ina219(settings).begin(bus)
    assert math.isnan(Ina219(settings).read(bus).current_a)


@pytest.mark.parametrize(
    ("cell_v", "share"),
    [(2.0, 0.0), (3.0, 0.0), (3.75, 0.45), (3.8, 0.55), (4.2, 1.0), (5.0, 1.0), (math.nan, math.nan)],
)
def test_charge_of_a_cell(cell_v: float, share: float) -> None:
    assert charge(cell_v) == pytest.approx(share, nan_ok=True)


def test_charge_rises_with_voltage() -> None:
    shares = [charge(2.9 + 0.01 * i, LITHIUM) for i in range(150)]
    assert shares == sorted(shares)


async def test_keeps_the_contract_of_sensors() -> None:
    fake = Ina219Fake()
    fake.voltage_v, fake.current_a = 11.4, 0.25
    device, link, _ = monitor(fake, rate_hz=20.0, cells=3, pack_ohm=0.4)
    published = await check_sensor(device)
    assert link.losses == [] and link.faults == []
    message = published[-1]
    assert isinstance(message, Battery)
    assert message.voltage_v == pytest.approx(11.4, abs=0.003)
    assert message.current_a == pytest.approx(0.25, abs=1e-4)
    assert message.charge == pytest.approx(charge((11.4 + 0.1) / 3), abs=0.01)


async def test_over_a_socket(tmp_path: Path) -> None:
    with I2cHost(FakeI2cBus([Ina219Fake(0x41)]), tmp_path / "i2c") as host:
        device, link = connected(Ina219, Ina219Config(bus=f"unix:{host.path}", address=0x41, rate_hz=20.0))
        await device.open()
        await link.received(2)
        await device.close()
    assert link.of(Battery)[0].voltage_v == pytest.approx(12.0, abs=0.003)
    assert math.isnan(link.of(Battery)[0].charge)


@pytest.mark.parametrize(
    ("fail", "words"),
    [
        (lambda bus: bus.fail("nack"), "battery: no chip answers at address 0x40"),
        (lambda bus: bus.fail("stuck"), "the bus is stuck"),
        (lambda bus: bus.power_cycle(), r"lost its settings \(399f\): its supply broke down"),
    ],
)
async def test_lost_while_running(fail: Any, words: str) -> None:
    device, link, bus = monitor(Ina219Fake(), rate_hz=20.0)
    await device.open()
    await link.received(1)
    fail(bus)
    await link.until(lambda link: bool(link.losses))
    await device.close()
    with pytest.raises(Exception, match=words):
        raise link.losses[0]
    bus.heal()
    link.clear()
    await device.open()  # and back again
    await link.received(1)
    await device.close()


async def test_one_bad_transaction_is_a_fault_and_no_more() -> None:
    device, link, bus = monitor(Ina219Fake(), rate_hz=20.0)
    await device.open()
    await link.received(1)
    bus.fail("arbitration", times=1)
    await link.until(lambda link: bool(link.faults))
    count = len(link.messages)
    await link.received(count + 1)
    await device.close()
    assert [name for name, _ in link.faults] == ["I2C retry"]
    assert link.losses == []


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FakeI2cBus([]), "battery: no chip answers at address 0x40"),
        (lambda: FakeI2cBus([_NotIna()]), "is no INA219: after a reset its settings read 0000"),
    ],
)
async def test_opening_says_why_not(make: Any, words: str) -> None:
    device, link = connected(partial(Ina219, open_bus=make), Ina219Config(), name="battery")
    with pytest.raises(DeviceUnavailable, match=words):
        await device.open()
    await device.close()
    assert link.messages == []


class _NotIna(Ina219Fake):
    def read(self, count: int) -> bytes:
        return bytes(count)


@pytest.mark.parametrize(
    ("volts", "low"),
    [
        ([10.6] * 13, 0),  # 3.53 V a cell
        ([10.2] * 10, 0),  # low, for 4.5 s
        ([10.2] * 11, 1),
        ([10.2] * 8 + [11.0] + [10.2] * 10, 0),  # a break
        ([10.2] * 13, 3),
        ([10.2] * 13 + [10.7, 10.8, 10.9], 5),  # at rest it recovers a little: not low any more from 10.82 V on
    ],
)
def test_low_battery_is_told_when_it_lasts(volts: list[float], low: int) -> None:
    device, link = connected(Ina219, Ina219Config(cells=3), clock=ManualClock(10**11))
    device.prepare()
    for beat, volt in enumerate(volts):
        device.take(Reading(volt, 0.0), 10**10 + beat * 500_000_000)
    assert [name for name, _ in link.faults] == (["battery low"] if low else [])
    assert sum(battery.low for battery in link.of(Battery)) == low
    assert len(link.messages) == len(volts)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"max_a": 4.0}, "0.4 V across the shunt is more than the chip's 0.32 V"),
        ({"cell_table": ((3.0, 0.0),)}, "two or more rows"),
        ({"cell_table": ((3.0, 0.0), (2.0, 1.0))}, "both rising"),
        ({"address": 0x20}, "address"),
    ],
)
def test_config_refuses(config: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Ina219Config(**config)
