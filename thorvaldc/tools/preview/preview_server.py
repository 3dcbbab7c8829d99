"""The web server of the preview: one page and one socket, on the loopback interface alone.

A page can drive a simulated robot, with the base driver and the physics of ``sim``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import signal
import threading
from collections.abc import Awaitable, Callable
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web
from watchfiles import awatch

from thorvaldc.diagnostics.files import read_json
from thorvaldc.model.plugins import data_folder
from thorvaldc.runtime.loopback import HEADERS, HOST, listen, refusal
from thorvaldc.tools.preview.compiled_robot import CompiledRobot, robot_page
from thorvaldc.tools.preview.page_drive import PageDrive

DEBOUNCE = 10
"""Time in ms for which changes of files are collected."""
CHECK_PERIOD = 1000
"""Time in ms after which the files are compared, for file systems that report no changes."""
DRAW_TIME = 0.5
"""Longest time in s that the facts wait for the picture.  A hidden page draws none."""
MAX_MESSAGE = 4096
"""Largest message in bytes from a page."""


class _Client:
    """A page that is connected."""

    def __init__(self, connection: web.WebSocketResponse) -> None:
        self.connection = connection
        self.known: set[str] = set()
        self.drive: PageDrive | None = None
        self._sending: set[asyncio.Task[None]] = set()

    def send_soon(self, message: dict[str, Any]) -> None:
        """Sends a message.  States of the robot are left out while the page is slow."""
        if message["kind"] == "state" and self._sending:
            return
        task = asyncio.ensure_future(self.send(message))
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)

    async def send(self, message: dict[str, Any]) -> None:
        with contextlib.suppress(ConnectionError, RuntimeError):  # the page was closed
            await self.connection.send_str(json.dumps(message, separators=(",", ":")))

    def stop(self) -> None:
        """Stops the robot that the page drives."""
        if self.drive is not None:
            self.drive.close()


class PreviewServer:
    """Serves the page of a robot, and compiles the robot again when its files change."""

    def __init__(self, compiled: CompiledRobot) -> None:
        self.compiled = compiled
        self.token = secrets.token_urlsafe(24)
        self.port = 0
        self._clients: set[_Client] = set()
        self._drives: dict[PageDrive, threading.Thread] = {}
        self._details: dict[str, Any] = {}
        self._drawn = asyncio.Event()
        folder = data_folder("templates") / "preview"
        host = (folder / "socket.js").read_text(encoding="utf-8")
        self._page = robot_page(host)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.port}/{self.token}/"

    async def run(self, port: int, started: Callable[[], None]) -> None:
        """Serves the page until the process is interrupted.

        ``port`` is the TCP port, or 0 for any free one.  Raises ``OutsideError`` if it is in use.
        """
        listener = listen(port, "--port")
        self.port = listener.getsockname()[1]
        application = web.Application(middlewares=[self._guard])
        application.router.add_get(f"/{self.token}/", self._show_page)
        application.router.add_get(f"/{self.token}/socket", self._serve_socket)
        runner = web.AppRunner(application, access_log=None, shutdown_timeout=1.0)
        end = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(NotImplementedError):  # Windows: asyncio ends this task
                loop.add_signal_handler(number, end.set)
        await runner.setup()
        tasks = []
        try:
            await web.SockSite(runner, listener).start()
            await asyncio.to_thread(self._compile)
            tasks = [asyncio.create_task(self._watch(end)), asyncio.create_task(end.wait())]
            started()
            finished, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in finished:
                task.result()
        finally:
            end.set()
            await asyncio.gather(*tasks, return_exceptions=True)
            for client in tuple(self._clients):
                client.stop()
                await client.connection.close(code=WSCloseCode.GOING_AWAY)
            for thread in tuple(self._drives.values()):
                await asyncio.to_thread(thread.join, 5.0)
            await runner.cleanup()

    # -- requests ------------------------------------------------------------------------------

    @web.middleware
    async def _guard(
        self,
        request: web.Request,
        handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    ) -> web.StreamResponse:
        """Refuses other hosts and origins, so that no page of the internet reaches the server."""
        headers = request.headers
        if reason := refusal(headers.get("Host"), headers.get("Origin"), self.port):
            raise web.HTTPForbidden(text=reason)
        first = request.path.removeprefix("/").split("/", 1)[0]
        if not secrets.compare_digest(first.encode(), self.token.encode()):
            raise web.HTTPForbidden(
                text="open the whole address that the command printed: its key is new at each start"
            )
        return await handler(request)

    async def _show_page(self, request: web.Request) -> web.Response:
        return web.Response(text=self._page, content_type="text/html", headers=HEADERS)

    async def _serve_socket(self, request: web.Request) -> web.WebSocketResponse:
        if request.headers.get("Origin") is None:  # each browser sends it with a socket
            raise web.HTTPForbidden(text="the socket needs an origin")
        connection = web.WebSocketResponse(heartbeat=2.0, max_msg_size=MAX_MESSAGE, compress=False)
        await connection.prepare(request)
        client = _Client(connection)
        await client.send(self.compiled.message(client.known))
        if self._details:
            await client.send(self._details)
        self._clients.add(client)
        try:
            async for message in connection:
                if message.type is WSMsgType.TEXT:
                    self._receive(client, message.data)
        finally:
            client.stop()
            self._clients.discard(client)
        return connection

    def _receive(self, client: _Client, text: str) -> None:
        try:
            message = read_json(text)
            kind = message["kind"]
            if kind == "motion" and client.drive is not None:
                client.drive.move(*(float(message[name]) for name in ("x", "y", "yaw")))
            elif kind == "drive":
                self._switch(client, message["on"] is True, str(message.get("robot", "")))
            elif kind == "drawn":
                self._drawn.set()
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
            return  # no message of the page

    def _switch(self, client: _Client, on: bool, robot: str) -> None:
        model = self.compiled.model
        if not on:
            client.stop()
        elif client.drive is None and model is not None:
            loop = asyncio.get_running_loop()
            drive: PageDrive | None = None

            def deliver(message: dict[str, Any]) -> None:  # in the event loop
                if message["kind"] == "drive" and not message["on"] and drive is not None:
                    self._drives.pop(drive, None)
                    client.drive = None
                client.send_soon(message)

            def send(message: dict[str, Any]) -> None:  # in the thread of the robot
                with contextlib.suppress(RuntimeError):  # the server has ended
                    loop.call_soon_threadsafe(deliver, message)

            drive = client.drive = PageDrive(model, robot, send)
            thread = threading.Thread(target=drive.run, name="drive", daemon=True)
            self._drives[drive] = thread
            thread.start()

    # -- changes of files ----------------------------------------------------------------------

    def _compile(self) -> None:
        self.compiled.compile()
        if self.compiled.is_good:
            self._details = {}

    async def _watch(self, end: asyncio.Event) -> None:
        await self._describe()
        while not end.is_set():
            folders = self.compiled.folders
            changes = awatch(
                *folders,
                watch_filter=None,
                debounce=DEBOUNCE,
                step=5,
                stop_event=end,
                rust_timeout=CHECK_PERIOD,
                yield_on_timeout=True,
                recursive=False,
            )
            async with contextlib.aclosing(changes):
                async for _ in changes:
                    if self.compiled.has_changed():
                        await self._update()
                    if self.compiled.folders != folders:
                        break

    async def _update(self) -> None:
        await asyncio.to_thread(self._compile)
        self._drawn.clear()
        for client in tuple(self._clients):
            if self.compiled.is_good:
                client.stop()  # the robot that it drives is an old one
            await client.send(self.compiled.message(client.known))
        if self._clients:
            # The facts take longer than the compilation and would slow the picture down.
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._drawn.wait(), DRAW_TIME)
        await self._describe()

    async def _describe(self) -> None:
        if not self.compiled.is_good:
            return
        self._details = await asyncio.to_thread(self.compiled.details)
        for client in tuple(self._clients):
            await client.send(self._details)
