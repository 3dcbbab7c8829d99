"""A program under test on a simulated wire, in virtual time and in one thread."""

from __future__ import annotations

from collections import deque

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import RECEIVE_LIMIT, SEND_LIMIT, CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import NEVER, to_ns
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.wire import Wire


class VirtualTimeInterface:
    """A controller whose device is a program: it sends, and waits by letting time run.

    What is received waits in a queue of ``receive_limit`` frames; a full one loses the
    newest and counts it in ``overruns``, as controllers and kernels do.  ``bitrate``
    ``None``: the wire's.
    """

    epoch = 0.0
    """s: what its times count from."""

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
        self.controller.on_frame = self._arrived
        if receive_own:
            self.controller.on_sent = lambda frame: self._arrived(frame, own=True)
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
        """Queue a frame.  Where the queue is full, wait at most ``timeout`` s for room.

        ``False``: there was none, or the controller is in bus-off.
        """
        controller = self.controller
        if controller.pending >= controller.queue_limit and timeout > 0.0:
            limit = self.timeline.now + to_ns(timeout)
            self.timeline.run_until(limit, lambda: controller.pending < controller.queue_limit)
        return controller.send(frame)

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """The oldest frame received; where there is none, time runs until one comes.

        ``None`` after ``timeout`` s without.  Without a time-out it returns ``None`` only
        where nothing at all is planned to happen any more.
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
        """Let time run; what comes meanwhile waits in the queue."""
        self.timeline.run_until(self.timeline.now + to_ns(seconds))

    def sleep_until(self, time: float) -> None:
        """Let time run until ``time`` (s); a time that is past is now."""
        self.timeline.run_until(to_ns(time))

    def restart(self) -> None:
        """Come back from bus-off."""
        self.controller.restart()

    def close(self) -> None:
        self.wire.detach(self.controller)

    def _arrived(self, frame: CanFrame, own: bool = False) -> None:
        if len(self.received) >= self.receive_limit:
            self.overruns += 1
        else:
            self.received.append(ReceivedFrame(self.timeline.now, frame, own))
