"""Wander: what it does in small places, what it remembers, and the contract of every behaviour."""

import pytest
from robotd import Drive, LidarScan
from robotd.testing import box_scan, check_behaviour, corridor_scan, open_scan
from robotd.world.messages import Contact

from robotd_wander.wander import Sees, Wander, WanderConfig

AHEAD, LEFT, RIGHT, BACK = Drive(0.25), Drive(wz_radps=1.0), Drive(wz_radps=-1.0), Drive(-0.1)


@pytest.mark.parametrize(
    ("place", "scan", "expected"),
    [
        ("open ground", open_scan(), AHEAD),
        ("along a corridor", corridor_scan(width_m=1.0), AHEAD),
        ("a wall ahead, nearer on the right", corridor_scan(width_m=0.8, heading_rad=-0.9), LEFT),
        ("a wall ahead, nearer on the left", corridor_scan(width_m=0.8, heading_rad=0.9), RIGHT),
        ("a post ahead to the left", open_scan(posts=[(0.4, 0.15, 0.05)]), RIGHT),
        ("a wall behind", box_scan(behind_m=0.3), AHEAD),
    ],
)
def test_turns_from_what_is_near(place: str, scan: LidarScan, expected: Drive) -> None:
    assert Wander(WanderConfig()).step(Sees(scan=scan, bumper=None)) == expected, place


def test_a_turn_goes_on_until_the_way_is_clear() -> None:
    wander = Wander(WanderConfig())
    walls = [box_scan(ahead_m=distance_m) for distance_m in (0.4, 0.6, 0.8, 0.6)]
    assert [wander.step(Sees(scan=wall, bumper=None)) for wall in walls] == [LEFT, LEFT, AHEAD, AHEAD]


def test_backs_off_while_pressed_and_then_turns() -> None:
    wander = Wander(WanderConfig())
    pressed, free = Contact(0, closed=True), Contact(1, closed=False)
    near = box_scan(ahead_m=0.3)
    assert wander.step(Sees(scan=near, bumper=pressed)) == BACK
    assert wander.step(Sees(scan=near, bumper=free)) == LEFT


def test_keeps_the_contract() -> None:
    check_behaviour(Wander)
