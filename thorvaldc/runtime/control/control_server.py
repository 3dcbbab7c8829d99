"""Server of the control channel, which answers the requests of other programs between two control
cycles.

    client                                                  server, once in a cycle
    {"call": "twist", "arguments": {...}, "id": 7}   --->   reads what has come,
                                                            runs the services,
                                                     <---   {"ok": true, "result": null, "id": 7}

The constants of this module limit the length of lines, the number of requests and the unsent
answers for each client.  Without the limits, a client could delay a control cycle with long lines,
too many requests or unread answers.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
from pathlib import Path
from typing import Any

from thorvaldc.can.local_socket import remove_stale_socket, socket_path
from thorvaldc.runtime.control.service_table import ServiceError, Services

LONGEST_LINE = 65536
"""Largest length of a request, in bytes."""
MOST_CLIENTS = 32
MOST_REQUESTS = 100
"""Largest number of requests of one client in a cycle; more requests wait for the next cycle."""
LONGEST_BACKLOG = 1 << 20
"""Size of unread answers (bytes) above which the server closes the connection of a client."""


def control_path(name: str) -> Path:
    """Returns the path of the control socket of the base driver ``name``.

    A driver name that contains a slash is used as the path of the socket.  Raises ``OSError`` if
    the path cannot be used for a local socket.
    """
    return socket_path(name if "/" in name else f"{name}-control")


class _Client:
    """Connection to a client of the control channel, with received bytes and unsent answers."""

    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self.unread = b""
        self.out = bytearray()
        self.ended = False


class ControlServer:
    """Server for programs that command a robot over a local socket.

    A service request is a line ``{"call": NAME, "arguments": {...}}``.  The answer of the server is
    a line ``{"ok": true, "result": ...}`` or ``{"ok": false, "error": "one line"}``.  If the
    service request has an ``id``, the answer has the same ``id``.  Only programs of the same user
    can connect to the control channel.
    """

    def __init__(self, name: str, services: Services) -> None:
        """Creates the control socket of the base driver ``name``.

        Raises ``OSError`` if a base driver with the same name already runs.
        """
        self.path = control_path(name)
        self.services = services
        self._clients: list[_Client] = []
        remove_stale_socket(self.path, "a driver")
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        mask = os.umask(0o177)
        try:
            self._listener.bind(str(self.path))
        except OSError as error:
            self._listener.close()
            raise OSError(f"{self.path}: {error.strerror or error}") from None
        finally:
            os.umask(mask)
        self._inode = self.path.stat().st_ino
        self._listener.listen()
        self._listener.setblocking(False)

    def poll(self, now: float) -> None:
        """Accepts new clients and answers all received requests, without waiting.

        ``now``: time (s) on the clock of the base driver.
        """
        if self._ready(self._listener):
            self._accept()
        for client in list(self._clients):
            try:
                self._serve(client, now)
            except OSError:  # the client has ended, perhaps in the middle of a line
                self._drop(client)

    def close(self) -> None:
        """Closes all client connections and removes the socket file."""
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
        # The socket file is not removed if another base driver has created a socket at the same
        # path.
        with contextlib.suppress(OSError):
            if self.path.stat().st_ino == self._inode:
                self.path.unlink()

    # -- inside --------------------------------------------------------------------------------

    @staticmethod
    def _ready(stream: socket.socket) -> bool:
        return bool(select.select([stream], [], [], 0.0)[0])

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            stream, _ = self._listener.accept()
            if len(self._clients) >= MOST_CLIENTS:
                stream.close()
                return
            stream.setblocking(False)
            self._clients.append(_Client(stream))

    def _serve(self, client: _Client, now: float) -> None:
        if not client.ended and len(client.unread) <= LONGEST_LINE:
            with contextlib.suppress(BlockingIOError):
                data = client.stream.recv(LONGEST_LINE)
                client.ended = not data
                client.unread += data
        requests = 0
        while requests < MOST_REQUESTS and b"\n" in client.unread:
            line, _, client.unread = client.unread.partition(b"\n")
            client.out += _line(self._answer(line, now))
            requests += 1
        if len(client.unread) > LONGEST_LINE and b"\n" not in client.unread:
            client.out += _line(_refusal(f"a request is longer than {LONGEST_LINE} bytes"))
            client.unread, client.ended = b"", True
        if client.out:
            with contextlib.suppress(BlockingIOError):
                sent = client.stream.send(client.out)
                del client.out[:sent]
        if len(client.out) > LONGEST_BACKLOG or (client.ended and b"\n" not in client.unread):
            self._drop(client)

    def _answer(self, line: bytes, now: float) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal("the request is not JSON")
        if not isinstance(request, dict):
            return _refusal('the request is not a mapping, such as {"call": "state"}')
        answer = self._call(request, now)
        if "id" in request:
            answer["id"] = request["id"]
        return answer

    def _call(self, request: dict[str, Any], now: float) -> dict[str, Any]:
        name, arguments = request.get("call"), request.get("arguments", {})
        if not isinstance(name, str):
            return _refusal('the request names no service, such as {"call": "state"}')
        if not isinstance(arguments, dict):
            return _refusal("`arguments` is not a mapping")
        unknown = [key for key in request if key not in ("call", "arguments", "id")]
        if unknown:
            return _refusal(
                f"a request has no key `{unknown[0]}`; its keys are call, arguments and id"
            )
        try:
            return {"ok": True, "result": self.services.call(name, arguments, now)}
        except ServiceError as error:
            return _refusal(str(error))

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        client.stream.close()


def _refusal(error: str) -> dict[str, Any]:
    return {"ok": False, "error": error}


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
