"""What cameras do wrong: no torn, repeated or old picture is passed on; and of each kind, the newest at any pace."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fault_matrix import answers
from mjpeg_server import jpeg, number_of, part, served

from robotd.testing import FakeLink, ManualClock, connected, virtual_time
from robotd.world.messages import CameraFrame
from robotd_devices.camera import Camera, CameraConfig
from robotd_devices.camera.capture_fake import CaptureFake

PERIOD_NS = 50_000_000
SLOWER = 10


@asynccontextmanager
async def v4l2(**config: Any) -> AsyncIterator[tuple[CaptureFake, FakeLink, ManualClock, Camera]]:
    """A camera at 20 Hz, faked at the capture call, open, on a clock that the test moves."""
    fake, clock = CaptureFake(), ManualClock(10**10)
    make = partial(Camera, open_capture=fake)
    camera, link = connected(make, CameraConfig(rate_hz=20.0, **config), name="camera", clock=clock)
    await camera.open()
    try:
        yield fake, link, clock, camera
    finally:
        fake.inject("camera out")
        await camera.close()


def later(clock: ManualClock, by_ns: int) -> None:
    clock.set_ns(clock.now_ns() + by_ns)


# ---------------------------------------------------------------------------------------------- 21, 22: pictures


@answers(21, "torn picture")
async def test_of_a_v4l2_camera_a_torn_picture_is_left_out_and_counted(fault: str) -> None:
    async with v4l2() as (fake, link, clock, _):
        for torn in (False, True, False):
            fake.is_torn = torn
            later(clock, PERIOD_NS)
            fake.take()
        await link.until(lambda link: bool(link.messages) and link.of(CameraFrame)[-1].sequence == 3)
        assert 2 not in [frame.sequence for frame in link.of(CameraFrame)]
        assert [name for name, _ in link.faults] == ["torn picture"]
        assert fake.sent == 3


@answers(21, "torn picture", "wrong length", "boundary in pieces")
async def test_of_an_mjpeg_stream_a_damaged_part_costs_itself_only(fault: str) -> None:
    async with served() as server:
        camera, link = connected(Camera, CameraConfig(source=server.url), name="camera")
        await camera.open()
        await server.asked.wait()
        await server.show(1)
        await link.received(1)
        server.inject(fault)
        await server.show(2)
        server.mend(fault)
        is_lost = fault == "torn picture"
        if not is_lost:
            await link.received(2)
        await server.show(3)
        await link.until(lambda link: bool(link.messages) and number_of(link.of(CameraFrame)[-1].bgr) == 3)
        assert [number_of(frame.bgr) for frame in link.of(CameraFrame)] == ([1, 3] if is_lost else [1, 2, 3])
        assert len(link.faults) == is_lost
        assert link.losses == []
        await camera.close()


@answers(22, "frozen picture")
async def test_a_camera_that_repeats_itself_is_stale_at_once_and_opened_anew_after_2_s(fault: str) -> None:
    async with v4l2() as (fake, link, clock, camera):
        fake.take()
        await link.received(1)
        fake.inject(fault)
        began_ns = clock.now_ns()
        while not link.losses:
            later(clock, PERIOD_NS)
            fake.send()
            told = len(link.faults)
            await link.until(lambda link, told=told: len(link.faults) > told or bool(link.losses))
            assert clock.now_ns() - began_ns <= 2_100_000_000
        assert clock.now_ns() - began_ns >= 1_900_000_000
        assert len(link.messages) == 1, "an old picture was passed on as new"
        assert "it is opened anew" in str(link.losses[0])
        await camera.close()
        fake.mend(fault)
        await camera.open()
        assert (fake.opened, fake.released) == (2, 1)
        later(clock, PERIOD_NS)
        fake.take()
        await link.received(2)


@answers(22, "camera hangs", "camera out")
async def test_a_camera_that_hangs_or_is_pulled_out_is_told_within_2_s(fault: str) -> None:
    fake = CaptureFake()
    make = partial(Camera, open_capture=fake)
    camera, link = connected(make, CameraConfig(silent_s=0.2), name="camera")
    await camera.open()
    fake.take()
    await link.received(1)
    fake.inject(fault)
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    await link.until(lambda link: bool(link.losses), 2.0)
    await camera.close()
    assert loop.time() - began_s < 2.0
    assert len(link.messages) == 1
    fake.inject("camera out")


# --------------------------------------------------------------------- the newest picture, whoever asks how slowly


async def test_v4l2_ten_times_too_slow_a_program_sees_pictures_of_at_most_one_and_a_half_periods() -> None:
    async with v4l2() as (fake, link, clock, _):
        for turn in range(1, 6):
            for _ in range(SLOWER):  # the loop is busy for ten periods
                later(clock, PERIOD_NS)
                fake.take()
            await link.received(turn)
            later(clock, PERIOD_NS - 1)  # it is looked at just before the next one is there
            frame = link.of(CameraFrame)[-1]
            assert frame.sequence == fake.sent == SLOWER * turn
            assert clock.now_ns() - frame.stamp_ns <= 1.5 * PERIOD_NS
            later(clock, 1)
        assert len(link.messages) == 5


async def test_mjpeg_ten_times_too_slow_a_program_sees_pictures_of_at_most_one_and_a_half_periods() -> None:
    async with served() as server:
        clock = ManualClock(10**10)
        camera, link = connected(Camera, CameraConfig(source=server.url, rate_hz=20.0), name="camera", clock=clock)
        await camera.open()
        await server.asked.wait()
        for turn in range(1, 4):
            for number in [0] * (SLOWER - 1) + [turn]:  # they fill the kernel while the loop is busy for ten periods
                later(clock, PERIOD_NS)
                server.send(part(jpeg(number)))
            sent_ns = clock.now_ns()
            later(clock, PERIOD_NS - 1)
            await link.until(
                lambda link, turn=turn: bool(link.messages) and link.of(CameraFrame)[-1].sequence == SLOWER * turn
            )
            assert number_of(link.of(CameraFrame)[-1].bgr) == turn, "the newest one, as the server sees it"
            assert clock.now_ns() - sent_ns <= 1.5 * PERIOD_NS
            later(clock, 1)
        assert len(link.messages) == 3, "none of those that waited before it"
        await camera.close()


@pytest.mark.parametrize("kind", ["folder", "video"])
@virtual_time
async def test_files_ten_times_too_slow_a_program_sees_pictures_of_at_most_one_and_a_half_periods(
    tmp_path: Path, kind: str
) -> None:
    """A program that looks every ten periods finds the picture of the last beat, and no queue."""
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (32, 24))
    (tmp_path / "pictures").mkdir()
    for number in range(12):
        picture = np.full((24, 32, 3), 20 + 18 * number, np.uint8)
        cv2.imwrite(str(tmp_path / "pictures" / f"{number:02d}.png"), picture)
        writer.write(picture)
    writer.release()
    source = tmp_path / ("pictures" if kind == "folder" else "drive.avi")
    camera, link = connected(Camera, CameraConfig(source=str(source), rate_hz=20.0), name="camera")
    clock = camera.context.clock
    await camera.open()
    for _ in range(5):
        await asyncio.sleep(SLOWER * PERIOD_NS / 1e9 + 0.01)
        frame = link.of(CameraFrame)[-1]
        assert clock.now_ns() - frame.stamp_ns <= 1.5 * PERIOD_NS
    await camera.close()
