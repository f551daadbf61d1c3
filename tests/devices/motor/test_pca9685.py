"""The PCA9685's register rules on the fake, and other people's register log played against it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from robotd_devices.motor import pca9685
from robotd_devices.motor.pca9685_fake import BridgeFake, Pca9685Fake
from robotd_devices.ports.i2c_bus import EREMOTEIO
from robotd_devices.ports.i2c_fake import FakeI2cBus, SmbusStub

ADDRESS = 0x60

# What Adafruit-MotorHAT 1.4.1 writes, byte by byte, as logged on its own bus class (research report, section 4.1).
INIT = [(r, 0) for r in range(0xFA, 0xFE)] + [
    *((0x01, 0x04), (0x00, 0x01), (0x00, 0x01)),
    *((0x00, 0x11), (0xFE, 0x03), (0x00, 0x01), (0x00, 0x81)),
]
M1_128_FORWARD = [
    *((0x26, 0x00), (0x27, 0x00), (0x28, 0x00), (0x29, 0x08)),
    *((0x2A, 0x00), (0x2B, 0x00), (0x2C, 0x00), (0x2D, 0x10)),
    *((0x2E, 0x00), (0x2F, 0x10), (0x30, 0x00), (0x31, 0x00)),
]
M1_RELEASE = [
    *((0x2E, 0x00), (0x2F, 0x00), (0x30, 0x00), (0x31, 0x10)),
    *((0x2A, 0x00), (0x2B, 0x00), (0x2C, 0x00), (0x2D, 0x10)),
]


class Board:
    """A chip on a bus, and M1 behind it."""

    def __init__(self) -> None:
        self.chip = Pca9685Fake(ADDRESS)
        self.bus = FakeI2cBus([self.chip])
        self.m1 = BridgeFake(self.chip, pwm=8, in1=10, in2=9)

    def write(self, register: int, *data: int) -> None:
        self.bus.write(ADDRESS, register, bytes(data))

    def read(self, register: int, count: int = 1) -> list[int]:
        return list(self.bus.read(ADDRESS, register, count))


def test_the_library_s_log_drives_the_fake_byte_for_byte() -> None:
    board = Board()
    smbus = SmbusStub(board.bus)
    steps: list[tuple[list[tuple[int, int]], float, float]] = [
        (INIT, 0.0, 25e6 / 4096 / 4),
        (M1_128_FORWARD, 128 * 16 / 4096, 25e6 / 4096 / 4),
        (M1_RELEASE, 0.0, 25e6 / 4096 / 4),
    ]
    for log, voltage, pwm_hz in steps:
        board.chip.log.clear()
        for register, value in log:
            smbus.write_byte_data(ADDRESS, register, value)
        assert board.chip.log == log
        assert board.m1.voltage == voltage
        assert board.chip.pwm_hz == pwm_hz
    assert smbus.read_byte_data(ADDRESS, pca9685.MODE1) == 0x01


def test_powers_on_asleep_with_all_outputs_off() -> None:
    board = Board()
    assert board.read(pca9685.MODE1) == [0x11]
    assert board.read(pca9685.MODE2) == [0x04]
    assert board.read(pca9685.PRESCALE) == [0x1E]
    assert [board.chip.levels(c) for c in range(16)] == [(0, 4096)] * 16
    assert board.chip.pwm_hz == pytest.approx(197, abs=1)  # the data sheet calls it 200 Hz


@pytest.mark.parametrize(
    ("act", "register", "expected"),
    [
        # without auto-increment all bytes go to one register
        (lambda b: b.write(0x06, 1, 2, 3), 0x06, [3]),
        (lambda b: (b.write(0x00, 0x21), b.write(0x06, 1, 2, 3)), 0x06, [1, 2, 3, 0x10]),
        # past the last channel to the first register; past the prescaler likewise
        (lambda b: (b.write(0x00, 0x21), b.write(0x45, 0x10, 0x31)), 0x00, [0x31]),
        (lambda b: (b.write(0x00, 0x31), b.write(0xFE, 9, 0x21)), 0x00, [0x21]),
        # the prescaler: only asleep, and at least 3
        (lambda b: b.write(0xFE, 5), 0xFE, [5]),
        (lambda b: b.write(0xFE, 1), 0xFE, [3]),
        (lambda b: (b.write(0x00, 0x01), b.write(0xFE, 5)), 0xFE, [0x1E]),
        # all channels at once; reads as nothing; the high bytes have five bits
        (lambda b: b.write(0xFD, 0xFF), 0x09, [0x1F]),
        (lambda b: b.write(0xFD, 0x10), 0xFD, [0]),
        # an external clock stays until a reset
        (lambda b: (b.write(0x00, 0x51), b.write(0x00, 0x01)), 0x00, [0x41]),
        # RESTART cannot be set from outside
        (lambda b: b.write(0x00, 0x91), 0x00, [0x11]),
        # software reset, and a general call that is none
        (lambda b: (b.write(0x00, 0x21), b.bus.write(0x00, 0x06, b"")), 0x00, [0x11]),
        (lambda b: (b.write(0x00, 0x21), b.bus.write(0x00, 0x05, b"")), 0x00, [0x21]),
        # the all-call address
        (lambda b: b.bus.write(0x70, 0x01, b"\x0c"), 0x01, [0x0C]),
    ],
)
def test_registers(act: Callable[[Board], object], register: int, expected: list[int]) -> None:
    board = Board()
    act(board)
    if len(expected) > 1:
        board.write(0x00, 0x31)
    assert board.read(register, len(expected)) == expected


def test_the_all_call_address_is_silent_without_allcall() -> None:
    board = Board()
    board.write(0x00, 0x10)
    with pytest.raises(OSError) as raised:
        board.bus.write(0x70, 0x01, b"\x0c")
    assert raised.value.errno == EREMOTEIO


def test_full_off_wins_over_full_on_and_sleep_over_both() -> None:
    board = Board()
    board.write(0x00, 0x21)
    for level, duty in [
        ((4096, 0), 1.0),
        ((4096, 4096), 0.0),
        ((0, 2048), 0.5),
        ((4095, 2047), 0.5),
        ((0, 0), 0.0),
        ((0, 4080), 4080 / 4096),
    ]:
        board.write(0x06, *pca9685.level_bytes(level))
        assert board.chip.duty(0) == duty
    board.write(0x00, 0x31)
    assert board.chip.duty(0) == 0.0


@pytest.mark.parametrize("wake", ["restart", "write a channel", "neither"])
def test_restart_holds_the_outputs_after_sleep(wake: str) -> None:
    board = Board()
    board.write(0x00, 0x21)
    board.write(0x06, 0, 0, 0, 8)
    board.write(0x00, 0x31)
    assert board.read(0x00) == [0xB1]
    board.write(0x00, 0x21)
    assert board.chip.duty(0) == 0.0
    if wake == "restart":
        board.write(0x00, 0xA1)
    elif wake == "write a channel":
        board.write(0x0A, 0)
    assert board.chip.duty(0) == (0.0 if wake == "neither" else 0.5)
    assert board.read(0x00) == [0xA1 if wake == "neither" else 0x21]


def test_begin_stops_first_and_leaves_every_output_off_from_any_state() -> None:
    for before in ([], INIT + M1_128_FORWARD, [(0x00, 0x11)]):
        board = Board()
        for register, value in before:
            board.write(register, value)
        writes = pca9685.begin_writes(ADDRESS, 1600.0)
        assert writes[0] == (ADDRESS, 0xFD, b"\x10")
        for write in writes:
            board.bus.write(*write)
            assert board.m1.voltage == 0.0
        assert board.read(0x00) == [0x21]
        assert board.read(0xFE) == [3]
        assert [board.chip.duty(c) for c in range(16)] == [0.0] * 16


@pytest.mark.parametrize(("pwm_hz", "value"), [(1600.0, 3), (9999.0, 3), (200.0, 30), (50.0, 121), (1.0, 255)])
def test_prescale(pwm_hz: float, value: int) -> None:
    assert pca9685.prescale(pwm_hz) == value


def test_neighbouring_channels_go_in_one_block() -> None:
    writes = pca9685.level_writes(0x60, {9: (0, 1), 8: (2, 3), 13: (4096, 0)})
    assert writes == [
        (0x60, 0x26, bytes((2, 0, 3, 0, 0, 0, 1, 0))),
        (0x60, 0x3A, bytes((0, 0x10, 0, 0))),
    ]
