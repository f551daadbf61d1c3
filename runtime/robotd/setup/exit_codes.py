"""Which exit code and which sentence an error calls for: those of sysexits(3) that robotd uses, see docs/cli.md."""

from __future__ import annotations

import errno
from collections.abc import Iterable

OK, USAGE, UNAVAILABLE, INTERNAL, TEMPORARY, PERMISSION, CONFIG = 0, 64, 69, 70, 75, 77, 78
INTERRUPTED = 130


class Usage(Exception):
    """The command line itself is wrong; the message says what and what to type instead."""


class MissingExtra(Exception):
    """What comes with an extra of robotd is not installed; the message says how to get it."""


def judge(error: BaseException) -> tuple[int, str]:
    """Exit code and sentence for an error that ended a command; of a group, its worst member decides."""
    from robotd.authoring.device import DeviceError, DeviceMisconfigured
    from robotd.engine.devices import Unavailable
    from robotd.setup.problems import ConfigError
    from robotd.setup.scaffold import ScaffoldError

    if isinstance(error, BaseExceptionGroup):
        told = [judge(inner) for inner in error.exceptions]
        return max(code for code, _ in told), "\n".join(dict.fromkeys(text for _, text in told))
    match error:
        case Usage() | ScaffoldError():
            return USAGE, str(error)
        case ConfigError() | DeviceMisconfigured():
            forbidden = isinstance(error.__cause__, PermissionError)
            return PERMISSION if forbidden else CONFIG, str(error)
        case MissingExtra():
            return UNAVAILABLE, str(error)
        case Unavailable() | DeviceError():
            return os_code(causes(error), UNAVAILABLE), str(error)
        case OSError():
            where = f"{error.filename}: " if error.filename is not None else ""
            return os_code([error], UNAVAILABLE), f"{where}{error.strerror or error}"
    return INTERNAL, f"robotd has a fault: {type(error).__name__}: {error} (add -vv for the traceback)"


def causes(error: BaseException) -> list[BaseException]:
    """`error` and what it was raised from, the nearest first."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    return chain


def os_code(chain: Iterable[BaseException], otherwise: int) -> int:
    """77 where something was forbidden, 75 where somebody else holds it, else `otherwise`."""
    for link in chain:
        if isinstance(link, PermissionError):
            return PERMISSION
        if isinstance(link, BlockingIOError) or (isinstance(link, OSError) and link.errno == errno.EBUSY):
            return TEMPORARY
    return otherwise
