"""CAN interface to a simulated bus that runs in another process (``sim:NAME``)."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from typing import Any

from thorvaldc.can import frame as can_frame
from thorvaldc.can import simulated_bus_protocol as protocol
from thorvaldc.can.local_socket import Unpacker, pack, pack_json, socket_path
from thorvaldc.diagnostics.files import read_json

ANSWER_TIME = 5.0
"""Longest time (s) to wait for the WELCOME message of the server."""
LATE = 0.03
"""Time (s) without a message of the server after which its process is late."""
LATE_SEND_LIMIT = 8
"""Largest number of frames that wait for a late server, in send queues.

The buffer of a local socket has room for about 270 short messages on Linux; ``send`` must not wait
for a server that does not run."""


class SimulatedBusClient:
    """A CAN interface to a simulated bus, connected over a local socket.

    The simulated bus runs in real time.  All methods are thread-safe.
    """

    receives_by_itself = True

    def __init__(
        self,
        channel: str,
        name: str = "client",
        bitrate: int | None = None,
        *,
        send_limit: int = can_frame.SEND_LIMIT,
        receive_limit: int = can_frame.RECEIVE_LIMIT,
        receive_own: bool = False,
        listen_only: bool = False,
        fifo: bool = False,
    ) -> None:
        """Connects to the simulated bus ``channel``.

        - ``name``: name of this client in the messages of the server;
        - ``bitrate``: bitrate (bit/s) of this client, or ``None`` for the bitrate of the bus;
        - ``send_limit``, ``receive_limit``: sizes of the send queue and the receive queue, in
          frames;
        - ``receive_own``: ``receive`` also returns the frames that this client has sent;
        - ``listen_only``: the client sends neither frames nor acknowledgements;
        - ``fifo``: frames are sent in the order of the calls of ``send``, not by priority.

        Raises ``OSError`` if the simulated bus ``channel`` does not run, or if the server of the
        bus refuses the connection.
        """
        self.channel = channel
        self.name = name
        self.send_limit = send_limit
        self.receive_limit = receive_limit
        self.overruns = 0
        self._received: deque[can_frame.ReceivedFrame] = deque()
        self._changed = threading.Condition()
        self._writing = threading.Lock()
        self._unsent = 0
        self._now = 0
        self._state = can_frame.ErrorState.ACTIVE
        self._closed = ""
        path = socket_path(channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise OSError(f"no bus runs at {path} ({error.strerror or error})") from None
        hello = {
            "version": protocol.VERSION,
            "name": name,
            "bitrate": bitrate,
            "send_limit": send_limit,
            "receive_own": receive_own,
            "listen_only": listen_only,
            "fifo": fifo,
        }
        self._unpacker = Unpacker()
        try:
            self._socket.sendall(pack_json(protocol.HELLO, hello))
            welcome = self._receive_welcome()
        except OSError:
            self._socket.close()
            raise
        self.bitrate: int = welcome["bitrate"]
        self.epoch: float = welcome["epoch"]
        self._now = max(self._now, welcome["now"])
        self._start: int = welcome["start"]
        self._reader = threading.Thread(target=self._read, name=f"bus {channel}", daemon=True)
        self._reader.start()

    @property
    def state(self) -> can_frame.ErrorState:
        return self._state

    @property
    def now(self) -> float:
        """Time (s) since the start of the simulated bus."""
        return self._clock() / can_frame.NANOSECONDS

    @property
    def received_until(self) -> float:
        """Time (s) up to which all frames on the bus have reached the receive queue.

        The time is earlier than ``now`` if the process of the bus runs late.
        """
        return self._now / can_frame.NANOSECONDS

    def send(self, frame: can_frame.CanFrame, timeout: float = 0.0) -> bool:
        """Puts a CAN frame into the send queue.

        Waits at most ``timeout`` seconds while the send queue is full.

        Returns ``False`` if the send queue is still full after ``timeout``, or if the CAN
        controller is in bus-off.
        """
        with self._changed:
            if not self._has_room() and timeout > 0.0:
                self._changed.wait_for(self._has_room, timeout)
            if not self._has_room() or self._state is can_frame.ErrorState.BUS_OFF:
                return False
            self._unsent += 1
        self._write(protocol.pack_frame(protocol.SEND, frame, self._clock()))
        return True

    def receive(self, timeout: float | None = None) -> can_frame.ReceivedFrame | None:
        """Returns the oldest CAN frame in the receive queue.

        Waits for a CAN frame if the receive queue is empty.

        Returns ``None`` if no CAN frame arrives within ``timeout`` seconds.  Raises
        ``ConnectionError`` if the simulated bus has stopped.
        """
        with self._changed:
            if not self._received and timeout != 0.0:
                self._changed.wait_for(lambda: self._received or self._closed, timeout)
            if self._received:
                return self._received.popleft()
            if self._closed:
                raise ConnectionError(self._closed)
            return None

    def sleep(self, seconds: float) -> None:
        """Waits for ``seconds``.

        CAN frames that arrive during the wait stay in the receive queue.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed, seconds)

    def sleep_until(self, time: float) -> None:
        self.sleep(time - self.now)

    def restart(self) -> None:
        """Restarts the simulated CAN controller after bus-off."""
        self._write(pack(protocol.RESTART))

    def close(self) -> None:
        with self._changed:
            self._closed = self._closed or "closed"
        with contextlib.suppress(OSError):  # the server may have closed the connection before
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if threading.current_thread() is not self._reader:
            self._reader.join(1.0)

    # -- inside --------------------------------------------------------------------------------

    def _clock(self) -> int:
        return time.monotonic_ns() - self._start

    def _has_room(self) -> bool:
        if self._unsent < self.send_limit or self._closed:
            return True
        # A server that runs late will send the frames at the times of these calls.  It is not known
        # yet whether the send queue of the simulated controller is full.
        late = self.now - self.received_until > LATE
        return late and self._unsent < LATE_SEND_LIMIT * self.send_limit

    def _write(self, message: bytes) -> None:
        try:
            with self._writing:
                self._socket.sendall(message)
        except OSError:
            raise ConnectionError(self._closed or "the bus has stopped") from None

    def _receive_welcome(self) -> dict[str, Any]:
        self._socket.settimeout(ANSWER_TIME)
        try:
            while True:
                data = self._socket.recv(65536)
                if not data:
                    raise ConnectionError("the bus closed the connection")
                welcome: dict[str, Any] | None = None
                for kind, body in self._unpacker.feed(data):
                    if kind == protocol.CLOSED:
                        raise ConnectionError(read_json(body)["reason"])
                    if kind == protocol.WELCOME:
                        welcome = read_json(body)
                    else:  # on a busy bus the same packet may contain the first frames
                        self._process(kind, body)
                if welcome is not None:
                    return welcome
        except TimeoutError:
            raise ConnectionError("the bus does not answer") from None
        except (ValueError, LookupError, TypeError):
            raise ConnectionError("what answers there is no simulated bus") from None
        finally:
            self._socket.settimeout(None)

    def _read(self) -> None:
        """Receives and processes the messages of the simulated bus server, in a separate thread."""
        reason = "the bus has stopped"
        try:
            while data := self._socket.recv(65536):
                with self._changed:
                    for kind, body in self._unpacker.feed(data):
                        if kind == protocol.CLOSED:
                            reason = read_json(body)["reason"]
                        else:
                            self._process(kind, body)
                    self._changed.notify_all()
        except OSError:
            pass  # this client or the server has closed the connection
        except (ValueError, LookupError, TypeError):
            reason = "the bus sends messages that are not understood"
        with self._changed:
            self._closed = self._closed or reason
            self._changed.notify_all()

    def _process(self, kind: bytes, body: bytes) -> None:
        if kind == protocol.FRAME:
            time, frame, own = protocol.unpack_frame(body)
            self._now = max(self._now, time)
            if len(self._received) >= self.receive_limit:
                self.overruns += 1
            else:
                self._received.append(can_frame.ReceivedFrame(time, frame, own))
        elif kind in (protocol.SENT, protocol.REFUSED):
            self._unsent = max(self._unsent - 1, 0)
        elif kind == protocol.STATE:
            state = read_json(body)
            self._state = can_frame.ErrorState(state["state"])
            # The simulated CAN controller clears its send queue when it enters bus-off and when it
            # restarts.
            self._unsent = max(self._unsent - state["dropped"], 0)
        elif kind == protocol.TIME:
            self._now = protocol.unpack_time(body)
