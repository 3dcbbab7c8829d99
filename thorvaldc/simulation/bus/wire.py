"""The wire that CAN controllers share: arbitration, frame times and errors (ISO 11898-1).

The simulation computes one event per frame, not one per bit.

Arbitration.  When the wire is free, all controllers with a waiting frame start at the same bit.
A 0 is dominant: a controller that sends a 1 and reads a 0 has lost and becomes a receiver.  So
the lowest arbitration field wins, and the winner does not notice the others:

    bit        SOF 10  9  8  7  6  5  4  3 ...
    A 0x185     0   0  0  1  1  0  0  0  0      wins
    B 0x285     0   0  1  .  .  .  .  .  .      reads 0 for its 1 at bit 9, and stops
    wire        0   0  0  1  1  0  0  0  0

Two controllers with the same identifier do not notice each other until their frames differ.  Equal
frames pass as one.  If they differ, the controller that sends 1 reads 0 outside of the arbitration
field: a bit error.  If it is error-active, it destroys the frame with an error flag:

    time -->
    frame of A  |SOF|identifier|length|data 01 2 |
    frame of B  |SOF|identifier|length|data 01 3 |
    error flag of the loser                      |000000|
    echo of the flag from all others                    |000000|
    error delimiter, interframe space                          |11111111|111|
                                                 |<- FLAG ->|<- FLAG ->|     |
    next arbitration: all senders try again                                  |SOF ...

If the loser is error-passive, its flag is recessive and the other frame passes.

Error counters after an error: sender +8; receivers +1; the receiver that sent its flag first +9,
because it also sees the dominant bits of the flags of the others.

A frame ends for its receivers before the interframe space.  If no controller acknowledges it, the
sender repeats it, and its transmit errors stop to count at error-passive.

docs/simulated-bus.md lists the simplifications.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import INTERFRAME_BITS, CanFrame, first_difference, frame_bits
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.simulation.bus.can_controller import CanController, QueuedFrame
from thorvaldc.simulation.bus.timeline import Event, Timeline

FLAG_BITS = 6
DELIMITER_BITS = 8
MISMATCH_BIT = 13
"""Bit of a frame at which a controller with another bitrate detects its first error (assumed)."""


class _Transmission:
    """A frame on the wire, its senders, and the listeners that were online at its start."""

    __slots__ = ("bits", "event", "frame", "listeners", "queued", "senders", "start")

    def __init__(
        self,
        frame: CanFrame,
        senders: list[CanController],
        queued: list[QueuedFrame],
        listeners: list[CanController],
        start: int,
    ) -> None:
        """``queued``: the entry in the send queue of each sender.  ``start`` in ns."""
        self.frame = frame
        self.senders = senders
        self.queued = queued
        self.listeners = listeners
        self.start = start
        self.bits = frame_bits(frame)
        self.event: Event | None = None


Observer = Callable[[int, CanFrame, Sequence[CanController]], None]
"""Called with the time (ns), the frame and the senders of each valid frame."""


class Wire:
    """A bus line that connects controllers in one timeline.

    ``bitrate`` (bit/s) is the nominal one; each controller has its own.  ``frames`` counts
    the valid frames and ``errors`` the destroyed or unacknowledged ones; ``busy`` is the time
    (ns) that both occupied the wire.  ``noise`` is the share of frames (0..1) that are
    destroyed at random; ``seed`` determines which.
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
        self._arbitration: Event | None = None
        self._at_frame: dict[int, list[Callable[[], None]]] = {}

    def attach(self, controller: CanController) -> None:
        self.controllers.append(controller)

    def detach(self, controller: CanController) -> None:
        controller.switch_off()
        self.controllers.remove(controller)

    def at_frame(self, number: int, action: Callable[[], None]) -> None:
        """Calls ``action`` in the middle of the frame with this number; the first frame is 1."""
        self._at_frame.setdefault(number, []).append(action)

    # -- arbitration ------------------------------------------------------------------------

    def wake(self) -> None:
        """Plans an arbitration for the next moment at which the wire is free."""
        if self._current is None and self._arbitration is None:
            self._plan_arbitration(max(self.timeline.now, self._free_at))

    def _plan_arbitration(self, time: int) -> None:
        if self._arbitration is not None:
            self._arbitration.cancel()
        # After all other events of that time, so that every frame queued by then takes part.
        self._arbitration = self.timeline.at(time, self._arbitrate, last=True)

    def _arbitrate(self) -> None:
        self._arbitration = None
        now = self.timeline.now
        contenders: list[tuple[int, CanController, QueuedFrame]] = []
        next_ready = 0
        for controller in self.controllers:
            head = controller.head()
            if head is None:
                continue
            ready_at = controller.ready_at()
            if ready_at > now:
                next_ready = min(next_ready or ready_at, ready_at)
            else:
                contenders.append((head.frame.arbitration, controller, head))
        if not contenders:
            if next_ready:
                self._plan_arbitration(next_ready)
            return
        lowest = min(field for field, _, _ in contenders)
        senders = [controller for field, controller, _ in contenders if field == lowest]
        queued = [head for field, _, head in contenders if field == lowest]
        frame = queued[0].frame
        if len(senders) > 1:
            # Zeros are dominant: among equal identifiers the lowest length and data remain.
            frame = min((head.frame for head in queued), key=lambda f: (f.length, f.data))
        listeners = [c for c in self.controllers if c.online and c not in senders]
        current = _Transmission(frame, senders, queued, listeners, now)
        self._current = current
        for action in self._at_frame.pop(self.frames + 1, ()):
            middle = now + senders[0].time_of(current.bits // 2)
            self.timeline.at(middle, action)
        error = self._find_error(current)
        if error is None:
            end = now + senders[0].time_of(current.bits - INTERFRAME_BITS)
            current.event = self.timeline.at(end, self._finish)
        else:
            error_bit, detectors = error
            current.event = self.timeline.at(
                now + senders[0].time_of(error_bit), lambda: self._destroy(detectors)
            )

    def _find_error(self, current: _Transmission) -> tuple[int, list[CanController]] | None:
        """Returns the bit at which an error flag starts, and the controllers that send it first.

        ``None``: no active error flag destroys the frame.
        """
        senders, frame = current.senders, current.frame
        rate = senders[0].bitrate
        mismatched = [c for c in (*senders, *current.listeners) if c.bitrate != rate]
        flagging = [c for c in mismatched if c.state is ErrorState.ACTIVE and not c.listen_only]
        if flagging or any(s.bitrate != rate for s in senders):
            return MISMATCH_BIT, mismatched
        losers = [
            (sender, head.frame)
            for sender, head in zip(senders, current.queued, strict=True)
            if head.frame != frame
        ]
        active = [lost for sender, lost in losers if sender.state is ErrorState.ACTIVE]
        if active:
            difference = min(first_difference(frame, lost) for lost in active)
            return difference + 1, []
        if losers:
            # All losers are error-passive: their flags are recessive, and the frame goes on.
            current.senders = [s for s in senders if all(s is not loser for loser, _ in losers)]
            current.queued = [head for head in current.queued if head.frame == frame]
            for sender, _ in losers:
                sender.count_errors(transmit=8)
                sender.suspend()
        if self.noise and self._random.random() < self.noise:
            return self._random.randrange(1, current.bits - INTERFRAME_BITS), []
        return None

    # -- ends of a frame -----------------------------------------------------------------------

    def _finish(self) -> None:
        """End of frame, before the interframe space: the frame is valid for its receivers."""
        current = self._current
        if current is None:
            return
        rate = current.senders[0].bitrate
        listening = [c for c in current.listeners if c.online_at(current.start)]
        receivers = [c for c in listening if c.bitrate == rate]
        if all(c.listen_only for c in receivers):
            self._end_unacknowledged(current)
            return
        self._current = None
        self.frames += 1
        self._release_wire(current, INTERFRAME_BITS)
        for controller in listening:
            if controller.bitrate != rate and not controller.listen_only:
                controller.count_errors(receive=1)
        now = self.timeline.now
        for observer in self.observers:
            observer(now, current.frame, current.senders)
        for sender, queued in zip(current.senders, current.queued, strict=True):
            sender.frame_sent(queued)
        for receiver in receivers:
            receiver.frame_received(current.frame)

    def _end_unacknowledged(self, current: _Transmission) -> None:
        """Acknowledge error.  ISO 11898-1: it takes a lone sender no further than error-passive."""
        self.errors += 1
        self._current = None
        for sender in current.senders:
            if sender.state is ErrorState.ACTIVE:
                sender.count_errors(transmit=8)
        self._release_wire(current, FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for sender in current.senders:
            sender.suspend()

    def _destroy(self, detectors: Iterable[CanController]) -> None:
        """Error flag: all controllers drop the frame; its senders try again.

        ``detectors``: the controllers that send their flag first.
        """
        current = self._current
        if current is None:
            return
        self.errors += 1
        self._current = None
        first = list(detectors)
        self._release_wire(current, 2 * FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for sender in current.senders:
            sender.count_errors(transmit=8)
            sender.suspend()
        for listener in current.listeners:
            if listener.online and not listener.listen_only:
                listener.count_errors(receive=9 if listener in first else 1)

    def dropped(self, controller: CanController) -> None:
        """Handles the loss of a controller; a frame that it alone was sending breaks off."""
        current = self._current
        if current is None or controller not in current.senders:
            return
        if len(current.senders) > 1:
            index = current.senders.index(controller)
            current.senders = [s for s in current.senders if s is not controller]
            current.queued = [head for i, head in enumerate(current.queued) if i != index]
            return
        if current.event is not None:
            current.event.cancel()
        self.errors += 1
        self._current = None
        # A stuff error after 6 equal bits, then the flag and its echo.
        self._release_wire(current, 3 * FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for listener in current.listeners:
            if listener.online and not listener.listen_only:
                listener.count_errors(receive=1)

    def _release_wire(self, current: _Transmission, more_bits: int) -> None:
        """Frees the wire after ``more_bits`` bits, and plans the next arbitration for then."""
        rest = more_bits * NANOSECONDS // current.senders[0].bitrate
        self._free_at = self.timeline.now + rest
        self.busy += self._free_at - current.start
        self._plan_arbitration(self._free_at)
