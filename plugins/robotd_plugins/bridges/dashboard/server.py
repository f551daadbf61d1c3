"""The page over HTTP and one WebSocket for each viewer; imported by `load()`, because aiohttp is heavy."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import socket
import time
from importlib import resources
from typing import TYPE_CHECKING

from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler

from robotd_plugins.bridges.dashboard.asking import TEXT_BYTES_MAX, Garbage, parse
from robotd_plugins.bridges.dashboard.gate import Gate

if TYPE_CHECKING:
    from robotd_plugins.bridges.dashboard.bridge import Dashboard
    from robotd_plugins.bridges.dashboard.viewer import Viewer

log = logging.getLogger("robotd")
http_log = logging.getLogger("robotd.page")
http_log.addFilter(lambda record: not _is_bad_http(record))

KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
SEND_BUFFER_BYTES = 65536
"""Of the kernel, for each viewer: what lies in there is old by the time that it is read."""
BODY_S = 5.0
HEADERS = {
    # nothing from elsewhere, nothing inline, no frame around us
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with no-referrer, the login form would come with Origin: null
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@functools.cache
def static_files() -> dict[str, tuple[bytes, str]]:
    """Every file of the page by its name, with its content type; read once: serving must not wait for a disk."""
    folder = resources.files("robotd_plugins.bridges.dashboard") / "static"
    return {
        file.name: (file.read_bytes(), KINDS[file.name[file.name.rindex(".") :]])
        for file in folder.iterdir()
        if file.name[file.name.rindex(".") :] in KINDS
    }


def _is_bad_http(record: logging.LogRecord) -> bool:
    """Whether aiohttp complains about what a stranger sent, at length; that is answered with 400 and no news here."""
    error = record.exc_info[1] if record.exc_info else None
    return isinstance(error, HttpProcessingError)


class PageServer:
    """Speaks HTTP for a `Dashboard`: `start`, then `listen` (again after an OSError), at the end `close`."""

    def __init__(self, dashboard: Dashboard, gate: Gate) -> None:
        self._dashboard = dashboard
        self._gate = gate
        self._refusals: set[str] = set()
        app = web.Application(middlewares=[self._guarded], client_max_size=TEXT_BYTES_MAX)
        app.router.add_get("/", self._page)
        app.router.add_get("/live", self._live)
        app.router.add_post("/login", self._login)
        app.router.add_get("/{name}", self._file)
        self._runner = web.AppRunner(
            app, logger=http_log, access_log=None, shutdown_timeout=0.5, keepalive_timeout=30.0
        )

    async def start(self) -> None:
        """Before `listen`."""
        await self._runner.setup()

    async def listen(self, host: str, port: int) -> int:
        """Returns the port, chosen by the system where `port` is 0. Raises OSError where it is not to be had."""
        site = web.TCPSite(self._runner, host, port)
        try:
            await site.start()
        except OSError:
            with contextlib.suppress(RuntimeError):
                await site.stop()
            raise
        return int(self._runner.addresses[0][1])

    async def close(self) -> None:
        """Stop listening and drop every connection."""
        await self._runner.cleanup()

    # ---------------------------------------------------------------------------------------- requests

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        refusal = self._gate.refusal(request.headers.get("Host"), request.headers.get("Origin"))
        if refusal:
            self._say(request, refusal)
            return web.Response(status=403, text=f"refused: {refusal}\n", headers=HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    def _may_see(self, request: web.Request) -> bool:
        return self._gate.is_pass(request.cookies.get(self._cookie(request)))

    def _cookie(self, request: web.Request) -> str:
        # browsers do not tell ports apart: two robots on one machine need two names
        return f"robotd_{request.url.port or 80}"

    async def _page(self, request: web.Request) -> web.Response:
        if not self._may_see(request):
            return self._static("login.html", status=401)
        return self._static("index.html")

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in static_files() or not (self._may_see(request) or name.endswith((".css", ".svg"))):
            raise web.HTTPNotFound(text="no such page\n")
        return self._static(name)

    def _static(self, name: str, status: int = 200) -> web.Response:
        body, kind = static_files()[name]
        return web.Response(body=body, status=status, content_type=kind, charset="utf-8")

    async def _login(self, request: web.Request) -> web.Response:
        try:
            async with asyncio.timeout(BODY_S):
                form = await request.post()
        except TimeoutError:
            raise web.HTTPRequestTimeout from None
        if not self._gate.is_token(str(form.get("token", ""))):
            self._say(request, "wrong token")
            return self._static("login.html", status=401)
        response = web.Response(status=303, headers={"Location": "/"})
        response.set_cookie(self._cookie(request), self._gate.pass_value, httponly=True, samesite="Strict", path="/")
        return response

    def _say(self, request: web.Request, refusal: str) -> None:
        """Each refusal of each address once: a stranger who asks a million times must not fill the disk."""
        said = f"page: refused {request.remote}: {refusal}"
        if said not in self._refusals and len(self._refusals) < 100:
            self._refusals.add(said)
            log.warning("%s", said)

    # -------------------------------------------------------------------------------------------- live

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if not self._may_see(request):
            self._say(request, "the page's connection without its cookie")
            return web.Response(status=401, text="log in first\n")
        if self._dashboard.is_full:
            return web.Response(status=503, text="too many pages are open: bridges.dashboard.viewers_max\n")
        transport = request.transport
        if transport is None:
            raise web.HTTPBadRequest
        raw = transport.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        wire = web.WebSocketResponse(
            max_msg_size=TEXT_BYTES_MAX, compress=False, autoping=False, timeout=0.5, writer_limit=SEND_BUFFER_BYTES
        )
        await wire.prepare(request)
        viewer = self._dashboard.join(request.remote or "?", transport.abort)
        sender = asyncio.create_task(self._send(viewer, wire), name=f"page {viewer.number} sends")
        try:
            why = await self._receive(viewer, wire)
            if why:
                log.warning("%s (%s): %s; hung up", viewer.name, viewer.address, why)
                transport.abort()
        finally:
            self._dashboard.leave(viewer)
            sender.cancel()
        return wire

    async def _receive(self, viewer: Viewer, wire: web.WebSocketResponse) -> str:
        """Until the connection ends; returns what was wrong with it, if anything. Never waits for a send."""
        while True:
            message = await wire.receive()
            if message.type is WSMsgType.ERROR:
                return str(message.data)
            if message.type in (WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED):
                return ""
            if not viewer.hears(time.monotonic()):
                return "sends more than any page does"
            if message.type is WSMsgType.BINARY:
                return "sent binary data"
            if message.type is WSMsgType.TEXT:
                try:
                    self._dashboard.asked(viewer, parse(message.data))
                except Garbage as garbage:
                    return f"sent garbage ({garbage})"

    async def _send(self, viewer: Viewer, wire: web.WebSocketResponse) -> None:
        """Everything that the viewer gets, in one task: it alone waits where the page does not read."""
        with contextlib.suppress(ConnectionError):
            while True:
                await viewer.wake.wait()
                viewer.wake.clear()
                for payload in viewer.take():
                    if isinstance(payload, str):
                        await wire.send_str(payload)
                    else:
                        await wire.send_bytes(payload)
