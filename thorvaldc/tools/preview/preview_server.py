"""The web server of the preview: one page and one socket, on the loopback interface alone.

A page can drive a simulated robot, with the base driver and the physics of ``sim``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import signal
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web
from watchfiles import awatch

from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.plugins import data_folder
from thorvaldc.model.settings import AUTOMATIC
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import FIRST_SHARE, Limits, Request, operate
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.web_viewer import VIEWER, viewer_script
from thorvaldc.tools.preview.compiled_robot import CompiledRobot

HOLD_TIME = 0.25
"""Time in s for which a motion from the page drives.  The page repeats a held motion 20 times per
second."""
GIVE_WAY = 0.1
"""Time in s for which the page commands zero after the robot was driven."""
PICTURE_PERIOD = 1 / 30
"""Time in s between two states for the page."""
SOURCE = "teleop_joy"

Send = Callable[[dict[str, Any]], None]


class PageOperator:
    """An operator who drives with a page.  The robot stops if the page sends no motions."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.share = FIRST_SHARE
        self.message = ""
        self.finished = False
        self._motion = (0.0, 0.0, 0.0)
        self._received = -math.inf

    def move(self, x: float, y: float, yaw: float, now: float) -> None:
        """Stores a motion: fractions of the top speeds, between -1 and 1."""
        if all(math.isfinite(value) for value in (x, y, yaw)):
            self._motion = (_clamped(x), _clamped(y), _clamped(yaw))
            self._received = now

    def poll(self, now: float) -> list[Request]:
        return []

    def twist(self, now: float) -> Twist | None:
        age = now - self._received
        if age <= HOLD_TIME and not self.finished:
            return self.limits.twist(*self._motion, self.share)
        return ZERO_TWIST if age <= HOLD_TIME + GIVE_WAY else None

    def close(self) -> None:
        self.finished = True


def _clamped(value: float) -> float:
    return min(max(value, -1.0), 1.0)


class PageDrive:
    """A simulated robot in a thread of its own.

    The other robots of a fleet stand in the scene.  ``send`` is called in the thread: with the
    states of the robots, and once at the end.
    """

    def __init__(self, model: Robot | Fleet, name: str, send: Send) -> None:
        """Drives the robot ``name`` of the model, or its first robot without such a robot."""
        robots = (
            {placed.name: placed.robot for placed in model.placements}
            if isinstance(model, Fleet)
            else {model.name: model}
        )
        self._name = name if name in robots else next(iter(robots))
        self._model, self._robots, self._send = model, robots, send
        self._operator: PageOperator | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="drive", daemon=True)
        self._thread.start()

    def move(self, x: float, y: float, yaw: float) -> None:
        """Drives for ``HOLD_TIME``."""
        if self._operator is not None:
            self._operator.move(x, y, yaw, time.monotonic())

    def close(self) -> None:
        """Stops the robot and ends the simulation."""
        self._ended.set()

    def join(self) -> None:
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        text = ""
        try:
            robot = self._robots[self._name]
            scene = MujocoScene(emit(self._model, ["mjcf"]))
            vehicle = _ShownRobot(robot, scene, self._name, self._robots, self._send)
            try:
                description = vehicle.call("description")
                self._operator = PageOperator(Limits.of(description))
                self._send({"kind": "drive", "on": True, "message": "ready"})
                sources = description["sources"]
                source = SOURCE if SOURCE in sources else next(iter(sources))
                operate(vehicle, self._operator, source, lambda lines: None, self._ended.is_set)
            finally:
                vehicle.shutdown()
        except Exception as error:  # the page shows what ended the simulation
            text = f"the simulation ended: {error}"
        self._send({"kind": "drive", "on": False, "message": text})


class _ShownRobot(DrivenRobot):
    """A simulated robot that sends its state, and the poses of all robots, to the page."""

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        name: str,
        robots: Mapping[str, Robot],
        send: Send,
    ) -> None:
        super().__init__(robot, MujocoBase(robot, scene), arming=AUTOMATIC)
        self._scene, self._name, self._send = scene, name, send
        self._bodies = {
            name: scene.index("body", other.prefix + other.links[0].name, other)
            for name, other in robots.items()
        }
        self._joints = [
            (joint.name, int(scene.model.jnt_qposadr[index]))
            for joint in robot.joints
            if joint.type != "fixed" and joint.mimic is None
            for index in [scene.index("joint", robot.prefix + joint.name, robot)]
        ]
        self._shown = -math.inf

    def step(self) -> None:
        super().step()
        if self.now - self._shown < PICTURE_PERIOD:
            return
        self._shown = self.now
        data = self._scene.data
        twist = self.call("state")["in_force"]
        self._send(
            {
                "kind": "state",
                "robot": self._name,
                "poses": {
                    name: [*data.xpos[body].tolist(), *data.xquat[body].tolist()]
                    for name, body in self._bodies.items()
                },
                "joints": {name: float(data.qpos[index]) for name, index in self._joints},
                "twist": twist,
            }
        )


HOST = "127.0.0.1"
DEBOUNCE = 10
"""Time in ms for which changes of files are collected."""
CHECK_PERIOD = 1000
"""Time in ms after which the files are compared, for file systems that report no changes."""
DRAW_TIME = 0.5
"""Longest time in s that the facts wait for the picture.  A hidden page draws none."""
MAX_MESSAGE = 4096
"""Largest message in bytes from a page."""
TIMINGS = 200
"""Number of pictures whose times a server keeps."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline';"
    " style-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'; base-uri 'none';"
    " form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


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
        self.timings: list[dict[str, float]] = []
        self._clients: set[_Client] = set()
        self._drives: set[PageDrive] = set()
        self._details: dict[str, Any] = {}
        self._drawn = asyncio.Event()
        template = data_folder("templates") / "preview" / "page.html"
        page = template.read_text(encoding="utf-8")
        self._page = page.replace(VIEWER, viewer_script(), 1)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.port}/{self.token}/"

    async def run(self, port: int, started: Callable[[], None]) -> None:
        """Serves the page until the process is interrupted.

        ``port`` is the TCP port, or 0 for any free one.  Raises ``OSError`` if the port is in use.
        """
        listener = socket.create_server((HOST, port))
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
            for drive in tuple(self._drives):
                await asyncio.to_thread(drive.join)
            await runner.cleanup()

    # -- requests ------------------------------------------------------------------------------

    @web.middleware
    async def _guard(
        self,
        request: web.Request,
        handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    ) -> web.StreamResponse:
        """Refuses other hosts and origins, so that no page of the internet reaches the server."""
        hosts = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        origin = request.headers.get("Origin")
        if request.headers.get("Host") not in hosts:
            raise web.HTTPForbidden(text="the host is not this computer")
        if origin is not None and origin.removeprefix("http://") not in hosts:
            raise web.HTTPForbidden(text="the page comes from another server")
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
                times = {str(name): float(value) for name, value in message["times"].items()}
                self._drawn.set()
                self.timings = [*self.timings[1 - TIMINGS :], times]
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
                    self._drives.discard(drive)
                    client.drive = None
                client.send_soon(message)

            def send(message: dict[str, Any]) -> None:  # in the thread of the robot
                with contextlib.suppress(RuntimeError):  # the server has ended
                    loop.call_soon_threadsafe(deliver, message)

            drive = client.drive = PageDrive(model, robot, send)
            self._drives.add(drive)

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
                raise_interrupt=False,
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
