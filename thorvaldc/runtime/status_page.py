"""A page on this computer that shows a running driver, with a button that stops the robot.

A process of its own serves the page, as a client of the control channel: a thread would make the
control cycle wait for the lock of the Python interpreter.  The page cannot arm or drive; the button
calls the service ``safety_stop``.  Whoever can open ports of this computer can read and stop.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import timedelta
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics.report import UnknownCode, explain
from thorvaldc.model.facts.fact_page import escape, page
from thorvaldc.runtime.control_channel import ControlClient
from thorvaldc.runtime.loopback import HEADERS, HOST, refusal
from thorvaldc.runtime.pace import END_SIGNALS
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.runtime.state_text import state_rows

MOST_THREADS = 16
"""Connections beyond are closed, since those of the control channel are few, too."""
_PROGRAM = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from thorvaldc.runtime.status_page import serve; serve(int(sys.argv[2]), sys.argv[3])"
)
_STYLE = """\
#stop { font: inherit; font-size: 1.4rem; font-weight: 700; padding: .7rem 1.6rem; border: 0;
  border-radius: .4rem; color: #fff; background: #b00020; cursor: pointer; }
#stop:focus-visible { outline: 3px solid var(--ink); outline-offset: 3px; }
[role=alert], .fault td, table.list .fault th { color: var(--fault); font-weight: 600; }
table.list th { width: 7.5rem; }
.old { opacity: .45; }
pre { white-space: pre-wrap; }
:root { --fault: #b00020; color-scheme: light dark; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e9ed; --soft: #a9b2bd; --rule: #3a424c; --accent: #6cc78f; --fault: #ff8a94; }
  body { background: #15191e; } a { color: #8ab8ff; }
}
"""


@contextlib.contextmanager
def status_page(listener: socket.socket, channel: str) -> Iterator[None]:
    """Serves the page of the driver with the control channel ``channel`` at a listening socket.

    The process ends with the ``with`` block, and with this process.
    """
    number = listener.fileno()
    command = [sys.executable, "-P", "-c", _PROGRAM, json.dumps(sys.path), str(number), channel]
    with (
        listener,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, pass_fds=[number]
        ) as process,
    ):
        listener.close()
        try:
            yield
        finally:
            process.kill()


def serve(number: int, channel: str) -> None:
    """Serves at the file descriptor ``number`` until the standard input ends."""
    for each in END_SIGNALS:  # the page shows how the driver ends
        signal.signal(each, signal.SIG_IGN)
    with contextlib.suppress(
        AttributeError, OSError
    ):  # the driver's policy may be one in real time
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.nice(10)
    server = _Server(socket.socket(fileno=number), channel)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.buffer.read()


class _Server(ThreadingHTTPServer):
    def __init__(self, listener: socket.socket, channel: str) -> None:
        super().__init__((HOST, 0), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.server_port = listener, listener.getsockname()[1]
        self.channel = channel
        self.token = secrets.token_urlsafe(24)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return threading.active_count() < MOST_THREADS

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # a browser that ends is no error
            super().handle_error(request, client_address)

    def call(self, service: str) -> Any:
        with contextlib.closing(ControlClient(self.channel)) as client:
            return client.call(service)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 5.0

    def log_message(self, format: str, *args: Any) -> None:
        return

    def do_GET(self) -> None:
        if not self._refuses():
            try:
                self._send(*self._content(self.path))
            except UnknownCode:
                self._send("there is no such page", HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        if self._refuses():
            return
        token = self.headers.get("X-Token", "")
        if self.path != "/stop":
            self._send("there is no such page", HTTPStatus.NOT_FOUND)
        elif not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._send("this page is of an earlier run: load it again", HTTPStatus.FORBIDDEN)
        else:
            try:
                self.server.call("safety_stop")
            except (OSError, ServiceError) as error:
                self._send(str(error), HTTPStatus.SERVICE_UNAVAILABLE)
                return
            release = f"`thorvaldc call {self.server.channel} release_safety_stop force=true`"
            self._send(f"The safety stop is engaged; {release} releases it.")

    def _refuses(self) -> bool:
        headers, port = self.headers, self.server.server_port
        reason = refusal(headers.get("Host"), headers.get("Origin"), port)
        if reason:
            self._send(reason, HTTPStatus.FORBIDDEN)
        return bool(reason)

    def _content(self, path: str) -> tuple[str, HTTPStatus, str]:
        """Returns text, status and type of a page.  Raises ``UnknownCode`` without such a page."""
        name = self.server.channel
        if path == "/":
            text = Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
            main = text.replace("TOKEN", self.server.token)
            about = "The running base driver. This page does not arm or drive the robot."
            return page(name, name, about, main, _STYLE), HTTPStatus.OK, "text/html"
        if path == "/state":
            try:
                values = _values(self.server.call("state"))
            except (OSError, ServiceError) as error:
                values = {"error": str(error)}
            return json.dumps(values), HTTPStatus.OK, "application/json"
        if not path.startswith("/explain/"):
            raise UnknownCode(path, "")
        code = path.removeprefix("/explain/")
        text = f"<pre>{escape(explain(code))}</pre>"
        return page(code, code, "", text, _STYLE), HTTPStatus.OK, "text/html"

    def _send(
        self, text: str, status: HTTPStatus = HTTPStatus.OK, kind: str = "text/plain"
    ) -> None:
        data = text.encode()
        self.send_response(status)
        headers = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(data))}
        for key, value in (HEADERS | headers).items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(data)


def _values(state: dict[str, Any]) -> dict[str, Any]:
    """Returns what the page shows of the result of the service ``state``."""
    rows = [
        *state_rows(state),
        ("time since start", str(timedelta(seconds=int(state["uptime"])))),
        ("age of the data", "unknown" if state["age"] is None else f"{state['age']:.2f} s"),
    ]
    wheels = [
        (name, _text(joints, "speed", 1.0), _text(joints, "angle", 180.0 / math.pi))
        for name, joints in state["joints"].items()
    ]
    return {"robot": state["robot"], "code": state["fault_code"], "rows": rows, "wheels": wheels}


def _text(joints: dict[str, float | None], name: str, factor: float) -> str:
    if name not in joints:
        return ""
    value = joints[name]
    return "no report" if value is None else f"{factor * value:+z.2f}"
