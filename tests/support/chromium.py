"""A headless Chromium for tests of the page: started, asked over the DevTools protocol, ended.

Speaks the few commands of https://chromedevtools.github.io/devtools-protocol/ that the tests need, over aiohttp.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

SWITCHES = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--mute-audio",
    "--remote-debugging-port=0",
)


class PageError(AssertionError):
    """The page threw, or did not do in time what it was waited for."""


class Navigated(PageError):
    """The page went elsewhere before it answered."""


class Tab:
    """One open page. `complaints`: errors and warnings of its console, and exceptions that nobody caught."""

    def __init__(self, wire: aiohttp.ClientWebSocketResponse) -> None:
        self.complaints: list[str] = []
        self._wire = wire
        self._next = 0
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._reader = asyncio.create_task(self._read())

    async def close(self) -> None:
        self._reader.cancel()
        await self._wire.close()

    async def ask(self, method: str, **params: Any) -> Any:
        """One command of the protocol; returns its result."""
        self._next += 1
        answer = self._waiting[self._next] = asyncio.get_running_loop().create_future()
        await self._wire.send_json({"id": self._next, "method": method, "params": params})
        return await answer

    async def run(self, script: str) -> Any:
        """Evaluate JavaScript, awaiting promises; returns its value. Raises PageError where it throws."""
        told = await self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in told:
            raise PageError(f"{script}: {told['exceptionDetails'].get('exception', {}).get('description')}")
        return told["result"].get("value")

    async def until(self, condition: str, within_s: float = 10.0) -> None:
        """Wait in the page until a JavaScript expression is true, through reloads. One that throws is not true yet."""
        script = f"""new Promise((resolve) => {{
            const look = () => {{
                let good = false;
                try {{ good = {condition}; }} catch {{}}
                if (good) resolve(true); else setTimeout(look, 20);
            }};
            look(); }})"""
        try:
            async with asyncio.timeout(within_s):
                while True:
                    try:
                        await self.run(script)
                        return
                    except Navigated:
                        continue
        except TimeoutError:
            text = await self.run("document.body.innerText")
            raise PageError(f"not within {within_s:g} s: {condition}\n{text}\n{self.complaints}") from None

    async def click(self, selector: str) -> None:
        """Press and release the mouse in the middle of an element, as a person does, who first sees the page drawn."""
        await self.until("document.readyState === 'complete'")
        # a click before the first picture is thrown away, one before the last style sheet may go beside the element
        await self.run("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        found = f"document.querySelector({json.dumps(selector)})"
        await self.run(f"{found}.scrollIntoView({{block: 'center'}})")
        box = await self.run(f"(({{x, y, width, height}}) => [x, y, width, height])({found}.getBoundingClientRect())")
        x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
        for kind in ("mousePressed", "mouseReleased"):
            await self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    async def press(self, key: str, code: str, text: str = "") -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            await self.ask(
                "Input.dispatchKeyEvent", type=kind, key=key, code=code, text=text if kind == "keyDown" else ""
            )

    async def size(
        self, width: int, height: int, *, scale: float = 1.0, phone: bool = False, dark: bool = False
    ) -> None:
        await self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        await self.ask("Emulation.setEmulatedMedia", features=[scheme])

    async def screenshot(self) -> bytes:
        """What the window shows now, as PNG."""
        shot = await self.ask("Page.captureScreenshot", format="png")
        return base64.b64decode(shot["data"])

    async def _read(self) -> None:
        async for message in self._wire:
            told = json.loads(message.data)
            if "id" in told:
                waiting = self._waiting.pop(told["id"])
                if waiting.done():
                    continue
                if "error" in told:
                    kind = Navigated if "navigated" in told["error"]["message"] else PageError
                    waiting.set_exception(kind(told["error"]["message"]))
                else:
                    waiting.set_result(told["result"])
            elif told["method"] == "Runtime.exceptionThrown":
                details = told["params"]["exceptionDetails"]
                self.complaints.append(details.get("exception", {}).get("description", details["text"]))
            elif told["method"] == "Log.entryAdded" and told["params"]["entry"]["level"] in ("error", "warning"):
                self.complaints.append(told["params"]["entry"]["text"])
            elif told["method"] == "Runtime.consoleAPICalled" and told["params"]["type"] in ("error", "warning"):
                self.complaints.append(str(told["params"]["args"]))


class Browser:
    def __init__(self, session: aiohttp.ClientSession, root: str) -> None:
        self._session = session
        self._root = root

    @contextlib.asynccontextmanager
    async def open(self, url: str) -> AsyncIterator[Tab]:
        """A new tab at `url`."""
        async with self._session.put(f"{self._root}/json/new?about:blank") as answer:
            where = (await answer.json())["webSocketDebuggerUrl"]
        tab = Tab(await self._session.ws_connect(where, max_msg_size=0))
        try:
            for domain in ("Runtime", "Log", "Page"):
                await tab.ask(f"{domain}.enable")
            await tab.ask("Page.navigate", url=url)
            yield tab
        finally:
            await tab.close()


@contextlib.asynccontextmanager
async def browser(program: str, folder: Path) -> AsyncIterator[Browser]:
    """A Chromium with a profile in `folder`, ended with the block."""
    process = await asyncio.create_subprocess_exec(
        program,
        *SWITCHES,
        f"--user-data-dir={folder / 'profile'}",
        "about:blank",
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    drain = None
    try:
        async with asyncio.timeout(60):
            async for line in process.stderr:
                if line.startswith(b"DevTools listening on ws://"):
                    root = "http://" + line.decode().split("ws://")[1].split("/")[0]
                    break
            else:
                raise PageError("chromium ended before it listened")
        drain = asyncio.create_task(process.stderr.read())
        async with aiohttp.ClientSession() as session:
            yield Browser(session, root)
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        await process.wait()
        if drain is not None:
            await drain
