"""The driver's end of the control channel, served between two control cycles."""

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
"""Bytes of a request."""
MOST_CLIENTS = 32
MOST_REQUESTS = 100
"""Of a client, between two control cycles; more of them wait for the next."""
BACKLOG = 1 << 20
"""Bytes of answers that wait for a client that does not read; after that it is let go."""


def control_path(name: str) -> Path:
    """The socket of a driver by its name (or a path with a slash).  Raises ``OSError``."""
    return socket_path(name if "/" in name else f"{name}-control")


class _Client:
    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self.unread = b""
        self.out = bytearray()
        self.ended = False


class ControlServer:
    """Listens for programs that drive this robot; ``poll`` answers what they have asked.

    A request is a line ``{"call": NAME, "arguments": {...}}``, its answer a line
    ``{"ok": true, "result": ...}`` or ``{"ok": false, "error": "one plain line"}``; an ``id`` of
    the request comes back with the answer.  Only programs of the same user can connect.
    One thread, and never a wait: the control cycle goes on whatever a client does.
    """

    def __init__(self, name: str, services: Services) -> None:
        """Raises ``OSError`` where a driver of that name is run already."""
        self.path = control_path(name)
        self.services = services
        self._clients: list[_Client] = []
        remove_stale_socket(self.path, "a driver")
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        mask = os.umask(0o177)
        try:
            self._listener.bind(str(self.path))
        except OSError as fault:
            self._listener.close()
            raise OSError(f"{self.path}: {fault.strerror or fault}") from None
        finally:
            os.umask(mask)
        self._inode = self.path.stat().st_ino
        self._listener.listen()
        self._listener.setblocking(False)

    def poll(self, now: float) -> None:
        """Take and answer what has come, as at ``now`` (s, the driver's time)."""
        if self._ready(self._listener):
            self._accept()
        for client in list(self._clients):
            try:
                self._serve(client, now)
            except OSError:  # it has gone, or was killed in the middle of a line
                self._drop(client)

    def close(self) -> None:
        """Let all clients go."""
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
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
            client.out += _line(_refusal(f"a line is longer than {LONGEST_LINE} bytes"))
            client.unread, client.ended = b"", True
        if client.out:
            with contextlib.suppress(BlockingIOError):
                sent = client.stream.send(client.out)
                del client.out[:sent]
        if len(client.out) > BACKLOG or (client.ended and b"\n" not in client.unread):
            self._drop(client)

    def _answer(self, line: bytes, now: float) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal("a line is no JSON")
        if not isinstance(request, dict):
            return _refusal('a line is no mapping, as {"call": "state"} is')
        answer = self._call(request, now)
        if "id" in request:
            answer["id"] = request["id"]
        return answer

    def _call(self, request: dict[str, Any], now: float) -> dict[str, Any]:
        name, arguments = request.get("call"), request.get("arguments", {})
        if not isinstance(name, str):
            return _refusal('a request names no service, as {"call": "state"} does')
        if not isinstance(arguments, dict):
            return _refusal("`arguments` is no mapping")
        unknown = [key for key in request if key not in ("call", "arguments", "id")]
        if unknown:
            return _refusal(f"a request has no `{unknown[0]}`; it has call, arguments and id")
        try:
            return {"ok": True, "result": self.services.call(name, arguments, now)}
        except ServiceError as fault:
            return _refusal(str(fault))

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        client.stream.close()


def _refusal(error: str) -> dict[str, Any]:
    return {"ok": False, "error": error}


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
