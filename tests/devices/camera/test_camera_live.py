"""Live cameras, faked at the capture call: the newest picture only, honest stamps, hangs, unplugging, a real stream."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from waiting import until

from robotd.authoring.device import DeviceError, DeviceLost, DeviceMisconfigured, DeviceUnavailable
from robotd.testing import FakeLink, ManualClock, check_sensor, connected
from robotd.world.clock import Clock
from robotd.world.messages import CameraFrame
from robotd_devices.camera import Camera, CameraConfig
from robotd_devices.camera.capture_fake import CaptureFake

PERIOD_NS = 50_000_000


def camera(capture: Callable[[], Any], clock: Clock | None = None, **config: Any) -> tuple[Camera, FakeLink]:
    make = partial(Camera, open_capture=capture)
    return connected(make, CameraConfig(**config), name="camera", clock=clock)


async def test_every_picture_of_a_fast_program() -> None:
    capture = CaptureFake()
    device, link = camera(capture)
    await device.open()
    for count in range(1, 8):
        capture.send()
        await link.received(count)
    frames = link.of(CameraFrame)
    assert [frame.sequence for frame in frames] == list(range(1, 8))
    assert {frame.source for frame in frames} == {"/dev/video0"}
    assert not frames[0].bgr.flags.writeable
    capture.inject("camera out")
    await device.close()
    assert capture.released == 1


@pytest.mark.parametrize(
    ("config", "driver_ns", "stamp_ns"),
    [
        ({}, None, 10_000_000_000 - PERIOD_NS // 2),  # the arrival, less half a period
        ({"latency_s": 0.1}, None, 9_900_000_000),
        ({"latency_s": 0.0}, None, 10_000_000_000),
        ({"latency_s": 0.0}, 9_970_000_000, 9_970_000_000),  # the driver's stamp
        ({"latency_s": 0.01}, 9_970_000_000, 9_960_000_000),
        ({"latency_s": 0.0}, 10_000_000_001, 10_000_000_000),  # from the future, or of another clock: not believed
        ({"latency_s": 0.0}, 8_999_999_999, 10_000_000_000),
        ({"latency_s": 0.0, "source": "rtsp://x/1"}, 9_970_000_000, 10_000_000_000),  # a position in a stream
    ],
)
async def test_stamps(config: dict[str, Any], driver_ns: int | None, stamp_ns: int) -> None:
    capture, clock = CaptureFake(), ManualClock(10_000_000_000)
    if driver_ns is not None:
        capture.driver_ms = driver_ns / 1e6
    device, link = camera(capture, clock, rate_hz=20.0, **config)
    await device.open()
    capture.send()
    await link.received(1)
    assert link.messages[0].stamp_ns == stamp_ns
    capture.inject("camera out")
    await device.close()


async def test_unplugged_and_plugged_in_again() -> None:
    capture = CaptureFake()
    device, link = camera(capture)
    await device.open()
    capture.send()
    await link.received(1)
    capture.inject("camera out")
    await link.until(lambda link: bool(link.losses))
    assert isinstance(link.losses[0], DeviceLost)
    assert str(link.losses[0]) == (
        "camera: /dev/video0: no picture came any more: is its cable in, and its supply strong enough?"
    )
    await device.close()
    assert capture.released == 1
    capture.mend("camera out")
    await device.open()
    capture.send()
    await link.received(2)
    capture.inject("camera out")
    await device.close()
    assert (capture.opened, capture.released, len(link.losses)) == (2, 2, 1)


async def test_silent_camera_is_lost_and_closing_does_not_wait_for_a_read_that_hangs() -> None:
    captures: list[CaptureFake] = []

    def new() -> CaptureFake:
        captures.append(CaptureFake())
        return captures[-1]()

    device, link = camera(new, silent_s=0.2)
    loop = asyncio.get_running_loop()
    for count in (1, 2):
        await device.open()
        await link.until(lambda link, count=count: len(link.losses) == count)
        assert "no picture for 0.2 s: does the camera hang" in str(link.losses[-1])
        began_s = loop.time()
        await device.close()
        assert loop.time() - began_s < 0.2
    # two threads hang in their reads: no third one
    with pytest.raises(DeviceUnavailable, match=r"camera: /dev/video0 hangs: 2 reads of it never returned"):
        await device.open()
    await device.close()
    captures[0].send()  # one comes back after all; what it brings is old
    await until(lambda: captures[0].released == 1)
    await device.open()
    captures[-1].send()
    await link.received(1)
    assert len(link.messages) == 1
    captures[-1].inject("camera out")
    captures[1].inject("camera out")
    await device.close()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: setattr(c, "odd", np.zeros((4, 4, 2), np.uint8)), "uint8 (4, 4, 2) is not 8 bits"),
        (lambda c: setattr(c, "decodes", False), "it could not be decoded"),
    ],
)
async def test_bad_picture_is_dropped_and_counted(spoil: Callable[[CaptureFake], None], words: str) -> None:
    capture = CaptureFake()
    device, link = camera(capture)
    await device.open()
    spoil(capture)
    capture.take()
    capture.decodes = True
    capture.send()
    await link.received(1)
    assert [name for name, _ in link.faults] == ["picture dropped"]
    assert words in link.faults[0][1]
    assert link.of(CameraFrame)[0].sequence == 2
    capture.inject("camera out")
    await device.close()


async def test_a_camera_that_repeats_itself_is_lost_and_no_old_picture_looks_new() -> None:
    capture, clock = CaptureFake(), ManualClock(10**10)
    device, link = camera(capture, clock, frozen_s=1.0)
    await device.open()
    still = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
    for _ in range(21):
        capture.odd = still.copy()
        clock.set_ns(clock.now_ns() + PERIOD_NS)
        capture.send()
        await link.until(lambda link: len(link.messages) + len(link.faults) >= 1)
        await until(lambda: capture.odd is None)
    await link.until(lambda link: bool(link.losses))
    assert "frozen: the very same picture for 1 s, it is opened anew" in str(link.losses[0])
    assert len(link.messages) == 1
    assert {name for name, _ in link.faults} == {"repeated picture"}
    await device.close()
    assert capture.released == 1


async def test_torn_pictures_are_left_out_and_the_numbers_show_it() -> None:
    capture = CaptureFake()
    device, link = camera(capture)
    await device.open()
    torn = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
    torn[12:] = 128
    capture.odd = torn
    capture.take()
    capture.send()
    await link.received(1)
    assert [name for name, _ in link.faults] == ["torn picture"]
    assert link.of(CameraFrame)[0].sequence == 2
    capture.inject("camera out")
    await device.close()


async def test_grey_live_pictures_become_three_channels() -> None:
    capture = CaptureFake()
    device, link = camera(capture, rotate_deg=90, width_px=18)
    await device.open()
    capture.odd = np.full((24, 32), 7, np.uint8)
    capture.send()
    await link.received(1)
    assert link.of(CameraFrame)[0].bgr.shape == (24, 18, 3)
    capture.inject("camera out")
    await device.close()


async def test_keeps_the_contract_of_sensors() -> None:
    capture = CaptureFake()
    stop = threading.Event()

    def feed() -> None:
        while not stop.wait(0.005):
            capture.send()

    feeder = threading.Thread(target=feed, daemon=True)
    feeder.start()
    device, link = camera(capture, rate_hz=100.0)
    await check_sensor(device, messages=5)
    assert link.losses == []
    stop.set()
    capture.inject("camera out")
    feeder.join(6.0)
    assert not feeder.is_alive()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (DeviceMisconfigured("`source`: wrong"), r"camera: `source`: wrong"),
        (cv2.error("oops"), r"camera: error: oops"),
    ],
)
async def test_opening_fails_with_words(error: Exception, words: str) -> None:
    def fails() -> Any:
        raise error

    device, link = camera(fails)
    with pytest.raises(DeviceError, match=words):
        await device.open()
    await device.close()
    assert link.losses == []


async def test_cancelled_opening_releases_the_capture_when_it_comes() -> None:
    capture, go = CaptureFake(), threading.Event()

    def slow() -> CaptureFake:
        go.wait(5.0)
        return capture()

    device, _ = camera(slow)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await device.open()
    await device.close()
    go.set()
    await until(lambda: capture.released)
    assert (capture.opened, capture.released) == (1, 1)
