"""A SparkFun SCMD as its bus sees it: registers, locks, and a failsafe that any transaction puts off."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotd_devices.motor import scmd
from robotd_devices.ports.i2c_bus import GENERAL_CALL

_LOCKED = {scmd.DRIVER_ENABLE, scmd.MASTER_LOCK, scmd.FSAFE_TIME}
_READ_ONLY = {scmd.ID, scmd.STATUS}
_UNIT_NS = 10_000_000


class ScmdFake:
    """Writes of one register only; longer ones are counted as dumped. Settings are refused while locked.

    The failsafe counts trips, and stops the motors where FSAFE_CTRL says so; every write puts it off, also the one that
    only says which register is read next. `clock`: nanoseconds.
    """

    def __init__(self, address: int = 0x5D, *, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.address = address
        self._clock = clock
        self.is_enumerated = True
        self.power_on()

    def power_on(self) -> None:
        self._registers = bytearray(scmd.REGISTERS)
        self._registers[scmd.ID] = scmd.IDENTITY
        self._registers[scmd.MOTOR_A] = self._registers[scmd.MOTOR_B] = scmd.STANDING
        self._registers[scmd.LOCAL_MASTER_LOCK] = self._registers[scmd.MASTER_LOCK] = scmd.MASTER_KEY
        self._registers[scmd.LOCAL_USER_LOCK] = self._registers[scmd.USER_LOCK] = scmd.USER_KEY
        self._pointer = 0
        self._fed_ns = self._clock()

    def answers(self, address: int) -> bool:
        return address == self.address

    def write(self, data: bytes, address: int) -> None:
        if address == GENERAL_CALL:
            return
        self._look()
        self._fed_ns = self._clock()
        self._pointer = data[0]
        if len(data) == 2:
            self._store(data[0], data[1])
        elif len(data) > 2:
            self._registers[scmd.DUMPED] += 1

    def read(self, count: int) -> bytes:
        self._look()
        if self._pointer == scmd.STATUS:
            return bytes((scmd.ENUMERATED * self.is_enumerated,)) + bytes(count - 1)
        return bytes((self._registers[self._pointer],)) + bytes(count - 1)

    def lock(self) -> None:
        """Another program locked the settings."""
        for register in (scmd.LOCAL_MASTER_LOCK, scmd.LOCAL_USER_LOCK):
            self._registers[register] = 0

    def register(self, number: int) -> int:
        """What a register holds."""
        self._look()
        return self._registers[number]

    @property
    def voltages(self) -> tuple[float, float]:
        """What the motors A and B get now, -1 to 1."""
        self._look()
        if not self._registers[scmd.DRIVER_ENABLE]:
            return 0.0, 0.0
        a, b = self._registers[scmd.MOTOR_A], self._registers[scmd.MOTOR_B]
        return (a - scmd.STANDING) / 127, (b - scmd.STANDING) / 127

    def _look(self) -> None:
        """What the failsafe did since."""
        limit_ns = self._registers[scmd.FSAFE_TIME] * _UNIT_NS
        late_ns = self._clock() - self._fed_ns
        if not limit_ns or late_ns < limit_ns:
            return
        trips = self._registers[scmd.FSAFE_FAULTS] + late_ns // limit_ns
        self._registers[scmd.FSAFE_FAULTS] = min(255, trips)
        self._fed_ns += late_ns // limit_ns * limit_ns
        if self._registers[scmd.FSAFE_CTRL] & scmd.DRIVE_KILL:
            self._registers[scmd.MOTOR_A] = self._registers[scmd.MOTOR_B] = scmd.STANDING

    def _store(self, register: int, value: int) -> None:
        is_open = (
            self._registers[scmd.LOCAL_USER_LOCK] == scmd.USER_KEY
            or self._registers[scmd.LOCAL_MASTER_LOCK] == scmd.MASTER_KEY
        )
        if register >= scmd.REGISTERS or register in _READ_ONLY or (register in _LOCKED and not is_open):
            self._registers[scmd.REFUSED] = min(255, self._registers[scmd.REFUSED] + 1)
            return
        self._registers[register] = value
        if register == scmd.USER_LOCK:
            self._registers[scmd.LOCAL_USER_LOCK] = value
        elif register == scmd.MASTER_LOCK:
            self._registers[scmd.LOCAL_MASTER_LOCK] = value
