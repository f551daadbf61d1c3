"""The SparkFun Serial Controlled Motor Driver, two motors on I2C: its registers, and writes to it as data.

Every write is one register: the firmware throws longer ones away. Source: SparkFun's Arduino library and the firmware
of the board (MIT), SCMD_config.h, registerHandlers.c, customSerialInterrupts.c.
"""

from __future__ import annotations

import time

from robotd.authoring.device import DeviceUnavailable
from robotd_devices.motor.jetbot_wheels import Speeds
from robotd_devices.ports.i2c_bus import I2cBus, I2cWrite

ID, IDENTITY = 0x01, 0xA9
DUMPED, FSAFE_FAULTS, REFUSED = 0x06, 0x0E, 0x10
LOCAL_MASTER_LOCK, LOCAL_USER_LOCK = 0x15, 0x16
FSAFE_CTRL, DRIVE_KILL = 0x1F, 0x01
MOTOR_A, MOTOR_B, STANDING = 0x20, 0x21, 0x80
DRIVER_ENABLE = 0x70
MASTER_LOCK, USER_LOCK, MASTER_KEY, USER_KEY = 0x74, 0x75, 0x9B, 0x5C
FSAFE_TIME, FSAFE_UNIT_S = 0x76, 0.01
STATUS, ENUMERATED, BUSY = 0x77, 0x01, 0x0E
REGISTERS = 0x80

_SETTLE_S = 0.002
_LOOKS = 50
_FRESH_S = 0.05


def one(address: int, register: int, value: int) -> I2cWrite:
    """One register."""
    return I2cWrite(address, register, bytes((value,)))


def stop_writes(address: int) -> tuple[I2cWrite, ...]:
    """Both motors off."""
    return one(address, MOTOR_A, STANDING), one(address, MOTOR_B, STANDING)


def level(told: int) -> int:
    """The register's value for a speed of -255 to 255, positive forward: seven bits about 128, as the library does."""
    return STANDING + (told >> 1 if told >= 0 else -(-told >> 1))


class ScmdChip:
    """What the writer's thread does with the board: set it up, write speeds, look after it. See `ChipPlan`.

    The board stops its motors `failsafe_s` after the last transaction, whatever it was. So speeds are written again and
    again, also where they do not change, and nothing is read while the robot moves on a speed that nobody renews.
    """

    def __init__(self, address: int, failsafe_s: float) -> None:
        self._address = address
        self._settings = {
            FSAFE_CTRL: DRIVE_KILL,
            FSAFE_TIME: round(failsafe_s / FSAFE_UNIT_S),
            DRIVER_ENABLE: 1,
        }
        self.is_moving = False
        self._written_s = 0.0

    def begin(self, bus: I2cBus) -> None:
        """The stop, then who it is, then its settings. Raises OSError and DeviceUnavailable."""
        for write in stop_writes(self._address):
            bus.write(*write)
        identity = self._read(bus, ID)
        if identity != IDENTITY:
            raise DeviceUnavailable(
                f"the chip at 0x{self._address:02X} says it is {identity:02X}, an SCMD says {IDENTITY:02X}: "
                "is `address` right?"
            )
        if not self._read(bus, STATUS) & ENUMERATED:
            raise DeviceUnavailable(f"the motor driver at 0x{self._address:02X} still starts")
        # a lock that another program left behind would refuse the settings in silence
        for register, value in {USER_LOCK: USER_KEY, **self._settings}.items():
            bus.write(*one(self._address, register, value))
            self._settle(bus)
        self.check(bus)

    def plan(self, before: Speeds | None, wanted: Speeds) -> tuple[I2cWrite, ...]:
        """Both motors, always."""
        self.is_moving, self._written_s = wanted != Speeds(), time.monotonic()
        return one(self._address, MOTOR_A, level(wanted.left)), one(self._address, MOTOR_B, level(wanted.right))

    def stopped(self) -> None:
        """Both motors were told to stand: from now on it may be read again."""
        self.is_moving = False

    def check(self, bus: I2cBus) -> None:
        """Is it still set up? Raises OSError and DeviceUnavailable."""
        if self.is_moving and time.monotonic() - self._written_s > _FRESH_S:
            return
        for register, value in self._settings.items():
            found = self._read(bus, register)
            if found != value:
                raise DeviceUnavailable(
                    f"the motor driver at 0x{self._address:02X} lost its settings (register {register:02X} is "
                    f"{found:02X}, set was {value:02X}): its supply broke down, or another program uses it"
                )

    def _settle(self, bus: I2cBus) -> None:
        for _ in range(_LOOKS):
            if not self._read(bus, STATUS) & BUSY:
                return
            time.sleep(_SETTLE_S)
        raise DeviceUnavailable(f"the motor driver at 0x{self._address:02X} is busy for ever: switch it off and on")

    def _read(self, bus: I2cBus, register: int) -> int:
        return bus.read(self._address, register, 1)[0]
