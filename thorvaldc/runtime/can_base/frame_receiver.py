"""Receives CAN frames for the control cycle, measures the load of the bus, and detects frames that
arrive too often."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from thorvaldc.can.frame import NANOSECONDS, CanFrame, CanInterface, ReceivedFrame
from thorvaldc.model import Bus, FrameDefinition
from thorvaldc.model.bus import key_text
from thorvaldc.model.bus_timing import worst_case_bits

EVENT_LIMIT = 512
"""Size of the event queue, in frames."""
LOAD_WINDOW = 1.0
"""Time (s) over which the load of a bus is measured."""
_POLL = 0.005
"""Longest time (s) for which the receiving thread waits for a frame."""


class Event(NamedTuple):
    """A received CAN frame that must not be skipped, such as a heartbeat or an EMCY message."""

    time: float
    key: int
    data: bytes


class LatestFrame(NamedTuple):
    """The newest received CAN frame with a given key.

    - ``time``: time of reception (s);
    - ``data``: data bytes of the frame;
    - ``number``: number of frames received with this key.
    """

    time: float
    data: bytes
    number: int


class FrameReceiver:
    """Receives CAN frames in a separate thread or in the method ``drain``.

    - ``latest``: newest frame of each key (``CanFrame.key``), which is sufficient for periodic
      reports;
    - ``received``: number of received data frames, standard ones and known extended ones;
    - ``dropped``: number of events that were lost because the event queue was full;
    - ``ignored``: number of remote frames and of other extended frames, which CANopen does not use;
    - ``ignored_id``: identifier of the newest of them that has the number of an event, or ``None``;
    - ``bits_per_second``: bits of the frames on the bus in the last ``LOAD_WINDOW``, or ``None``
      before its end.  Each received or sent frame counts with the most stuff bits that it can have;
      error frames and repetitions do not count, which CAN controllers do not report;
    - ``drained_until``: time (s) up to which all frames on the bus are in ``latest``, and were
      returned by ``drain``.  Frames that still wait in the CAN interface, because the receiving
      thread runs late, are newer.

    CAN frames whose keys are in the parameter ``events`` are also put into the event queue.  If the
    event queue is full, the oldest CAN frame in the event queue is dropped.  The parameter
    ``extended`` has the keys of the known extended frames: ``latest`` must not grow with each of
    the other 29-bit identifiers.
    """

    def __init__(
        self,
        interface: CanInterface,
        events: Collection[int],
        extended: Collection[int] = (),
        *,
        limit: int = EVENT_LIMIT,
    ) -> None:
        self.interface = interface
        self.latest: dict[int, LatestFrame] = {}
        self.received = 0
        self.dropped = 0
        self.ignored = 0
        self.ignored_id: int | None = None
        self.bits_per_second: float | None = None
        self.drained_until = -math.inf
        self.lost: str = ""
        """Reason why the CAN interface is lost; empty if the CAN interface works."""
        self._event_keys = frozenset(events)
        self._extended = frozenset(extended)
        self._events: deque[Event] = deque()
        self._limit = limit
        self._lock = threading.Lock()
        self._receiving: threading.Thread | None = None
        self._stopping = threading.Event()
        self._read_until = -math.inf
        # The receiving thread and the control loop have a counter each.
        self._received_bits = self._sent_bits = self._window_bits = 0
        self._window_start = math.nan

    def start(self) -> None:
        """Starts the thread that receives CAN frames."""
        self._receiving = threading.Thread(target=self._run, name="CAN receiver", daemon=True)
        self._receiving.start()

    def stop(self) -> None:
        self._stopping.set()
        if self._receiving is not None:
            self._receiving.join(2.0)
            self._receiving = None

    def drain(self) -> list[Event]:
        """Returns the CAN frames of the event queue since the last call of ``drain``, the oldest
        first.

        If the receiving thread was not started, ``drain`` first reads all CAN frames from the CAN
        interface.
        """
        if self._receiving is None and not self.lost:
            self._read_until = self.interface.received_until
            try:
                while (received := self.interface.receive(0.0)) is not None:
                    self._store(received)
            except ConnectionError as error:
                self.lost = str(error) or "the interface is lost"
        self._measure_load(self.interface.now)
        with self._lock:
            self.drained_until = self._read_until
            events = list(self._events)
            self._events.clear()
        return events

    def count_sent(self, frame: CanFrame) -> None:
        """Counts a frame for the load of the bus."""
        self._sent_bits += worst_case_bits(frame.length, frame.extended)

    def _measure_load(self, now: float) -> None:
        bits, elapsed = self._received_bits + self._sent_bits, now - self._window_start
        if elapsed < LOAD_WINDOW:
            return
        if not math.isnan(elapsed):
            self.bits_per_second = (bits - self._window_bits) / elapsed
        self._window_bits, self._window_start = bits, now

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
        self._received_bits += worst_case_bits(frame.length, frame.extended)
        key = frame.key
        if frame.remote or (frame.extended and key not in self._extended):
            self.ignored += 1
            if frame.id in self._event_keys or key in self._event_keys:
                self.ignored_id = frame.id
            return
        self.received += 1
        time = received.time / NANOSECONDS
        previous = self.latest.get(key)
        number = 1 if previous is None else previous.number + 1
        self.latest[key] = LatestFrame(time, frame.data, number)
        if key in self._event_keys:
            with self._lock:
                if len(self._events) >= self._limit:
                    self._events.popleft()
                    self.dropped += 1
                self._events.append(Event(time, key, frame.data))


# -- detects CAN frames that arrive more often than the robot file states -----------------------
#
# Two devices with the same node id send every heartbeat and every report twice.  A program that
# sends false reports of a node adds frames to the true reports.  In both cases the number of frames
# in a time exceeds the number that the period T of the frame allows.  For each identifier the
# excess e, in frames, is computed from the times of reception t and from the number n of received
# frames:
#
#     e <- e + (n - n') - (t - t') (1 + TOLERANCE) / T          ': values of the previous sample
#
#     frames    x---x---x---x---x-x-x-x-x-x-x-x-x-x-x      T: period
#     excess    0   0   0   0   0 .   1   .   2   .   3    > EXCESS: too many frames
#
# The excess over every earlier time is the largest of these sums, so that e is at least 0 (CUSUM
# test).  The time t is the time of reception of the newest frame, not the present time.  The result
# therefore does not depend on the load of the computer:
#
# - Lost frames and frames that arrive late make the excess smaller.
# - Frames that a CAN adapter or a stalled program delivers in a burst follow a silence.  The
#   silence and the burst usually belong to the same sample, because t does not change during the
#   silence.  If a sample ends in the middle of the burst, the silence gives a credit (e < 0).  Of
#   the credit, ``CREDIT_SHARE`` is left in the next sample; the credit is at most
#   ``LONGEST_BURST``.
# - A device that sends some frames early, such as a heartbeat at each change of its NMT state,
#   stays below ``EXCESS``.
#
# The clock of a device on a CAN bus is more accurate than ``TOLERANCE``; otherwise its bit timing
# would fail.
#
# If all nodes send too many frames at once, it is the clock of the computer that is wrong: it stood
# while the bus went on, because the computer slept.  The watchdogs of the drives may have acted in
# this time, which the driver cannot see as a gap between two control cycles.

EXCESS = 5.0
"""Largest number of frames above the stated number."""
TOLERANCE = 0.01
"""Largest deviation of the rate of a device from the stated rate, as a share."""
LONGEST_BURST = 0.25
"""Largest time (s) of silence that gives a credit for the frames that follow."""
CREDIT_SHARE = 0.75
"""Share of the credit that is left in the next sample."""
SAMPLE_CYCLES = 5
"""Number of control cycles between two samples of the same identifier."""
LEAST_MISSED = 0.05
"""Shortest time (s) by which all nodes exceed the clock of the computer."""
OBSERVATION = 1.0
"""Shortest time (s) of observation before the motors are enabled.

After this time a second device that sends heartbeats with a period of 100 ms has exceeded
``EXCESS``."""


class _Rate:
    """Excess of one identifier; see the docstring of this module.

    ``period``: shortest allowed period (s) of the frame.
    """

    __slots__ = ("excess", "frame_name", "key", "name", "node", "number", "per_second", "time")

    def __init__(self, frame: FrameDefinition, period: float) -> None:
        self.key = frame.key
        self.node = frame.producer
        self.frame_name = frame.name
        self.name = frame.name.removeprefix(f"{frame.producer}_")
        self.per_second = (1.0 + TOLERANCE) / period
        self.clear(None)

    def clear(self, newest: LatestFrame | None) -> None:
        """Starts again without excess."""
        self.excess = 0.0
        self.number = 0 if newest is None else newest.number
        self.time: float | None = None if newest is None else newest.time

    def add(self, newest: LatestFrame) -> bool:
        """Takes a sample; returns ``True`` if too many frames were received."""
        self.excess = self.excess_with(newest)
        self.number, self.time = newest.number, newest.time
        return self.excess > EXCESS

    def excess_with(self, newest: LatestFrame | None) -> float:
        """Returns the excess that a sample would have, in frames."""
        if newest is None or self.time is None:
            return self.excess
        credit = LONGEST_BURST * self.per_second
        excess = self.excess if self.excess > 0.0 else CREDIT_SHARE * self.excess
        excess += newest.number - self.number - (newest.time - self.time) * self.per_second
        return excess if excess > -credit else -credit


class FrameRates:
    """Counts the periodic CAN frames of all nodes of one CAN bus.

    - ``excessive``: description of the first identifier with too many frames by name of the node;
    - ``missed_time``: time (s) that the clock of the computer has missed, as the frames of all
      nodes say, at the first identifier with too many frames; 0 if single nodes send too many.
    - ``latest``: newest received frame of each key.
    """

    def __init__(
        self,
        bus: Bus,
        nodes: Collection[str],
        latest: Mapping[int, LatestFrame],
        periods: Mapping[str, float],
    ) -> None:
        """Counts the frames of the nodes in ``nodes``.

        ``periods``: shortest period (s) of a frame by frame name, if the base driver makes the node
        send the frame more often than the robot file states.
        """
        self._latest = latest
        self._ids = {node.name: node.id for node in bus.nodes}
        rates = [
            _Rate(frame, periods.get(frame.name, period))
            for frame, period in _periodic_frames(bus)
            if frame.producer in nodes
        ]
        self._groups = [rates[i::SAMPLE_CYCLES] for i in range(SAMPLE_CYCLES)]
        self._next_group = 0
        self.excessive: dict[str, str] = {}
        self.missed_time = 0.0

    def change_periods(self, periods: Mapping[str, float]) -> None:
        """Changes the shortest allowed periods (s) of the frames in ``periods``, by frame name."""
        for group in self._groups:
            for rate in group:
                if rate.frame_name in periods:
                    rate.per_second = (1.0 + TOLERANCE) / periods[rate.frame_name]

    def clear(self) -> None:
        """Forgets all frames that were counted before."""
        self.excessive.clear()
        self.missed_time = 0.0
        for group in self._groups:
            for rate in group:
                rate.clear(self._latest.get(rate.key))

    def forget(self, nodes: Collection[str]) -> bool:
        """Counts the frames of some nodes anew; returns whether one of them sent too many."""
        noticed = [name for name in nodes if self.excessive.pop(name, "")]
        for group in self._groups:
            for rate in group:
                if rate.node in noticed:
                    rate.clear(self._latest.get(rate.key))
        return bool(noticed)

    def take_sample(self) -> None:
        """Takes a sample of a part of the identifiers; called once in each control cycle."""
        self._next_group = (self._next_group + 1) % SAMPLE_CYCLES
        for rate in self._groups[self._next_group]:
            newest = self._latest.get(rate.key)
            if newest is None or newest.number == rate.number:
                continue
            if rate.add(newest) and rate.node not in self.excessive:
                self.missed_time = self.missed_time or self._common_excess()
                self.excessive[rate.node] = (
                    f"{rate.name} ({key_text(rate.key)}) comes more often than the robot file "
                    f"states; {second_device(self._ids[rate.node])}"
                )

    def _common_excess(self) -> float:
        """Returns the time (s) by which the frames of every node exceed the clock, or 0.

        A node that sent nothing lately says nothing.  A single node cannot tell a second device
        from a clock that stands.
        """
        times: dict[str, float] = {}
        for rate in (rate for group in self._groups for rate in group):
            newest = self._latest.get(rate.key)
            if newest is not None:
                excess = rate.excess_with(newest) / rate.per_second
                times[rate.node] = max(times.get(rate.node, -math.inf), excess)
        common = min(times.values(), default=0.0)
        return common if len(times) > 1 and common > LEAST_MISSED else 0.0


def second_device(node_id: int) -> str:
    """Returns the question to the operator whether two devices have the same id."""
    return f"is a second device with the id {node_id} on the bus?"


def _periodic_frames(bus: Bus) -> Iterator[tuple[FrameDefinition, float]]:
    for frame in bus.frames:
        if frame.period is not None and frame.kind in ("pdo", "heartbeat", "broadcast"):
            yield frame, frame.period
