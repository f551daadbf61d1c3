"""An Arduino with ros_arduino_bridge's firmware as its serial line sees it: it boots when the port is opened."""

from __future__ import annotations

from robotd_devices.motor import arduino_bridge_lines as lines

_MS = 1_000_000


class ArduinoBridgeFake:
    """`boot_ms`: how long it hears nothing after the port was opened, which resets it (DTR).

    The wheels reach their speed at once. They stop `AUTO_STOP_MS` after the last `m`.
    """

    def __init__(self, *, boot_ms: int = 1500) -> None:
        self.is_mute = False
        self.gains = (20, 12, 0, 50)
        self._boot_ns = boot_ms * _MS
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        """The port was opened: the board is reset, its counters too."""
        self._awake_ns = now_ns + self._boot_ns
        self._cmd, self._args = "", ["", ""]
        self._arg = 0
        self._out = b""
        self._told = (0, 0)
        self._told_ns = self._now_ns = now_ns
        self._counts = [0.0, 0.0]

    def ticks(self, now_ns: int) -> tuple[int, int]:
        """Counts a frame that the wheels make now."""
        return (0, 0) if now_ns - self._told_ns > lines.AUTO_STOP_MS * _MS else self._told

    def feed(self, data: bytes, now_ns: int) -> None:
        self._turn(now_ns)
        if now_ns < self._awake_ns:
            return  # the boot loader
        for byte in data.decode("latin-1"):
            self._hear(byte, now_ns)

    def _hear(self, char: str, now_ns: int) -> None:
        """The firmware's own way of taking characters."""
        if char == "\r":
            self._run(now_ns)
            self._cmd, self._args, self._arg = "", ["", ""], 0
        elif char == " ":
            self._arg = min(self._arg + 1, 2)
        elif self._arg == 0:
            self._cmd = char
        else:
            self._args[self._arg - 1] += char

    def _run(self, now_ns: int) -> None:
        left, right = (_atoi(arg) for arg in self._args)
        if self._cmd == "m":
            self._told, self._told_ns = (left, right), now_ns
            self._say("OK")
        elif self._cmd == "e":
            self._say(f"{round(self._counts[0])} {round(self._counts[1])}")
        elif self._cmd == "r":
            self._counts = [0.0, 0.0]
            self._say("OK")
        elif self._cmd == "u":
            kp, kd, ki, ko = map(_atoi, self._args[0].split(":"))
            self.gains = (kp, kd, ki, ko)
            self._say("OK")
        elif self._cmd == "b":
            self._say(" 57600")
        else:
            self._say("Invalid Command")

    def _say(self, text: str) -> None:
        self._out += text.encode() + b"\r\n"

    def _turn(self, now_ns: int) -> None:
        passed_s = max(0, now_ns - self._now_ns) / 1e9
        for i, ticks in enumerate(self.ticks(now_ns)):
            self._counts[i] += ticks * lines.FRAMES_HZ * passed_s
        self._now_ns = max(self._now_ns, now_ns)

    def tick(self, now_ns: int) -> bytes:
        self._turn(now_ns)
        out, self._out = self._out, b""
        return b"" if self.is_mute else out


def _atoi(text: str) -> int:
    """As C's: the number at the beginning, 0 where there is none."""
    digits = ""
    for i, char in enumerate(text):
        if char.isdigit() or (i == 0 and char in "+-"):
            digits += char
        else:
            break
    return int(digits) if digits.lstrip("+-") else 0
