"""The wire that CAN controllers are on: arbitration, frame times and errors.

Follows ISO 11898-1 frame by frame: what lies inside a frame (the place of an error, say)
is computed, not stepped through bit by bit.  What is simplified is listed in
docs/simulated-bus.md.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import INTERFRAME_BITS, CanFrame, first_difference, frame_bits
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.timeline import Event, Timeline

FLAG_BITS = 6
DELIMITER_BITS = 8
MISMATCH_BIT = 13
"""Where a controller of another bitrate is taken to see its first error in a frame."""


class _Transmission:
    """A frame on the wire: who sends it, who heard its start."""

    __slots__ = ("bits", "entries", "event", "frame", "listeners", "senders", "start")

    def __init__(
        self,
        frame: CanFrame,
        senders: list[CanController],
        entries: list[tuple[int, int, CanFrame]],
        listeners: list[CanController],
        start: int,
    ) -> None:
        self.frame = frame
        self.senders = senders
        self.entries = entries
        self.listeners = listeners
        self.start = start
        self.bits = frame_bits(frame)
        self.event: Event | None = None


Observer = Callable[[int, CanFrame, Sequence[CanController]], None]


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
        self.controllers: list[CanController] = []
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

    def attach(self, controller: CanController) -> None:
        self.controllers.append(controller)

    def detach(self, controller: CanController) -> None:
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
        ready: list[tuple[int, CanController, tuple[int, int, CanFrame]]] = []
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

    def _break(self, current: _Transmission) -> tuple[int, list[CanController]] | None:
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

    def _fail(self, first: Iterable[CanController]) -> None:
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

    def dropped(self, controller: CanController) -> None:
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
