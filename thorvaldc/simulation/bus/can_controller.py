"""A simulated CAN controller with send queue, error counters and error state (ISO 11898-1).

A CAN controller has a transmit error counter (TEC) and a receive error counter (REC).  The error
counters determine the error state of the CAN controller:

                 TEC > 127 or REC > 127               TEC > 255
    error-active ----------------------> error-passive ---------> bus-off
         ^   ^                                |                      |
         |   +--------------------------------+                      |
         |          TEC and REC < 128                                |
         +-----------------------------------------------------------+
               restart, or 128 x 11 recessive bits with auto_recovery

An error-active CAN controller destroys a faulty CAN frame with a dominant error flag.  An
error-passive CAN controller sends a recessive error flag, which other CAN controllers do not
detect.  After each sent CAN frame, an error-passive CAN controller waits 8 more bit times.  A CAN
controller in bus-off neither sends nor receives CAN frames.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import NamedTuple, Protocol

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.frame_bits import INTERFRAME_BITS
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.simulation.bus.timeline import Event, Timeline

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


class Medium(Protocol):
    """The interface of the simulated bus line that a CAN controller requires."""

    @property
    def timeline(self) -> Timeline: ...

    def wake(self) -> None:
        """Requests an arbitration because a CAN controller has a CAN frame to send.

        The arbitration starts when the bus line is free.
        """

    def dropped(self, controller: CanController) -> None:
        """Handles a CAN controller that stops sending and receiving.

        The current CAN frame is aborted if no other CAN controller sends the same CAN frame.
        """


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
    * ``accepts``: filter for received frames.  If the filter returns ``False``, the CAN controller
      acknowledges the received CAN frame, adds 1 to ``lost``, and drops the CAN frame.
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
            self.refused += 1
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
        If ``lost`` is true, the CAN controller treats the CAN frame as ``accepts`` would do with a
        CAN frame that the filter drops.
        """
        errors = self.receive_errors
        if errors:
            previous = self.state
            self.receive_errors = 127 if errors > 127 else errors - 1
            self._report_change(previous)
        if lost or (self.accepts is not None and not self.accepts(frame)):
            self.lost += 1
        else:
            self.deliver(frame)

    def deliver(self, frame: CanFrame) -> None:
        """Passes a CAN frame to the device or program that owns the CAN controller."""
        self.received += 1
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
