"""Remembers on disk that the robot is armed: a program that died while it was does not arm itself when it is back."""

from __future__ import annotations

import logging
from pathlib import Path

log = logging.getLogger("robotd")


class ArmedMark:
    """A file that is there while the robot is armed. It counts until the computer is started anew.

    `found`: the last run ended armed, without a good end: killed, frozen and killed, or crashed. A file that cannot be
    written is warned of once and does not keep the robot from driving.
    """

    def __init__(self, path: Path, boot: str | None = None) -> None:
        self.path = path
        self._boot = boot if boot is not None else _boot()
        self._armed = False
        try:
            self.found = path.read_text() == self._boot
        except (OSError, ValueError):
            self.found = False

    def set(self, armed: bool) -> None:
        """Say whether the robot is armed; writes where that changed."""
        if armed == self._armed:
            return
        self._armed = armed
        try:
            if armed:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.path.write_text(self._boot)
            else:
                self.path.unlink(missing_ok=True)
        except OSError as error:
            log.warning("%s cannot be written (%s): a restart after a crash may arm by itself", self.path, error)

    def clear(self) -> None:
        """A run ended in good order."""
        self._armed = True
        self.set(False)


def _boot() -> str:
    """What changes with every start of the computer; empty where the system does not tell."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
