"""Who may talk to the page: the checks of Host, Origin and token, decided on header values alone.

A browser on this machine also runs pages of strangers. Two things keep those out. `Host` must be a name of this robot,
so that a stranger's domain that was re-pointed at our address (DNS rebinding) is refused. `Origin` must be that same
host, so that a stranger's page can neither open the WebSocket nor post. Programs that are not browsers send no Origin.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
from dataclasses import dataclass
from urllib.parse import urlsplit

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


@dataclass(frozen=True, slots=True)
class Gate:
    """loopback: served to this machine alone. names: further host names, lower case. token: None lets all in."""

    loopback: bool
    names: frozenset[str] = frozenset()
    token: str | None = None

    def refusal(self, host: str | None, origin: str | None) -> str:
        """Why a request with these headers is refused, or an empty string."""
        name = host_name(host)
        if not name:
            return "no valid Host header"
        if not self._is_ours(name):
            return f"{name!r} is no name of this robot; add it to bridges.dashboard.names if it is"
        if origin is not None and urlsplit_netloc(origin) != (host or "").lower():
            return f"a page of another site ({origin[:80]!r}) asked"
        return ""

    def _is_ours(self, name: str) -> bool:
        if name in LOOPBACK_NAMES or name in self.names:
            return True
        # a literal address cannot be re-pointed; beyond loopback the robot may have several
        return not self.loopback and _is_address(name)

    def is_token(self, given: str) -> bool:
        """Whether this is the token, compared in constant time."""
        return self.token is None or hmac.compare_digest(given.encode(), self.token.encode())

    @property
    def pass_value(self) -> str:
        """What the cookie of a person who typed the token holds; it dies with the token, not with robotd."""
        return hmac.new((self.token or "").encode(), b"robotd dashboard", hashlib.sha256).hexdigest()

    def is_pass(self, cookie: str | None) -> bool:
        """Whether a request with this cookie may see anything."""
        return self.token is None or (
            cookie is not None and hmac.compare_digest(cookie.encode(), self.pass_value.encode())
        )


def host_name(host: str | None) -> str:
    """The name or address in a Host header, lower case without port and brackets; empty where it is none."""
    if not host:
        return ""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""


def urlsplit_netloc(origin: str) -> str:
    """Host and port of an Origin header, lower case; empty for `null` and anything unreadable."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
