"""The YDLIDAR models that this driver knows, and how their samples are to be read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s


@dataclass(frozen=True, slots=True)
class YdModel:
    """One model.

    sample_bytes: 2 (distance) or 3 (intensity, distance); it is fixed, since a reader that guesses it from checksums
    can be led astray by noise. unit_mm: what one step of the distance is; shift: bits below the distance.
    bright_bits: of the intensity; with 10 the upper two lie below the distance, with 8 those two say something else
    (a T-mini's: 2 looks like glass, 3 was disturbed by the sun).
    commanded: whether it scans on request and then turns by DTR; the others turn and send from power-on.
    lens_mm: for triangulation, (numerator, distance of the zero point): the beam leaves the head under an angle of
    atan(a * (b - d) / (b * d)); b None: atan(a / d); a 0: along the head.
    """

    name: str
    baud: int
    rate_hz: float
    sample_bytes: int = 2
    unit_mm: float = 0.25
    shift: int = 0
    bright_bits: int = 10
    commanded: bool = False
    lens_mm: tuple[float, float | None] = (21.8, 155.3)
    range_max_m: float = 8.0


MODELS = {
    model.name: model
    for model in (
        YdModel("x4", 128_000, 5000.0, commanded=True, range_max_m=10.0),
        YdModel("x2", 115_200, 3000.0),
        YdModel("x3", 115_200, 3000.0),
        YdModel("g4", 230_400, 9000.0, commanded=True, range_max_m=16.0),
        YdModel("scl", 115_200, 3000.0, sample_bytes=3, unit_mm=1.0, shift=2, lens_mm=(17.8, None)),
        YdModel("tmini", 230_400, 4000.0, unit_mm=1.0, lens_mm=(0.0, None), range_max_m=12.0),
        YdModel(
            "tmini_plus",
            230_400,
            4000.0,
            sample_bytes=3,
            unit_mm=1.0,
            shift=2,
            bright_bits=8,
            commanded=True,
            lens_mm=(0.0, None),
            range_max_m=12.0,
        ),
    )
}


def lens_deg(model: YdModel, mm: Float64s) -> Float64s:
    """By how much beams to points at these distances lead their head, degrees, clockwise; 0 where nothing returned."""
    a, b = model.lens_mm
    if a == 0.0:
        return np.zeros_like(mm)
    seen = mm > 0.0
    far = np.where(seen, mm, 1.0)
    slope = a / far if b is None else a * (b - far) / (b * far)
    return np.where(seen, np.degrees(np.arctan(slope)), 0.0)


def decode_samples(model: YdModel, data: bytes) -> tuple[Float64s, NDArray[np.uint8] | None]:
    """Distances in millimetres (0 = no return) and intensities (0..255) of samples, (n,) each."""
    if model.sample_bytes == 2:
        words = np.frombuffer(data, dtype="<u2")
        return (words >> model.shift).astype(np.float64) * model.unit_mm, None
    rows = np.frombuffer(data, dtype=[("intensity", "u1"), ("word", "<u2")])
    bright = rows["intensity"].astype(np.uint8)
    if model.bright_bits == 10:
        bright = ((rows["intensity"].astype(np.uint16) | (rows["word"] & 3) << 8) >> 2).astype(np.uint8)
    return (rows["word"] >> model.shift).astype(np.float64) * model.unit_mm, bright


def encode_samples(model: YdModel, mm: Float64s, intensity: int = 800) -> bytes:
    """Samples as the device sends them; for fakes. `intensity`: of what returned, in ten bits."""
    words = np.rint(mm / model.unit_mm).astype(np.uint16) << model.shift
    if model.sample_bytes == 2:
        return words.astype("<u2").tobytes()
    rows = np.zeros(len(mm), dtype=[("intensity", "u1"), ("word", "<u2")])
    bright = np.where(mm > 0.0, intensity, 0).astype(np.uint16)
    if model.bright_bits == 8:
        bright >>= 2
    rows["intensity"], rows["word"] = bright & 0xFF, words | bright >> 8
    return rows.tobytes()


def metres(mm: Float64s) -> Float32s:
    """Millimetres as single-precision metres."""
    return (mm * 0.001).astype(np.float32)
