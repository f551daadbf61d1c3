"""All key frames of a survey at once: the poses at which their returns lie on each other and the lap is closed.

First a pose graph of the odometry's steps and the one closing (Lu and Milios, Globally consistent range scan alignment,
Autonomous Robots 4, 1997), then a few rounds in which each return is tied to one of another key frame, as far away in
the lap as its neighbours allow, by its distance along the wall's normal. Solved as one sparse least-squares problem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.toolkit.race_track import TrackSurvey

_ROUNDS: Final = 6
_TIED_MOST: Final = 24_000
_NEIGHBOURS: Final = 12
_SIGMA_M: Final = 0.03
_STEP_M, _STEP_SHARE, _STEP_RAD, _STEP_TURN_SHARE = 0.01, 0.02, 0.004, 0.02
_CLOSING: Final = (0.10, 0.05, 0.02)
_FIXED: Final = 1e-6
Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Wall points in `track`, (m, 2), each moved onto the wall of its neighbours; normals (m, 2) towards the track."""

    points_m: Float64s
    normals: Float64s


def register(survey: TrackSurvey) -> Float64s:
    """Poses (n, 3) of base at the key frames in `track`."""
    poses = _closed(survey)
    every = max(1, math.ceil(len(survey.key) / _TIED_MOST))
    points, key = survey.points_m[::every].astype(np.float64), survey.key[::every].astype(np.intp)
    steps = _steps(survey.path)
    for at in range(_ROUNDS):
        reach_m = max(0.5 * 0.6**at, 0.12)
        world = placed(points, key, poses)
        normals, _, neighbours, there = normals_of(world, eyes_of(survey, poses)[key], _NEIGHBOURS, min(reach_m, 0.25))
        one, other = _ties(normals, key, neighbours, there & _within(world, neighbours, reach_m))
        rows, e = _tie_rows(points, key, poses, world, normals, one, other)
        sigma = max(_SIGMA_M, 1.4826 * float(np.median(np.abs(e)))) if len(e) else _SIGMA_M
        weight = 1.0 / (1.0 + (e / sigma) ** 2) / sigma**2
        poses = _solved(poses, rows, e, weight, *_step_rows(poses, steps))
    return poses


def surface(survey: TrackSurvey, poses: Float64s) -> Surface:
    """The walls that all returns show from the given poses of their key frames."""
    key = survey.key.astype(np.intp)
    world = placed(survey.points_m.astype(np.float64), key, poses)
    normals, mean, neighbours, there = normals_of(world, eyes_of(survey, poses)[key], 20, 0.2)
    off = np.einsum("ij,ij->i", normals, world - mean)
    flat = world - off[:, None] * normals
    # which side of a wall is the track: a return that was met at a flat angle may have it wrong, its neighbours vote
    votes = np.einsum("ijk,ij->ik", normals[neighbours], there.astype(np.float64))
    agree = np.einsum("ij,ij->i", normals, votes) / there.sum(axis=1)
    normals = np.where((agree < 0.0)[:, None], -normals, normals)
    # a return that stands alone is no wall, and one whose neighbours point to all sides none that can be told
    kept = (there.sum(axis=1) >= 4) & (np.abs(agree) > 0.4)
    return Surface(flat[kept], normals[kept])


def placed(points: Float64s, key: Ints, poses: Float64s) -> Float64s:
    """Points (m, 2), each in base of its key frame, seen in `track`."""
    x, y, yaw = poses[key].T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack((cos * points[:, 0] - sin * points[:, 1] + x, sin * points[:, 0] + cos * points[:, 1] + y), axis=1)


def eyes_of(survey: TrackSurvey, poses: Float64s) -> Float64s:
    """Where the lidar was at each key frame, (n, 2) in `track`."""
    lidar = np.array([survey.lidar_x_m, survey.lidar_y_m])
    return placed(np.broadcast_to(lidar, (len(poses), 2)), np.arange(len(poses)), poses)


# ------------------------------------------------------------------------------------------- correspondences


def normals_of(world: Float64s, eyes: Float64s, most: int, reach_m: float) -> tuple[Float64s, Float64s, Ints, Any]:
    """For each point: its normal towards its eye, the mean of its neighbours, which they are (m, most), which count."""
    from scipy.spatial import cKDTree

    distance, neighbours = cKDTree(world).query(world, k=most, distance_upper_bound=reach_m)
    there = np.isfinite(distance)
    neighbours = np.where(there, neighbours, 0)
    count = there.sum(axis=1)[:, None]
    near = np.where(there[:, :, None], world[neighbours], 0.0)
    mean = near.sum(axis=1) / count
    off = np.where(there[:, :, None], near - mean[:, None, :], 0.0)
    xx, xy, yy = (off[:, :, 0] ** 2).sum(1), (off[:, :, 0] * off[:, :, 1]).sum(1), (off[:, :, 1] ** 2).sum(1)
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    normals = np.stack((-np.sin(along), np.cos(along)), axis=1)
    normals *= np.where(np.einsum("ij,ij->i", normals, eyes - world) < 0.0, -1.0, 1.0)[:, None]
    return normals, mean, neighbours, there


def _within(world: Float64s, neighbours: Ints, reach_m: float) -> NDArray[np.bool_]:
    away = world[neighbours] - world[:, None, :]
    near: NDArray[np.bool_] = np.einsum("ijk,ijk->ij", away, away) < reach_m * reach_m
    return near


def _ties(normals: Float64s, key: Ints, neighbours: Ints, there: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Pairs of points: each with the neighbour of the same wall whose key frame is farthest from its own."""
    same = np.einsum("ik,ijk->ij", normals, normals[neighbours]) > 0.7
    apart = np.where(there & same, np.abs(key[neighbours] - key[:, None]), 0)
    best = apart.argmax(axis=1)
    one = np.flatnonzero(apart[np.arange(len(key)), best] > 0)
    return one, neighbours[one, best[one]]


# --------------------------------------------------------------------------------------------- least squares


def _tie_rows(
    points: Float64s, key: Ints, poses: Float64s, world: Float64s, normals: Float64s, one: Ints, other: Ints
) -> tuple[Any, Float64s]:
    """Rows of the sparse problem, and the distances along the normals."""
    from scipy.sparse import csr_array

    n = normals[one]
    e = np.einsum("ij,ij->i", n, world[one] - world[other])

    def turned(which: Ints) -> Float64s:
        arm = world[which] - poses[key[which], :2]
        turned: Float64s = n[:, 1] * arm[:, 0] - n[:, 0] * arm[:, 1]
        return turned

    values = np.stack((n[:, 0], n[:, 1], turned(one), -n[:, 0], -n[:, 1], -turned(other)), axis=1)
    columns = np.concatenate([3 * key[one][:, None] + np.arange(3), 3 * key[other][:, None] + np.arange(3)], axis=1)
    begin = np.arange(0, 6 * len(one) + 1, 6)
    return csr_array((values.ravel(), columns.ravel(), begin), shape=(len(one), 3 * len(poses))), e


def _steps(path: Float64s) -> Float64s:
    """Each key frame but the first, seen from the one before, (n - 1, 3)."""
    return _between(path[:-1], path[1:])


def _between(a: Float64s, b: Float64s) -> Float64s:
    cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    turn = np.remainder(b[:, 2] - a[:, 2] + math.pi, math.tau) - math.pi
    return np.stack((cos * dx + sin * dy, cos * dy - sin * dx, turn), axis=1)


def _step_rows(poses: Float64s, steps: Float64s) -> tuple[Any, Float64s, Float64s]:
    """Rows, errors and weights of the odometry's steps."""
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    sigma = np.stack(
        (_STEP_M + _STEP_SHARE * way, _STEP_M + _STEP_SHARE * way, _STEP_RAD + _STEP_TURN_SHARE * turn), axis=1
    )
    n = len(poses)
    return _pair_rows(poses, np.arange(n - 1), np.arange(1, n), steps, sigma)


def _pair_rows(
    poses: Float64s, one: Ints, other: Ints, seen: Float64s, sigma: Float64s
) -> tuple[Any, Float64s, Float64s]:
    """Rows that want `other` seen from `one` as `seen`; both move in `track` and turn about themselves."""
    from scipy.sparse import csr_array

    a, b = poses[one], poses[other]
    now = _between(a, b)
    e = now - seen
    e[:, 2] = np.remainder(e[:, 2] + math.pi, math.tau) - math.pi
    cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
    m = len(one)
    values = np.zeros((m, 3, 6))
    values[:, 0, 0], values[:, 0, 1], values[:, 0, 2] = -cos, -sin, now[:, 1]
    values[:, 1, 0], values[:, 1, 1], values[:, 1, 2] = sin, -cos, -now[:, 0]
    values[:, 0, 3], values[:, 0, 4] = cos, sin
    values[:, 1, 3], values[:, 1, 4] = -sin, cos
    values[:, 2, 2], values[:, 2, 5] = -1.0, 1.0
    columns = np.concatenate([3 * one[:, None] + np.arange(3), 3 * other[:, None] + np.arange(3)], axis=1)
    columns = np.broadcast_to(columns[:, None, :], (m, 3, 6))
    begin = np.arange(0, 18 * m + 1, 6)
    rows = csr_array((values.ravel(), columns.ravel(), begin), shape=(3 * m, 3 * len(poses)))
    return rows, e.ravel(), (1.0 / sigma**2).ravel()


def _solved(poses: Float64s, *parts: Any) -> Float64s:
    """One Gauss-Newton step. parts: rows, errors, weights, and so on again; the first pose stays."""
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import spsolve

    size = poses.size
    h, g = csc_array((size, size)), np.zeros(size)
    for rows, e, weight in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        weighted = rows.T.multiply(weight)
        h, g = h + (weighted @ rows).tocsc(), g + weighted @ e
    hold = np.full(size, 1e-3)
    hold[:3] = 1.0 / _FIXED**2
    step: Float64s = spsolve(csc_array(h + diags_array(hold)), -g)
    return poses + step.reshape(-1, 3)


def _closed(survey: TrackSurvey) -> Float64s:
    """The odometry's path with the closing's error spread over it."""
    poses = survey.path.copy()
    steps = _steps(survey.path)
    one, other = np.array([survey.closed_key]), np.array([survey.closing_key])
    seen, sigma = np.array([survey.closing]), np.array([_CLOSING])
    for _ in range(5):
        closing = _pair_rows(poses, one, other, seen, sigma)
        poses = _solved(poses, *_step_rows(poses, steps), *closing)
    return poses
