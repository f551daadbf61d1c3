"""The GStreamer pipelines of a Jetson's and a Raspberry Pi's own camera connector, from the camera's keys. Pure.

Sources: NVIDIA, Jetson Linux developer guide, chapter Accelerated GStreamer (nvarguscamerasrc, nvvidconv); libcamera's
GStreamer element `libcamerasrc`; GStreamer's reference of `videoflip` and `appsink`.
"""

from __future__ import annotations

from fractions import Fraction

from robotd.authoring.device import DeviceMisconfigured

DEFAULT_PX = 640, 480
_CSI_MODES = (((1640, 1232), 30.0), ((1280, 720), 60.0))
"""Sizes and fastest rates at which an IMX219 (the JetBot's camera, the Pi's v2) uses its width; the first all of it."""
_NVVIDCONV_FLIP = {0: 0, 90: 3, 180: 2, 270: 1}
"""`flip-method` counts counter-clockwise quarter turns."""
_VIDEOFLIP = {0: "identity", 90: "90r", 180: "180", 270: "90l"}
_SINK = "appsink drop=true max-buffers=1 sync=false"


def pipeline(source: str, rate_hz: float, width_px: int | None, height_px: int | None, rotate_deg: int) -> str:
    """A pipeline for OpenCV that ends in turned BGR pictures of the size asked for, by default 640 x 480.

    source: `csi` or `csi:N` (Jetson, sensor N), `libcamera` or `libcamera:NAME` (Raspberry Pi). One size alone keeps
    4 to 3 (before turning). Raises DeviceMisconfigured for another source, and a name that cannot be quoted.
    """
    kind, _, which = source.partition(":")
    width, height = _size(width_px, height_px, rotate_deg)
    if kind == "csi" and (not which or which.isdigit()):
        return _csi(int(which or 0), _fraction(rate_hz), rate_hz, (width, height), rotate_deg)
    if kind == "libcamera" and not set(which) & set("\"'!\\ "):
        return _libcamera(which, _fraction(rate_hz), (width, height), rotate_deg)
    raise DeviceMisconfigured(f"`source`: {source!r}: write csi, csi:1, libcamera or libcamera:NAME")


def _csi(sensor: int, rate: str, rate_hz: float, size: tuple[int, int], rotate_deg: int) -> str:
    captured = next((mode for mode, fastest_hz in _CSI_MODES if rate_hz <= fastest_hz), _CSI_MODES[-1][0])
    return (
        f"nvarguscamerasrc sensor-id={sensor} "
        f"! video/x-raw(memory:NVMM), width={captured[0]}, height={captured[1]}, framerate={rate} "
        f"! nvvidconv flip-method={_NVVIDCONV_FLIP[rotate_deg]} "
        f"! video/x-raw, width={size[0]}, height={size[1]}, format=BGRx "
        f"! videoconvert ! video/x-raw, format=BGR ! {_SINK}"
    )


def _libcamera(name: str, rate: str, size: tuple[int, int], rotate_deg: int) -> str:
    named = f'libcamerasrc camera-name="{name}"' if name else "libcamerasrc"
    # the sensor's own size, before turning
    width, height = size if rotate_deg % 180 == 0 else size[::-1]
    turn = f"! videoflip video-direction={_VIDEOFLIP[rotate_deg]} " if rotate_deg else ""
    return (
        f"{named} ! video/x-raw, width={width}, height={height}, framerate={rate} "
        f"! videoconvert {turn}! video/x-raw, format=BGR ! {_SINK}"
    )


def _size(width_px: int | None, height_px: int | None, rotate_deg: int) -> tuple[int, int]:
    """The published size."""
    across, down = DEFAULT_PX if rotate_deg % 180 == 0 else DEFAULT_PX[::-1]
    if width_px is not None and height_px is not None:
        return width_px, height_px
    if width_px is not None:
        return width_px, round(width_px * down / across)
    if height_px is not None:
        return round(height_px * across / down), height_px
    return across, down


def _fraction(rate_hz: float) -> str:
    """Pictures a second as GStreamer writes them; 29.97 is 30000/1001, as television has it."""
    whole = round(rate_hz)
    if rate_hz != whole and abs(rate_hz - whole * 1000 / 1001) < 0.005:
        return f"{whole * 1000}/1001"
    rate = Fraction(rate_hz).limit_denominator(100)
    return f"{rate.numerator}/{rate.denominator}"
