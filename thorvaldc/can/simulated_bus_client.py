"""A program on a simulated wire that another process runs."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections import deque
from typing import Any

from thorvaldc.can import simulated_bus_protocol as protocol
from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import RECEIVE_LIMIT, SEND_LIMIT, CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import NANOSECONDS, NEVER, to_ns

ANSWER_TIME = 5.0
"""s to wait for the server's welcome."""
LOCKSTEP_POLL = 0.0001
"""s of the simulation after which a client in lockstep looks whether there is room to send."""


class RemoteClient:
    """As ``Client``, over a local socket: time goes by the clock, or with ``lockstep`` by waits.

    In lockstep time stands still while any client that asked for it is not waiting: a
    program has all the time it wants between two waits.  Safe to use from several threads.
    """

    def __init__(
        self,
        channel: str,
        name: str = "client",
        bitrate: int | None = None,
        *,
        send_limit: int = SEND_LIMIT,
        receive_limit: int = RECEIVE_LIMIT,
        receive_own: bool = False,
        listen_only: bool = False,
        fifo: bool = False,
        lockstep: bool = False,
    ) -> None:
        """Raises ``OSError`` where no such bus is run, or it does not want this client."""
        self.channel = channel
        self.name = name
        self.lockstep = lockstep
        self.send_limit = send_limit
        self.receive_limit = receive_limit
        self.overruns = 0
        self._received: deque[ReceivedFrame] = deque()
        self._changed = threading.Condition()
        self._writing = threading.Lock()
        self._outstanding = 0
        self._state = ErrorState.ACTIVE
        self._closed = ""
        self._waited_until: int | None = None
        path = protocol.channel_path(channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as fault:
            self._socket.close()
            raise OSError(f"no bus is run at {path} ({fault.strerror or fault})") from None
        hello = {
            "version": protocol.VERSION,
            "name": name,
            "bitrate": bitrate,
            "send_limit": send_limit,
            "receive_own": receive_own,
            "listen_only": listen_only,
            "fifo": fifo,
            "lockstep": lockstep,
        }
        self._unpacker = protocol.Unpacker()
        try:
            self._socket.sendall(protocol.pack_json(protocol.HELLO, hello))
            welcome = self._welcome()
        except OSError:
            self._socket.close()
            raise
        self.bitrate: int = welcome["bitrate"]
        self.epoch: float = welcome["epoch"]
        self._now: int = welcome["now"]
        self._clock = time.monotonic_ns() - self._now
        self._reader = threading.Thread(target=self._read, name=f"bus {channel}", daemon=True)
        self._reader.start()

    @property
    def state(self) -> ErrorState:
        return self._state

    @property
    def now(self) -> float:
        """s; of the simulation in lockstep, else of the clock since the bus was started."""
        now = self._now if self.lockstep else time.monotonic_ns() - self._clock
        return now / NANOSECONDS

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Queue a frame.  Where the queue is full, wait at most ``timeout`` s for room."""
        with self._changed:
            if self._outstanding >= self.send_limit and timeout > 0.0:
                self._wait_for_room(timeout)
            if self._outstanding >= self.send_limit or self._state is ErrorState.BUS_OFF:
                return False
            self._outstanding += 1
        self._write(protocol.pack_frame(protocol.SEND, frame))
        return True

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """The oldest frame received; where there is none, wait for one.

        ``None`` after ``timeout`` s without one.  Raises ``ConnectionError`` where the bus
        is not run any more.
        """
        with self._changed:
            if not self._received and timeout != 0.0:
                self._wait(timeout, stop_at_frame=True)
            if self._received:
                return self._received.popleft()
            if self._closed:
                raise ConnectionError(self._closed)
            return None

    def sleep(self, seconds: float) -> None:
        """Let time run; what comes meanwhile waits in the queue."""
        with self._changed:
            self._wait(seconds, stop_at_frame=False)

    def sleep_until(self, time: float) -> None:
        self.sleep(time - self.now)

    def restart(self) -> None:
        """Come back from bus-off."""
        self._write(protocol.pack(protocol.RESTART))

    def close(self) -> None:
        with self._changed:
            self._closed = self._closed or "closed"
        with contextlib.suppress(OSError):  # the server may have been first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if threading.current_thread() is not self._reader:
            self._reader.join(1.0)

    # -- inside --------------------------------------------------------------------------------

    def _has_room(self) -> bool:
        return self._outstanding < self.send_limit or bool(self._closed)

    def _wait_for_room(self, timeout: float) -> None:
        if not self.lockstep:
            self._changed.wait_for(self._has_room, timeout)
            return
        until = self._now + to_ns(timeout)
        while not self._has_room() and self._now < until:
            self._wait(LOCKSTEP_POLL, stop_at_frame=False)

    def _wait(self, timeout: float | None, stop_at_frame: bool) -> None:
        def over() -> bool:
            return bool(self._closed) or (stop_at_frame and bool(self._received))

        if not self.lockstep:
            self._changed.wait_for(over, timeout)
            return
        until = NEVER - 1 if timeout is None else self._now + to_ns(timeout)
        while not over() and self._now < until:
            self._waited_until = None
            self._write(protocol.pack_time(protocol.WAIT, until))
            self._changed.wait_for(lambda: self._waited_until is not None or bool(self._closed))

    def _write(self, message: bytes) -> None:
        try:
            with self._writing:
                self._socket.sendall(message)
        except OSError:
            raise ConnectionError(self._closed or "the bus is not run any more") from None

    def _welcome(self) -> dict[str, Any]:
        self._socket.settimeout(ANSWER_TIME)
        try:
            while True:
                data = self._socket.recv(65536)
                if not data:
                    raise ConnectionError("the bus closed the connection")
                welcome: dict[str, Any] | None = None
                for kind, body in self._unpacker.feed(data):
                    if kind == protocol.CLOSED:
                        raise ConnectionError(json.loads(body)["reason"])
                    if kind == protocol.WELCOME:
                        welcome = json.loads(body)
                    else:  # on a busy bus frames come in the same breath
                        self._take(kind, body)
                if welcome is not None:
                    return welcome
        except TimeoutError:
            raise ConnectionError("the bus does not answer") from None
        finally:
            self._socket.settimeout(None)

    def _read(self) -> None:
        """The thread that takes what the server sends."""
        reason = "the bus is not run any more"
        try:
            while data := self._socket.recv(65536):
                with self._changed:
                    for kind, body in self._unpacker.feed(data):
                        if kind == protocol.CLOSED:
                            reason = json.loads(body)["reason"]
                        else:
                            self._take(kind, body)
                    self._changed.notify_all()
        except OSError:
            pass  # closed, here or there
        with self._changed:
            self._closed = self._closed or reason
            self._changed.notify_all()

    def _take(self, kind: bytes, body: bytes) -> None:
        if kind == protocol.FRAME:
            moment, frame, own = protocol.unpack_frame(body)
            if len(self._received) >= self.receive_limit:
                self.overruns += 1
            else:
                self._received.append(ReceivedFrame(moment, frame, own))
        elif kind in (protocol.SENT, protocol.REFUSED):
            self._outstanding = max(self._outstanding - 1, 0)
        elif kind == protocol.STATE:
            found = json.loads(body)
            self._state = ErrorState(found["state"])
            self._outstanding = max(self._outstanding - found["dropped"], 0)
        elif kind == protocol.TIME:
            self._now = self._waited_until = protocol.unpack_time(body)
