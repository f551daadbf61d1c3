"""The perceptor: scans and what the wheels tell in, one `Located` out for each scan as soon as there is a track."""

from __future__ import annotations

import logging
import math

from robotd import LidarScan, Odometry, Perceptor, View, every, latest
from robotd.authoring.explain import Explanation, Path, Scalar, Text
from robotd.world.geometry import compose, inverse
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Applied
from robotd.world.robot import Robot
from robotd_plugins.perception.track_position.config import TrackPositionConfig
from robotd_plugins.perception.track_position.locate import Locator
from robotd_plugins.toolkit.race_track import Located, RaceTrack
from robotd_plugins.toolkit.scan_motion import CarMotion

log = logging.getLogger("robotd.track_position")
_HZ = 50
_DRAWN_M = 12.0


class Sees(View, hz=_HZ):
    """Each scan; between scans, what wheels tell or, without odometry, what they were commanded."""

    scan: LidarScan = every(within_s=0.25)
    odometry: Odometry | None = latest(within_s=0.25)
    applied: Applied | None = latest(within_s=1.0)
    track: RaceTrack | None = latest()


class TrackPosition(Perceptor[TrackPositionConfig, Sees, Located]):
    """Publishes nothing without a track."""

    def __init__(self, config: TrackPositionConfig, robot: Robot | None = None) -> None:
        super().__init__(config, robot)
        kinematics = self.robot.kinematics
        wheelbase_m = kinematics.wheelbase_m if isinstance(kinematics, Ackermann) else math.inf
        self._locator = Locator(config)
        self._motion = CarMotion(wheelbase_m, config.command_lag_s)
        self._stamp_ns: int | None = None
        self._located: Located | None = None

    def step(self, seen: Sees) -> Located | None:
        self._motion.hear(seen.now_ns, seen.odometry, seen.applied.command if seen.applied is not None else None)
        if seen.track is not None and seen.track is not self._locator.track:
            self._locator.take(seen.track)
        if seen.scan.stamp_ns == self._stamp_ns:
            return None
        self._stamp_ns = seen.scan.stamp_ns
        was, self._located = self._located, self._locator.step(seen.scan, self._motion)
        is_sure = self._located is not None and self._located.is_sure
        if self._located is not None and is_sure != (was is not None and was.is_sure):
            log.info("%s", "sure" if is_sure else self._located.reason)
        return self._located

    def explain(self) -> Explanation:
        located, track = self._located, self._locator.track
        if located is None or track is None:
            return (Text("track_position", "no track yet"),)
        here = inverse((located.x_m, located.y_m, located.yaw_rad))
        lap = [compose(here, (x, y, 0.0))[:2] for x, y, _ in track.path.tolist()]
        near = tuple(point for point in lap if math.hypot(*point) < _DRAWN_M)
        return (
            Text("track_position", located.reason or "sure"),
            Path("learned lap", near),
            Scalar("explained", located.explained_share),
            Scalar("residual", located.residual_m, "m"),
        )
