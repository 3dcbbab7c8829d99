"""Control channel, over which other programs call the services of a running driver.

The server answers the requests of all clients between two control cycles:

    client                                                  server, once in a cycle
    {"call": "twist", "arguments": {...}, "id": 7}   --->   reads what has come,
                                                            runs the services,
                                                     <---   {"ok": true, "result": null, "id": 7}

A request counts only if it is fresh.  A client may state in ``time`` when it has sent the request,
on the clock of the base driver.  Without that time, the server assumes that the request was sent
directly after the last time when nothing was waiting:

    poll        |         |         |     (a cycle is late)      |         |
    request          x        x                  x                    x
    answered              ok        ok                           void      ok

Requests that only read or stop the robot count however old they are, and also if the client has
closed its connection.

Clients could delay a control cycle with long lines, too many requests or unread answers.  Therefore
no request is begun ``LONGEST_POLL`` after the first one of a cycle.  They take turns; the client
that was answered longest ago is the next one:

    client   a   b   c        cycle 1              cycle 2
    waiting  500 1   500      a1 b1 c1 a2 c2 a3    c3 a4 c4 a5 c5 a6

A stop of a client that has been silent is thus answered in the next cycle, however many requests
the others send.
"""

from __future__ import annotations

import contextlib
import json
import math
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from thorvaldc.can.local_socket import listen, socket_path
from thorvaldc.diagnostics.files import read_json
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.runtime.service_table import Argument, Caller, ServiceError, Services

LONGEST_LINE = 65536
"""Largest length of a request, in bytes."""
MOST_CLIENTS = 32
LONGEST_POLL = 0.004
"""Real time (s) of a cycle after which no further request is begun, a fifth of it at 50 Hz."""
LONGEST_WAIT = 0.05
"""Longest time (s) for which a request may wait and still count, 2.5 cycles at 50 Hz."""
_ROUNDING = 1e-9
LARGEST_CLOCK_ERROR = 0.005
"""Largest time (s) by which a client's request may seem to come from the future."""
LONGEST_BACKLOG = 1 << 20
"""Size of unread answers (bytes) above which the server closes the connection of a client."""


def control_path(name: str) -> Path:
    """Returns the path of the control socket of the base driver ``name``.

    A driver name that contains a slash is used as the path of the socket.  Raises ``OSError`` if
    the path cannot be used for a local socket.
    """
    return socket_path(name if "/" in name else f"{name}-control")


class _Client:
    """Connection to a client of the control channel, with received bytes and unsent answers.

    - ``emptied``: time (s) of the last poll at which no request of the client was waiting;
    - ``closed``: ``True`` if the client has closed its side of the connection;
    - ``ended``: ``True`` if the server reads nothing more from the client;
    - ``answered``: number of requests of all clients until its latest one.
    """

    def __init__(self, stream: socket.socket, name: str, emptied: float) -> None:
        self.stream = stream
        self.name = name
        self.emptied = emptied
        self.unread = b""
        self.out = bytearray()
        self.closed = False
        self.ended = False
        self.answered = 0

    @property
    def has_request(self) -> bool:
        return b"\n" in self.unread


class ControlServer:
    """Server for programs that command a robot over a local socket.

    A service request is a line ``{"call": NAME, "arguments": {...}}``.  The answer of the server is
    a line ``{"ok": true, "result": ...}`` or ``{"ok": false, "error": "one line"}``.  If the
    service request has an ``id``, the answer has the same ``id``.  Only programs of the same user
    can connect to the control channel.
    """

    def __init__(
        self,
        name: str,
        services: Services,
        longest_wait: float = LONGEST_WAIT,
        closed: Callable[[str], None] = lambda name: None,
    ) -> None:
        """Creates the control socket of the base driver ``name``.

        - ``longest_wait``: longest time (s) for which a request may wait and still count.
        - ``closed``: function that is called with the name of a connection that has ended.

        Raises ``OSError`` if a base driver with the same name already runs.
        """
        self.name = name
        self.path = control_path(name)
        self.services = services
        self._longest_wait = longest_wait
        self._closed = closed
        self.real_time = time.monotonic
        """Clock (s) of ``LONGEST_POLL``."""
        self._clients: list[_Client] = []
        self._connections = self._requests = 0
        self._last_poll = -math.inf
        self._now = 0.0
        self._listener = listen(self.path, "a driver")
        self._inode = self.path.stat().st_ino

    @property
    def streams(self) -> list[socket.socket]:
        """Open connections.  A copy of this process needs connections of its own."""
        return [client.stream for client in self._clients]

    def poll(self, now: float, clock_time: float | None = None) -> None:
        """Accepts new clients and answers all received requests, without waiting.

        - ``now``: time (s) on the clock of the base driver.
        - ``clock_time``: time (s) on the clock of the clients, which measures the age of requests.
          ``None``: the clients have the clock of the base driver.
        """
        self._now = now
        clock_time = now if clock_time is None else clock_time
        self._accept(clock_time)
        emptied = {client for client in self._clients if self._receive(client)}
        self._answer_in_turns(clock_time)
        for client in list(self._clients):
            if client in emptied and not client.has_request:
                client.emptied = clock_time
            try:
                self._send(client)
            except OSError:  # the client has ended, perhaps in the middle of a line
                self._drop(client)
        self._last_poll = clock_time

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

    def _accept(self, now: float) -> None:
        """Accepts all new clients, at most ``MOST_CLIENTS`` in a poll."""
        # A new client has connected after the last poll.  Before the first poll, it may have waited
        # since the socket was created, when the base driver did nothing yet.
        since = self._last_poll if math.isfinite(self._last_poll) else now
        with contextlib.suppress(OSError):
            for _ in range(MOST_CLIENTS):
                stream, _ = self._listener.accept()
                if len(self._clients) >= MOST_CLIENTS:
                    stream.close()
                    continue
                stream.setblocking(False)
                self._connections += 1
                name = f"connection {self._connections}{_process(stream)}"
                self._clients.append(_Client(stream, name, since))

    def _answer_in_turns(self, now: float) -> None:
        """Answers one request of each client after another, for ``LONGEST_POLL``."""
        until = self.real_time() + LONGEST_POLL
        while waiting := [client for client in self._clients if client.has_request]:
            client = min(waiting, key=lambda client: client.answered)
            line, _, client.unread = client.unread.partition(b"\n")
            client.out += _line(self._answer(line, client, now))
            self._requests += 1
            client.answered = self._requests
            if self.real_time() >= until:
                return

    def _send(self, client: _Client) -> None:
        """Sends the answers of a client, and ends its connection if nothing more will come."""
        if len(client.unread) > LONGEST_LINE and not client.has_request:
            client.out += _line(_refusal(f"a request is longer than {LONGEST_LINE} bytes"))
            client.unread, client.ended = b"", True
        if client.out:
            with contextlib.suppress(BlockingIOError):
                sent = client.stream.send(client.out)
                del client.out[:sent]
        if len(client.out) > LONGEST_BACKLOG or (client.ended and not client.has_request):
            self._drop(client)

    @staticmethod
    def _receive(client: _Client) -> bool:
        """Receives what the client has sent, and returns ``True`` if nothing more is waiting.

        The end of the connection is noticed before the requests that were sent before it.
        """
        while not client.ended and len(client.unread) <= LONGEST_LINE:
            try:
                data = client.stream.recv(LONGEST_LINE)
            except BlockingIOError:
                return True
            except OSError:  # the client has ended with unread answers
                data = b""
            client.ended = client.closed = not data
            client.unread += data
        return client.ended

    def _answer(self, line: bytes, client: _Client, now: float) -> dict[str, Any]:
        try:
            request = read_json(line)
        except ValueError:
            return _refusal("the request is not JSON")
        if not isinstance(request, dict):
            return _refusal('the request is not a mapping, such as {"call": "state"}')
        answer = self._call(request, client, now)
        if "id" in request:
            answer["id"] = request["id"]
        return answer

    def _call(self, request: dict[str, Any], client: _Client, now: float) -> dict[str, Any]:
        name, arguments = request.get("call"), request.get("arguments", {})
        if not isinstance(name, str):
            return _refusal('the request names no service, such as {"call": "state"}')
        if not isinstance(arguments, dict):
            return _refusal("`arguments` is not a mapping")
        unknown = [key for key in request if key not in ("call", "arguments", "id", "time")]
        if unknown:
            return _refusal(
                f"a request has no key `{unknown[0]}`; its keys are call, arguments, id and time"
            )
        try:
            caller = self._caller(request.get("time"), client, now)
            return {"ok": True, "result": self.services.call(name, arguments, self._now, caller)}
        except ServiceError as error:
            return _refusal(str(error))

    def _caller(self, sent: Any, client: _Client, now: float) -> Caller:
        """Judges the age of a request that was sent at the time ``sent`` (s).

        If ``sent`` is ``None``, the request is as old as it can be.  Raises ``ServiceError`` if
        ``sent`` is in the future.
        """
        if client.closed:
            return Caller(client.name, void="the connection is closed; nothing is done")
        age = now - client.emptied
        if sent is not None:
            sent = Argument("time", "number").check(sent)
            age = now - sent
            if age < -LARGEST_CLOCK_ERROR:
                raise ServiceError(f"`time` is {sent:.3f} s; the driver's clock shows {now:.3f} s")
        if age > self._longest_wait + _ROUNDING:
            return Caller(
                client.name,
                age,
                f"the request may have waited for {age * 1000.0:.0f} ms; nothing is done, send it"
                " again",
            )
        return Caller(client.name, max(age, 0.0) if sent is not None else 0.0)

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        client.stream.close()
        self._closed(client.name)


def _process(stream: socket.socket) -> str:
    """Returns the process of a client as text, where the operating system tells it (Linux)."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return ""
    credentials = stream.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i"))
    return f" (process {struct.unpack('3i', credentials)[0]})"


def _refusal(error: str) -> dict[str, Any]:
    return {"ok": False, "error": " ".join(error.split())}


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message, ensure_ascii=False).encode("utf-8", "replace") + b"\n"


def version_text(other: str, version: str) -> str:
    """Returns the sentence about another program with another version of thorvaldc."""
    return (
        f"{other} is thorvaldc {version}, this program is thorvaldc {program_version()}; services"
        " and states may differ: install one version on both"
    )


ANSWER_TIME = 2.0
"""Longest time (s) to wait for an answer, equal to 100 control cycles."""


class ControlClient:
    """Connection to the control channel of a running base driver.

    The constructor raises ``OSError`` if no base driver with the given name runs.  The method
    ``call`` raises ``ConnectionError`` if the base driver ends or does not answer.
    """

    def __init__(self, name: str, answer_time: float = ANSWER_TIME) -> None:
        self.name = name
        path = control_path(name)
        self._stream = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._stream.settimeout(answer_time)
        self._unread = b""
        self._calls = 0
        try:
            self._stream.connect(str(path))
        except OSError as error:
            self._stream.close()
            raise OSError(
                f"no driver `{name}` runs: start one with `thorvaldc run`"
                f" ({path}: {error.strerror or error})"
            ) from None

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the base driver and returns the result.

        Raises ``ServiceError`` if the base driver refuses the service call.
        """
        self._calls += 1
        request = {"call": service, "arguments": arguments, "id": self._calls}
        try:
            self._stream.sendall(_line(request))
            answer = self._read_answer()
        except TimeoutError:
            raise ConnectionError(f"the driver `{self.name}` does not answer") from None
        except (OSError, ValueError):
            raise ConnectionError(f"the driver `{self.name}` has ended") from None
        if not answer.get("ok"):
            raise ServiceError(str(answer.get("error", "refused")))
        return answer.get("result")

    def other_version(self) -> str:
        """Exchanges versions with the driver, which reports a different one too.

        Returns a sentence if the driver is another version of thorvaldc, or an empty text.  Raises
        ``ConnectionError`` if the base driver does not answer.
        """
        own = program_version()
        try:
            answer = self.call("hello", version=own)
            version = str(answer.get("version")) if isinstance(answer, dict) else "unknown"
        except ServiceError:
            version = "older than 0.1.0"  # it has no service `hello`
        return "" if version == own else version_text(f"the driver `{self.name}`", version)

    def close(self) -> None:
        self._stream.close()

    def _read_answer(self) -> dict[str, Any]:
        """Returns the answer to the last service call, and skips late answers to earlier service
        calls."""
        while True:
            line, end, rest = self._unread.partition(b"\n")
            if end:
                self._unread = rest
                answer = read_json(line)
                if isinstance(answer, dict) and answer.get("id") == self._calls:
                    return answer
                # The answer of the server has no ``id`` if the server could not read the request.
                if isinstance(answer, dict) and not answer.get("ok") and "id" not in answer:
                    return answer
                continue
            data = self._stream.recv(65536)
            if not data:
                raise ConnectionResetError
            self._unread += data
