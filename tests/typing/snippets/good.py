"""What a plugin author writes, all of it right: mypy must find nothing here."""

from typing import assert_type

from robotd import (
    Actuator,
    Behaviour,
    Bridge,
    CameraFrame,
    Config,
    Detections,
    Done,
    Drive,
    Failed,
    Goal,
    LidarScan,
    Odometry,
    Perceptor,
    Plan,
    RuntimeLink,
    Sensor,
    Sequence,
    Steer,
    Target,
    Topic,
    View,
    every,
    latest,
    needed,
)
from robotd.authoring.explain import Explanation, Scalar

REAR_SCAN = Topic("rear_scan", LidarScan)


class FollowConfig(Config):
    speed_mps: float = 0.3


class FollowGoal(Goal):
    person: int


class Sees(View):
    scan: LidarScan = every(within_s=0.15)
    rear: LidarScan = needed(REAR_SCAN, within_s=0.15)
    odometry: Odometry = needed(within_s=0.1)
    target: Target | None = latest(within_s=0.5)


class OnTime(View, hz=20):
    odometry: Odometry | None = latest(within_s=0.2)


class Follow(Behaviour[FollowConfig, Sees, FollowGoal]):
    def step(self, seen: Sees) -> Drive | Done | Failed | None:
        assert_type(self.config.speed_mps, float)
        assert_type(self.goal.person, int)
        assert_type(seen.now_ns, int)
        assert_type(seen.rear, LidarScan)
        if seen.target is None:
            return None
        if seen.target.track_id != self.goal.person:
            return Failed("somebody else")
        if float(seen.scan.ranges_m.min()) < 0.3:
            return Done()
        return Drive(self.config.speed_mps, seen.target.bearing_rad)

    def explain(self) -> Explanation:
        return (Scalar("speed", self.config.speed_mps, "m/s"),)


class Race(Behaviour[FollowConfig, OnTime]):
    emits = Steer

    def step(self, seen: OnTime) -> Steer | None:
        return Steer(self.config.speed_mps) if seen.odometry is not None else None


class Approach(Sequence[FollowConfig, Sees]):
    def plan(self, seen: Sees) -> Plan[Sees]:
        while seen.odometry.x_m < 1.0:
            seen = yield Drive(self.config.speed_mps)
        return Done("one metre")


class Pictures(View):
    frame: CameraFrame = every(within_s=0.3)


class Detector(Perceptor[FollowConfig, Pictures, Detections]):
    def step(self, seen: Pictures) -> Detections | None:
        height, width, _ = seen.frame.bgr.shape
        return Detections(seen.frame.stamp_ns, (), width, height)


class Wheels(Sensor[FollowConfig, Odometry]):
    async def open(self) -> None:
        self.publish(Odometry(self.context.clock.now_ns(), 0.0, 0.0, 0.0))


class Motors(Actuator[FollowConfig, Drive]):
    def apply(self, command: Drive) -> None:
        self.context.link.fault("test", str(command.vx_mps))

    def halt(self) -> None:
        self.apply(Drive())


class Page(Bridge[FollowConfig]):
    async def run(self, runtime: RuntimeLink) -> None:
        async for event in runtime.events():
            runtime.estop("page", str(event.stamp_ns))


def use(scan: LidarScan, odometry: Odometry) -> None:
    seen = Sees(scan=scan, rear=scan, odometry=odometry, target=None, now_ns=3)
    assert_type(Follow(FollowConfig(), FollowGoal(person=1)).step(seen), Drive | Done | Failed | None)
    Race(FollowConfig(speed_mps=1.0)).step(OnTime(odometry=None))
