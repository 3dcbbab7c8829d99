"""A CAN interface to a simulated bus in virtual time, for a program with one thread."""

from __future__ import annotations

from collections import deque

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import RECEIVE_LIMIT, SEND_LIMIT, CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import NEVER, to_ns
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.wire import Wire


class VirtualTimeInterface:
    """A ``CanInterface`` to a simulated bus in virtual time.

    Virtual time advances only while the program waits.  The receive queue has space for
    ``receive_limit`` CAN frames.  If the receive queue is full, a received CAN frame is dropped and
    ``overruns`` is increased by 1.  Real CAN controllers and operating systems drop frames in the
    same way.  ``bitrate`` is the bitrate of the CAN controller (bit/s), by default the bitrate of
    the simulated bus.
    """

    receives_by_itself = True
    epoch = 0.0
    """Offset (s) between timestamps and the times of the CAN interface."""

    def __init__(
        self,
        wire: Wire,
        name: str = "client",
        bitrate: int | None = None,
        *,
        send_limit: int = SEND_LIMIT,
        receive_limit: int = RECEIVE_LIMIT,
        receive_own: bool = False,
        listen_only: bool = False,
        fifo: bool = False,
    ) -> None:
        self.wire = wire
        self.timeline = wire.timeline
        self.name = name
        self.receive_limit = receive_limit
        self.overruns = 0
        self.received: deque[ReceivedFrame] = deque()
        self.controller = CanController(
            wire,
            name,
            bitrate or wire.bitrate,
            queue_limit=send_limit,
            fifo=fifo,
            listen_only=listen_only,
            auto_recovery=False,
        )
        self.controller.on_frame = self._queue_received
        if receive_own:
            self.controller.on_sent = lambda frame: self._queue_received(frame, own=True)
        wire.attach(self.controller)
        self.controller.switch_on()

    @property
    def state(self) -> ErrorState:
        return self.controller.state

    @property
    def now(self) -> float:
        """Virtual time (s)."""
        return self.timeline.seconds

    @property
    def received_until(self) -> float:
        return self.timeline.seconds

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Adds a CAN frame to the send queue.

        The method waits at most ``timeout`` s for space in the send queue.  Returns ``False`` if
        the send queue is still full, or if the CAN controller is in bus-off.
        """
        controller = self.controller
        if controller.pending >= controller.queue_limit and timeout > 0.0:
            limit = self.timeline.now + to_ns(timeout)
            self.timeline.run_until(limit, lambda: controller.pending < controller.queue_limit)
        return controller.send(frame)

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """Returns the oldest CAN frame in the receive queue.

        Virtual time advances until a CAN frame is received.  Returns ``None`` if no CAN frame is
        received within ``timeout`` s.  If ``timeout`` is ``None``, the method returns ``None`` when
        the simulation has no further events.
        """
        if not self.received and (timeout is None or timeout > 0.0):
            limit = NEVER - 1 if timeout is None else self.timeline.now + to_ns(timeout)
            if timeout is None:
                while not self.received and self.timeline.next_time < limit:
                    self.timeline.run_until(self.timeline.next_time)
            else:
                self.timeline.run_until(limit, lambda: bool(self.received))
        return self.received.popleft() if self.received else None

    def sleep(self, seconds: float) -> None:
        """Advances the virtual time by ``seconds`` s.

        CAN frames that are received during the wait are added to the receive queue.
        """
        self.timeline.run_until(self.timeline.now + to_ns(seconds))

    def sleep_until(self, time: float) -> None:
        """Advances the virtual time to ``time`` (s).

        The method returns immediately if ``time`` is in the past.
        """
        self.timeline.run_until(to_ns(time))

    def restart(self) -> None:
        """Restarts the CAN controller after bus-off."""
        self.controller.restart()

    def close(self) -> None:
        self.wire.detach(self.controller)

    def _queue_received(self, frame: CanFrame, own: bool = False) -> None:
        if len(self.received) >= self.receive_limit:
            self.overruns += 1
        else:
            self.received.append(ReceivedFrame(self.timeline.now, frame, own))
