"""A simulated CAN bus line with arbitration, frame times and errors (ISO 11898-1).

The simulation computes one event per CAN frame, instead of one event per bit.

Arbitration: when the bus line is free, all CAN controllers with a CAN frame to send start at the
same bit.  The bit 0 is dominant.  A controller that sends a 1 and reads a 0 has lost the
arbitration and becomes a receiver.  The CAN frame with the lowest arbitration field thus wins the
arbitration without an error:

    bit        SOF 10  9  8  7  6  5  4  3 ...
    A 0x185     0   0  0  1  1  0  0  0  0      wins
    B 0x285     0   0  1  .  .  .  .  .  .      reads 0 for its 1 at bit 9, and stops
    wire        0   0  0  1  1  0  0  0  0

Two CAN controllers may send CAN frames with the same identifier at the same time.  If the two CAN
frames are equal, the receivers receive one CAN frame.  If the two CAN frames have different data,
one CAN controller sends a 1 and reads a 0 after the arbitration field.  The CAN controller then
detects a bit error.  An error-active CAN controller that detects a bit error destroys both CAN
frames with an error flag:

    time -->
    frame of A  |SOF|identifier|length|data 01 2 |
    frame of B  |SOF|identifier|length|data 01 3 |
    error flag of the loser                      |000000|
    echo of the flag from all others                    |000000|
    error delimiter, interframe space                          |11111111|111|
                                                 |<- FLAG ->|<- FLAG ->|     |
    next arbitration: all senders try again                                  |SOF ...

The error flag of an error-passive controller is recessive, so that the other frame is not
destroyed.

An error increases the transmit error counter of a sender by 8 and the receive error counter of a
receiver by 1.  The receive error counter of the receiver that sent the first error flag increases
by 9, because the receiver also detects the dominant bits of the other error flags.

A receiver accepts a CAN frame at the end of the CAN frame, before the interframe space.  A sender
repeats a CAN frame that no other CAN controller acknowledges.  A missing acknowledgement does not
increase the transmit error counter of an error-passive sender.

The page docs/simulated-bus.md lists the simplifications of the simulation.
"""

from __future__ import annotations

import bisect
import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from thorvaldc.can.frame import NANOSECONDS, CanFrame, ErrorState
from thorvaldc.can.frame_bits import INTERFRAME_BITS, first_difference, frame_bits
from thorvaldc.simulation.bus.timeline import Event, Timeline

# -- CAN controllers -------------------------------------------------------------------------------

# A CAN controller has a transmit error counter (TEC) and a receive error counter (REC).  The error
# counters determine the error state of the CAN controller:
#
#                  TEC > 127 or REC > 127               TEC > 255
#     error-active ----------------------> error-passive ---------> bus-off
#          ^   ^                                |                      |
#          |   +--------------------------------+                      |
#          |          TEC and REC < 128                                |
#          +-----------------------------------------------------------+
#                restart, or 128 x 11 recessive bits with auto_recovery
#
# An error-active CAN controller destroys a faulty CAN frame with a dominant error flag.  An
# error-passive CAN controller sends a recessive error flag, which other CAN controllers do not
# detect.  After each sent CAN frame, an error-passive CAN controller waits 8 more bit times.  A CAN
# controller in bus-off neither sends nor receives CAN frames.

SUSPEND_BITS = 8
"""Additional bit times that an error-passive controller waits after a sent frame."""
JOIN_BITS = 11
"""Number of recessive bits that a controller must detect before it sends or receives frames."""
RECOVERY_BITS = 128 * 11
"""Number of bit times in bus-off before the automatic recovery."""
QUEUE_LIMIT = 32


class QueuedFrame(NamedTuple):
    """A CAN frame in the send queue of a CAN controller.

    The CAN controller sends the CAN frame with the lowest ``priority`` first.  CAN frames with
    equal priorities are sent in the order of ``number``.
    """

    priority: int
    number: int
    frame: CanFrame


class CanController:
    """A simulated CAN controller with a send queue, error counters and an error state.

    The CAN controller sends the queued CAN frame with the lowest identifier first.  If ``fifo`` is
    true, the CAN controller sends the oldest queued CAN frame first.  If the send queue is full, a
    new CAN frame is not queued.  The send queue is cleared when the CAN controller enters bus-off.
    If ``auto_recovery`` is true, the CAN controller leaves bus-off after 128 x 11 bit times.

    Attributes that the user of the CAN controller may set:

    * ``on_frame``: function that the controller calls for each received frame.
    * ``on_sent``: function that the controller calls after a frame was sent.
    * ``on_state``: function that the controller calls after a change of the error state.
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
        self.transmit_errors = 0
        self.receive_errors = 0
        self.sent = 0
        self.powered = False
        self.bus_off = False
        self.queue: list[QueuedFrame] = []
        self._queued = 0
        self._ready_at = 0
        self._online_since = 0
        self._recovery: Event | None = None

    # -- for the device or program that owns the controller -----------------------------

    @property
    def online(self) -> bool:
        """True if the CAN controller has power and is not in bus-off."""
        return self.powered and not self.bus_off

    @property
    def state(self) -> ErrorState:
        if self.bus_off:
            return ErrorState.BUS_OFF
        passive = self.transmit_errors > 127 or self.receive_errors > 127
        return ErrorState.PASSIVE if passive else ErrorState.ACTIVE

    @property
    def pending(self) -> int:
        """Number of CAN frames in the send queue."""
        return len(self.queue)

    def send(self, frame: CanFrame) -> bool:
        """Adds a CAN frame to the send queue.

        Returns ``False`` if the send queue is full or the CAN controller cannot send.
        """
        if not self.online or self.listen_only or len(self.queue) >= self.queue_limit:
            return False
        self._queued += 1
        priority = 0 if self.fifo else frame.arbitration
        bisect.insort(self.queue, QueuedFrame(priority, self._queued, frame))
        self.wire.wake()
        return True

    def switch_on(self) -> None:
        """Switches the CAN controller on and sets both error counters to zero."""
        if not self.powered:
            self.powered = True
            self._join()

    def switch_off(self) -> None:
        """Switches the CAN controller off, as after a loss of power.

        The send queue and the error counters of the CAN controller are cleared.  The transmission
        of the current CAN frame is aborted.
        """
        if self.powered:
            self.powered = self.bus_off = False
            self._leave()
            self.transmit_errors = self.receive_errors = 0

    def restart(self) -> None:
        """Restarts the CAN controller after bus-off or after a change of the bitrate."""
        if self.powered:
            previous = self.state
            self.bus_off = False
            self._leave()
            self._join()
            self._report_change(previous)

    def go_bus_off(self) -> None:
        """Sets the CAN controller to bus-off, as if the transmit error counter exceeded 255."""
        previous = self.state
        if previous is not ErrorState.BUS_OFF and self.powered:
            self.bus_off = True
            self._leave()
            if self.auto_recovery:
                delay = self.time_of(RECOVERY_BITS)
                self._recovery = self.wire.timeline.after(delay, self.restart)
            self._report_change(previous)

    def time_of(self, bits: int) -> int:
        """Returns the duration (ns) of ``bits`` bits at the bitrate of the CAN controller."""
        return bits * NANOSECONDS // self.bitrate

    # -- for the wire ----------------------------------------------------------------------

    def head(self) -> QueuedFrame | None:
        """Returns the next CAN frame to send, or ``None`` if no CAN frame can be sent."""
        return self.queue[0] if self.queue and not self.listen_only else None

    def ready_at(self) -> int:
        """Returns the earliest time (ns) at which the CAN controller may send a CAN frame."""
        return self._ready_at

    def online_at(self, time: int) -> bool:
        """Returns true if the CAN controller has been online since the time ``time`` (ns)."""
        return self.online and self._online_since <= time

    def frame_sent(self, queued: QueuedFrame) -> None:
        """Removes a CAN frame from the send queue after the successful transmission."""
        queue = self.queue
        if queue and queue[0] is queued:
            del queue[0]
        else:
            index = bisect.bisect_left(queue, queued)
            if index < len(queue) and queue[index] is queued:
                del queue[index]
        self.sent += 1
        errors = self.transmit_errors
        previous = self.state if errors else ErrorState.ACTIVE
        if errors:
            self.transmit_errors = errors - 1
        self.suspend()
        if self.on_sent is not None:
            self.on_sent(queued.frame)
        if errors:
            self._report_change(previous)

    def suspend(self) -> None:
        """Delays the next CAN frame of an error-passive CAN controller (suspend transmission)."""
        passive = self.transmit_errors > 127 or self.receive_errors > 127
        if passive and not self.bus_off:
            bits = INTERFRAME_BITS + SUSPEND_BITS
            self._ready_at = self.wire.timeline.now + self.time_of(bits)

    def frame_received(self, frame: CanFrame, lost: bool = False) -> None:
        """Receives a valid CAN frame and decreases the receive error counter.

        The receive error counter decreases by 1, or from a value above 127 to 127 (ISO 11898-1).
        If ``lost`` is true, the CAN controller acknowledges the CAN frame and drops it.
        """
        errors = self.receive_errors
        if errors:
            previous = self.state
            self.receive_errors = 127 if errors > 127 else errors - 1
            self._report_change(previous)
        if not lost:
            self.deliver(frame)

    def deliver(self, frame: CanFrame) -> None:
        """Passes a CAN frame to the device or program that owns the CAN controller."""
        if self.on_frame is not None:
            self.on_frame(frame)

    def count_errors(self, transmit: int = 0, receive: int = 0) -> None:
        """Increases the error counters and updates the error state of the CAN controller."""
        previous = self.state
        self.transmit_errors += transmit
        self.receive_errors = min(self.receive_errors + receive, 255)
        if self.transmit_errors > 255:
            self.go_bus_off()
        else:
            self._report_change(previous)

    # -- inside ------------------------------------------------------------------------------

    def _join(self) -> None:
        self.transmit_errors = self.receive_errors = 0
        self._online_since = self.wire.timeline.now
        self._ready_at = self._online_since + self.time_of(JOIN_BITS)

    def _leave(self) -> None:
        self.queue.clear()
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None
        self.wire.dropped(self)

    def _report_change(self, previous: ErrorState) -> None:
        if self.on_state is not None and self.state is not previous:
            self.on_state(self.state)


FLAG_BITS = 6
DELIMITER_BITS = 8
MISMATCH_BIT = 13
"""Assumed bit of a frame at which a controller with another bitrate detects the first error."""


@dataclass(slots=True)
class _Transmission:
    """The transmission of a CAN frame on the bus line.

    - ``senders``: CAN controllers that send the CAN frame.
    - ``queued``: queued CAN frame of each sender.
    - ``listeners``: CAN controllers that were online at the start of the CAN frame.
    - ``start``: start time (ns) of the transmission.
    """

    frame: CanFrame
    senders: list[CanController]
    queued: list[QueuedFrame]
    listeners: list[CanController]
    start: int
    bits: int
    event: Event | None = None


Observer = Callable[[int, CanFrame, Sequence[CanController]], None]
"""Function that is called with the time (ns), the frame and the senders of each valid frame."""
Filter = Callable[[CanController, CanFrame], bool]
"""Function that returns ``False`` if the CAN controller loses the received CAN frame."""


class Wire:
    """A simulated CAN bus line that connects CAN controllers.

    * ``timeline``: virtual time of the simulation.
    * ``bitrate``: nominal bitrate (bit/s).  Each CAN controller may have a different bitrate.
    * ``frames``: number of valid frames.
    * ``errors``: number of frames that were destroyed or not acknowledged.
    * ``busy``: total duration (ns) of all valid and faulty frames.
    * ``noise``: probability (0..1) that a frame is destroyed by a random error.
    * ``filters``: filters for the CAN frames that the CAN controllers on the bus line receive.
    * ``seed``: seed of the random errors.
    """

    def __init__(self, timeline: Timeline, bitrate: int = 500_000, *, seed: int = 0) -> None:
        self.timeline = timeline
        self.bitrate = bitrate
        self.controllers: list[CanController] = []
        self.observers: list[Observer] = []
        self.filters: list[Filter] = []
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
        """Calls ``action`` in the middle of the CAN frame with the number ``number``.

        The first CAN frame on the bus line has the number 1.
        """
        self._at_frame.setdefault(number, []).append(action)

    # -- arbitration ------------------------------------------------------------------------

    def wake(self) -> None:
        """Schedules an arbitration for the next time at which the bus line is free."""
        if self._current is None and self._arbitration is None:
            self._plan_arbitration(max(self.timeline.now, self._free_at))

    def _plan_arbitration(self, time: int) -> None:
        if self._arbitration is not None:
            self._arbitration.cancel()
        # The arbitration runs after all other events with the same time, so that all queued frames
        # take part in the arbitration.
        self._arbitration = self.timeline.at(time, self._arbitrate, last=True)

    def _arbitrate(self) -> None:
        self._arbitration = None
        now = self.timeline.now
        contenders: list[tuple[int, CanController, QueuedFrame]] = []
        next_ready = 0
        for controller in self.controllers:
            head = controller.head() if controller.queue else None
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
        if len(contenders) > 1:
            lowest = min(field for field, _, _ in contenders)
            contenders = [contender for contender in contenders if contender[0] == lowest]
        senders = [controller for _, controller, _ in contenders]
        queued = [head for _, _, head in contenders]
        frame = queued[0].frame
        if len(senders) > 1:
            # The bit 0 is dominant, so that the frame with the lowest length and data remains among
            # frames with equal identifiers.
            frame = min((head.frame for head in queued), key=lambda f: (f.length, f.data))
        listeners = [
            c for c in self.controllers if c.powered and not c.bus_off and c not in senders
        ]
        current = _Transmission(frame, senders, queued, listeners, now, frame_bits(frame))
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
        """Finds the first error in a CAN frame.

        Returns the bit at which the first error flag starts, and the controllers that send the
        first error flag.  Returns ``None`` if no dominant error flag destroys the frame.
        """
        senders, frame = current.senders, current.frame
        rate = senders[0].bitrate
        mismatched = [c for c in (*senders, *current.listeners) if c.bitrate != rate]
        flagging = [c for c in mismatched if c.state is ErrorState.ACTIVE and not c.listen_only]
        if flagging or any(s.bitrate != rate for s in senders):
            return MISMATCH_BIT, mismatched
        losers = (
            []
            if len(senders) == 1
            else [
                (sender, head.frame)
                for sender, head in zip(senders, current.queued, strict=True)
                if head.frame != frame
            ]
        )
        active = [lost for sender, lost in losers if sender.state is ErrorState.ACTIVE]
        if active:
            difference = min(first_difference(frame, lost) for lost in active)
            return difference + 1, []
        if losers:
            # All losing senders are error-passive and send recessive error flags, so that the
            # transmission of the frame continues.
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
        """Handles the end of a CAN frame, before the interframe space.

        The receivers accept the CAN frame as valid.
        """
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
        frame, filters = current.frame, self.filters
        for receiver in receivers:
            lost = bool(filters) and not all(accepts(receiver, frame) for accepts in filters)
            receiver.frame_received(frame, lost)
        self._plan_next()

    def _end_unacknowledged(self, current: _Transmission) -> None:
        """Handles the end of a CAN frame that no CAN controller acknowledged.

        An acknowledgement error does not change the state of a sender beyond error-passive
        (ISO 11898-1).
        """
        self.errors += 1
        self._current = None
        for sender in current.senders:
            if sender.state is ErrorState.ACTIVE:
                sender.count_errors(transmit=8)
        self._release_wire(current, FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for sender in current.senders:
            sender.suspend()
        self._plan_next()

    def _destroy(self, detectors: Iterable[CanController]) -> None:
        """Destroys the current CAN frame with an error flag.

        All receivers drop the destroyed CAN frame, and all senders repeat the CAN frame.
        ``detectors`` has the CAN controllers that send the first error flag.
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
        self._plan_next()

    def dropped(self, controller: CanController) -> None:
        """Handles a CAN controller that stops sending and receiving.

        If the CAN controller is the only sender of the current CAN frame, the CAN frame is aborted.
        """
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
        # The receivers of a CAN frame detect a stuff error after 6 equal bits.  After a stuff
        # error, the error flag and the echo of the error flag follow.
        self._release_wire(current, 3 * FLAG_BITS + DELIMITER_BITS + INTERFRAME_BITS)
        for listener in current.listeners:
            if listener.online and not listener.listen_only:
                listener.count_errors(receive=1)
        self._plan_next()

    def _release_wire(self, current: _Transmission, more_bits: int) -> None:
        """Frees the bus line after ``more_bits`` bits."""
        rest = more_bits * NANOSECONDS // current.senders[0].bitrate
        self._free_at = self.timeline.now + rest
        self.busy += self._free_at - current.start

    def _plan_next(self) -> None:
        """Schedules the next arbitration if any CAN controller has a CAN frame to send.

        Otherwise, the next CAN frame that is queued schedules the arbitration (``wake``).
        """
        for controller in self.controllers:
            if controller.queue:
                self.wake()
                return
