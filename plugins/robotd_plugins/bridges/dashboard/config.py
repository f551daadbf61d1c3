"""Parameters of the bridge `dashboard`, and the rule that only this machine sees the page without a token."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import Field, SecretStr, model_validator

from robotd import Config

TOKEN_LENGTH_MIN = 16
"""Long enough that nobody guesses it over a network, however patient."""


class DashboardConfig(Config):
    """Where the page is served and how much of the robot it sends."""

    host: str = Field(default="127.0.0.1", min_length=1)
    """Address to listen on. The default is this machine alone; any other address needs `token`."""
    port: int = Field(default=8765, ge=0, le=65535)
    """TCP port; 0 takes any free one, which the log names."""
    token: Annotated[SecretStr, Field(min_length=TOKEN_LENGTH_MIN)] | None = None
    """What a person types to see the page. Without one, whoever reaches the port may drive."""
    names: tuple[str, ...] = ()
    """Further names under which browsers reach this robot (`robot.example.org`), beside its addresses and own name."""
    frame_hz: float = Field(default=10.0, gt=0.0, le=30.0)
    """Camera pictures a second at most, for each viewer."""
    frame_width: int = Field(default=320, ge=32, le=1920)
    """Wider pictures are scaled down to this width (px) before they are sent."""
    jpeg_quality: int = Field(default=70, ge=10, le=95)
    """Of the pictures sent."""
    viewers_max: int = Field(default=8, ge=1, le=64)
    """Pages open at the same time; one more is turned away."""

    @property
    def loopback(self) -> bool:
        """Whether only this machine reaches the page."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @model_validator(mode="after")
    def _others_need_a_token(self) -> DashboardConfig:
        if not self.loopback and self.token is None:
            raise ValueError(
                f"host {self.host} lets other machines see and drive this robot: set a token of at least "
                f"{TOKEN_LENGTH_MIN} characters, or leave host at 127.0.0.1 and come by ssh -L"
            )
        return self
