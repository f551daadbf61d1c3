"""A map as a MuJoCo model: tape, walls, posts, boxes and cards as geometry, people as bodies that are moved.

Nothing of our own renderer goes into it but the faces of cards: tape is laid as flat boxes, light and gloss are
MuJoCo's. MJCF is MuJoCo's XML format (its documentation, chapter "XML Reference").
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from robotd.authoring.device import DeviceMisconfigured
from robotd.world.messages import Bytes2D, Float64s
from robotd_devices.sim.faces import front_of
from robotd_devices.sim.maps import Card, FloorLine, WorldMap
from robotd_devices.sim.people import LEG_RADIUS_M, TORSO_RADIUS_M, Person
from robotd_devices.sim.scene import Scene

_THIN_M = 0.0004
"""Half the thickness of walls and cards."""
_TAPE_TOP_M = 0.0006
_HIP_SHARE = 0.5
_BEYOND_M = 3.0
"""Floor around everything that the map has."""
_AWAY_M = -50.0
"""Where a body is that is not there: deep under the floor."""


@dataclass(frozen=True, slots=True)
class Surface:
    """How floor and tape look: grey levels in full light, the share that mirrors, highlights, shadows of the lamps."""

    tape_grey: float = 82.0
    floor_grey: float = 200.0
    reflectance: float = 0.1
    specular: float = 0.3
    shadows: bool = False
    samples: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """A pinhole camera on the base: place (3,), right and up (3,) each in base, vertical field of view."""

    place_m: Float64s
    right: Float64s
    up: Float64s
    fov_rad: float


def import_mujoco() -> Any:
    """MuJoCo with a renderer that needs no screen. Raises DeviceMisconfigured where it is not installed."""
    import os
    import sys

    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError as error:
        raise DeviceMisconfigured(f"MuJoCo is missing ({error}): install it with pip install 'robotd[sim]'") from error
    return mujoco


class MujocoWorld:
    """A model of one scene. `model` and `data` are MuJoCo's; cameras are `eye0`, `eye1`... on the body `base`.

    `rng` draws floor, lamps and greys. Raises ValueError for a card's picture that cannot be read.
    """

    def __init__(self, scene: Scene, surface: Surface, eyes: tuple[Eye, ...], rng: np.random.Generator) -> None:
        mujoco = import_mujoco()
        self._scene = scene
        xml, files = mjcf(scene.map, scene.people, surface, eyes, rng)
        self.model: Any = mujoco.MjModel.from_xml_string(xml, files)
        self.data: Any = mujoco.MjData(self.model)
        self._kinematics, self._cameras = mujoco.mj_kinematics, mujoco.mj_camlight
        self._row = {
            self.model.body(at).name: int(self.model.body(at).mocapid[0])
            for at in range(self.model.nbody)
            if self.model.body(at).mocapid[0] >= 0
        }

    def place(self, pose: tuple[float, float, float], when_s: float) -> None:
        """Moves base, people and boxes to where they are at an instant."""
        data = self.data
        self._move("base", (pose[0], pose[1], 0.0), pose[2])
        for at, box in enumerate(self._scene.map.boxes):
            self._move(f"box{at}", (0.0, 0.0, 0.0 if box.from_s <= when_s < box.until_s else _AWAY_M))
        for at, person in enumerate(self._scene.people):
            for side, (x_m, y_m, _) in zip("ab", person.circles_m(when_s, 0.0), strict=True):
                self._move(f"leg{at}{side}", (x_m, y_m, 0.0))
            self._move(f"torso{at}", (*person.walk.places_m(np.array([when_s]))[0], 0.0))
        self._kinematics(self.model, data)
        self._cameras(self.model, data)

    def _move(self, body: str, place_m: tuple[float, float, float], yaw_rad: float = 0.0) -> None:
        row = self._row[body]
        self.data.mocap_pos[row] = place_m
        self.data.mocap_quat[row] = (math.cos(yaw_rad / 2.0), 0.0, 0.0, math.sin(yaw_rad / 2.0))


def mjcf(
    world: WorldMap, people: tuple[Person, ...], surface: Surface, eyes: tuple[Eye, ...], rng: np.random.Generator
) -> tuple[str, dict[str, bytes]]:
    """The XML of a map, and the picture files that it names with their content."""
    files = {"floor.png": _png(_vinyl(surface.floor_grey, rng))}
    files |= {f"face{at}.png": _png(_opaque(card)) for at, card in enumerate(world.cards)}
    faces = "".join(
        f'<texture name="face{at}" type="2d" file="face{at}.png"/>'
        f'<material name="face{at}" texture="face{at}" texuniform="false" specular="0" shininess="0"/>'
        for at in range(len(world.cards))
    )
    height_m = world.structure_height_m
    things = [
        *_lamps(world.bounds_m(), surface.shadows, rng),
        *(piece for line in world.lines for piece in _tape(line)),
        *_upright(world.segments_m, height_m, rng),
        *_posts(world.circles_m, height_m, rng),
        *(piece for at, card in enumerate(world.cards) for piece in _card(at, card)),
    ]
    for at, box in enumerate(world.boxes):
        things += [f'<body name="box{at}" mocap="true">', *_upright(box.segments_m, height_m, rng), "</body>"]
    things += (piece for at, person in enumerate(people) for piece in _person(at, person))
    cameras = "".join(
        f'<camera name="eye{at}" pos="{_numbers(eye.place_m)}" xyaxes="{_numbers(eye.right)} {_numbers(eye.up)}" '
        f'fovy="{math.degrees(eye.fov_rad):.9f}"/>'
        for at, eye in enumerate(eyes)
    )
    # a larger floor is dear to draw and hidden by walls
    x0, y0, x1, y1 = world.bounds_m()
    middle_m, half_m = ((x0 + x1) / 2.0, (y0 + y1) / 2.0), ((x1 - x0) / 2.0 + _BEYOND_M, (y1 - y0) / 2.0 + _BEYOND_M)
    shine = f'specular="{surface.specular:.3f}" shininess="0.5"'
    xml = f"""
<mujoco model="floor">
  <compiler angle="degree"/>
  <option><flag contact="disable"/></option>
  <statistic extent="1" center="0 0 0"/>
  <visual>
    <headlight ambient="0.7 0.7 0.7" diffuse="0 0 0" specular="0 0 0"/>
    <quality offsamples="{surface.samples}" shadowsize="{2048 if surface.shadows else 0}"/>
    <map znear="0.01" zfar="80"/>
    <global offwidth="2048" offheight="2048"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.55 0.57 0.6" rgb2="0.3 0.28 0.27" width="64"
      height="64"/>
    <texture name="floor" type="2d" file="floor.png"/>
    <material name="floor" texture="floor" texrepeat="2 2" texuniform="true" {shine}
      reflectance="{surface.reflectance:.3f}"/>
    <material name="tape" rgba="{_shade(surface.tape_grey, (1.0, 0.92, 0.87))}" {shine}/>
    {faces}
  </asset>
  <worldbody>
    <geom type="plane" pos="{_numbers(middle_m)} 0" size="{_numbers(half_m)} 0.1" material="floor"/>
    {"".join(things)}
    <body name="base" mocap="true">{cameras}</body>
  </worldbody>
</mujoco>"""
    return xml, files


def _numbers(values: Any) -> str:
    return " ".join(f"{float(value):.9f}" for value in values)


def _shade(grey: float, tint: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> str:
    return f"{_numbers(np.clip(grey / 255.0 * np.array(tint), 0.0, 1.0))} 1"


def _png(bgr: Bytes2D) -> bytes:
    import cv2

    return cv2.imencode(".png", bgr)[1].tobytes()


def _vinyl(grey: float, rng: np.random.Generator) -> Bytes2D:
    """Half a metre of floor, (512, 512, 3): a woven grid with stains, another one than our own renderer's."""
    import cv2

    across = np.arange(512) * (math.tau / 8.0)
    weave = np.sin(across)[:, None] * np.sin(across)[None, :]
    stains = cv2.resize(rng.standard_normal((16, 16), dtype=np.float32), (512, 512), interpolation=cv2.INTER_CUBIC)
    level = grey + 5.0 * weave + 3.0 * stains + 3.0 * rng.standard_normal((512, 512))
    return np.asarray(np.clip(level[..., None] * (0.957, 0.922, 1.0), 0.0, 255.0), dtype=np.uint8)


def _opaque(card: Card) -> Bytes2D:
    """A card's face without transparency, (h, w, 3), on the bare card's grey."""
    face = front_of(card).astype(np.float64)
    share = face[..., 3:] / 255.0
    return np.asarray(face[..., :3] * share + card.grey * (1.0 - share), dtype=np.uint8)


def _lamps(bounds_m: tuple[float, float, float, float], shadows: bool, rng: np.random.Generator) -> Iterator[str]:
    x0, y0, x1, y1 = bounds_m
    for _ in range(4):
        x_m, y_m, z_m = rng.uniform((x0 - 1.0, y0 - 1.0, 2.2), (x1 + 1.0, y1 + 1.0, 3.2)).tolist()
        light = float(rng.uniform(0.04, 0.12))
        yield (
            f'<light pos="{x_m:.4f} {y_m:.4f} {z_m:.4f}" dir="0 0 -1" cutoff="85" exponent="1" '
            f'diffuse="{light:.4f} {light:.4f} {light:.4f}" specular="0.5 0.5 0.5" '
            f'castshadow="{"true" if shadows else "false"}"/>'
        )


def _tape(line: FloorLine) -> Iterator[str]:
    """One flat box for each straight piece; at bends a little longer, so that no wedge of floor shows."""
    pieces = line.segments_m
    for at, (x0, y0, x1, y1) in enumerate(pieces.tolist()):
        more_m = [line.width_m * 0.05 if line.closed or inner else 0.0 for inner in (at > 0, at < len(pieces) - 1)]
        length_m, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        half_m = (length_m + more_m[0] + more_m[1]) / 2.0
        shift_m = (more_m[1] - more_m[0]) / 2.0
        x_m, y_m = (x0 + x1) / 2.0 + shift_m * math.cos(yaw), (y0 + y1) / 2.0 + shift_m * math.sin(yaw)
        yield (
            f'<geom type="box" size="{half_m:.6f} {line.width_m / 2.0:.6f} {_TAPE_TOP_M:.6f}" '
            f'pos="{x_m:.6f} {y_m:.6f} 0" euler="0 0 {math.degrees(yaw):.6f}" material="tape"/>'
        )


def _upright(segments_m: Float64s, height_m: float, rng: np.random.Generator) -> Iterator[str]:
    for x0, y0, x1, y1 in segments_m.tolist():
        yaw_deg = math.degrees(math.atan2(y1 - y0, x1 - x0))
        yield (
            f'<geom type="box" size="{math.hypot(x1 - x0, y1 - y0) / 2.0:.6f} {_THIN_M} {height_m / 2.0:.6f}" '
            f'pos="{(x0 + x1) / 2.0:.6f} {(y0 + y1) / 2.0:.6f} {height_m / 2.0:.6f}" euler="0 0 {yaw_deg:.6f}" '
            f'rgba="{_shade(float(rng.uniform(110.0, 180.0)))}"/>'
        )


def _posts(circles_m: Float64s, height_m: float, rng: np.random.Generator) -> Iterator[str]:
    for x_m, y_m, radius_m in circles_m.tolist():
        tint = tuple(rng.uniform(0.4, 1.0, 3).tolist())
        yield (
            f'<geom type="cylinder" size="{radius_m:.6f} {height_m / 2.0:.6f}" '
            f'pos="{x_m:.6f} {y_m:.6f} {height_m / 2.0:.6f}" rgba="{_shade(200.0, (tint[0], tint[1], tint[2]))}"/>'
        )


def _card(at: int, card: Card) -> Iterator[str]:
    """A blank box, and its face as a plane just before it: a plane shows one side only."""
    cos, sin = math.cos(card.yaw_rad), math.sin(card.yaw_rad)
    middle_m, ahead_m = card.bottom_m + card.height_m / 2.0, _THIN_M + 0.0002
    yield (
        f'<geom type="box" size="{_THIN_M} {card.width_m / 2.0:.6f} {card.height_m / 2.0:.6f}" '
        f'pos="{card.x_m:.6f} {card.y_m:.6f} {middle_m:.6f}" euler="0 0 {math.degrees(card.yaw_rad):.6f}" '
        f'rgba="{_shade(card.grey)}"/>'
    )
    yield (
        f'<geom type="plane" size="{card.width_m / 2.0:.6f} {card.height_m / 2.0:.6f} 0.1" material="face{at}" '
        f'pos="{card.x_m + ahead_m * cos:.6f} {card.y_m + ahead_m * sin:.6f} {middle_m:.6f}" '
        f'xyaxes="{-sin:.9f} {cos:.9f} 0 0 0 1"/>'
    )


def _person(at: int, person: Person) -> Iterator[str]:
    hip_m, jacket, trousers = _HIP_SHARE * person.height_m, _shade(person.greys[0]), _shade(person.greys[1])
    for side in "ab":
        yield (
            f'<body name="leg{at}{side}" mocap="true"><geom type="cylinder" '
            f'size="{LEG_RADIUS_M} {hip_m / 2.0:.6f}" pos="0 0 {hip_m / 2.0:.6f}" rgba="{trousers}"/></body>'
        )
    torso_m, head_m = 0.32 * person.height_m, 0.065 * person.height_m
    yield (
        f'<body name="torso{at}" mocap="true"><geom type="cylinder" size="{TORSO_RADIUS_M} {torso_m / 2.0:.6f}" '
        f'pos="0 0 {hip_m + torso_m / 2.0:.6f}" rgba="{jacket}"/><geom type="sphere" size="{head_m:.6f}" '
        f'pos="0 0 {person.height_m - head_m:.6f}" rgba="0.75 0.6 0.5 1"/></body>'
    )
