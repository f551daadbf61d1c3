"""What a plugin author may get wrong. Lines that end in `# error: CODE` are just these errors."""

from robotd import (
    Actuator,
    Behaviour,
    Config,
    Drive,
    Goal,
    LidarScan,
    Odometry,
    Perceptor,
    Plan,
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

REAR_SCAN = Topic("rear_scan", LidarScan)


class MyConfig(Config):
    speed_mps: float = 0.3


class MyGoal(Goal):
    person: int


# wrong message type in a view


class WrongTopic(View):
    scan: Odometry = every(REAR_SCAN, within_s=0.15)  # error: assignment


class WrongNeeded(View, hz=10):
    scan: Odometry = needed(REAR_SCAN, within_s=0.15)  # error: assignment


class ForgotNone(View, hz=10):
    scan: LidarScan = latest(REAR_SCAN, within_s=0.5)  # error: assignment


class NoAge(View):
    scan: LidarScan = every()  # error: call-overload


class Sees(View):
    scan: LidarScan = every(within_s=0.15)
    target: Target | None = latest(within_s=0.5)


# building a view in a test


def build(scan: LidarScan, odometry: Odometry) -> None:
    Sees(scan=scan)  # error: call-arg
    Sees(scan=odometry, target=None)  # error: arg-type
    Sees(scan=scan, target=None, odometry=odometry)  # error: call-arg
    Sees(scan, None)  # error: call-arg, arg-type
    seen = Sees(scan=scan, target=None)
    seen.scan = scan  # error: misc


# reading what was not declared


class Undeclared(Behaviour[MyConfig, Sees, MyGoal]):
    def step(self, seen: Sees) -> Drive | None:
        speed = seen.odometry.vx_mps  # error: attr-defined
        bearing = seen.target.bearing_rad  # error: union-attr
        limit = self.config.speed_kmh  # error: attr-defined
        person = self.goal.animal  # error: attr-defined
        return Drive(speed + bearing + limit + person)


class Frozen(Behaviour[MyConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        seen.scan.stamp_ns = 3  # error: misc
        return None


# wrong results


class WrongResult(Behaviour[MyConfig, Sees]):
    def step(self, seen: Sees) -> float:  # error: override
        return 0.3


class WrongValue(Behaviour[MyConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return 0.3  # error: return-value


class WrongView(Behaviour[MyConfig, Sees]):
    def step(self, seen: WrongTopic) -> Drive | None:  # error: override
        return None


class WrongOutput(Perceptor[MyConfig, Sees, Target]):
    def step(self, seen: Sees) -> Odometry | None:  # error: override
        return None


class WrongYield(Sequence[MyConfig, Sees]):
    def plan(self, seen: Sees) -> Plan[Sees]:
        yield 0.3  # error: misc
        return None


# classes in the wrong places


class NotAConfig(Behaviour[int, Sees]):  # error: type-var
    pass


class NotAView(Behaviour[MyConfig, LidarScan]):  # error: type-var
    pass


class NotAMessage(Sensor[MyConfig, Drive]):  # error: type-var
    pass


# devices


class WrongPublish(Sensor[MyConfig, LidarScan]):
    async def open(self) -> None:
        self.publish(Odometry(0, 0.0, 0.0, 0.0))  # error: arg-type


class WrongCommand(Actuator[MyConfig, Drive]):
    def apply(self, command: Steer) -> None:  # error: override
        pass


# configs and goals


def configure() -> None:
    MyConfig(speed_mps="fast")  # error: arg-type
    MyConfig(speed=0.3)  # error: call-arg
    MyGoal()  # error: call-arg
    Undeclared(MyGoal(person=1))  # error: arg-type
