"""The RPLIDAR models that a fake can be: what each says of itself."""

from __future__ import annotations

from dataclasses import dataclass

from robotd_devices.lidar import rplidar_hq as hq
from robotd_devices.lidar import rplidar_wire as wire
from robotd_devices.lidar.rplidar_models import Motor, ScanMode

STANDARD = 0x81


@dataclass(frozen=True, slots=True)
class FakeModel:
    """What a model says of itself. `typical`: number of the mode that it prefers; `lags`: it measures by triangulation,
    so that a beam lags behind the head by an angle that grows with the distance."""

    info: wire.Info
    baud: int
    motor: Motor
    modes: tuple[ScanMode, ...]
    typical: int
    lags: bool = False


def _model(
    model: int, firmware: int, baud: int, motor: Motor, lags: bool, typical: int, *modes: tuple[str, int, float]
) -> FakeModel:
    table = tuple(ScanMode(i, name, answer, us, 12.0) for i, (name, answer, us) in enumerate(modes))
    info = wire.Info(model, firmware, 7, f"{model:02X}" * 16)
    return FakeModel(info, baud, motor, table, typical, lags)


_S, _E, _U = ("Standard", STANDARD), ("Express", 0x82), ("Boost", 0x84)
MODELS = {
    "a1": _model(0x18, 0x011D, 115_200, "dtr", True, 2, (*_S, 508.0), (*_E, 254.0), (*_U, 127.0)),
    "a2": _model(0x2C, 0x011E, 256_000, "pwm", True, 2, (*_S, 252.0), (*_E, 126.0), (*_U, 63.0)),
    "a3": _model(0x31, 0x011A, 256_000, "pwm", True, 2, (*_S, 252.0), (*_E, 126.0), (*_U, 62.5)),
    "s1": _model(0x61, 0x0117, 256_000, "rpm", False, 1, (*_S, 217.0), ("DenseBoost", 0x85, 108.0)),
    "s2": _model(0x71, 0x0101, 1_000_000, "rpm", False, 1, (*_S, 62.5), ("DenseBoost", 0x85, 31.25)),
    "s3": _model(
        0x81, 0x0101, 1_000_000, "rpm", False, 2,
        (*_S, 62.5), ("DenseBoost", 0x85, 31.25), ("UltraDense", 0x86, 31.25),
    ),
    "c1": _model(0x41, 0x0101, 460_800, "none", False, 0, (*_S, 200.0)),
    "s2-hq": _model(0x71, 0x0102, 1_000_000, "rpm", False, 1, (*_S, 125.0), ("HQ", hq.HQ, 125.0)),
    "a1-old": _model(0x18, 0x0114, 115_200, "dtr", True, 0, (*_S, 508.0), (*_E, 254.0)),
}  # fmt: skip
