"""What is said with a commanded YDLIDAR (X4, G4), without input or output: stop, are you well, scan."""

from __future__ import annotations

from robotd.authoring.device import DeviceUnavailable
from robotd_devices.lidar.dialogue import Ask, Dtr, Pause, Quiet, Say, Start, Talk, Warn

SCAN, STOP, FORCE_STOP, RESET, GET_INFO, GET_HEALTH = 0x60, 0x65, 0x00, 0x80, 0x90, 0x92
INFO, HEALTH = 0x04, 0x06
"""Types of answers."""

_STREAM = 0x81


def request(command: int) -> bytes:
    """The bytes of a request; none of these has a payload."""
    return bytes((0xA5, command))


def begin() -> Talk[None]:
    """From whatever it does to a scan. Raises DeviceUnavailable, saying why."""
    yield Say(request(FORCE_STOP) + request(STOP))
    yield Quiet(within_s=0.5)
    answer = None
    for _ in range(2):
        answer = answer or (yield Ask(request(GET_HEALTH), HEALTH))
    if answer is None or len(answer) != 3:
        raise DeviceUnavailable("it does not say whether it is well")
    status, code = answer[0], int.from_bytes(answer[1:], "little")
    if status == 1:
        yield Warn("health warning", f"code {code:#06x}")
    if status == 2:
        yield Warn("health error", f"code {code:#06x}: it is reset once")
        yield Say(request(RESET))
        yield Pause(0.5)
        yield Quiet(0.3, 2.0)
        answer = yield Ask(request(GET_HEALTH), HEALTH)
        if answer is None or answer[0] == 2:
            raise DeviceUnavailable(f"it reports an error, code {code:#06x}, also after a reset")
    yield Dtr(True)
    for _ in range(2):
        descriptor = yield Start(request(SCAN), 1.0)
        if descriptor is not None and descriptor.kind == _STREAM:
            return
    raise DeviceUnavailable("it does not begin to scan")
