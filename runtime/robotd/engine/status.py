"""What a person asks about a running robot, as frozen data: the terminal, the page and the bridges all show this."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from robotd.world.messages import Command, Drive, Mode

DeviceState: TypeAlias = Literal["opening", "open", "lost", "closed"]


@dataclass(frozen=True, slots=True)
class BehaviourStatus:
    """One behaviour. `state` is its own word for what it does; `verdict_reason` says why it drives or does not."""

    name: str
    active: bool
    state: str
    priority: int
    verdict_reason: str


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """One topic: messages a second, age of the newest (inf where none), messages replaced unseen, faults survived."""

    topic: str
    source: str
    rate_hz: float
    age_s: float
    overwritten: int
    faults: int


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """One device; `detail` says why it is not open, or what is wrong with it all the same (a low battery)."""

    name: str
    state: DeviceState
    detail: str


@dataclass(frozen=True, slots=True)
class Status:
    """One instant of one robot. `reason`: why it stands still, empty while it moves.

    zones_off: why this robot drives without the guard's zones; empty where it has them.
    """

    now_ns: int
    mode: Mode
    reason: str
    behaviours: tuple[BehaviourStatus, ...]
    streams: tuple[StreamStatus, ...]
    devices: tuple[DeviceStatus, ...]
    command: Command
    by: str
    limited_by: tuple[str, ...]
    tick_late_ms: float
    turns: int
    virtual: bool
    zones_off: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON: the mode by its name, infinities as None."""
        command = self.command
        return {
            "now_ns": self.now_ns,
            "mode": self.mode.value,
            "reason": self.reason,
            "behaviours": [
                {
                    "name": b.name,
                    "active": b.active,
                    "state": b.state,
                    "priority": b.priority,
                    "verdict_reason": b.verdict_reason,
                }
                for b in self.behaviours
            ],
            "streams": [
                {
                    "topic": s.topic,
                    "source": s.source,
                    "rate_hz": s.rate_hz,
                    "age_s": s.age_s if math.isfinite(s.age_s) else None,
                    "overwritten": s.overwritten,
                    "faults": s.faults,
                }
                for s in self.streams
            ],
            "devices": [{"name": d.name, "state": d.state, "detail": d.detail} for d in self.devices],
            "command": (
                {"vx_mps": command.vx_mps, "vy_mps": command.vy_mps, "wz_radps": command.wz_radps}
                if isinstance(command, Drive)
                else {"speed_mps": command.speed_mps, "steering_rad": command.steering_rad}
            ),
            "by": self.by,
            "limited_by": list(self.limited_by),
            "tick_late_ms": self.tick_late_ms,
            "turns": self.turns,
            "virtual": self.virtual,
            "zones_off": self.zones_off,
        }
