"""Typed names of streams: a message type is its own default topic, a `Topic` object names a second instance."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Generic

from typing_extensions import TypeVar

from robotd.world.messages import Message

MessageT_co = TypeVar("MessageT_co", bound=Message, covariant=True, default=Message)

_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")


@dataclass(frozen=True, slots=True)
class Topic(Generic[MessageT_co]):
    """The name of one stream and the type of message that flows on it.

    `name` is lower snake case, as it stands in a config's `as:`. Raises ValueError for any other form.
    """

    name: str
    type: type[MessageT_co]

    def __post_init__(self) -> None:
        if not _NAME.match(self.name):
            raise ValueError(f"topic name {self.name!r} must be lower snake case, for example 'rear_scan'")

    def __str__(self) -> str:
        return self.name


def default_topic(message_type: type[Message]) -> Topic[Message]:
    """The topic that a message type names by itself: `LidarScan` flows on `lidar_scan`."""
    return Topic(_WORD.sub("_", message_type.__name__).lower(), message_type)
