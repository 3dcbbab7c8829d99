"""The wire and the CAN controllers on it: arbitration, frame times, errors and their counters.

Follows ISO 11898-1 frame by frame: what lies inside a frame (the place of an error, say)
is computed, not stepped through bit by bit.  What is simplified is listed in
docs/simulated-bus.md.
"""

from __future__ import annotations

import bisect
import enum
import random
from collections.abc import Callable, Iterable, Sequence

from thorvaldc.runtime.bus.frame import (
    INTERFRAME_BITS,
    CanFrame,
    first_difference,
    frame_bits,
)
from thorvaldc.runtime.bus.timeline import NANOSECONDS, Event, Timeline

SUSPEND_BITS = 8
"""What an error-passive controller waits longer after a frame of its own."""
JOIN_BITS = 11
"""Recessive bits that a controller waits for before it takes part."""
RECOVERY_BITS = 128 * 11
"""What a controller in bus-off waits for before it takes part again."""
FLAG_BITS = 6
DELIMITER_BITS = 8
MISMATCH_BIT = 13
"""Where a controller of another bitrate is taken to see its first error in a frame."""
QUEUE_LIMIT = 32


class ErrorState(enum.Enum):
    """Of a controller: ``PASSIVE`` from 128 of either counter, ``BUS_OFF`` from 256 sent."""

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"


class Controller:
    """A CAN controller on a wire: its send queue, error counters and state.

    ``on_frame`` is called with each frame received, ``on_sent`` with each of its own
    that got through, ``on_state`` when the error state changes.  ``accepts`` may turn
    received frames away (they are acknowledged all the same, and counted in ``lost``).

    Of the frames that wait the one with the lowest identifier is sent first, or with
    ``fifo`` the oldest.  A full queue refuses the newest.  In bus-off the queue is
    emptied; with ``auto_recovery`` the controller comes back after 128 x 11 bits.
    """

    def __init__(
        self,
        wire: Wire,
        name: str,
        bitrate: int,
        *,
        queue_limit: int = QUEUE_LIMIT,
        fifo: bool = False,
        listen_only: bool = False,
        auto_recovery: bool = True,
    ) -> None:
        self.wire = wire
        self.name = name
        self.bitrate = bitrate
        self.queue_limit = queue_limit
        self.fifo = fifo
        self.listen_only = listen_only
        self.auto_recovery = auto_recovery
        self.on_frame: Callable[[CanFrame], None] | None = None
        self.on_sent: Callable[[CanFrame], None] | None = None
        self.on_state: Callable[[ErrorState], None] | None = None
        self.accepts: Callable[[CanFrame], bool] | None = None
        self.transmit_errors = 0
        self.receive_errors = 0
        self.sent = 0
        self.received = 0
        self.refused = 0
        self.lost = 0
        self.powered = False
        self.bus_off = False
        self._queue: list[tuple[int, int, CanFrame]] = []
        self._queued = 0
        self._waits_until = 0
        self._online_since = 0
        self._recovery: Event | None = None

    # -- what its owner does -----------------------------------------------------------

    @property
    def online(self) -> bool:
        return self.powered and not self.bus_off

    @property
    def state(self) -> ErrorState:
        if self.bus_off:
            return ErrorState.BUS_OFF
        passive = self.transmit_errors > 127 or self.receive_errors > 127
        return ErrorState.PASSIVE if passive else ErrorState.ACTIVE

    @property
    def pending(self) -> int:
        """Frames that wait to be sent."""
        return len(self._queue)

    def send(self, frame: CanFrame) -> bool:
        """Queue a frame; ``False`` where it is refused: full, off, or only listening."""
        if not self.online or self.listen_only or len(self._queue) >= self.queue_limit:
            self.refused += 1
            return False
        self._queued += 1
        order = 0 if self.fifo else frame.arbitration
        bisect.insort(self._queue, (order, self._queued, frame))
        self.wire.wake()
        return True

    def switch_on(self) -> None:
        """Take part from now on, with counters at zero."""
        if not self.powered:
            self.powered = True
            self._join()

    def switch_off(self) -> None:
        """Power gone: the queue and the counters with it, a frame under way is broken off."""
        if self.powered:
            self.powered = self.bus_off = False
            self._leave()
            self.transmit_errors = self.receive_errors = 0

    def restart(self) -> None:
        """Come back from bus-off, or start again with another bitrate."""
        if self.powered:
            was = self.state
            self.bus_off = False
            self._leave()
            self._join()
            self._tell(was)

    def go_bus_off(self) -> None:
        """What too many transmit errors lead to."""
        was = self.state
        if was is not ErrorState.BUS_OFF and self.powered:
            self.bus_off = True
            self._leave()
            if self.auto_recovery:
                delay = self.time_of(RECOVERY_BITS)
                self._recovery = self.wire.timeline.after(delay, self.restart)
            self._tell(was)

    def time_of(self, bits: int) -> int:
        """ns that so many bits take."""
        return bits * NANOSECONDS // self.bitrate

    # -- what the wire does ---------------------------------------------------------------

    def _join(self) -> None:
        self.transmit_errors = self.receive_errors = 0
        self._online_since = self.wire.timeline.now
        self._waits_until = self._online_since + self.time_of(JOIN_BITS)

    def _leave(self) -> None:
        self._queue.clear()
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None
        self.wire.dropped(self)

    def head(self) -> tuple[int, int, CanFrame] | None:
        return self._queue[0] if self._queue and not self.listen_only else None

    def waits_until(self) -> int:
        return self._waits_until

    def heard_since(self, time: int) -> bool:
        return self.online and self._online_since <= time

    def done(self, entry: tuple[int, int, CanFrame], suspend: bool) -> None:
        """A frame of its own got through."""
        was = self.state
        place = bisect.bisect_left(self._queue, entry)
        if place < len(self._queue) and self._queue[place] is entry:
            del self._queue[place]
        self.transmit_errors = max(self.transmit_errors - 1, 0)
        self.sent += 1
        if suspend:
            self.suspend()
        if self.on_sent is not None:
            self.on_sent(entry[2])
        self._tell(was)

    def suspend(self) -> None:
        if self.state is ErrorState.PASSIVE:
            bits = INTERFRAME_BITS + SUSPEND_BITS
            self._waits_until = self.wire.timeline.now + self.time_of(bits)

    def hear(self, frame: CanFrame) -> None:
        was = self.state
        errors = self.receive_errors
        self.receive_errors = 127 if errors > 127 else max(errors - 1, 0)
        if self.accepts is not None and not self.accepts(frame):
            self.lost += 1
        else:
            self.received += 1
            if self.on_frame is not None:
                self.on_frame(frame)
        self._tell(was)

    def count(self, transmit: int = 0, receive: int = 0) -> None:
        """Count errors, and draw the conclusions."""
        was = self.state
        self.transmit_errors += transmit
        self.receive_errors = min(self.receive_errors + receive, 255)
        if self.transmit_errors > 255:
            self.go_bus_off()
        else:
            self._tell(was)

    def _tell(self, was: ErrorState) -> None:
        if self.on_state is not None and self.state is not was:
            self.on_state(self.state)


class _Transmission:
    """A frame on the wire: who sends it, who heard its start."""

    __slots__ = ("bits", "entries", "event", "frame", "listeners", "senders", "start")

    def __init__(
        self,
        frame: CanFrame,
        senders: list[Controller],
        entries: list[tuple[int, int, CanFrame]],
        listeners: list[Controller],
        start: int,
    ) -> None:
        self.frame = frame
        self.senders = senders
        self.entries = entries
        self.listeners = listeners
        self.start = start
        self.bits = frame_bits(frame)
        self.event: Event | None = None


Observer = Callable[[int, CanFrame, Sequence[Controller]], None]


class Wire:
    """A bus: joins its controllers in a timeline.

    ``bitrate`` (bit/s) is the one that is meant; each controller has its own.
    ``frames`` counts the frames that got through, ``errors`` those that did not;
    ``busy`` is the time (ns) that they took.  ``observers`` are called with time (ns),
    frame and senders of each that got through.  ``noise`` is the share of frames that
    is destroyed at random, from ``seed``.
    """

    def __init__(self, timeline: Timeline, bitrate: int = 500_000, *, seed: int = 0) -> None:
        self.timeline = timeline
        self.bitrate = bitrate
        self.controllers: list[Controller] = []
        self.observers: list[Observer] = []
        self.noise = 0.0
        self.frames = 0
        self.errors = 0
        self.busy = 0
        self._random = random.Random(f"{seed}:wire")
        self._current: _Transmission | None = None
        self._free_at = 0
        self._wake: Event | None = None
        self._at_frame: dict[int, list[Callable[[], None]]] = {}

    def attach(self, controller: Controller) -> None:
        self.controllers.append(controller)

    def detach(self, controller: Controller) -> None:
        controller.switch_off()
        self.controllers.remove(controller)

    def at_frame(self, number: int, action: Callable[[], None]) -> None:
        """Do it in the middle of the ``number``-th frame (the first is 1)."""
        self._at_frame.setdefault(number, []).append(action)

    # -- arbitration ------------------------------------------------------------------------

    def wake(self) -> None:
        """Somebody has something to send."""
        if self._current is None and self._wake is None:
            self._plan(max(self.timeline.now, self._free_at))

    def _plan(self, time: int) -> None:
        if self._wake is not None:
            self._wake.cancel()
        # After all else that happens at that time, so that all who want to send take part.
        self._wake = self.timeline.at(time, self._arbitrate, last=True)

    def _arbitrate(self) -> None:
        self._wake = None
        now = self.timeline.now
        ready: list[tuple[int, Controller, tuple[int, int, CanFrame]]] = []
        later = 0
        for controller in self.controllers:
            entry = controller.head()
            if entry is None:
                continue
            until = controller.waits_until()
            if until > now:
                later = min(later or until, until)
            else:
                ready.append((entry[2].arbitration, controller, entry))
        if not ready:
            if later:
                self._plan(later)
            return
        lowest = min(key for key, _, _ in ready)
        senders = [c for key, c, _ in ready if key == lowest]
        entries = [e for key, _, e in ready if key == lowest]
        frame = entries[0][2]
        if len(senders) > 1:
            # Zeros win: of several with one identifier the lowest length and data go through.
            frame = min((e[2] for e in entries), key=lambda f: (f.length, f.data))
        listeners = [c for c in self.controllers if c.online and c not in senders]
        current = _Transmission(frame, senders, entries, listeners, now)
        self._current = current
        for action in self._at_frame.pop(self.frames + 1, ()):
            middle = now + senders[0].time_of(current.bits // 2)
            self.timeline.at(middle, action)
        broken = self._break(current)
        if broken is None:
            end = now + senders[0].time_of(current.bits - INTERFRAME_BITS)
            current.event = self.timeline.at(end, self._finish)
        else:
            at, first = broken
            current.event = self.timeline.at(
                now + senders[0].time_of(at), lambda: self._fail(first)
            )

    def _break(self, current: _Transmission) -> tuple[int, list[Controller]] | None:
        """Where (bits) an error flag destroys the frame and who sees the error first."""
        senders, frame = current.senders, current.frame
        rate = senders[0].bitrate
        others = [c for c in (*senders, *current.listeners) if c.bitrate != rate]
        flagging = [c for c in others if c.state is ErrorState.ACTIVE and not c.listen_only]
        if flagging or any(s.bitrate != rate for s in senders):
            return MISMATCH_BIT, others
        losers = [(s, e) for s, e in zip(senders, current.entries, strict=True) if e[2] != frame]
        active = [e[2] for s, e in losers if s.state is ErrorState.ACTIVE]
        if active:
            at = min(first_difference(frame, other) for other in active)
            return at + 1, []
        if losers:
            # They see their bit errors, but their flags are recessive: the frame goes on.
            current.senders = [s for s in senders if all(s is not loser for loser, _ in losers)]
            current.entries = [e for e in current.entries if e[2] == frame]
            for sender, _ in losers:
                sender.count(transmit=8)
                sender.suspend()
        if self.noise and self._random.random() < self.noise:
            return self._random.randrange(1, current.bits - INTERFRAME_BITS), []
        return None

    # -- ends of a frame -----------------------------------------------------------------------

    def _finish(self) -> None:
        """The end of frame, but for the interframe space: valid for all who heard it."""
        current = self._current
        if current is None:
            return
        rate = current.senders[0].bitrate
        heard = [c for c in current.listeners if c.heard_since(current.start)]
        receivers = [c for c in heard if c.bitrate == rate]
        if all(c.listen_only for c in receivers):
            self._unacknowledged(current)
            return
        self._current = None
        self.frames += 1
        self._free(current, INTERFRAME_BITS)
        for controller in heard:
            if controller.bitrate != rate and not controller.listen_only:
                controller.count(receive=1)
        now = self.timeline.now
        for observer in self.observers:
            observer(now, current.frame, current.senders)
        for sender, entry in zip(current.senders, current.entries, strict=True):
            sender.done(entry, suspend=True)
        for receiver in receivers:
            receiver.hear(current.frame)

    def _unacknowledged(self, current: _Transmission) -> None:
        """Nobody acknowledges: an error, but it leads no further than to error-passive."""
        self.errors += 1
        self._current = None
        for sender in current.senders:
            if sender.state is ErrorState.ACTIVE:
                sender.count(transmit=8)
        self._free(current, FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for sender in current.senders:
            sender.suspend()

    def _fail(self, first: Iterable[Controller]) -> None:
        """An error flag: everybody drops the frame, its senders will try again."""
        current = self._current
        if current is None:
            return
        self.errors += 1
        self._current = None
        seen = list(first)
        self._free(current, 2 * FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for sender in current.senders:
            sender.count(transmit=8)
            sender.suspend()
        for listener in current.listeners:
            if listener.online and not listener.listen_only:
                # Who flags first sees the others' flags after its own: 8 more.
                listener.count(receive=9 if listener in seen else 1)

    def dropped(self, controller: Controller) -> None:
        """A controller is gone, perhaps in the middle of its frame."""
        current = self._current
        if current is None or controller not in current.senders:
            return
        if len(current.senders) > 1:
            place = current.senders.index(controller)
            current.senders = [s for s in current.senders if s is not controller]
            current.entries = [e for i, e in enumerate(current.entries) if i != place]
            return
        if current.event is not None:
            current.event.cancel()
        self.errors += 1
        self._current = None
        self._free(current, 3 * FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for listener in current.listeners:
            if listener.online and not listener.listen_only:
                listener.count(receive=1)

    def _free(self, current: _Transmission, more_bits: int) -> None:
        """The wire is free after so many bits more; whoever waits goes on then."""
        rest = more_bits * NANOSECONDS // current.senders[0].bitrate
        self._free_at = self.timeline.now + rest
        self.busy += self._free_at - current.start
        self._plan(self._free_at)
