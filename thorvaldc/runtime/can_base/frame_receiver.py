"""Receives CAN frames for the control cycle."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from thorvaldc.can.frame import ReceivedFrame
from thorvaldc.can.interface import CanInterface
from thorvaldc.can.nanoseconds import NANOSECONDS

EVENT_LIMIT = 512
"""Size of the event queue, in frames."""
_POLL = 0.005
"""Longest time (s) for which the receiving thread waits for a frame."""


class Event(NamedTuple):
    """A received CAN frame that must not be skipped, such as a heartbeat or an EMCY message."""

    time: float
    cob_id: int
    data: bytes


class LatestFrame(NamedTuple):
    """The newest received CAN frame with a given identifier.

    - ``time``: time of reception (s);
    - ``data``: data bytes of the frame;
    - ``number``: number of frames received with this identifier.
    """

    time: float
    data: bytes
    number: int


class FrameReceiver:
    """Receives CAN frames in a separate thread or in the method ``drain``.

    - ``latest``: newest frame of each identifier, which is sufficient for periodic reports;
    - ``received``: number of received data frames with standard identifier;
    - ``dropped``: number of events that were lost because the event queue was full;
    - ``ignored``: number of extended and remote frames, which CANopen does not use;
    - ``ignored_id``: identifier of the newest of them that has the number of an event, or ``None``;
    - ``drained_until``: time (s) up to which all frames on the bus are in ``latest``, and were
      returned by ``drain``.  Frames that still wait in the CAN interface, because the receiving
      thread runs late, are newer.

    CAN frames whose identifiers are in the parameter ``events`` are also put into the event queue.
    If the event queue is full, the oldest CAN frame in the event queue is dropped.
    """

    def __init__(
        self, interface: CanInterface, events: Collection[int], *, limit: int = EVENT_LIMIT
    ) -> None:
        self.interface = interface
        self.latest: dict[int, LatestFrame] = {}
        self.received = 0
        self.dropped = 0
        self.ignored = 0
        self.ignored_id: int | None = None
        self.drained_until = -math.inf
        self.lost: str = ""
        """Reason why the CAN interface is lost; empty if the CAN interface works."""
        self._event_ids = frozenset(events)
        self._events: deque[Event] = deque()
        self._limit = limit
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._read_until = -math.inf

    def start(self) -> None:
        """Starts the thread that receives CAN frames."""
        self._thread = threading.Thread(target=self._run, name="CAN receiver", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def drain(self) -> list[Event]:
        """Returns the CAN frames of the event queue since the last call of ``drain``, the oldest
        first.

        If the receiving thread was not started, ``drain`` first reads all CAN frames from the CAN
        interface.
        """
        if self._thread is None and not self.lost:
            self._read_until = self.interface.received_until
            try:
                while (received := self.interface.receive(0.0)) is not None:
                    self._store(received)
            except ConnectionError as error:
                self.lost = str(error) or "the interface is lost"
        with self._lock:
            self.drained_until = self._read_until
            events = list(self._events)
            self._events.clear()
        return events

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                received_until = self.interface.received_until
                received = self.interface.receive(_POLL)
            except ConnectionError as error:
                if not self._stopping.is_set():
                    self.lost = str(error) or "the interface is lost"
                return
            if received is None:
                self._read_until = received_until
            else:
                self._store(received)
                self._read_until = received.time / NANOSECONDS

    def _store(self, received: ReceivedFrame) -> None:
        frame = received.frame
        if received.own:
            return
        if frame.extended or frame.remote:
            self.ignored += 1
            if frame.id in self._event_ids:
                self.ignored_id = frame.id
            return
        self.received += 1
        time = received.time / NANOSECONDS
        previous = self.latest.get(frame.id)
        number = 1 if previous is None else previous.number + 1
        self.latest[frame.id] = LatestFrame(time, frame.data, number)
        if frame.id in self._event_ids:
            with self._lock:
                if len(self._events) >= self._limit:
                    self._events.popleft()
                    self.dropped += 1
                self._events.append(Event(time, frame.id, frame.data))
