"""A CAN controller on a wire: its queue, its error counters and its state, after ISO 11898-1."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import TYPE_CHECKING

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import INTERFRAME_BITS, CanFrame
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.simulation.bus.timeline import Event

if TYPE_CHECKING:
    from thorvaldc.simulation.bus.wire import Wire

SUSPEND_BITS = 8
"""What an error-passive controller waits longer after a frame of its own."""
JOIN_BITS = 11
"""Recessive bits that a controller waits for before it takes part."""
RECOVERY_BITS = 128 * 11
"""What a controller in bus-off waits for before it takes part again."""
QUEUE_LIMIT = 32


class CanController:
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
