"""A program's access to a CAN bus, simulated or real: the protocol ``CanInterface``.

Implementations:

- ``PythonCanInterface``: hardware and UDP, through python-can;
- ``SimulatedBusClient``: a simulated bus that another process runs (``sim:NAME``);
- ``VirtualTimeInterface`` of the room ``simulation``: a simulated bus in the same process,
  in virtual time.
"""

from __future__ import annotations

from typing import Protocol

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame, ReceivedFrame


class CanInterface(Protocol):
    """Sends and receives CAN frames.  All times are s of the interface's monotonic clock.

    ``send`` and ``receive`` raise ``ConnectionError`` where the interface is lost: it is
    unplugged, or its process has ended.
    """

    @property
    def now(self) -> float:
        """Time (s) on the clock of ``sleep_until`` and of ``ReceivedFrame.time`` (ns)."""

    @property
    def state(self) -> ErrorState:
        """Error state of the CAN controller, as far as the interface reports it."""

    @property
    def overruns(self) -> int:
        """Number of received frames that were lost because the receive queue was full."""

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Queues a frame; waits at most ``timeout`` s for room in the send queue.

        Returns ``False`` where the frame is not queued.
        """

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """Returns the oldest received frame, or ``None`` after ``timeout`` s without a frame.

        ``timeout`` ``None``: waits without limit.
        """

    def sleep(self, seconds: float) -> None: ...

    def sleep_until(self, time: float) -> None:
        """Sleeps until ``now`` is ``time``; returns immediately where that time is past."""

    def restart(self) -> None:
        """Recovers from bus-off."""

    def close(self) -> None: ...
