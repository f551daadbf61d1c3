"""The page in a real browser: it shows the robot, stops it, never looks live when it is not. Screenshots in tmp."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from chromium import Tab, browser
from small_robot import FakeBase
from watched import watch

from robotd.engine.runtime import Runtime
from robotd_plugins.bridges.dashboard import Dashboard

LIVE = "document.body.dataset.link === 'live'"
MODE = "document.body.dataset.mode === '{}'"
INK = """(() => {{ const drawn = document.getElementById('{}');
    const pen = new OffscreenCanvas(drawn.width, drawn.height).getContext('2d', {{ willReadFrequently: true }});
    pen.drawImage(drawn, 0, 0);
    const data = pen.getImageData(0, 0, drawn.width, drawn.height).data;
    const seen = new Set(); for (let i = 0; i < data.length; i += 4 * 61) seen.add(data.slice(i, i + 4).join());
    return seen.size; }})()"""
"""How many colours a canvas holds, looked at in every 61st pixel."""
INSIDE = """(() => {{ const b = document.querySelector('{}').getBoundingClientRect();
    return b.width > 0 && b.top >= 0 && b.left >= 0 && b.bottom <= innerHeight && b.right <= innerWidth; }})()"""


@pytest.fixture
def in_browser(program: Any, tmp_path: Path) -> Callable[..., None]:
    """Runs `scenario(tab, dashboard, runtime)` with the page open; `may_complain`: the console need not stay empty."""
    chromium = program("chromium")

    def run(scenario: Any, *, may_complain: bool = False, **config: Any) -> None:
        async def watched(dashboard: Dashboard, runtime: Runtime) -> None:
            await dashboard.serving.wait()
            async with browser(chromium, tmp_path) as started, started.open(dashboard.url) as tab:
                await scenario(tab, dashboard, runtime)
                assert may_complain or tab.complaints == []

        watch(watched, **config)

    return run


async def keep(tab: Tab, path: Path) -> None:
    shot = await tab.screenshot()
    await asyncio.to_thread(path.write_bytes, shot)


def halted(runtime: Runtime) -> bool:
    base = next(kept.device for kept in runtime.devices if kept.name == "base")
    assert isinstance(base, FakeBase)
    return base.log[-1][1] == "halt"


def test_it_shows_the_robot_and_stops_it(in_browser: Callable[..., None], tmp_path: Path) -> None:
    async def scenario(tab: Tab, dashboard: Dashboard, runtime: Runtime) -> None:
        await tab.size(1280, 800)
        await tab.until(LIVE)
        await tab.until("document.getElementById('sentence').textContent === 'driving: ahead (AHEAD)'")
        await tab.until("document.getElementById('behaviours').textContent.includes('gap 1.50 m')")
        await tab.until(f"{INK.format('scan')} > 3 && {INK.format('camera')} > 3")
        assert await tab.run("document.title") == "tester · robotd"
        assert await tab.run("document.querySelectorAll('#streams tr').length") == 2
        assert await tab.run(INSIDE.format("#estop"))
        await keep(tab, tmp_path / "desk.png")

        await tab.click("#estop")
        await tab.until(MODE.format("estop"))
        assert halted(runtime)
        await tab.ask("Page.reload")
        await tab.until(f"{LIVE} && {MODE.format('estop')}")
        sentence = await tab.run("document.getElementById('sentence').textContent")
        assert sentence == "standing still because e-stop by page 1; reset it, then arm"
        await tab.until("document.getElementById('events').textContent.includes('e-stop by page 1')")

        await tab.click("#reset")
        await tab.until(MODE.format("disarmed"))
        await tab.run("document.getElementById('arm').focus()")
        await tab.press("Enter", "Enter", "\r")
        await tab.until(MODE.format("auto"))
        await tab.run("document.getElementById('pause').focus()")
        await tab.press(" ", "Space", " ")  # on a focused button, too, the space bar is the e-stop
        await tab.until(MODE.format("estop"))
        assert halted(runtime)

        await tab.size(390, 844, scale=2, phone=True, dark=True)
        await tab.until("innerWidth === 390")
        assert await tab.run("document.documentElement.scrollWidth") == 390
        assert await tab.run(INSIDE.format("#estop")) and await tab.run(INSIDE.format("#sentence"))
        await keep(tab, tmp_path / "phone.png")

    in_browser(scenario)


def test_without_connection_it_says_so_and_keeps_the_e_stop(
    in_browser: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shut = [False]
    monkeypatch.setattr(Dashboard, "is_full", property(lambda self: shut[0]))

    async def scenario(tab: Tab, dashboard: Dashboard, runtime: Runtime) -> None:
        await tab.until(f"{LIVE} && {MODE.format('auto')}")
        shut[0] = True
        for hang_up in list(dashboard._viewers.values()):
            hang_up()
        await tab.until("document.body.dataset.link === 'lost' && !document.getElementById('lost').hidden")
        await tab.until("document.getElementById('mode').textContent === 'unknown'")
        assert "not known" in await tab.run("document.getElementById('sentence').textContent")
        assert await tab.run("[...document.querySelectorAll('#acts button')].every((b) => b.disabled)")
        await tab.press(" ", "Space", " ")
        await tab.until("document.getElementById('said').textContent.includes('NOT DELIVERED')")
        await tab.until("document.getElementById('lost').textContent.includes('E-STOP WAITS')")
        await keep(tab, tmp_path / "lost.png")
        assert not halted(runtime)
        shut[0] = False
        await tab.until(f"{LIVE} && {MODE.format('estop')}")
        assert halted(runtime)

    in_browser(scenario, may_complain=True)


def test_a_token_is_asked_for_and_nothing_shown_without(in_browser: Callable[..., None]) -> None:
    async def scenario(tab: Tab, dashboard: Dashboard, runtime: Runtime) -> None:
        async def log_in(token: str) -> None:
            await tab.until("document.getElementById('token') !== null")
            await tab.run(f"document.getElementById('token').value = '{token}'; document.forms[0].dataset.sent = 1")
            await tab.click("button")
            await tab.until("document.readyState === 'complete' && !document.forms[0]?.dataset.sent")

        await log_in("some other token here")
        assert "tester" not in await tab.run("document.documentElement.outerHTML")
        await log_in("a token of some length")
        await tab.until(LIVE)
        assert await tab.run("document.cookie") == ""

    in_browser(scenario, may_complain=True, token="a token of some length")
