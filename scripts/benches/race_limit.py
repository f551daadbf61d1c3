"""The friction-limited time of a track: a line of least curvature inside the walls, driven as fast as tyres allow.

A yardstick, not a proof of the optimum: the line minimises squared second differences (Heilmeier et al., Minimum
curvature trajectory planning, Vehicle System Dynamics 2020, without its iteration), the speed comes from one pass
backwards and one forwards on the friction circle.
"""

from __future__ import annotations

import numpy as np

from benches.race_tracks import Floats, Track, curvature
from robotd_devices.sim.single_track import GRAVITY_MPS2, RaceCar

_STEP_M = 0.4


def line(track: Track, half_width_m: float) -> Floats:
    """The line (n, 2), closed, the car's middle `half_width_m` and 5 cm from each wall."""
    from scipy.optimize import lsq_linear
    from scipy.sparse import diags_array, vstack

    ring = np.vstack((track.middle_m, track.middle_m[:1]))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
    n = round(way[-1] / _STEP_M)
    at = np.arange(n) * (way[-1] / n)
    middle = np.stack([np.interp(at, way, ring[:, k]) for k in (0, 1)], axis=1)
    width = np.interp(at, way, np.append(track.width_m, track.width_m[0]))
    along = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    normal = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.hypot(along[:, 0], along[:, 1])[:, None]
    second = diags_array(
        [1.0, -2.0, 1.0, 1.0, 1.0], offsets=[-1, 0, 1, n - 1, 1 - n], shape=(n, n), dtype=np.float64
    ).tocsr()  # fmt: skip
    matrix = vstack([second @ diags_array(normal[:, k]) for k in (0, 1)]).tocsr()
    room = np.maximum(width / 2.0 - half_width_m - 0.05, 0.02)
    found = lsq_linear(matrix, -np.concatenate([second @ middle[:, k] for k in (0, 1)]), (-room, room), max_iter=60)
    return middle + found.x[:, None] * normal


def limited_lap_s(track: Track, car: RaceCar, top_mps: float, mu: float) -> tuple[float, float]:
    """Time of a flying lap, and of one from a standstill, in seconds."""
    path = line(track, car.width_m / 2.0)
    kappa = np.abs(curvature(path))
    step = np.hypot(*(np.roll(path, -1, axis=0) - path).T)
    grip = mu * GRAVITY_MPS2
    accel, brake = min(car.accel_mps2, grip), min(car.brake_mps2, grip)
    cap = np.minimum(np.sqrt(grip / np.maximum(kappa, 1e-6)), top_mps)

    def along(v: float, k: float, most: float) -> float:
        return most * max(1.0 - (v * v * k / grip) ** 2, 0.0) ** 0.5

    n = len(cap)
    v = cap.copy()
    for i in range(2 * n - 1, -1, -1):
        a, b = i % n, (i + 1) % n
        v[a] = min(v[a], (v[b] ** 2 + 2.0 * along(v[b], kappa[b], brake) * step[a]) ** 0.5)
    times = []
    for standing in (False, True):
        u = v.copy()
        if standing:
            u[0] = 0.5
        for i in range(n - 1 if standing else 2 * n):
            a, b = i % n, (i + 1) % n
            most = along(u[a], kappa[a], accel * min(1.0, car.full_power_to_mps / max(u[a], 1e-3)))
            u[b] = min(v[b], (u[a] ** 2 + 2.0 * most * step[a]) ** 0.5)
        pair = u + np.roll(u, -1)
        if standing:
            pair[-1] = 2.0 * u[-1]
        times.append(float((2.0 * step / pair).sum()))
    return times[0], times[1]
