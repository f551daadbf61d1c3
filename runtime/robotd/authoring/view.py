"""What one plugin sees in one step: a small frozen class that *is* its subscription.

    class Sees(View):
        scan: LidarScan = every(within_s=0.15)             # wakes the step; missing or older: no step
        odometry: Odometry = needed(within_s=0.1)          # does not wake; missing or older: no step
        target: Target | None = latest(within_s=0.5)       # optional; becoming stale wakes the step with None

`class Sees(View, hz=20)` steps on time instead. A view that nothing wakes is refused when the class is made.
"""

from __future__ import annotations

import inspect
import sys
import types
import typing
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Self, overload

from typing_extensions import TypeVar, dataclass_transform

from robotd.world.clock import ns
from robotd.world.messages import Message
from robotd.world.topics import Topic, default_topic

MessageT = TypeVar("MessageT", bound=Message)


class Wake(Enum):
    """How a field takes part in a step."""

    EVERY = "every"
    NEEDED = "needed"
    LATEST = "latest"


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """One field of a view after its class was made: `within_ns` is None for a state topic, which has no age."""

    name: str
    topic: Topic[Message]
    wake: Wake
    within_ns: int | None


@dataclass(frozen=True, slots=True)
class _Unbound:
    wake: Wake
    within_s: float | None
    topic: Topic[Message] | None


class ViewError(TypeError):
    """A view class that cannot work; the message names the class, the field and the mend."""


@overload
def every(topic: Topic[MessageT], /, *, within_s: float) -> MessageT: ...
@overload
def every(*, within_s: float) -> Any: ...
def every(topic: Topic[Any] | None = None, /, *, within_s: float) -> Any:
    """Wakes the step with each new message; missing or older than `within_s`: no step."""
    return _Unbound(Wake.EVERY, within_s, topic)


@overload
def needed(topic: Topic[MessageT], /, *, within_s: float | None = None) -> MessageT: ...
@overload
def needed(*, within_s: float | None = None) -> Any: ...
def needed(topic: Topic[Any] | None = None, /, *, within_s: float | None = None) -> Any:
    """Accompanies the step; missing or older than `within_s`: no step. A state topic takes no `within_s`."""
    return _Unbound(Wake.NEEDED, within_s, topic)


@overload
def latest(topic: Topic[MessageT], /, *, within_s: float | None = None) -> MessageT | None: ...
@overload
def latest(*, within_s: float | None = None) -> Any: ...
def latest(topic: Topic[Any] | None = None, /, *, within_s: float | None = None) -> Any:
    """Accompanies the step or is None; becoming older than `within_s` wakes the step with None."""
    return _Unbound(Wake.LATEST, within_s, topic)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(every, needed, latest))
class _Fields:
    """Tells type checkers what the classes below it are; they would not count the fields of this class itself."""


class View(_Fields):
    """Root of all views. `now_ns`: the instant of the step, the same for all that runs in one turn."""

    now_ns: int = 0

    specs: ClassVar[tuple[FieldSpec, ...]] = ()
    period_ns: ClassVar[int | None] = None

    def __init_subclass__(cls, *, hz: float | None = None) -> None:
        super().__init_subclass__()
        if hz is not None and not hz > 0.0:
            raise ViewError(f"{cls.__qualname__}: hz must be above 0, not {hz}")
        inherited = {spec.name: spec for spec in cls.specs}
        inherited.update(_bind(cls))
        cls.specs = tuple(inherited.values())
        if hz is not None:
            cls.period_ns = ns(1.0 / hz)
        if cls.period_ns is None and not any(spec.wake is Wake.EVERY for spec in cls.specs):
            raise ViewError(
                f"{cls.__qualname__}: nothing wakes this view; give one field every(...), "
                f"or write class {cls.__name__}(View, hz=20)"
            )

    if not typing.TYPE_CHECKING:

        def __init__(self, *, now_ns: int = 0, **fields: Message | None) -> None:
            wanted = {spec.name for spec in self.specs}
            if wrong := sorted(wanted ^ fields.keys()):
                raise TypeError(f"{type(self).__qualname__}() takes exactly {sorted(wanted)}; wrong: {wrong}")
            self.__dict__["now_ns"] = now_ns
            self.__dict__.update(fields)

        def __setattr__(self, name: str, value: object) -> None:
            raise AttributeError(f"a view is frozen: cannot set {name}")

        def __delattr__(self, name: str) -> None:
            raise AttributeError(f"a view is frozen: cannot delete {name}")

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value!r}" for name, value in self.__dict__.items())
        return f"{type(self).__name__}({inside})"

    @classmethod
    def assemble(cls, now_ns: int, values: dict[str, Any]) -> Self:
        """The engine's way in: the fields by name, checked while they were gathered; the view takes the dict over."""
        values["now_ns"] = now_ns
        view = object.__new__(cls)
        object.__setattr__(view, "__dict__", values)
        return view


def _bind(cls: type[View]) -> dict[str, FieldSpec]:
    own = inspect.get_annotations(cls)
    unbound = {name: value for name, value in vars(cls).items() if isinstance(value, _Unbound)}
    for name in unbound:
        if name not in own:
            raise ViewError(f"{cls.__qualname__}.{name}: needs an annotation, as in `{name}: LidarScan = every(...)`")
    for name, annotation in own.items():
        if name not in unbound and "ClassVar" not in str(annotation):
            raise ViewError(f"{cls.__qualname__}.{name}: say how it wakes the step: every(), needed() or latest()")
    bound = {name: _bind_field(cls, name, own[name], value) for name, value in unbound.items()}
    for name in unbound:
        delattr(cls, name)
    return bound


def _bind_field(cls: type[View], name: str, annotation: object, unbound: _Unbound) -> FieldSpec:
    topic = unbound.topic or default_topic(_message_type(cls, name, annotation))
    where = f"{cls.__qualname__}.{name}"
    if topic.type.is_state:
        if unbound.within_s is not None:
            raise ViewError(f"{where}: {topic.type.__name__} holds until replaced; leave within_s out")
        return FieldSpec(name, topic, unbound.wake, None)
    if unbound.within_s is None or not unbound.within_s > 0.0:
        raise ViewError(f"{where}: say how old it may be, for example within_s=0.15")
    return FieldSpec(name, topic, unbound.wake, ns(unbound.within_s))


def _message_type(cls: type[View], name: str, annotation: object) -> type[Message]:
    """The message class that an annotation names; a string is looked up where the class statement stands."""
    if isinstance(annotation, str):
        scope = dict(vars(sys.modules[cls.__module__])) if cls.__module__ in sys.modules else {}
        scope.update(_locals_around(cls))
        try:
            annotation = eval(annotation, scope)
        except NameError as error:
            raise ViewError(
                f"{cls.__qualname__}.{name}: {error}; import the message type at run time "
                f"(not under TYPE_CHECKING), or name a topic: every(Topic('...', Type), ...)"
            ) from error
    wanted = [arg for arg in typing.get_args(annotation) or (annotation,) if arg is not type(None)]
    if len(wanted) == 1 and isinstance(wanted[0], type) and issubclass(wanted[0], Message):
        return wanted[0]
    raise ViewError(f"{cls.__qualname__}.{name}: expected one message type, got {annotation!r}")


def _locals_around(cls: type[View]) -> dict[str, Any]:
    """Local names of the function in which a class statement stands; empty for a class at module level."""
    function, local, _ = cls.__qualname__.rpartition(".<locals>.")
    frame: types.FrameType | None = sys._getframe() if local else None
    while frame is not None:
        if frame.f_code.co_qualname == function:
            return dict(frame.f_locals)
        frame = frame.f_back
    return {}
