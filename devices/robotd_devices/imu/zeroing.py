"""The rates' offsets, from samples while the robot stands still. Pure functions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robotd.world.messages import Float64s

MOST_STD_RADPS = 0.03
"""Cheap gyroscopes at rest are below 0.01; a motor that idles or a hand on the robot is above."""
MOST_OFFSET_RADPS = 0.5
"""20 degrees a second is an MPU-6050's worst; more is a robot that turns evenly."""


class Zero(NamedTuple):
    """Offsets (3,) to take off the rates, or None with the reason."""

    offset_radps: Float64s | None
    why_not: str = ""


def zero(rates_radps: Float64s) -> Zero:
    """Offsets from rates (n, 3) that were read in a row. None where the robot moved meanwhile."""
    if len(rates_radps) < 2:
        return Zero(None, "fewer than two samples")
    std, mean = float(rates_radps.std(axis=0).max()), rates_radps.mean(axis=0)
    if std > MOST_STD_RADPS:
        return Zero(None, f"the robot moved (rates vary by {std:.3f} rad/s)")
    if float(np.abs(mean).max()) > MOST_OFFSET_RADPS:
        return Zero(None, f"the robot turned ({float(np.abs(mean).max()):.2f} rad/s)")
    return Zero(mean)
