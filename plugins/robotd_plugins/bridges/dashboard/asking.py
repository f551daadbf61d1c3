"""What a viewer may ask: parses one text into an `Ask`, and carries it out on the runtime."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robotd import RuntimeLink
from robotd.authoring.bridge import Refused

TEXT_BYTES_MAX = 4096
"""A longer message is refused before anything looks into it."""


class Ask(BaseModel):
    """One message of the page. `id` comes back with the answer; `n` is the beat that was drawn."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    do: Literal[
        "estop", "reset_estop", "arm", "disarm", "pause", "resume", "start", "cancel",  # to the robot
        "beat", "ping", "look",  # between page and bridge
    ]  # fmt: skip
    id: int = Field(default=0, ge=0, le=1 << 31)
    n: int = Field(default=0, ge=0, le=1 << 31)
    behaviour: str = Field(default="", max_length=100)
    goal: dict[str, Any] | None = None
    camera: str | None = Field(default=None, max_length=100)


class Garbage(ValueError):
    """A message that no page of ours sends; the text says what is wrong with it."""


def parse(text: str) -> Ask:
    """One message of a viewer. Raises Garbage."""
    try:
        return Ask.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise Garbage(f"{place}: {first['msg']}" if place else first["msg"]) from error


def carry_out(ask: Ask, runtime: RuntimeLink, by: str) -> str:
    """Do what was asked of the robot; returns the reason of a refusal, or an empty string."""
    try:
        match ask.do:
            case "estop":
                runtime.estop(by, "")
            case "reset_estop":
                runtime.reset_estop(by)
            case "arm":
                runtime.arm(by)
            case "disarm":
                runtime.disarm(by)
            case "pause":
                runtime.pause(by)
            case "resume":
                runtime.resume(by)
            case "start":
                runtime.start(by, ask.behaviour, ask.goal)
            case "cancel":
                runtime.cancel(by, ask.behaviour)
            case _:
                return f"{ask.do!r} asks nothing of the robot"
    except Refused as refused:
        return str(refused)
    return ""


def in_words(ask: Ask) -> str:
    """What was asked, for the log."""
    return f"{ask.do} {ask.behaviour}".strip()
