"""`robotd --config jetbot.yaml` as a process: real lidar bytes and real pictures in, motor registers out."""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from robot_process import RobotProcess

pytestmark = pytest.mark.skipif("sys.platform != 'linux'", reason="ptys and I2C as Linux has them")


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short path: a socket's address has 100 bytes."""
    with tempfile.TemporaryDirectory(prefix="robotd") as name:
        yield Path(name)


def drives(robot: RobotProcess) -> None:
    """Wait until the motors turn."""
    robot.until(lambda: not robot.stands(), "the motors to turn")


def ready(robot: RobotProcess) -> None:
    """Wait until every device is open and the line is seen, then arm."""
    robot.until(lambda: all(d["state"] == "open" for d in robot.ask("status")["devices"]), "all devices")
    robot.until(lambda: all(s["age_s"] is not None for s in robot.ask("status")["streams"]), "all streams")
    robot.until(lambda: robot.ask_or_refused("arm", "test") == "", "the arming to be accepted")


@pytest.mark.parametrize(("picture", "turns_left"), [("test.jpg", True), ("test2.jpg", False)])
def test_real_pictures_in_the_right_registers_out(folder: Path, data_dir: Path, picture: str, turns_left: bool) -> None:
    """The line lies to the left in one picture, to the right in the other; both wheels go forward, one faster."""
    with RobotProcess(folder, [data_dir / "jetbot" / "floor" / picture]) as robot:
        assert "disarmed" in robot.reason and robot.stands(), "real hardware waits for somebody to arm it"
        ready(robot)
        drives(robot)
        robot.until(lambda: robot.ask("status")["by"] == "jetbot_route", "the route to drive")
        seen: list[tuple[int, int]] = []

        def steers() -> bool:
            seen.append(robot.duties())
            return min(seen[-1]) > 0 and seen[-1][0] != seen[-1][1]

        robot.until(steers, "both wheels to go forward, one faster")
        left, right = seen[-1]
        assert (right > left) is turns_left, (left, right)
        robot.process.send_signal(signal.SIGTERM)
        assert robot.process.wait(5.0) == 0
        assert robot.stands(), "a stop on the way out"


def test_the_unplugged_lidar_stops_the_motors_and_after_replug_it_drives_again(folder: Path, data_dir: Path) -> None:
    with RobotProcess(folder, [data_dir / "jetbot" / "floor" / "test2.jpg"]) as robot:
        ready(robot)
        drives(robot)
        pulled_ns = time.monotonic_ns()
        robot.lidar.unplug()
        robot.until(robot.stands, "the motors to stop")
        stopped_ns = next(e.now_ns for e in robot.bus.log if e.now_ns > pulled_ns and e.data[:1] == b"\xfd")
        assert stopped_ns - pulled_ns < 100e6, f"stopped after {(stopped_ns - pulled_ns) / 1e6:.1f} ms"
        assert "lidar" in robot.reason
        robot.lidar.plug()
        robot.until(lambda: robot.device("lidar") == "open", "the lidar to come back")
        robot.until(lambda: "disarmed" in robot.reason, "a reason")
        assert robot.stands(), "it does not drive off by itself"
        ready(robot)
        drives(robot)
