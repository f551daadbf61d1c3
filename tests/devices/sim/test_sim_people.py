"""People, cards and boxes: where they are in time, what a lidar sees of them, and what a base runs into."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd.world.messages import STOP, Drive
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import SimBase, SimBaseConfig, SimLidar, SimLidarConfig, load_map
from robotd_devices.sim.maps import Card, map_from_segments
from robotd_devices.sim.people import Person, Walk, walk_along

PERFECT = SimBaseConfig(
    lag_s=0.0, motor_error=0.0, wheel_error=0.0, track_error=0.0, slip_std=0.0, dead_band_mps=0.0, encoder_ticks=0
)
EXACT: dict[str, Any] = {"noise_m": 0.0, "noise_share": 0.0, "dropout": 0.0}
ROBOT = Robot(footprint_m=((0.1, 0.05), (0.1, -0.05), (-0.1, -0.05), (-0.1, 0.05)), mounts={"lidar": Mount(z_m=0.15)})


OUT_AND_BACK = {"points_m": [(0.0, 0.0), (2.0, 0.0)], "pause_s": 1.0}
"""At 1 m/s: stands 1 s, walks 2 s, stands 1 s, walks back 2 s; a round of 6 s."""
CORNER = {"points_m": [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0)], "from_s": 1.0}


@pytest.mark.parametrize(
    ("way", "then", "when_s", "place"),
    [
        (OUT_AND_BACK, "back", 0.5, (0.0, 0.0)),
        (OUT_AND_BACK, "back", 1.5, (0.5, 0.0)),
        (OUT_AND_BACK, "back", 3.5, (2.0, 0.0)),
        (OUT_AND_BACK, "back", 4.5, (1.5, 0.0)),
        (OUT_AND_BACK, "back", 8.0, (1.0, 0.0)),
        (CORNER, "stay", 0.5, (0.0, 0.0)),
        (CORNER, "stay", 3.5, (2.0, 0.5)),
        (CORNER, "stay", 99.0, (2.0, 1.0)),
        (CORNER, "back", 4.5, (2.0, 0.5)),
        (CORNER, "round", 4.0 + math.sqrt(5.0) / 2.0, (1.0, 0.5)),
        ({"points_m": [(3.0, 4.0)]}, "back", 7.0, (3.0, 4.0)),
    ],
)
def test_a_walk_is_a_function_of_time(way: Any, then: Any, when_s: float, place: tuple[float, float]) -> None:
    walk = walk_along(speed_mps=1.0, then=then, **way)
    assert walk.places_m(np.array([when_s]))[0] == pytest.approx(place)


def test_way_walked_goes_on_growing_round_after_round() -> None:
    walk = walk_along([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], 2.0, then="round")
    walked = walk.walked_m(np.linspace(0.0, 9.0, 400))
    assert np.diff(walked).min() > 0.0
    assert walked[-1] == pytest.approx(18.0)


def test_legs_swing_about_the_body_and_the_head_ends_somewhere() -> None:
    person = Person(walk_along([(0.0, 0.0), (9.0, 0.0)], 1.2))
    when = np.linspace(1.0, 3.0, 60)
    legs = np.stack([person.circles_m(float(t), 0.15) for t in when])
    body = person.walk.places_m(when)
    assert legs.shape == (60, 2, 3)
    assert legs[:, :, :2].mean(axis=1) == pytest.approx(body)
    swing = legs[:, 0, 0] - body[:, 0]
    assert 0.35 < np.ptp(swing) <= 0.4
    assert np.abs(np.diff(legs[:, 0, 0])).max() < 0.12, "no leg jumps"
    assert person.circles_m(1.0, 1.2).shape == (1, 3)
    assert person.circles_m(1.0, 1.8).shape == (0, 3)


def test_somebody_who_stands_has_the_legs_side_by_side() -> None:
    legs = Person(Walk(np.zeros(1), np.array([(2.0, 1.0)]))).circles_m(5.0, 0.1)
    assert legs[:, 0] == pytest.approx([2.0, 2.0])
    assert np.ptp(legs[:, 1]) == pytest.approx(0.2)


def seen(rig: Any, world_map: Any, seconds: float = 1.05, robot: Robot = ROBOT, **values: Any) -> Any:
    devices = {"base": (SimBase, PERFECT), "lidar": (SimLidar, SimLidarConfig(**{**EXACT, **values}))}
    return rig(devices, robot=robot, world_map=world_map).run(seconds)


def test_each_beam_meets_the_legs_where_they_are_at_its_instant(rig: Any) -> None:
    person = Person(walk_along([(1.5, -2.0), (1.5, 2.0)], 1.5))
    run = seen(rig, map_from_segments(people=[person]), 2.05, beams=1200)
    walker = run.world.scene.people[0]
    gaps: list[float] = []
    for scan in run.messages["lidar"]:
        stamps = np.linspace(scan.start_ns, scan.stamp_ns, len(scan.ranges_m)) / 1e9
        for at in np.flatnonzero(np.isfinite(scan.ranges_m)):
            legs = walker.circles_m(float(stamps[at]), 0.15)
            bearing, reach = float(scan.angles_rad[at]), float(scan.ranges_m[at])
            hit = (reach * math.cos(bearing), reach * math.sin(bearing))
            gaps.append(float(np.abs(np.hypot(*(legs[:, :2] - hit).T) - legs[:, 2]).min()))
    # a leg swings on a curve, within one sweep it goes straight
    assert len(gaps) > 200
    assert max(gaps) < 0.02
    assert np.median(gaps) < 0.004


@pytest.mark.parametrize(("height_m", "is_seen"), [(0.02, False), (0.05, True), (0.13, True), (0.14, False)])
def test_a_card_is_seen_at_its_height_and_from_both_sides(rig: Any, height_m: float, is_seen: bool) -> None:
    cards = [Card(1.0, 0.0, math.pi, 0.2, 0.1), Card(-1.0, 0.0, math.pi, 0.2, 0.1)]
    robot = Robot(mounts={"lidar": Mount(z_m=height_m)})
    scan = seen(rig, map_from_segments(cards=cards), 0.15, robot, beams=360).messages["lidar"][0]
    hit = np.isfinite(scan.ranges_m)
    assert hit.any() == is_seen
    if is_seen:
        assert (scan.ranges_m[180], scan.ranges_m[0]) == (pytest.approx(1.0), pytest.approx(1.0))
        assert hit.sum() == 2 * 11


def test_boxes_come_and_go_and_so_does_what_a_test_puts_there(rig: Any, tmp_path: Path) -> None:
    file = tmp_path / "boxes.yaml"
    file.write_text("boxes: [{x_m: 2.0, y_m: 0.0, length_m: 1.0, width_m: 0.4, from_s: 0.3, until_s: 0.7}]")
    run = rig(
        {"base": (SimBase, PERFECT), "lidar": (SimLidar, SimLidarConfig(beams=1, moving_sweep=False, **EXACT))},
        robot=ROBOT,
        world_map=load_map(str(file)),
    )
    wall = [(1.2, -1.0, 1.2, 1.0)]
    run.run(
        1.35,
        [(0.95, lambda rig: rig.world.put("wall", wall)), (1.15, lambda rig: rig.world.take_away("wall"))],
    )
    ahead = [float(scan.ranges_m[0]) for scan in run.messages["lidar"]]
    assert ahead == [math.inf] * 2 + [1.5] * 4 + [math.inf] * 3 + [pytest.approx(1.2)] * 2 + [math.inf] * 2


def test_a_box_that_appears_stops_the_base_and_lets_it_go(rig: Any, tmp_path: Path) -> None:
    file = tmp_path / "box.yaml"
    file.write_text("boxes: [{x_m: 1.0, y_m: 0.0, length_m: 0.4, width_m: 1.0, until_s: 3.0}]")
    devices = {"base": (SimBase, PERFECT)}
    places: list[float] = []
    run = rig(devices, robot=ROBOT, world_map=load_map(str(file)))
    run.run(
        4.0,
        [(0.0, lambda rig: rig.open["base"].apply(Drive(0.5))), (2.9, lambda rig: places.append(rig.world.pose()[0]))],
    )
    assert places[0] == pytest.approx(0.7, abs=0.003)
    assert run.world.collisions == 1
    assert run.world.pose()[0] == pytest.approx(places[0] + 0.5, abs=0.01)


@pytest.mark.parametrize(
    ("card", "stops"), [(Card(1.0, 0.0, 0.0, bottom_m=0.03), True), (Card(1.0, 0.0, 0.0, bottom_m=0.3), False)]
)
def test_a_low_card_is_in_the_way_and_a_high_one_is_not(rig: Any, card: Card, stops: bool) -> None:
    run = rig({"base": (SimBase, PERFECT)}, robot=ROBOT, world_map=map_from_segments(cards=[card]))
    run.run(3.0, [(0.0, lambda rig: rig.open["base"].apply(Drive(0.5)))])
    assert (run.world.pose()[0] < 1.0) == stops


@pytest.mark.parametrize(("drive", "contacts"), [(Drive(0.2), 1), (STOP, 0)])
def test_a_contact_with_a_person_counts_for_a_base_that_moves(rig: Any, drive: Drive, contacts: int) -> None:
    person = Person(walk_along([(1.0, -2.0), (1.0, 2.0)], 1.0, then="stay"))
    bearings: list[tuple[float, ...]] = []
    run = rig(
        {"base": (SimBase, PERFECT)}, robot=ROBOT, world_map=map_from_segments(people=[person], start=(0.7, 0, 0))
    )
    run.run(
        4.0,
        [
            (1.0, lambda rig: rig.open["base"].apply(drive)),
            (2.0, lambda rig: rig.world.advance()),
            (2.0, lambda rig: bearings.append(rig.world.contacts_rad)),
        ],
    )
    assert run.world.person_contacts == contacts
    assert run.world.collisions == 0
    assert run.world.contacts_rad == ()
    if contacts:
        assert bearings[0] == (pytest.approx(0.0, abs=0.05),)


def test_people_walk_the_same_for_a_seed_and_are_dressed_by_it(rig: Any) -> None:
    world_map = map_from_segments(people=[Person(walk_along([(1.5, -2.0), (1.5, 2.0)], 1.5))])

    def scans(seed: int) -> list[bytes]:
        devices = {"lidar": (SimLidar, SimLidarConfig(**EXACT))}
        run = rig(devices, robot=ROBOT, world_map=world_map, seed=seed).run(1.0)
        return [scan.ranges_m.tobytes() for scan in run.messages["lidar"]]

    assert scans(1) == scans(1)
    assert scans(1) != scans(2)
