"""Runs simulated CAN buses in real time for programs in other processes.

The module ``thorvaldc.can.simulated_bus_protocol`` describes the messages between a client program
and the server.
"""

from __future__ import annotations

import contextlib
import heapq
import selectors
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.can import simulated_bus_protocol as protocol
from thorvaldc.can.frame import SEND_LIMIT, CanFrame
from thorvaldc.can.local_socket import Unpacker, listen, pack, pack_json, socket_path
from thorvaldc.diagnostics.files import read_json
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import CanController, Wire

LONGEST_WAIT = 0.5
"""Longest time (s) to wait for a client, so that ``stop`` takes effect."""
LONGEST_WORK = 20_000_000
"""Simulated time (ns) after which the server handles clients, even if the simulation lags."""
LONGEST_DELAY = 250_000_000
"""Longest time (ns) for which a frame of a client waits for a simulation that computes too slowly.
The frame is then sent at the present simulated time."""
TIME_PERIOD = 5_000_000
"""Time (ns) between two TIME messages to a client."""
BACKLOG = 1 << 20
"""Number of bytes that may wait for a client.  The server drops messages beyond this number."""
_MAXIMUM_RATE = 10_000_000


@dataclass(eq=False)
class _Connection:
    """A client program that is connected to the server by a socket."""

    stream: socket.socket
    wire: Wire
    unpacker: Unpacker = field(default_factory=Unpacker)
    out: bytearray = field(default_factory=bytearray)
    controller: CanController | None = None
    lost: int = 0
    pending: int = 0
    """Number of frames of the client that were not yet reported as sent or dropped."""
    sent_at: int = 0
    """Time (ns) of the newest message of the client."""
    told_time: int = 0
    """Time (ns) of the newest TIME message."""

    def send_state(self) -> None:
        """Sends the error state of the CAN controller to the client program.

        The message also contains the number of CAN frames that bus-off or a restart removed from
        the send queue.
        """
        controller = self.controller
        if controller is not None:
            dropped, self.pending = self.pending - controller.pending, controller.pending
            self.put(
                pack_json(protocol.STATE, {"state": controller.state.value, "dropped": dropped})
            )

    def put(self, message: bytes) -> None:
        """Queues a message to the client program.

        The message is dropped if more than ``BACKLOG`` bytes are already queued.
        """
        if len(self.out) > BACKLOG:
            self.lost += 1
        else:
            self.out += message


class _Waiting(NamedTuple):
    """A message of a client that waits until the simulation has reached its time.

    - ``time``: simulated time (ns) at which the client has sent the message;
    - ``number``: number of the message, which keeps the order of messages of the same time;
    - ``read_at``: time (ns) on the clock at which the server has read the message.
    """

    time: int
    number: int
    read_at: int
    connection: _Connection
    kind: bytes
    body: bytes


class BusServer:
    """Runs simulated CAN buses and offers each bus to other processes over a local socket.

    The simulated time follows the clock of the computer.  A process that runs late, or computes too
    slowly, lags behind the clock and catches up later; it simulates the frames of its clients at
    the times at which the clients have sent them.  ``behind`` is the largest lag (ns) of the
    simulated time behind the clock.
    """

    def __init__(self, timeline: Timeline, wires: Mapping[str, Wire]) -> None:
        """Opens a local socket for each simulated bus.

        ``wires`` maps each channel name to a simulated bus.  Raises ``OSError`` if another server
        already uses one of the channel names.
        """
        self.timeline = timeline
        self.channels = tuple(wires)
        self.behind = 0
        # The system call select has a time resolution of microseconds, and epoll only of
        # milliseconds.
        self._selector = selectors.SelectSelector()
        self._connections: list[_Connection] = []
        self._paths: list[Path] = []
        self._listeners: list[socket.socket] = []
        self._stop = False
        self._epoch = 0.0
        self._start = 0
        self._clock = 0
        """Time (ns) on the clock; all messages that were sent before are read."""
        self._waiting: list[_Waiting] = []
        self._messages = 0
        self._wakeup, woken = socket.socketpair()
        self._woken = woken
        woken.setblocking(False)
        self._selector.register(woken, selectors.EVENT_READ, None)
        try:
            for channel, wire in wires.items():
                self._listen(socket_path(channel), wire)
        except OSError:
            self._close()
            raise

    def run(self) -> None:
        """Runs the server until another thread or a signal handler calls ``stop``."""
        self._start = time.monotonic_ns() - self.timeline.now
        self._epoch = time.time() - self.timeline.seconds
        try:
            while not self._stop:
                self._advance()
                self._flush()
                self._selector.select(self._wait_time())
                # All messages that were sent before this time are now in the sockets.
                self._clock = time.monotonic_ns() - self._start
                self._serve()
        finally:
            self._close()

    def stop(self) -> None:
        self._stop = True
        with contextlib.suppress(OSError):
            self._wakeup.send(b"x")

    # -- time ---------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Simulates until the time at which the clients were last read, with their messages."""
        self.behind = max(self.behind, self._clock - self.timeline.next_time)
        limit = time.monotonic_ns() + LONGEST_WORK
        waiting = self._waiting
        while waiting and waiting[0].time <= self._clock:
            overdue = self._clock - waiting[0].read_at > LONGEST_DELAY
            if not overdue and self._run_until(waiting[0].time, limit):
                return
            self._handle_waiting(heapq.heappop(waiting))
        self._run_until(self._clock, limit)

    def _run_until(self, end: int, limit: int) -> bool:
        """Simulates until the time ``end`` (ns), or until the monotonic clock reads ``limit``.

        Returns ``True`` if the simulation has not reached ``end``.
        """
        return self.timeline.run_until(end, lambda: time.monotonic_ns() > limit)

    def _wait_time(self) -> float:
        """Returns the time (s) until the next event of the simulation."""
        if self._waiting:
            return 0.0
        ahead = self.timeline.next_time - (time.monotonic_ns() - self._start)
        longest = TIME_PERIOD / 1e9 if self._connections else LONGEST_WAIT
        return min(max(ahead / 1e9, 0.0), longest)

    def _tell_time(self) -> None:
        """Tells the clients up to which time they have received all frames."""
        now = self.timeline.now
        for connection in self._connections:
            # A client that does not read needs no further times.
            due = now - connection.told_time >= TIME_PERIOD
            if due and connection.controller is not None and not connection.out:
                connection.told_time = now
                connection.put(protocol.pack_time(protocol.TIME, now))

    # -- clients ------------------------------------------------------------------------------

    def _listen(self, path: Path, wire: Wire) -> None:
        listener = listen(path, "a bus")
        self._listeners.append(listener)
        self._paths.append(path)
        self._selector.register(listener, selectors.EVENT_READ, wire)

    def _serve(self) -> None:
        for key, events in self._selector.select(0.0):
            if key.data is None:
                with contextlib.suppress(OSError):
                    self._woken.recv(64)
            elif isinstance(key.data, Wire):
                with contextlib.suppress(OSError):
                    stream, _ = key.fileobj.accept()  # type: ignore[union-attr]
                    self._accept(stream, key.data)
            else:
                if events & selectors.EVENT_WRITE:
                    self._write(key.data)
                if events & selectors.EVENT_READ:
                    self._read(key.data)

    def _accept(self, stream: socket.socket, wire: Wire) -> None:
        stream.setblocking(False)
        connection = _Connection(stream, wire)
        self._connections.append(connection)
        self._selector.register(stream, selectors.EVENT_READ, connection)

    def _read(self, connection: _Connection) -> None:
        try:
            data = connection.stream.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._handle_rest(connection)
            self._drop(connection)
            return
        now = time.monotonic_ns() - self._start
        for kind, body in connection.unpacker.feed(data):
            if kind == protocol.SEND:
                with contextlib.suppress(ValueError):  # ``_handle`` refuses the message
                    sent_at = min(protocol.unpack_time(body[:8]), now)
                    connection.sent_at = max(connection.sent_at, sent_at)
            self._messages += 1
            message = _Waiting(connection.sent_at, self._messages, now, connection, kind, body)
            heapq.heappush(self._waiting, message)

    def _handle_rest(self, connection: _Connection) -> None:
        """Handles the waiting messages of a client that has ended."""
        rest = sorted(m for m in self._waiting if m.connection is connection)
        self._waiting = [m for m in self._waiting if m.connection is not connection]
        heapq.heapify(self._waiting)
        for message in rest:
            self._handle_waiting(message)

    def _handle_waiting(self, message: _Waiting) -> None:
        connection = message.connection
        if connection not in self._connections:
            return
        try:
            self._handle(connection, message.kind, message.body)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            self._refuse(connection, f"not understood: {error}")

    def _handle(self, connection: _Connection, kind: bytes, body: bytes) -> None:
        controller = connection.controller
        if kind == protocol.HELLO and controller is None:
            self._welcome(connection, read_json(body))
        elif kind == protocol.SEND and controller is not None:
            _, frame, _ = protocol.unpack_frame(body)
            if controller.send(frame):
                connection.pending += 1
            else:
                connection.put(pack(protocol.REFUSED))
        elif kind == protocol.RESTART and controller is not None:
            controller.restart()
            connection.send_state()
        else:
            raise ValueError(f"message {kind!r}")

    def _welcome(self, connection: _Connection, hello: Mapping[str, Any]) -> None:
        if hello["version"] != protocol.VERSION:
            self._refuse(connection, f"the protocol version is not {protocol.VERSION}")
            return
        wire = connection.wire
        bitrate = hello["bitrate"] or wire.bitrate
        if not isinstance(bitrate, int) or not 0 < bitrate <= _MAXIMUM_RATE:
            raise ValueError(f"bitrate {bitrate!r}")
        controller = CanController(
            wire,
            str(hello["name"]),
            bitrate,
            queue_limit=max(int(hello.get("send_limit", SEND_LIMIT)), 1),
            fifo=bool(hello["fifo"]),
            listen_only=bool(hello["listen_only"]),
            auto_recovery=False,
        )
        receive_own = bool(hello["receive_own"])

        def on_frame(frame: CanFrame) -> None:
            connection.put(protocol.pack_frame(protocol.FRAME, frame, self.timeline.now))

        def on_sent(frame: CanFrame) -> None:
            connection.pending -= 1
            connection.put(pack(protocol.SENT))
            if receive_own:
                now = self.timeline.now
                connection.put(protocol.pack_frame(protocol.FRAME, frame, now, own=True))

        controller.on_frame, controller.on_sent = on_frame, on_sent
        controller.on_state = lambda _: connection.send_state()
        connection.controller = controller
        wire.attach(controller)
        controller.switch_on()
        welcome = {
            "version": protocol.VERSION,
            "bitrate": bitrate,
            "now": self.timeline.now,
            "start": self._start,
            "epoch": self._epoch,
        }
        connection.put(pack_json(protocol.WELCOME, welcome))

    def _refuse(self, connection: _Connection, reason: str) -> None:
        connection.put(pack_json(protocol.CLOSED, {"reason": reason}))
        self._write(connection)
        self._drop(connection)

    def _flush(self) -> None:
        self._tell_time()
        for connection in list(self._connections):
            if connection.out:
                self._write(connection)

    def _write(self, connection: _Connection) -> None:
        try:
            sent = connection.stream.send(connection.out)
            del connection.out[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if connection.out else 0)
        with contextlib.suppress(KeyError):
            if self._selector.get_key(connection.stream).events != events:
                self._selector.modify(connection.stream, events, connection)

    def _drop(self, connection: _Connection) -> None:
        if connection in self._connections:
            self._connections.remove(connection)
            self._selector.unregister(connection.stream)
            connection.stream.close()
            if connection.controller is not None:
                connection.wire.detach(connection.controller)

    def _close(self) -> None:
        reason = {"reason": "the bus was stopped"}
        for connection in list(self._connections):
            connection.put(pack_json(protocol.CLOSED, reason))
            self._write(connection)
            self._drop(connection)
        for listener in self._listeners:
            listener.close()
        for path in self._paths:
            path.unlink(missing_ok=True)
        self._paths = []
        self._selector.close()
        self._wakeup.close()
        self._woken.close()


@contextlib.contextmanager
def serving(
    timeline: Timeline,
    wires: Mapping[str, Wire],
    *,
    stopped: Callable[[], None] | None = None,
) -> Iterator[BusServer]:
    """Runs a server for simulated CAN buses in a separate thread during the ``with`` block.

    Other threads must not use the simulated buses during the ``with`` block.  The function
    ``stopped`` is called after the server thread has ended.
    """
    server = BusServer(timeline, wires)
    thread = threading.Thread(target=server.run, name="bus server", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        if stopped is not None:
            stopped()
