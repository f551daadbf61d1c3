"""Tracks of the race bench: procedural ones from a seed (they are shipped in maps/tracks), and occupancy pictures.

A procedural track is the way round a random tree of cells, so that it never crosses itself and turns back at each leaf
of the tree: a hairpin. Its corners are rounded and the whole is bent smoothly.

    python scripts/benches/race_tracks.py        writes maps/tracks anew; a test holds the files against it
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
SEEDS = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)
"""Of the twelve shipped tracks, chosen before anything was tuned."""
EVANS = ("aut", "esp", "gbr", "mco")
_STEP_M = 0.1
_WALL_M = 0.25
_HAIRPIN_M = 1.5
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A closed track. middle_m: (n, 2) once round, not repeated, in driving direction, starting at the start line;
    width_m: (n,); grid: occupied (rows, columns), row 0 lowest, its lower left corner at `origin_m`.
    """

    name: str
    middle_m: Floats
    width_m: Floats
    occupied: NDArray[np.bool_]
    resolution_m: float
    origin_m: tuple[float, float]

    @property
    def length_m(self) -> float:
        """Once round along the middle."""
        steps = np.roll(self.middle_m, -1, axis=0) - self.middle_m
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def reverse(self) -> Track:
        """The same track the other way round."""
        middle = np.roll(self.middle_m[::-1], 1, axis=0)
        width = np.roll(self.width_m[::-1], 1)
        return Track(self.name + "-reverse", middle, width, self.occupied, self.resolution_m, self.origin_m)

    def pose(self, at_m: float = 0.0) -> tuple[float, float, float]:
        """A pose on the middle, `at_m` behind the start line's point, looking along it."""
        steps = np.roll(self.middle_m, -1, axis=0) - self.middle_m
        way = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
        i = int(np.searchsorted(way, at_m % way[-1], side="right")) - 1
        ahead = (i + 3) % len(self.middle_m)
        along = self.middle_m[ahead] - self.middle_m[i]
        return float(self.middle_m[i, 0]), float(self.middle_m[i, 1]), math.atan2(along[1], along[0])


def procedural(seed: int) -> Track:
    """The track of one seed: 1.6 to 2.1 m wide, 50 to 130 m long."""
    for attempt in range(100):
        rng = random.Random(f"track {seed} {attempt}")
        spacing_m = rng.uniform(2.6, 2.95)
        cells = rng.randint(5, 12)
        middle = _bent(_rounded(_round_the_tree(_tree(rng, cells)), spacing_m), rng)
        middle = _resampled(middle, _STEP_M)
        way = np.arange(len(middle)) * (math.tau / len(middle))
        base_m, wave_m = rng.uniform(1.7, 2.0), rng.uniform(0.0, 0.1)
        width = base_m + wave_m * np.sin(rng.randint(2, 5) * way + rng.uniform(0.0, math.tau))
        if _is_good(middle, width):
            start = _straightest(middle)
            return _with_grid(f"track_{seed:02d}", np.roll(middle, -start, axis=0), np.roll(width, -start))
    raise ValueError(f"seed {seed} gives no track")


def _tree(rng: random.Random, cells: int) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Edges of a random tree on the grid; it likes to go on straight."""
    inside, edges = [(0, 0)], set[tuple[tuple[int, int], tuple[int, int]]]()
    heading = (1, 0)
    while len(inside) < cells:
        here = inside[-1] if rng.random() < 0.7 else rng.choice(inside)
        step = heading if rng.random() < 0.5 else rng.choice([(1, 0), (-1, 0), (0, 1), (0, -1)])
        there = (here[0] + step[0], here[1] + step[1])
        if there not in inside:
            inside.append(there)
            edges |= {(here, there), (there, here)}
            heading = step
    return edges


def _round_the_tree(edges: set[tuple[tuple[int, int], tuple[int, int]]]) -> list[tuple[float, float]]:
    """Counter-clockwise round a tree of cells, in units of half the lane spacing: the tree stays on the left."""
    start = min(edge[0] for edge in edges)
    # a corner of a cell is where lanes meet: (cell, quadrant); a lane goes on to the next cell where an edge leads
    quads = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    outs = [(0, -1), (1, 0), (0, 1), (-1, 0)]
    points: list[tuple[float, float]] = []
    cell, q = start, 0
    while True:
        points.append((4.0 * cell[0] + quads[q][0], 4.0 * cell[1] + quads[q][1]))
        out = outs[q]
        there = (cell[0] + out[0], cell[1] + out[1])
        if (cell, there) in edges:
            cell, q = there, (q - 1) % 4
        else:
            q = (q + 1) % 4
        if (cell, q) == (start, 0):
            return points


def _rounded(corners: list[tuple[float, float]], spacing_m: float) -> Floats:
    """Lanes `spacing_m` apart whose corners are arcs of half of that: two in a row make the hairpin."""
    ring = np.array(corners) * (spacing_m / 2.0)
    out = []
    for at, corner in enumerate(ring):
        into, away = ring[at] - ring[at - 1], ring[(at + 1) % len(ring)] - ring[at]
        into, away = into / np.hypot(*into), away / np.hypot(*away)
        reach = spacing_m / 2.0
        if abs(float(into @ away)) > 0.5:  # straight on
            out.append(corner[None, :])
            continue
        share = np.linspace(0.0, math.pi / 2.0, 12)[:, None]
        centre = corner - into * reach + away * reach
        out.append(centre - away * reach * np.cos(share) + into * reach * np.sin(share))
    return np.vstack(out)


def _bent(points: Floats, rng: random.Random) -> Floats:
    """The plane bent by two slow waves: no straight stays quite straight, nothing crosses."""
    bend_m, length_m = rng.uniform(0.2, 0.45), rng.uniform(11.0, 15.0)
    a, b = rng.uniform(0.0, math.tau), rng.uniform(0.0, math.tau)
    x, y = points[:, 0], points[:, 1]
    return np.stack(
        (x + bend_m * np.sin(y * math.tau / length_m + a), y + bend_m * np.sin(x * math.tau / length_m + b)), axis=1
    )


def _resampled(points: Floats, step_m: float) -> Floats:
    """A closed line at equal steps, smoothed over a third of a metre."""
    ring = np.vstack((points, points[:1]))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
    count = round(way[-1] / step_m)
    at = np.arange(count) * (way[-1] / count)
    even = np.stack([np.interp(at, way, ring[:, k]) for k in (0, 1)], axis=1)
    for _ in range(4):
        even = 0.25 * np.roll(even, 1, axis=0) + 0.5 * even + 0.25 * np.roll(even, -1, axis=0)
    return even


def curvature(middle: Floats) -> Floats:
    """Of a closed line of equal steps, (n,), over three steps to each side."""
    before, after = middle - np.roll(middle, 3, axis=0), np.roll(middle, -3, axis=0) - middle
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.einsum("ij,ij->i", before, after))
    return turn / (0.5 * (np.hypot(before[:, 0], before[:, 1]) + np.hypot(after[:, 0], after[:, 1])))


def _is_good(middle: Floats, width: Floats) -> bool:
    """Long enough, a real hairpin, no corner tighter than the walls allow, a wall between neighbouring lanes."""
    if not 50.0 <= len(middle) * _STEP_M <= 140.0:
        return False
    kappa = np.abs(curvature(middle))
    if float((kappa * width).max()) > 1.8:
        return False
    turned = np.abs(np.convolve(np.concatenate((curvature(middle),) * 2) * _STEP_M, np.ones(45), "valid"))
    if turned.max() < 0.8 * math.pi or 4.5 / turned.max() > _HAIRPIN_M:
        return False
    gap = np.hypot(middle[:, None, 0] - middle[None, :, 0], middle[:, None, 1] - middle[None, :, 1])
    index = np.arange(len(middle))
    apart = np.abs(index[:, None] - index[None, :])
    apart = np.minimum(apart, len(middle) - apart) * _STEP_M > 5.0
    need = (width[:, None] + width[None, :]) / 2.0 + _WALL_M
    return bool((gap[apart] >= need[apart]).all())


def _straightest(middle: Floats) -> int:
    """Where a start line stands best: the middle of the calmest five metres."""
    kappa = np.abs(curvature(middle))
    calm = np.convolve(np.concatenate((kappa, kappa[:50])), np.ones(50), "valid")[: len(kappa)]
    return (int(calm.argmin()) + 10) % len(kappa)


def walls(track: Track) -> tuple[Floats, Floats]:
    """Left and right wall, each a closed line (n, 2)."""
    along = np.roll(track.middle_m, -1, axis=0) - np.roll(track.middle_m, 1, axis=0)
    normal = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.hypot(along[:, 0], along[:, 1])[:, None]
    half = track.width_m[:, None] / 2.0
    return track.middle_m + half * normal, track.middle_m - half * normal


def _with_grid(name: str, middle: Floats, width: Floats, resolution_m: float = 0.05) -> Track:
    """Occupied is what is farther from the middle than half the width there."""
    from scipy.spatial import cKDTree

    low = middle.min(axis=0) - 2.0
    columns, rows = (np.ceil((middle.max(axis=0) + 2.0 - low) / resolution_m)).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * resolution_m
    y = low[1] + (np.arange(rows) + 0.5) * resolution_m
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    fine = np.concatenate([middle + share * (np.roll(middle, -1, axis=0) - middle) for share in (0.0, 0.25, 0.5, 0.75)])
    distance, nearest = cKDTree(fine).query(cells)
    occupied = (distance > np.tile(width, 4)[nearest] / 2.0).reshape(rows, columns)
    return Track(name, middle, width, occupied, resolution_m, (float(low[0]), float(low[1])))


def evans(name: str, data: Path) -> Track:
    """One of the four tracks of f1tenth_benchmarks from the folder of test data."""
    from ruamel.yaml import YAML

    from robotd_devices.sim.grid import read_grid

    file = data / "tracks_evans" / f"{name}.yaml"
    grid = read_grid(file, YAML(typ="safe").load(file.read_text(encoding="utf-8")))
    line = np.loadtxt(data / "tracks_evans" / f"{name}_centerline.csv", delimiter=",", comments="#")
    origin = grid.origin[:2]
    return Track(name, line[:, :2], line[:, 2] + line[:, 3], grid.occupied, grid.resolution_m, origin)


def map_text(seed: int) -> str:
    """The map file of a procedural track."""
    track = procedural(seed)
    x_m, y_m, yaw_rad = track.pose()
    lines = [
        f"# A procedural race track (seed {seed}): {track.length_m:.0f} m round, {track.width_m.min():.2f} to "
        f"{track.width_m.max():.2f} m wide. Written by scripts/benches/race_tracks.py.",
        f"name: {track.name}",
        f"start: {{x_m: {x_m:.3f}, y_m: {y_m:.3f}, yaw_rad: {yaw_rad:.4f}}}",
        "walls:",
    ]
    for wall in walls(track):
        points = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in wall[::2])
        lines += [f"  - points_m: [{points}]", "    closed: true"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    for number in SEEDS:
        path = ROOT / "maps" / "tracks" / f"track_{number:02d}.yaml"
        path.write_text(map_text(number), encoding="utf-8")
        print(path.name)
