"""The page of a running robot over real sockets: what it is told, what it may ask, who is turned away."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
from dataclasses import replace
from typing import Any

import aiohttp
import numpy as np
import pytest
from small_robot import ANGLES, FakeBase, ScriptConfig
from watched import WITHIN_S, FakeCamera, opened, watch, watched_robot

from robotd import CameraFrame
from robotd.engine.loops import virtual_loop
from robotd.engine.parts import DevicePart
from robotd.engine.runtime import Runtime
from robotd_plugins.bridges.dashboard import Dashboard

TOKEN = "a token of some length"


def base_of(runtime: Runtime) -> FakeBase:
    base = next(kept.device for kept in runtime.devices if kept.name == "base")
    assert isinstance(base, FakeBase)
    return base


def test_a_viewer_is_told_everything() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as page:
            hello = await page.kind("hello")
            assert (hello["robot"], hello["scans"], hello["cameras"]) == ("tester", ["lidar_scan"], ["camera_frame"])
            status = await page.status(lambda s: s["moving"])
            assert status["sentence"] == "driving: ahead (AHEAD)" or status["sentence"] == "driving: ahead"
            await page.status(lambda s: s["sentence"] == "driving: ahead (AHEAD)")
            scan = await page.binary(1)
            count = int.from_bytes(scan[4:8], "little")
            np.testing.assert_array_equal(np.frombuffer(scan, "<f4", count, 36), ANGLES)
            np.testing.assert_array_equal(np.frombuffer(scan, "<f4", count, 36 + 4 * count), np.full(72, 2.0))
            picture = await page.binary(2)
            assert (int.from_bytes(picture[2:4], "little"), int.from_bytes(picture[4:8], "little")) == (640, 480)
            import cv2

            shown = cv2.imdecode(np.frombuffer(picture, np.uint8, offset=16), cv2.IMREAD_COLOR)
            assert shown is not None and shown.shape == (240, 320, 3)
            assert shown[120, 40, 0] > 150 and shown[120, 280, 2] > 150
            drawings = await page.until(lambda told: told["kind"] == "drawings" and "ahead" in told["by"])
            assert [item["type"] for item in drawings["by"]["ahead"]] == ["Text", "Scalar", "Line", "ImageBox"]

    watch(scenario)


def test_any_viewer_stops_the_robot_and_it_stays_stopped() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as first, opened(dashboard) as second:
            await first.status(lambda s: s["moving"])
            assert (await second.ask("estop"))["ok"]
            assert base_of(runtime).log[-1][1] == "halt"
            status = await first.status(lambda s: s["mode"] == "estop")
            assert status["sentence"] == "standing still because e-stop by page 2; reset it, then arm"
            events = await first.until(
                lambda t: t["kind"] == "events" and any(e["kind"] == "EStopped" for e in t["entries"])
            )
            assert "page 2: estop" in [entry["text"] for entry in events["entries"]]
            for do in ("arm", "start", "resume", "pause"):
                answer = await first.ask(do, behaviour="ahead")
                assert not answer["ok"] and "e-stop by page 2" in answer["reason"]
        async with opened(dashboard) as third:  # a reload changes nothing, and is told what happened
            assert (await third.kind("status"))["mode"] == "estop"
            assert "e-stop by page 2" in str(await third.kind("events"))
            assert (await third.ask("reset_estop"))["ok"]
            assert (await third.status(lambda s: s["mode"] == "disarmed"))["moving"] is False
            assert (await third.ask("arm"))["ok"]
            await third.status(lambda s: s["moving"])

    watch(scenario)


def test_requests_are_answered_with_the_reason_of_a_refusal() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as page:
            assert (await page.ask("reset_estop"))["reason"] == "no e-stop is latched"
            assert "no behaviour 'fly'" in (await page.ask("start", behaviour="fly"))["reason"]
            assert (await page.ask("cancel", behaviour="ahead"))["ok"]
            assert (await page.ask("cancel", behaviour="ahead"))["reason"] == "ahead is not active"
            assert (await page.ask("start", behaviour="ahead"))["ok"]
            assert "goal of ahead: speed" in (await page.ask("start", behaviour="ahead", goal={"speed": 1}))["reason"]
            assert (await page.ask("pause"))["ok"]
            await page.status(lambda s: s["mode"] == "paused" and "paused by page 1" in s["sentence"])
            assert (await page.ask("resume"))["ok"]
            await page.status(lambda s: s["mode"] == "auto")
            assert (await page.ask("disarm"))["ok"]
            await page.status(lambda s: s["mode"] == "disarmed")
            assert (await page.ask("ping"))["kind"] == "pong"

    watch(scenario)


def test_who_does_not_draw_gets_one_beat_and_the_others_all() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard, draws=False) as slow, opened(dashboard) as quick:
            for _ in range(8):
                await quick.kind("beat")
            for _ in range(50):
                await slow.wire.send_json({"do": "ping"})
            await slow.ask("ping")
            assert [told["n"] for told in slow.told if isinstance(told, dict) and told["kind"] == "beat"] == [1]
            # what it gets once it draws again is of now
            now_ns = runtime.handle.clock.now_ns()
            slow.draws = True
            await slow.wire.send_json({"do": "beat", "n": 1})
            assert (await slow.kind("status"))["now_ns"] >= now_ns

    watch(scenario)


class NoisyCamera(FakeCamera):
    """Pictures that no JPEG makes small: far more than a socket's buffers hold."""

    def message(self, now_ns: int) -> CameraFrame:
        noise = np.random.default_rng(1).integers(0, 255, (960, 1280, 3), dtype=np.uint8)
        return CameraFrame(now_ns, noise, self._count)


def test_the_e_stop_of_a_page_that_reads_nothing_comes_through() -> None:
    parts = watched_robot()
    camera = DevicePart("camera", NoisyCamera, ScriptConfig(hz=15.0))

    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        await dashboard.serving.wait()
        port = int(dashboard.url.split(":")[2].strip("/"))
        async with opened(dashboard) as quick:
            with socket.socket() as raw:
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                raw.connect(("127.0.0.1", port))
                raw.sendall(
                    f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
                )
                # it says that it drew what it never read, until a picture lies in front of a full socket
                for _ in range(6):
                    await quick.binary(2)
                    raw.sendall(b"".join(_frame(b'{"do":"beat","n":%d}' % beat) for beat in range(1, 7)))
                for _ in range(150):
                    raw.sendall(_frame(b'{"do":"ping","id":1}'))
                raw.sendall(_frame(b'{"do":"estop","id":2}'))
                status = await quick.status(lambda s: s["mode"] == "estop")
                assert "e-stop by page 2" in status["reason"]

    watch(scenario, replace(parts, devices=(*parts.devices[:2], camera)), frame_width=1280, jpeg_quality=95)


def _frame(text: bytes) -> bytes:
    """A text frame of a client (RFC 6455, 5.2) with a mask of zeros."""
    return bytes((0x81, 0x80 | len(text), 0, 0, 0, 0)) + text


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        ("not json", "sent garbage"),
        ('{"do":"fly"}', "sent garbage"),
        (b"\x00\x01", "sent binary data"),
        ('{"do":"estop","id":' + "1" * 5000 + "}", "exceeds limit 4096"),
    ],
)
def test_garbage_is_hung_up_on_and_the_robot_drives_on(
    sent: str | bytes, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as page, opened(dashboard) as other:
            await other.status(lambda s: s["moving"])
            await (page.wire.send_bytes(sent) if isinstance(sent, bytes) else page.wire.send_str(sent))
            with pytest.raises(ConnectionError):
                while True:
                    await page.next()
            assert (await other.kind("status"))["moving"]

    watch(scenario)
    assert why in caplog.text


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example"}, 403),
        ({}, 200),
    ],
)
def test_pages_of_strangers_are_turned_away(
    headers: dict[str, str], status: int, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        await dashboard.serving.wait()
        async with aiohttp.ClientSession(headers=headers) as session:
            for path in ("", "page.js", "live"):
                async with session.get(dashboard.url + path) as answer:
                    if status == 403:
                        assert answer.status == 403 and "refused" in await answer.text()
                    elif path != "live":
                        assert answer.status == 200
                    assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'") or path == "live"
            if status == 403:
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await session.ws_connect(dashboard.url + "live")

    watch(scenario)
    assert ("page: refused 127.0.0.1" in caplog.text) is (status == 403)


def test_without_the_token_nothing_is_seen() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        await dashboard.serving.wait()
        url = dashboard.url
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            for path, status in (("", 401), ("page.js", 404), ("live", 401), ("page.css", 200)):
                async with session.get(url + path) as answer:
                    assert answer.status == status
                    assert "tester" not in await answer.text()
            async with session.post(url + "login", data={"token": "another"}, allow_redirects=False) as answer:
                assert answer.status == 401 and "Set-Cookie" not in answer.headers
            async with session.post(url + "login", data={"token": "x" * 10_000}) as answer:
                assert answer.status == 413
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(url + "live")
            async with session.post(url + "login", data={"token": TOKEN}, allow_redirects=False) as answer:
                assert answer.status == 303
                assert "HttpOnly" in answer.headers["Set-Cookie"] and "SameSite=Strict" in answer.headers["Set-Cookie"]
            async with session.ws_connect(url + "live") as wire:
                assert json.loads((await wire.receive(WITHIN_S)).data)["robot"] == "tester"

    watch(scenario, token=TOKEN)


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"\x00\xff garbage\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n", b"400"),
        (b"GET /" + b"a" * 9000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n", b"400"),
        (b"GET /../config.py HTTP/1.1\r\nHost: localhost\r\n\r\n", b"404"),
        (b"GET /%2e%2e%2fconfig.py HTTP/1.1\r\nHost: localhost\r\n\r\n", b"404"),
        (b"GET /static/page.js HTTP/1.1\r\nHost: localhost\r\n\r\n", b"404"),
        (b"PUT / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n", b"405"),
    ],
)
def test_bad_http_is_answered_and_fills_no_log(
    request_bytes: bytes, status: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        await dashboard.serving.wait()
        reader, writer = await asyncio.open_connection("127.0.0.1", int(dashboard.url.split(":")[2].strip("/")))
        writer.write(request_bytes)
        async with asyncio.timeout(WITHIN_S):
            assert (await reader.readline()).split()[1] == status
        writer.close()
        await writer.wait_closed()

    watch(scenario)
    assert [record for record in caplog.records if record.exc_info] == []


def test_one_page_too_many_is_told_so() -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard), opened(dashboard):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
                async with opened(dashboard):
                    pass
        async with asyncio.timeout(WITHIN_S):
            await turned_away_no_more(dashboard)

    async def turned_away_no_more(dashboard: Dashboard) -> None:
        """The robot notices that pages closed, a moment after they did."""
        while True:
            with contextlib.suppress(aiohttp.WSServerHandshakeError):
                async with opened(dashboard) as page:
                    await page.kind("hello")
                    return

    watch(scenario, viewers_max=2)


def test_a_busy_port_is_named_and_the_robot_drives_on(caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]

        async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
            loop: Any = asyncio.get_running_loop()
            moving = loop.create_future()
            loop.call_at_ns(loop.now_ns() + 5_000_000_000, moving.set_result, None)
            await moving
            assert not dashboard.serving.is_set()
            assert runtime.handle.status()["by"] == "ahead"
            taken.close()
            await dashboard.serving.wait()
            assert str(port) in dashboard.url

        watch(scenario, loop_factory=virtual_loop, virtual=True, port=port)
    complaints = [r for r in caplog.records if "cannot listen on 127.0.0.1" in r.message]
    assert len(complaints) == 1 and complaints[0].levelno == logging.ERROR
    assert "set bridges.dashboard.port" in complaints[0].message


@pytest.mark.parametrize("camera", ["camera_frame", None])
def test_a_picture_is_sent_to_who_looks_at_it(camera: str | None) -> None:
    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as page:
            await page.wire.send_json({"do": "look", "camera": camera})
            await page.ask("ping")
            page.told.clear()
            for _ in range(10):
                await page.kind("beat")
            pictures = [told for told in page.told if isinstance(told, bytes) and told[0] == 2]
            assert bool(pictures) is (camera is not None)

    watch(scenario)


def test_watching_changes_no_command_of_a_simulated_run() -> None:
    def commands(watchers: int) -> list[Any]:
        async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
            loop: Any = asyncio.get_running_loop()
            over = loop.create_future()
            loop.call_at_ns(runtime.started_ns + 6_000_000_000, over.set_result, None)

            async def look() -> None:
                async with opened(dashboard) as page:
                    while True:
                        await page.next()

            lookers = [asyncio.create_task(look()) for _ in range(watchers)]
            await over
            seen.append(dashboard._numbers)
            for looker in lookers:
                looker.cancel()
            await asyncio.gather(*lookers, return_exceptions=True)

        seen: list[int] = []
        run = watch(scenario, loop_factory=lambda: virtual_loop(10.0), virtual=True)
        assert seen == [watchers]
        return [entry for entry in base_of(run).log if entry[0] <= run.started_ns + 6_000_000_000]

    assert commands(2) == commands(0)


def test_a_robot_without_lidar_and_camera_has_a_page_too() -> None:
    parts = watched_robot()

    async def scenario(dashboard: Dashboard, runtime: Runtime) -> None:
        async with opened(dashboard) as page:
            hello = await page.kind("hello")
            assert (hello["scans"], hello["cameras"]) == ([], [])
            assert "not armed" in (await page.kind("status"))["sentence"]

    watch(scenario, replace(parts, devices=parts.devices[:1], behaviours=(), arm_at_start=False))
