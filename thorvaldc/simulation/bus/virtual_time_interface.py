"""A program's access to a simulated wire, in virtual time and in one thread."""

from __future__ import annotations

from collections import deque

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import RECEIVE_LIMIT, SEND_LIMIT, CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import NEVER, to_ns
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.wire import Wire


class VirtualTimeInterface:
    """A ``CanInterface`` to a wire: virtual time runs while the program waits.

    The receive queue holds ``receive_limit`` frames.  A full queue drops the newest frame
    and counts it in ``overruns``, as controllers and kernels do.  ``bitrate`` ``None``: that
    of the wire.
    """

    epoch = 0.0
    """s: zero of the interface's times."""

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
        """Virtual time in s."""
        return self.timeline.seconds

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Queues a frame; waits at most ``timeout`` s for room in the queue.

        ``False``: there was no room, or the controller is in bus-off.
        """
        controller = self.controller
        if controller.pending >= controller.queue_limit and timeout > 0.0:
            limit = self.timeline.now + to_ns(timeout)
            self.timeline.run_until(limit, lambda: controller.pending < controller.queue_limit)
        return controller.send(frame)

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """Returns the oldest received frame; time runs until there is one.

        ``None`` after ``timeout`` s.  Without a time-out ``None`` means that no event is
        planned any more.
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
        """Lets time run; frames received meanwhile wait in the queue."""
        self.timeline.run_until(self.timeline.now + to_ns(seconds))

    def sleep_until(self, time: float) -> None:
        """Lets time run until ``time`` (s).  Returns immediately if that time is past."""
        self.timeline.run_until(to_ns(time))

    def restart(self) -> None:
        """Leaves bus-off."""
        self.controller.restart()

    def close(self) -> None:
        self.wire.detach(self.controller)

    def _queue_received(self, frame: CanFrame, own: bool = False) -> None:
        if len(self.received) >= self.receive_limit:
            self.overruns += 1
        else:
            self.received.append(ReceivedFrame(self.timeline.now, frame, own))
