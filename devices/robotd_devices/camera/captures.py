"""Opens live sources through OpenCV, and says in plain words why one cannot be opened. Blocking."""

from __future__ import annotations

import os
import stat
from typing import Any

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd_devices.camera.config import CameraConfig, device_path, kind_of, shown
from robotd_devices.camera.pipelines import pipeline
from robotd_devices.camera.shape import Shape

_OPEN_WITHIN_MS = 5000


def open_live(config: CameraConfig, shape: Shape) -> Any:
    """An open `cv2.VideoCapture`. Raises DeviceUnavailable and DeviceMisconfigured with the mend."""
    kind = kind_of(config.source)
    if kind == "v4l2":
        return _open_v4l2(config, shape)
    if kind == "url":
        return _open_url(config)
    if kind == "board":
        size = config.width_px, config.height_px
        return _open_pipeline(pipeline(str(config.source), config.rate_hz, *size, config.rotate_deg))
    return _open_pipeline(str(config.source))


def _open_v4l2(config: CameraConfig, shape: Shape) -> Any:
    import cv2

    path = device_path(config.source)
    check_node(path)
    capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise DeviceUnavailable(
            f"`source`: {path} cannot be opened: another program uses it, or it is a node without pictures (a camera "
            "has several; `v4l2-ctl --list-devices` names them)"
        )
    width_px, height_px = shape.asked_px
    if width_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width_px)
    if height_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height_px)
    capture.set(cv2.CAP_PROP_FPS, config.rate_hz)
    return capture


def check_node(path: str) -> None:
    """Raises DeviceUnavailable or DeviceMisconfigured where `path` cannot be a camera that we may use."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        raise DeviceUnavailable(
            f"`source`: {path} does not exist: plug the camera in, or name one of `ls /dev/v4l/by-id /dev/video*`"
        ) from None
    if not stat.S_ISCHR(mode):
        raise DeviceMisconfigured(f"`source`: {path} is no camera")
    if not os.access(path, os.R_OK | os.W_OK):
        raise DeviceUnavailable(
            f"`source`: no permission for {path}: `sudo usermod -aG video $USER`, then log in again"
        )


def _open_url(config: CameraConfig) -> Any:
    import cv2

    # these two count only where they are given at opening
    limits = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_WITHIN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
    capture = cv2.VideoCapture(str(config.source), cv2.CAP_FFMPEG, (*limits, round(1000.0 * config.silent_s)))
    if not capture.isOpened():
        raise DeviceUnavailable(
            f"`source`: no stream from {shown(config.source)}: is the camera on, and are address, path and password "
            "right?"
        )
    return capture


def _open_pipeline(text: str) -> Any:
    import cv2

    if not cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):
        raise DeviceMisconfigured(
            "`source` needs GStreamer, and this OpenCV was built without GStreamer (the package from PyPI is): "
            "`pip uninstall opencv-python-headless`, `sudo apt install python3-opencv` and an environment made with "
            "`--system-site-packages`; or use a camera that has a /dev/video node"
        )
    capture = cv2.VideoCapture(text, cv2.CAP_GSTREAMER)
    if not capture.isOpened():
        raise DeviceUnavailable(
            "`source`: the pipeline does not run: try it with `gst-launch-1.0`, with `appsink` replaced by `fakesink`: "
            f"{text}"
        )
    return capture
