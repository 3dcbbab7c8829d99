"""A CAN controller: send queue, error counters and error state (ISO 11898-1, fault confinement).

Each controller counts transmit errors (TEC) and receive errors (REC).  The counters set its state:

                 TEC > 127 or REC > 127               TEC > 255
    error-active ----------------------> error-passive ---------> bus-off
         ^   ^                                |                      |
         |   +--------------------------------+                      |
         |          TEC and REC < 128                                |
         +-----------------------------------------------------------+
               restart, or 128 x 11 recessive bits with auto_recovery

An error-active controller destroys a faulty frame with dominant bits.  An error-passive one
sends recessive error flags, which no other controller sees, and waits 8 more bits after each of
its own frames.  In bus-off a controller neither sends nor receives.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import NamedTuple, Protocol

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import INTERFRAME_BITS, CanFrame
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.simulation.bus.timeline import Event, Timeline

SUSPEND_BITS = 8
"""Suspend transmission: an error-passive controller waits this much longer after its own frame."""
JOIN_BITS = 11
"""Recessive bits that a controller must see before it takes part in the traffic."""
RECOVERY_BITS = 128 * 11
"""Time in bus-off before automatic recovery."""
QUEUE_LIMIT = 32


class QueuedFrame(NamedTuple):
    """A frame in a send queue, in the order of sending: by ``priority``, then by ``number``."""

    priority: int
    number: int
    frame: CanFrame


class Medium(Protocol):
    """The wire, as a controller uses it."""

    @property
    def timeline(self) -> Timeline: ...

    def wake(self) -> None:
        """A controller has a frame to send: start an arbitration when the wire is free."""

    def dropped(self, controller: CanController) -> None:
        """A controller stops taking part; a frame that it alone is sending ends here."""


class CanController:
    """A CAN controller with its send queue, error counters and state.

    Callbacks: ``on_frame`` for each received frame, ``on_sent`` for each own frame that was
    sent, ``on_state`` for each change of the error state.  If the filter ``accepts`` returns
    ``False`` for a frame, the controller acknowledges it, counts it in ``lost`` and drops it.

    The controller sends the waiting frame with the lowest identifier first, or with ``fifo``
    the oldest.  A full queue refuses the newest frame.  Bus-off empties the queue.  With
    ``auto_recovery`` the controller leaves bus-off after 128 x 11 bit times.
    """

    def __init__(
        self,
        wire: Medium,
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
        self._queue: list[QueuedFrame] = []
        self._queued = 0
        self._ready_at = 0
        self._online_since = 0
        self._recovery: Event | None = None

    # -- for the device or program that owns the controller -----------------------------

    @property
    def online(self) -> bool:
        """The controller is powered and not in bus-off."""
        return self.powered and not self.bus_off

    @property
    def state(self) -> ErrorState:
        if self.bus_off:
            return ErrorState.BUS_OFF
        passive = self.transmit_errors > 127 or self.receive_errors > 127
        return ErrorState.PASSIVE if passive else ErrorState.ACTIVE

    @property
    def pending(self) -> int:
        """Number of frames in the send queue."""
        return len(self._queue)

    def send(self, frame: CanFrame) -> bool:
        """Queues a frame.  ``False``: the queue is full, or the controller cannot send."""
        if not self.online or self.listen_only or len(self._queue) >= self.queue_limit:
            self.refused += 1
            return False
        self._queued += 1
        priority = 0 if self.fifo else frame.arbitration
        bisect.insort(self._queue, QueuedFrame(priority, self._queued, frame))
        self.wire.wake()
        return True

    def switch_on(self) -> None:
        """Starts to take part, with both error counters at zero."""
        if not self.powered:
            self.powered = True
            self._join()

    def switch_off(self) -> None:
        """Loss of power: clears the queue and the counters, and breaks off a frame being sent."""
        if self.powered:
            self.powered = self.bus_off = False
            self._leave()
            self.transmit_errors = self.receive_errors = 0

    def restart(self) -> None:
        """Leaves bus-off, or starts again after a change of the bitrate."""
        if self.powered:
            previous = self.state
            self.bus_off = False
            self._leave()
            self._join()
            self._report_change(previous)

    def go_bus_off(self) -> None:
        """Enters bus-off, as after more than 255 transmit errors."""
        previous = self.state
        if previous is not ErrorState.BUS_OFF and self.powered:
            self.bus_off = True
            self._leave()
            if self.auto_recovery:
                delay = self.time_of(RECOVERY_BITS)
                self._recovery = self.wire.timeline.after(delay, self.restart)
            self._report_change(previous)

    def time_of(self, bits: int) -> int:
        """Duration (ns) of a number of bits at the controller's bitrate."""
        return bits * NANOSECONDS // self.bitrate

    # -- for the wire ----------------------------------------------------------------------

    def head(self) -> QueuedFrame | None:
        """The next frame to send."""
        return self._queue[0] if self._queue and not self.listen_only else None

    def ready_at(self) -> int:
        """Time (ns) from which the controller may start to send."""
        return self._ready_at

    def online_at(self, time: int) -> bool:
        """Whether the controller has been online since ``time`` (ns) or longer."""
        return self.online and self._online_since <= time

    def frame_sent(self, queued: QueuedFrame) -> None:
        """Takes a frame out of the queue after its successful transmission."""
        previous = self.state
        index = bisect.bisect_left(self._queue, queued)
        if index < len(self._queue) and self._queue[index] is queued:
            del self._queue[index]
        self.transmit_errors = max(self.transmit_errors - 1, 0)
        self.sent += 1
        self.suspend()
        if self.on_sent is not None:
            self.on_sent(queued.frame)
        self._report_change(previous)

    def suspend(self) -> None:
        """Makes an error-passive controller wait after its own frame (suspend transmission)."""
        if self.state is ErrorState.PASSIVE:
            bits = INTERFRAME_BITS + SUSPEND_BITS
            self._ready_at = self.wire.timeline.now + self.time_of(bits)

    def frame_received(self, frame: CanFrame) -> None:
        """Receives a valid frame.  REC falls by 1, or from above 127 to 127 (ISO 11898-1)."""
        previous = self.state
        errors = self.receive_errors
        self.receive_errors = 127 if errors > 127 else max(errors - 1, 0)
        if self.accepts is not None and not self.accepts(frame):
            self.lost += 1
        else:
            self.received += 1
            if self.on_frame is not None:
                self.on_frame(frame)
        self._report_change(previous)

    def count_errors(self, transmit: int = 0, receive: int = 0) -> None:
        """Adds to the error counters, and changes the state where a limit is passed."""
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
        self._queue.clear()
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None
        self.wire.dropped(self)

    def _report_change(self, previous: ErrorState) -> None:
        if self.on_state is not None and self.state is not previous:
            self.on_state(self.state)
