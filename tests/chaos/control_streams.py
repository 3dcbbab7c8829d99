"""The control channel without a kernel: streams in memory, and a control server that uses them."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import Any

from thorvaldc.runtime.control_channel import LONGEST_POLL, ControlServer
from thorvaldc.runtime.service_table import Services

BUFFER = 200_000
"""Bytes that a stream in memory keeps in each direction, about as many as a local socket."""


class MemoryStream:
    """The driver's end of a connection, with the methods of a socket that the server uses."""

    def __init__(self) -> None:
        self.to_driver = bytearray()
        self.to_client = bytearray()
        self.client_gone = False
        self.closed = False

    # -- the client's end ----------------------------------------------------------------------

    def client_send(self, data: bytes) -> None:
        """Sends what the buffer has room for, as a client that never waits."""
        if not self.closed and not self.client_gone:
            self.to_driver += data[: max(BUFFER - len(self.to_driver), 0)]

    def client_read(self) -> bytes:
        data = bytes(self.to_client)
        self.to_client.clear()
        return data

    # -- the driver's end, like a socket that does not block -------------------------------------

    def setblocking(self, flag: bool) -> None:
        """Does nothing, because a stream in memory never blocks."""

    def recv(self, size: int) -> bytes:
        if not self.to_driver:
            if self.client_gone:
                return b""
            raise BlockingIOError
        data = bytes(self.to_driver[:size])
        del self.to_driver[:size]
        return data

    def send(self, data: bytes) -> int:
        if self.client_gone:
            raise BrokenPipeError
        size = min(len(data), BUFFER - len(self.to_client))
        if size <= 0:
            raise BlockingIOError
        self.to_client += data[:size]
        return size

    def getsockopt(self, level: int, option: int, size: int) -> bytes:
        """Returns the process of the client, as the option ``SO_PEERCRED``."""
        return bytes(size)

    def close(self) -> None:
        self.closed = True


class MemoryListener:
    """A listening socket in memory."""

    def __init__(self) -> None:
        self.waiting: deque[MemoryStream] = deque()

    def accept(self) -> tuple[MemoryStream, str]:
        if not self.waiting:
            raise BlockingIOError
        return self.waiting.popleft(), ""

    def close(self) -> None:
        self.waiting.clear()


class MemoryControlServer(ControlServer):
    """The control server of the driver, with connections in memory."""

    def __init__(
        self,
        services: Services,
        listener: MemoryListener,
        longest_wait: float,
        closed: Callable[[str], None],
    ) -> None:
        """Creates the server without a socket; the arguments are those of ``ControlServer``."""
        self.services = services
        self._clients: list[Any] = []
        self._listener = listener  # type: ignore[assignment]
        self._longest_wait = longest_wait
        self._closed = closed
        self._connections = self._requests = 0
        # A clock that depends on no machine: 64 requests take the time of a poll.
        self.real_time = itertools.count(0.0, LONGEST_POLL / 64).__next__
        self._last_poll = -math.inf
        self._now = 0.0

    def close(self) -> None:
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
