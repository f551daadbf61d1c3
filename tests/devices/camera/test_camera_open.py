"""Opening live sources through OpenCV: what each failure says, and a real MJPEG stream over HTTP."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd.testing import connected
from robotd.world.clock import ns
from robotd.world.messages import CameraFrame
from robotd_devices.camera import Camera, CameraConfig
from robotd_devices.camera.captures import check_node, open_live
from robotd_devices.camera.config import kind_of, shown
from robotd_devices.camera.shape import Shape


@pytest.mark.parametrize(
    ("source", "error", "words"),
    [
        ("/dev/video97", DeviceUnavailable, "/dev/video97 does not exist: plug the camera in"),
        (97, DeviceUnavailable, "/dev/video97 does not exist"),
        ("/dev/null", DeviceUnavailable, "/dev/null cannot be opened: another program uses it, or it is a node"),
        ("http://127.0.0.1:9/x", DeviceUnavailable, "no stream from http://127.0.0.1:9/x: is the camera on"),
        ("http://me:secret@127.0.0.1:9/x", DeviceUnavailable, "no stream from http://127.0.0.1:9/x: is"),
    ],
)
def test_open_live_says_why_not(source: int | str, error: type[Exception], words: str) -> None:
    with pytest.raises(error) as raised:
        open_live(CameraConfig(source=source), Shape())
    assert words in str(raised.value)
    assert "secret" not in str(raised.value)


@pytest.mark.parametrize(
    ("has_gstreamer", "error", "words"),
    [
        (False, DeviceMisconfigured, "this OpenCV was built without GStreamer.*apt install python3-opencv"),
        (True, DeviceUnavailable, "the pipeline does not run: try it with `gst-launch-1.0`"),
    ],
)
@pytest.mark.parametrize("source", ["no_such_element ! appsink", "csi", "libcamera"])
def test_pipelines_need_an_opencv_with_gstreamer(
    monkeypatch: pytest.MonkeyPatch, source: str, has_gstreamer: bool, error: type[Exception], words: str
) -> None:
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda backend: has_gstreamer)
    with pytest.raises(error, match=words):
        open_live(CameraConfig(source=source), Shape())


def test_a_plain_file_is_no_camera(tmp_path: Path) -> None:
    (tmp_path / "video0").write_text("")
    with pytest.raises(DeviceMisconfigured, match="video0 is no camera"):
        check_node(str(tmp_path / "video0"))


@pytest.mark.parametrize(
    ("source", "kind", "name"),
    [
        (0, "v4l2", "/dev/video0"),
        ("2", "v4l2", "/dev/video2"),
        ("/dev/v4l/by-id/usb-x-video-index0", "v4l2", "/dev/v4l/by-id/usb-x-video-index0"),
        ("rtsp://a:b@cam/1", "url", "rtsp://cam/1"),
        ("http://cam:81/stream", "url", "http://cam:81/stream"),
        ("csi", "board", "csi"),
        ("csi:1", "board", "csi:1"),
        ("libcamera:imx219", "board", "libcamera:imx219"),
        ("csirecordings", "video", "csirecordings"),
        ("nvarguscamerasrc ! appsink", "pipeline", "nvarguscamerasrc ! appsink"),
        ("/tmp", "folder", "/tmp"),
        ("drive.avi", "video", "drive.avi"),
    ],
)
def test_kinds_of_sources(source: int | str, kind: str, name: str) -> None:
    assert (kind_of(source), shown(source)) == (kind, name)


def test_declares_itself() -> None:
    assert Camera.emits == (CameraFrame,)
    assert Camera.config_type is CameraConfig
    assert Camera.sim_twin == "sim_camera"
    assert Camera.publish_period_s(CameraConfig(rate_hz=20.0)) == 0.05
    assert CameraConfig().latency == pytest.approx(1 / 60)
    assert CameraConfig(source="/tmp").latency == 0.0


@pytest.mark.parametrize(
    ("config", "words"),
    [({"rotate_deg": 45}, "rotate_deg"), ({"rate_hz": 0}, "rate_hz"), ({"width_px": 1}, "width_px"), ({"x": 1}, "x")],
)
def test_config_refuses(config: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        CameraConfig.model_validate(config)


# --------------------------------------------------------------------------- MJPEG over HTTP, through OpenCV


class _Stream(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        server: Any = self.server
        while self.rfile.readline().strip():
            pass
        self.wfile.write(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n")
        while not server.cut.wait(0.02):
            jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 200, np.uint8))[1].tobytes()
            head = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + jpeg + b"\r\n")
            except OSError:
                return


@pytest.fixture
def stream() -> Iterator[Any]:
    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True
        block_on_close = False

    with Server(("127.0.0.1", 0), _Stream) as server:
        server.cut = threading.Event()  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield server
        server.cut.set()  # type: ignore[attr-defined]
        server.shutdown()
        thread.join()


async def test_mjpeg_over_http_and_its_end(stream: Any) -> None:
    url = f"http://127.0.0.1:{stream.server_address[1]}/video"
    device, link = connected(Camera, CameraConfig(source=url, rate_hz=50.0), name="camera")
    await device.open()
    await link.received(5)
    frame = link.of(CameraFrame)[-1]
    assert frame.bgr.shape == (48, 64, 3)
    assert abs(int(frame.bgr.mean()) - 200) <= 3
    assert frame.source == url
    stamps = [message.stamp_ns for message in link.messages]
    assert stamps == sorted(stamps)
    assert link.arrived_ns[-1] - stamps[-1] >= ns(0.01)  # half a period before it arrived
    stream.cut.set()
    await link.until(lambda link: bool(link.losses))
    assert "no picture came any more" in str(link.losses[0])
    await device.close()
