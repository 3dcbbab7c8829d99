"""Protocol ``CanInterface``: a program's access to a simulated or real CAN bus.

Classes that implement the protocol ``CanInterface``:

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
    """Interface to send and receive CAN frames.

    All times are in seconds on the clock of the CAN interface, which never goes back and counts
    while the computer is asleep; a simulated bus sleeps with it.  ``send`` and ``receive`` raise
    ``ConnectionError`` if the CAN adapter is unplugged or the process of the bus has ended.
    """

    @property
    def receives_by_itself(self) -> bool:
        """``True`` if frames get their times of reception without a thread that calls
        ``receive``."""

    @property
    def now(self) -> float:
        """Current time (s) on the clock of the CAN interface.

        The reception time ``ReceivedFrame.time`` (ns) and the method ``sleep_until`` use the clock
        of the CAN interface.
        """

    @property
    def received_until(self) -> float:
        """Time (s) up to which all frames on the bus have reached the receive queue.

        For hardware it is ``now``, because the kernel and the adapter receive at all times.  The
        process of a simulated bus can run late on a busy computer; then the time is earlier.
        """

    @property
    def state(self) -> ErrorState:
        """Error state of the CAN controller.

        The state is ``ACTIVE`` if the CAN interface does not report error states.
        """

    @property
    def overruns(self) -> int:
        """Number of received CAN frames that were lost because the receive queue was full."""

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Puts a CAN frame into the send queue.

        Waits at most ``timeout`` seconds while the send queue is full.  Returns ``False`` if the
        CAN frame was not put into the send queue.
        """

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """Returns the oldest CAN frame in the receive queue.

        Waits for a CAN frame if the receive queue is empty.

        Returns ``None`` if no CAN frame arrives within ``timeout`` seconds.  If ``timeout`` is
        ``None``, ``receive`` waits without a time limit.
        """

    def sleep(self, seconds: float) -> None: ...

    def sleep_until(self, time: float) -> None:
        """Sleeps until ``time`` (s); returns immediately if ``time`` is in the past."""

    def restart(self) -> None:
        """Restarts the CAN controller after bus-off."""

    def close(self) -> None: ...
