"""The base of every plugin's parameters: a frozen model that refuses what it does not know."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict


@dataclass(frozen=True, slots=True)
class FileKey:
    """Marks a text parameter as the name of a file: `map: Annotated[str, FileKey("maps")] = "line_track"`.

    A relative name counts from the config's own folder; the parameter's value is then the whole path. With `shelf`,
    the name of a file that robotd ships there (`maps`), with or without its suffix, is taken too and stays as it is. A
    file that does not exist is refused at its key. (Parameters of pydantic's `FilePath` count from the config's folder
    likewise.)
    """

    shelf: str = ""
    suffix: str = ".yaml"


class Config(BaseModel):
    """Parameters of a plugin or a device. Keys carry their unit (`range_max_m`); unknown keys are errors."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, use_attribute_docstrings=True
    )


class NoConfig(Config):
    """For plugins without parameters."""


class Goal(Config):
    """What an operator asks of a behaviour: typed and validated like a config."""


class NoGoal(Goal):
    """For behaviours that are simply started."""
