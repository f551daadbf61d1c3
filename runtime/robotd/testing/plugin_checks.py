"""The contract of behaviours and perceptors as one call each."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import time
import typing
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np

from robotd.authoring.behaviour import Behaviour, Done, Failed, StepResult
from robotd.authoring.config import Config, Goal
from robotd.authoring.explain import Drawing
from robotd.authoring.perceptor import Perceptor
from robotd.authoring.view import View
from robotd.engine.codec import RecordError, encode, to_viewer_json
from robotd.testing.examples import example_view
from robotd.testing.failure import fail
from robotd.world.messages import Message
from robotd.world.robot import Robot

MakeView = Callable[[int], View]
"""From the number of the step, 0, 1, 2, ..., to its view."""

_PERIOD_NS = 50_000_000
_CLOCKS = ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "sleep")


def check_behaviour(
    cls: type[Behaviour[Any, Any, Any]],
    config: Config | None = None,
    make_view: MakeView | None = None,
    *,
    goal: Goal | None = None,
    robot: Robot | None = None,
    steps: int = 40,
) -> list[StepResult]:
    """Steps a behaviour through `steps` views and checks its contract; returns what it answered, up to its outcome.

    The config survives a round trip through a dict and through JSON and refuses unknown keys; a fresh instance given
    the same views gives the same results bit for bit, with `explain()` called or not; `step` reads no clock and leaves
    its view alone; results are None, Done, Failed or a finite command of the declared kind; `explain()` returns drawing
    types only; `close()` works on a stepped and on an unused instance. Raises CheckFailed.

    config: default the config type's defaults. make_view: default 20 views a second of `example_view`, every third
    without its optional messages.
    """
    config = _checked_config(cls, cls.config_type, config)
    if not issubclass(cls.goal_type, Goal):
        fail(cls, f"its goal type {cls.goal_type!r} is no Goal")
    views = _views(cls, cls.sees, make_view, steps)
    cls.load(config)

    def run(explain: bool) -> list[StepResult]:
        behaviour = cls(config, goal, robot)
        results: list[StepResult] = []
        for number, view in enumerate(views):
            results.append(_guarded_step(cls, behaviour, view, number))
            _check_result(cls, cls.emits, results[-1], number)
            if explain:
                _check_explanation(cls, behaviour.explain(), number)
            if isinstance(results[-1], Done | Failed):
                break
        behaviour.close()
        return results

    first = run(explain=False)
    _same(cls, first, run(explain=False), "a second fresh instance answered the same views differently")
    _same(cls, first, run(explain=True), "explain() changes what step() answers")
    cls(config, goal, robot).close()
    return first


def check_perceptor(
    cls: type[Perceptor[Any, Any, Any]],
    config: Config | None = None,
    make_view: MakeView | None = None,
    *,
    robot: Robot | None = None,
    steps: int = 20,
) -> list[Message | None]:
    """Steps a perceptor through `steps` views and checks its contract; returns what it published.

    As for `check_behaviour`; results are None or the declared message type, stamped no later than the view, with
    read-only arrays that a recording can hold. Raises CheckFailed.
    """
    config = _checked_config(cls, cls.config_type, config)
    views = _views(cls, cls.sees, make_view, steps)
    cls.load(config)

    def run(explain: bool) -> list[Message | None]:
        perceptor = cls(config, robot)
        results: list[Message | None] = []
        for number, view in enumerate(views):
            results.append(_guarded_step(cls, perceptor, view, number))
            _check_message(cls, cls.produces, results[-1], view, number)
            if explain:
                _check_explanation(cls, perceptor.explain(), number)
        return results

    first = run(explain=False)
    _same(cls, first, run(explain=False), "a second fresh instance answered the same views differently")
    _same(cls, first, run(explain=True), "explain() changes what step() answers")
    return first


# ----------------------------------------------------------------------------------------------- parts


def _checked_config(cls: type, config_type: type[Config], config: Config | None) -> Config:
    if not (config_type.model_config.get("frozen") and config_type.model_config.get("extra") == "forbid"):
        fail(cls, f"{config_type.__name__} must be frozen and forbid unknown keys", "derive it from robotd.Config")
    if config is None:
        wanted = [name for name, field in config_type.model_fields.items() if field.is_required()]
        if wanted:
            fail(cls, f"{config_type.__name__} has no default for {', '.join(wanted)}", "give the check a config")
        config = config_type()
    if type(config) is not config_type:
        fail(cls, f"takes {config_type.__name__}, was given {type(config).__name__}")
    try:
        through_dict = config_type.model_validate(config.model_dump())
        through_json = config_type.model_validate_json(config.model_dump_json())
    except ValueError as error:
        fail(cls, f"{config_type.__name__} does not survive a round trip: {error}")
    if not through_dict == through_json == config:
        fail(cls, f"{config_type.__name__} changes in a round trip: {config!r}, {through_dict!r}, {through_json!r}")
    return config


def _views(cls: type, sees: type[View], make_view: MakeView | None, steps: int) -> list[View]:
    if make_view is None:

        def make_view(number: int) -> View:
            return example_view(sees, (number + 1) * _PERIOD_NS, with_latest=number % 3 != 2)

    views = [make_view(number) for number in range(steps)]
    for number, view in enumerate(views):
        if not isinstance(view, sees):
            fail(cls, f"sees {sees.__name__}, make_view({number}) gave {type(view).__name__}")
    return views


def _guarded_step(cls: type, plugin: Any, view: View, number: int) -> Any:
    """One step that may neither read a clock nor change its view."""
    before = _print_of(view)
    with _no_clock(cls, number):
        result = plugin.step(view)
    if _print_of(view) != before:
        fail(cls, f"step {number} changed its view", "messages are shared: copy an array before changing it")
    return result


def _print_of(view: View) -> bytes:
    return encode({name: value for name, value in vars(view).items() if name != "now_ns"})


@contextlib.contextmanager
def _no_clock(cls: type, number: int) -> Iterator[None]:
    """While a step runs, the plugin's own package finds no clock; the libraries that it calls do."""
    package = cls.__module__.partition(".")[0]

    def guarded(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            if sys._getframe(1).f_globals.get("__name__", "").partition(".")[0] == package:
                mend = "never wait in a step" if name == "sleep" else "seen.now_ns is the time"
                fail(cls, f"step {number} calls time.{name}", mend)
            return real(*args)

        return call

    with contextlib.ExitStack() as stack:
        for name in _CLOCKS:
            stack.enter_context(mock.patch.object(time, name, guarded(name, getattr(time, name))))
        yield


def _check_result(cls: type, emits: type[Any], result: Any, number: int) -> None:
    if result is None:
        return
    if isinstance(result, Done | Failed):
        if not isinstance(result.reason, str):
            fail(cls, f"step {number} ended with the reason {result.reason!r}", "a reason is a sentence for people")
        return
    if not isinstance(result, emits):
        mend = f"declare emits = {type(result).__name__}" if type(result).__name__ in ("Drive", "Steer") else ""
        fail(cls, f"step {number} returned {type(result).__name__}, it declares {emits.__name__}", mend)
    for field in dataclasses.fields(result):
        value = getattr(result, field.name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not math.isfinite(value):
            fail(cls, f"step {number} returned {field.name} = {value!r}", "a command holds finite numbers")


def _check_message(cls: type, produces: type[Message], message: Any, view: View, number: int) -> None:
    if message is None:
        return
    if not isinstance(message, produces):
        fail(cls, f"step {number} returned {type(message).__name__}, it declares {produces.__name__}")
    if message.stamp_ns > view.now_ns:
        mend = "stamp the output with the stamp of the input that it describes"
        fail(cls, f"step {number} stamped {message.stamp_ns} ns, later than the view's {view.now_ns} ns", mend)
    for name in (field.name for field in dataclasses.fields(message)):
        value = getattr(message, name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            fail(cls, f"step {number}: the array {name} can be written to", "array.flags.writeable = False")
    try:
        encode(message)
    except RecordError as error:
        fail(cls, f"step {number} returned a message that cannot be recorded: {error}")


def _check_explanation(cls: type, explanation: Any, number: int) -> None:
    if not isinstance(explanation, tuple):
        fail(cls, f"explain() after step {number} returned {type(explanation).__name__}", "return a tuple")
    for drawing in explanation:
        if not isinstance(drawing, typing.get_args(Drawing)):
            fail(
                cls,
                f"explain() after step {number} returned a {type(drawing).__name__}",
                "see robotd.authoring.explain",
            )
        try:
            encode(drawing)
            to_viewer_json(drawing)
        except (RecordError, TypeError) as error:
            fail(cls, f"explain() after step {number}: {type(drawing).__name__} cannot be shown: {error}")


def _same(cls: type, first: list[Any], second: list[Any], what: str) -> None:
    for number, (one, two) in enumerate(zip(first, second, strict=False)):
        if encode(one) != encode(two):
            fail(cls, f"{what}: step {number} gave {one!r}, then {two!r}", "keep all memory in the instance")
    if len(first) != len(second):
        fail(cls, f"{what}: it ended after {len(first)} steps, then after {len(second)}")
