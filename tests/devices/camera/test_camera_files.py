"""Folders and video files as cameras: every picture in its order, at its instant on virtual time, and every mistake."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import FakeLink, check_sensor, connected, virtual_time
from robotd.world.clock import ns
from robotd.world.messages import CameraFrame
from robotd_devices.camera import Camera, CameraConfig
from robotd_devices.camera.pictures import Folder
from robotd_devices.camera.shape import Shape, to_bgr

GREYS = (10, 60, 110, 160, 210)


def picture(grey: int, width: int = 32, height: int = 24, channels: int = 3) -> Any:
    shape = (height, width, channels) if channels > 1 else (height, width)
    return np.full(shape, grey, np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "pictures"
    path.mkdir()
    for number, grey in enumerate(GREYS):
        cv2.imwrite(str(path / f"{number:02d}.png"), picture(grey))
    (path / "notes.txt").write_text("no picture")
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (32, 24))
    for grey in GREYS:
        writer.write(picture(grey))
    writer.release()
    return path


def camera(source: object, **config: Any) -> tuple[Camera, FakeLink]:
    return connected(Camera, CameraConfig(source=str(source), **config), name="camera")


def empty(folder: Path) -> None:
    for file in folder.glob("*.png"):
        file.unlink()


def greys(link: FakeLink) -> list[int]:
    """The nearest of GREYS for each frame: JPEG changes values a little."""
    return [min(GREYS, key=lambda grey: abs(grey - int(frame.bgr.mean()))) for frame in link.of(CameraFrame)]


@virtual_time
async def test_folder_in_order_at_exact_instants_and_over_again(folder: Path) -> None:
    device, link = camera(folder, rate_hz=20.0)
    began_ns = device.context.clock.now_ns()
    await device.open()
    await link.received(12)
    await device.close()
    frames = link.of(CameraFrame)
    assert greys(link) == [*GREYS, *GREYS, *GREYS[:2]]
    assert [frame.stamp_ns - began_ns for frame in frames] == [ns(n / 20.0) for n in range(1, 13)]
    assert link.arrived_ns == [frame.stamp_ns for frame in frames]
    assert [frame.sequence for frame in frames] == list(range(1, 13))
    assert [frame.source for frame in frames][4:6] == ["04.png", "00.png"]
    assert not frames[0].bgr.flags.writeable
    assert link.faults == []


@virtual_time
async def test_video_in_order_at_exact_instants_and_over_again(video: Path) -> None:
    device, link = camera(video, rate_hz=40.0)
    began_ns = device.context.clock.now_ns()
    await device.open()
    await link.received(7)
    await device.close()
    frames = link.of(CameraFrame)
    assert greys(link) == [*GREYS, *GREYS[:2]]
    assert [frame.stamp_ns - began_ns for frame in frames] == [ns(n / 40.0) for n in range(1, 8)]
    assert {frame.source for frame in frames} == {"drive.avi"}
    assert [frame.sequence for frame in frames] == list(range(1, 8))


@virtual_time
@pytest.mark.parametrize("kind", ["folder", "video"])
async def test_without_loop_the_end_is_a_loss_and_stays_the_end(kind: str, folder: Path, video: Path) -> None:
    source = folder if kind == "folder" else video
    device, link = camera(source, loop=False)
    await device.open()
    await link.until(lambda link: bool(link.losses))
    await device.close()
    assert greys(link) == list(GREYS)
    words = f"camera: {source} is at its end; `loop: true` begins again"
    assert str(link.losses[0]) == words
    with pytest.raises(DeviceUnavailable) as raised:
        await device.open()
    assert str(raised.value) == words
    await device.close()


@virtual_time
async def test_unreadable_pictures_are_skipped_and_named(folder: Path) -> None:
    (folder / "01.png").write_bytes(b"not a picture")
    (folder / "02.png").write_bytes(b"")
    whole = (folder / "03.png").read_bytes()
    (folder / "03.png").write_bytes(whole[:20])
    device, link = camera(folder)
    await device.open()
    await link.received(3)
    await device.close()
    assert greys(link)[:3] == [GREYS[0], GREYS[4], GREYS[0]]
    assert [frame.sequence for frame in link.of(CameraFrame)] == [1, 5, 6]  # the gap shows
    named = [detail.split(":")[0] for name, detail in link.faults if name == "unreadable picture"]
    assert named[:3] == ["01.png", "02.png", "03.png"]


@virtual_time
async def test_pictures_of_one_and_four_channels_and_sixteen_bits(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture(60, channels=1))
    cv2.imwrite(str(tmp_path / "b.png"), picture(110, channels=4))
    cv2.imwrite(str(tmp_path / "c.png"), np.full((24, 32), 160 * 257, np.uint16))
    device, link = camera(tmp_path)
    await device.open()
    await link.received(3)
    await device.close()
    assert {frame.bgr.shape for frame in link.of(CameraFrame)} == {(24, 32, 3)}
    assert greys(link) == [60, 110, 160]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "none does not exist: correct the path; a relative one counts from the folder in which"),
        (lambda path: path.mkdir(), "none holds no pictures; put some there (.jpg, "),
        (lambda path: path.write_bytes(b"x" * 100), "none is no video that OpenCV can read"),
        (
            lambda path: (path.mkdir(), (path / "a.png").write_bytes(b"x")),
            "none of the 1 pictures in {path} can be read: a.png: no picture that OpenCV can decode",
        ),
    ],
    ids=["absent", "empty folder", "no video", "no picture"],
)
@virtual_time
async def test_opening_says_why_not(tmp_path: Path, make: Any, words: str) -> None:
    path = tmp_path / "none"
    make(path)
    device, _ = camera(path)
    with pytest.raises(DeviceUnavailable) as raised:
        await device.open()
    await device.close()
    assert str(raised.value).startswith("camera: `source`: ")
    assert words.format(path=path) in str(raised.value)


@virtual_time
async def test_folder_whose_pictures_all_go_bad_is_lost(folder: Path) -> None:
    device, link = camera(folder)
    await device.open()
    await link.received(2)
    empty(folder)
    await link.until(lambda link: bool(link.losses))
    await device.close()
    assert "none of the 5 pictures" in str(link.losses[0])
    with pytest.raises(DeviceUnavailable, match="holds no pictures"):
        await device.open()
    await device.close()


@pytest.mark.parametrize("kind", ["folder", "video"])
async def test_keeps_the_contract_of_sensors(kind: str, folder: Path, video: Path) -> None:
    device, link = camera(folder if kind == "folder" else video, rate_hz=100.0)
    await check_sensor(device, messages=4)
    assert link.losses == []


async def test_slow_reading_neither_blocks_the_loop_nor_holds_up_closing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Folder.next
    slow = False

    def next_picture(self: Folder) -> Any:
        if slow:
            time.sleep(0.3)  # in the worker
        return real(self)

    monkeypatch.setattr(Folder, "next", next_picture)
    device, link = camera(folder, rate_hz=100.0)
    await device.open()
    slow = True
    await link.until(lambda link: ("picture not ready in time", "") in link.faults)
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    await device.close()
    assert loop.time() - began_s < 0.1
    count = len(link.messages)
    await asyncio.sleep(0)
    assert len(link.messages) == count


@virtual_time
async def test_real_floor_pictures(data_dir: Path) -> None:
    floor = data_dir / "jetbot" / "floor"
    device, link = camera(floor)
    await device.open()
    await link.received(2)
    await device.close()
    frames = link.of(CameraFrame)
    assert [frame.source for frame in frames[:2]] == ["test.jpg", "test2.jpg"]
    assert {frame.bgr.shape for frame in frames} == {(224, 224, 3)}


# ------------------------------------------------------------------------------------------- shapes


@pytest.mark.parametrize(
    ("shape", "size_px", "corner"),
    [
        (Shape(), (32, 24), (0, 0)),
        (Shape(rotate_deg=90), (24, 32), (0, 23)),  # the upper left corner goes to the upper right
        (Shape(rotate_deg=180), (32, 24), (23, 31)),
        (Shape(rotate_deg=270), (24, 32), (31, 0)),
        (Shape(width_px=16), (16, 12), None),
        (Shape(height_px=48), (64, 48), None),
        (Shape(20, 20), (20, 20), None),
        (Shape(width_px=12, rotate_deg=90), (12, 16), None),
    ],
)
def test_shape(shape: Shape, size_px: tuple[int, int], corner: tuple[int, int] | None) -> None:
    raw = picture(10)
    raw[0, 0] = 255
    out = shape.apply(raw)
    assert out.shape == (size_px[1], size_px[0], 3)
    assert not out.flags.writeable
    if corner is not None:
        assert tuple(out[corner]) == (255, 255, 255)


def test_nothing_to_do_is_no_copy() -> None:
    raw = picture(10)
    assert Shape(32, 24).apply(raw) is raw


def test_asks_a_camera_for_the_size_before_the_rotation() -> None:
    assert Shape(480, 640, 90).asked_px == (640, 480)
    assert Shape(480, 640, 180).asked_px == (480, 640)
    assert Shape(rotate_deg=90).asked_px == (None, None)


@pytest.mark.parametrize(
    "raw",
    [
        np.zeros((4, 4, 2), np.uint8),
        np.zeros((4, 4, 3), np.uint16),
        np.zeros((4,), np.uint8),
        np.zeros((0, 4, 3), np.uint8),
    ],
    ids=str,
)
def test_odd_pictures_are_refused(raw: Any) -> None:
    with pytest.raises(ValueError, match="is not 8 bits of one, three or four channels"):
        to_bgr(raw)


def test_channels() -> None:
    assert to_bgr(picture(60, channels=1)).shape == (24, 32, 3)
    assert to_bgr(np.dstack([picture(60, channels=1)] * 4)).shape == (24, 32, 3)
    single = picture(60, channels=1)[:, :, None]
    assert (to_bgr(single) == 60).all()
