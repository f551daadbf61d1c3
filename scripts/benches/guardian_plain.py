"""`scripts/bench guardian_plain`: the same as `guardian`, for a robot without privileges, whoever runs it."""

from __future__ import annotations

from typing import ClassVar

from benches.guardian import Guardian


class GuardianPlain(Guardian):
    """A guardian without a real-time priority, not locked in memory, as an ordinary user starts it."""

    name: ClassVar[str] = "guardian_plain"
    about: ClassVar[str] = "from the fault to the stop on the motors' side of the line, without privileges"
    plain: ClassVar[bool] = True


BENCH = GuardianPlain()
