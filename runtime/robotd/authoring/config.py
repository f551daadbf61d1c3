"""The base of every plugin's parameters: a frozen model that refuses what it does not know."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


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
