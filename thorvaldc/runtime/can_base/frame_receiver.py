"""What comes from a bus: the newest of each frame, and events in a ring that drops the oldest."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from thorvaldc.can.frame import ReceivedFrame
from thorvaldc.can.interface import CanInterface
from thorvaldc.can.nanoseconds import NANOSECONDS

RING = 512
"""Events that wait for the loop."""
_LISTEN = 0.1
"""s after which the thread looks whether it shall end."""


class Latest(NamedTuple):
    """The newest frame of an identifier: when it came (s) and the how manieth it is."""

    time: float
    data: bytes
    number: int


class Receiver:
    """Takes frames from a port, in a thread of its own or when it is told to.

    ``latest`` holds the newest of each identifier.  Those in ``events`` go into a ring
    besides, where none replaces another; a full ring loses the oldest, counted in
    ``dropped``.  Only standard data frames count; others are counted in ``strange``.
    """

    def __init__(self, port: CanInterface, events: Collection[int], *, ring: int = RING) -> None:
        self.port = port
        self.latest: dict[int, Latest] = {}
        self.received = 0
        self.dropped = 0
        self.strange = 0
        self.lost: str = ""
        """Why nothing more will come; empty: it may."""
        self._events = frozenset(events)
        self._ring: deque[tuple[float, int, bytes]] = deque()
        self._limit = ring
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()

    def start(self) -> None:
        """Receive in a thread from now on."""
        self._thread = threading.Thread(target=self._run, name="CAN receiver", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._ends.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def drain(self) -> list[tuple[float, int, bytes]]:
        """The events since it was called last, the oldest first: time (s), identifier, data.

        Without a thread it takes first what waits at the port.
        """
        if self._thread is None and not self.lost:
            try:
                while (found := self.port.receive(0.0)) is not None:
                    self._take(found)
            except ConnectionError as fault:
                self.lost = str(fault) or "the interface is gone"
        with self._lock:
            events = list(self._ring)
            self._ring.clear()
        return events

    def _run(self) -> None:
        while not self._ends.is_set():
            try:
                found = self.port.receive(_LISTEN)
            except ConnectionError as fault:
                if not self._ends.is_set():
                    self.lost = str(fault) or "the interface is gone"
                return
            if found is not None:
                self._take(found)

    def _take(self, found: ReceivedFrame) -> None:
        frame = found.frame
        if found.own:
            return
        if frame.extended or frame.remote:
            self.strange += 1
            return
        self.received += 1
        time = found.time / NANOSECONDS
        before = self.latest.get(frame.id)
        number = 1 if before is None else before.number + 1
        self.latest[frame.id] = Latest(time, frame.data, number)
        if frame.id in self._events:
            with self._lock:
                if len(self._ring) >= self._limit:
                    self._ring.popleft()
                    self.dropped += 1
                self._ring.append((time, frame.id, frame.data))
