"""Faults by name: what a fake, or the line that hosts it, is given in a test is a word of one catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

CATALOGUE: Mapping[str, str] = MappingProxyType(
    {
        # ------------------------------------------------------------------------------- a spinning lidar
        "head stalls": "measurements go on, but the head stands still",
        "bytes stop": "the port is alive, the device says nothing more",
        "still scanning": "when the port is opened, a scan of an earlier program comes in",
        "health warning": "the device answers that it is not quite well, with a code",
        "health error": "the device is in its protection stop, out of which a reset leads",
        "health error stays": "the same, and no reset helps",
        "brown-out": "the supply falls for a moment: boot text, motor and scan forgotten",
        "uneven turning": "the speed swings by a fifth, and so does the number of points of a turn",
        "no start of turn": "the mark of a new turn is missing",
        "no return": "a quarter of the view sends nothing back: distance and quality 0",
        "nothing returns": "all distances are 0: covered, blinded, behind glass",
        # -------------------------------------------------------------------------------- a serial line
        "split reads": "each byte comes in a read of its own",
        "byte lost": "one byte of the next that come is missing",
        "byte added": "one byte too many among the next that come",
        "byte changed": "one of the next bytes is another one",
        "bytes twice": "a run of the next bytes comes twice",
        "other speed": "the device speaks at another baud than its model's",
        "cable out": "the line is gone, and comes back where the cable is put in",
        "line full": "the adapter takes no bytes: they stay in the kernel, and behind it in the program",
        "program held up": "bytes pile up in the kernel while the program does not read, and come in one piece",
        "port in use": "another program has the port open and locked",
        # --------------------------------------------------------------------------- a motor controller
        "controller silent": "it says nothing more; its wheels go on by its own limits",
        "wheel stuck": "one wheel stands although it is told to turn",
        "over-current": "the controller reports it",
        # -------------------------------------------------------------------------------------- an I2C bus
        "nack": "the chip does not acknowledge",
        "stuck": "somebody holds the bus down: every transaction times out",
        "arbitration": "another master is quicker",
        # --------------------------------------------------------------------------------------- a camera
        "torn picture": "the lower part of a picture is missing",
        "wrong length": "a part of a stream says another length than it has",
        "boundary in pieces": "a part of a stream comes a few bytes at a time",
        "frozen picture": "the very same picture again and again",
        "camera hangs": "a read that never returns",
        "camera out": "reads fail from now on, also one that waits",
        # ------------------------------------------------------------------------------------ the computer
        "clock step": "the wall clock jumps by an hour, as NTP makes it",
    }
)
"""Every fault that a fake can be given, and what it is."""


class Breakable:
    """A fake that takes faults by name.

    breaks: name of the fault (one of `CATALOGUE`) to the attribute that is set to True, or to the method that is called
    with the time in nanoseconds.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def inject(self, fault: str, now_ns: int = 0) -> None:
        """Give it a fault from now on. Raises ValueError for one that it cannot have."""
        target = getattr(self, self._of(fault))
        if callable(target):
            target(now_ns)
        else:
            setattr(self, self._of(fault), True)

    def mend(self, fault: str) -> None:
        """Take a lasting fault away again. Raises ValueError for one that it cannot have, or that passes by itself."""
        name = self._of(fault)
        if callable(getattr(self, name)):
            raise ValueError(f"{fault!r} is over as soon as it has happened")
        setattr(self, name, False)

    def _of(self, fault: str) -> str:
        name = self.breaks.get(fault)
        if name is None:
            raise ValueError(f"{type(self).__name__} has no fault {fault!r}; it has: {', '.join(self.breaks)}")
        return name
