"""The race line: closed, inside the corridor, and of all compromises between curvature and length the quickest.

Least curvature alone loves long ways round; so its weight against length is looked for, by the time of a lap (Braghin
et al., Race driver model, Computers and Structures 86, 2008). Each candidate is a quadratic programme over the offsets
from a reference line (Heilmeier et al., Minimum curvature trajectory planning and control for an autonomous race car,
Vehicle System Dynamics 58, 2020), solved anew about its result. Where we differ: the curvature of an offset line is
linearised as k + x'' + k^2 x, change of curvature has a price, since servo and tyres need time, and the programme is
solved by interior points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.line.corridor import Ring, WallField, ring_of, room_m
from robotd_plugins.behaviours.ftg_race.line.profile import LineLimits, lap_s, speeds_mps

_STEP_M = 0.25
_SMOOTH = 6
_ROUNDS = 10
_TRUST_M = 0.6
"""No point moves farther in one round."""
_DONE_M = 0.02
_CHANGE_M = 1.0
"""Curvature that changes by 1/m over this way costs as much as a curvature of 1/m."""
_LENGTH_PM2 = (0.4, 0.2, 0.8, 0.1, 1.6)
"""Prices of a metre of length that are tried, in order."""


def quickest(x_m: Float64s, y_m: Float64s, field: WallField, clear_m: float, limits: LineLimits) -> Ring:
    """The line about a driven path of the car's middle, (m,), closed, in driving order.

    clear_m: from the middle to the nearest wall. Raises ValueError where the corridor is closed.
    """
    driven = ring_of(x_m, y_m, _STEP_M, _SMOOTH)
    best, best_s = driven, np.inf
    for length_pm2 in _LENGTH_PM2:
        ring = compromise(best, field, clear_m, length_pm2)
        time_s = lap_s(speeds_mps(ring.curvature_pm, ring.step_m, limits), ring.step_m)
        if time_s < best_s:
            best, best_s = ring, time_s
    return best


def compromise(ring: Ring, field: WallField, clear_m: float, length_pm2: float) -> Ring:
    """The line of least curvature squared, plus length times `length_pm2`, both summed along it."""
    for _ in range(_ROUNDS):
        least, most = room_m(ring, field, clear_m)
        shift = _step(ring, np.maximum(least, -_TRUST_M), np.minimum(most, _TRUST_M), length_pm2)
        ring = ring_of(ring.x_m + shift * ring.normal_x, ring.y_m + shift * ring.normal_y, _STEP_M)
        if float(np.abs(shift).max()) < _DONE_M:
            break
    return ring


def _step(ring: Ring, least_m: Float64s, most_m: Float64s, length_pm2: float) -> Float64s:
    """Offsets (n,) of one programme."""
    from scipy.sparse import diags_array, eye_array

    n, step, k = len(ring.x_m), ring.step_m, ring.curvature_pm
    one = eye_array(n, format="csr")
    up = one[np.roll(np.arange(n), -1)]
    slope = (up - one) / step
    bend = (up - 2.0 * one + up.T) / (step * step) + diags_array(k * k)
    change = _CHANGE_M * (slope @ bend)
    hessian = bend.T @ bend + change.T @ change + length_pm2 * (slope.T @ slope)
    gradient = bend.T @ k + change.T @ (_CHANGE_M * (np.roll(k, -1) - k) / step) - length_pm2 * k
    return box_programme(hessian, gradient, least_m, most_m)


def box_programme(hessian: Any, gradient: Float64s, least: Float64s, most: Float64s, rounds: int = 40) -> Float64s:
    """The x (n,) of least x'Hx/2 + g'x with least <= x <= most, H sparse and positive semidefinite.

    Primal-dual interior points (Nocedal, Wright, Numerical Optimization 2006, chapter 16.6); strictly inside.
    """
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import splu

    h = csc_array(hessian)
    width = most - least
    x = np.clip(np.zeros_like(least), least + 0.1 * width, most - 0.1 * width)
    scale = float(np.abs(h @ x + gradient).max()) + 1e-9
    low = np.full_like(x, scale)
    high = np.full_like(x, scale)
    for _ in range(rounds):
        to_low, to_high = x - least, most - x
        gap = float(low @ to_low + high @ to_high) / (2 * len(x))
        if gap < 1e-7 * scale:
            break
        target = 0.15 * gap
        weight = low / to_low + high / to_high
        push = -(h @ x + gradient) + target / to_low - target / to_high
        dx = splu(csc_array(h + diags_array(weight))).solve(push)
        dlow = target / to_low - low - low / to_low * dx
        dhigh = target / to_high - high + high / to_high * dx
        share = min(_most(to_low, dx), _most(to_high, -dx))
        share2 = min(_most(low, dlow), _most(high, dhigh))
        x = x + share * dx
        low, high = low + share2 * dlow, high + share2 * dhigh
    return x


def _most(value: Float64s, change: Float64s) -> float:
    """The greatest share of a change, up to 1, that leaves everything positive."""
    falls = change < 0.0
    return min(1.0, 0.99 * float((-value[falls] / change[falls]).min(initial=np.inf)))
