"""How a check says that something breaks the contract."""

from __future__ import annotations

from typing import NoReturn


class CheckFailed(AssertionError):
    """A plugin or device breaks the contract; the message says where, what, and the mend."""


def fail(cls: type, what: str, mend: str = "") -> NoReturn:
    """Raises CheckFailed for a class."""
    raise CheckFailed(f"{cls.__module__}.{cls.__qualname__}: {what}{mend and '; ' + mend}")
