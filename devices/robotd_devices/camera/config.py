"""A camera's parameters, and what its `source` means."""

from __future__ import annotations

import os
from typing import Literal, TypeAlias
from urllib.parse import urlsplit, urlunsplit

from pydantic import Field

from robotd.authoring.config import Config

Kind: TypeAlias = Literal["v4l2", "url", "pipeline", "board", "folder", "video"]
LIVE: tuple[Kind, ...] = ("v4l2", "url", "pipeline", "board")
"""Kinds that go at their own pace and must be read as fast as they come."""


class CameraConfig(Config):
    """Parameters of a camera, or of pictures in its place. The default is the first camera that Linux knows."""

    source: int | str = Field(default=0, union_mode="left_to_right")
    """Number or path of a V4L2 camera, `csi` or `libcamera` (Jetson's and Pi's connector), a URL, a GStreamer pipeline,
    a folder of pictures, or a video file."""
    reader: Literal["auto", "opencv"] = "auto"
    """Who reads MJPEG over HTTP: our own client, which gives way to OpenCV where it is no MJPEG; or OpenCV at once."""
    rate_hz: float = Field(default=30.0, gt=0.0, le=240.0)
    """Pictures a second: asked of a camera, and the pace of a folder or a video file."""
    width_px: int | None = Field(default=None, ge=16, le=7680)
    """Width of the published picture; by default as the source gives it, or in proportion to the height."""
    height_px: int | None = Field(default=None, ge=16, le=4320)
    """Height of the published picture."""
    rotate_deg: Literal[0, 90, 180, 270] = 0
    """Turns the picture clockwise, for a camera that is mounted on its side or head down."""
    loop: bool = True
    """Begin a folder or a video file again at its end; false: the end is a loss."""
    latency_s: float | None = Field(default=None, ge=0.0, le=1.0)
    """From the middle of the exposure to the picture's arrival; by default half a period, 0 for files."""
    silent_s: float = Field(default=2.0, ge=0.2, le=60.0)
    """Without a picture for this long a live camera is opened anew."""
    frozen_s: float = Field(default=2.0, ge=0.0, le=60.0)
    """The very same picture for so long: the camera hangs and is opened anew; 0: repeats are passed on unjudged."""
    torn: bool = True
    """Drop pictures of a live camera that are not whole."""
    black_below: float = Field(default=8.0, ge=0.0, le=255.0)
    """Mean brightness, of 255, below which a picture of a live camera counts as black."""
    black_pictures: int = Field(default=10, ge=0, le=10_000)
    """So many black pictures in a row are a fault; 0: none is."""

    @property
    def is_http(self) -> bool:
        """Whether our own MJPEG client is the first to try."""
        return self.reader == "auto" and str(self.source).lower().startswith(("http://", "https://"))

    @property
    def latency(self) -> float:
        """`latency_s` with its default, in seconds."""
        if self.latency_s is not None:
            return self.latency_s
        return 0.5 / self.rate_hz if kind_of(self.source) in LIVE else 0.0


def kind_of(source: int | str) -> Kind:
    """What a source is. A path that does not exist counts as a video file."""
    text = str(source)
    if text.isdigit() or text.startswith("/dev/"):
        return "v4l2"
    if text.partition(":")[0] in ("csi", "libcamera"):
        return "board"
    if " ! " in text:
        return "pipeline"
    if "://" in text:
        return "url"
    return "folder" if os.path.isdir(text) else "video"


def device_path(source: int | str) -> str:
    """The path of a V4L2 camera: a number N is /dev/videoN."""
    return f"/dev/video{source}" if str(source).isdigit() else str(source)


def shown(source: int | str) -> str:
    """A source as people may see it: without the password of a URL."""
    kind = kind_of(source)
    if kind == "v4l2":
        return device_path(source)
    if kind == "url":
        url = urlsplit(str(source))
        return urlunsplit(url._replace(netloc=url.netloc.rpartition("@")[2]))
    return str(source)
