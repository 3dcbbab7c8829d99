"""Classical CAN frames (ISO 11898-1), and a program's access to a CAN bus: ``CanInterface``.

Classes that implement the protocol ``CanInterface``:

- ``PythonCanInterface``: hardware and UDP, through python-can;
- ``SimulatedBusClient``: a simulated bus that another process runs (``sim:NAME``);
- ``VirtualTimeInterface`` of the room ``simulation``: a simulated bus in the same process,
  in virtual time.

The module also defines the unit of times and the clock of a real bus.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

from thorvaldc.model.bus import EXTENDED

SEND_LIMIT: Final = 32
"""Default size of a send queue, in frames."""
RECEIVE_LIMIT: Final = 1024
"""Default size of a receive queue, in frames."""


class CanFrame(NamedTuple):
    """A CAN data frame or a CAN remote frame.

    ``requested``: number of data bytes that a CAN remote frame requests.
    """

    id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    requested: int = 0

    @property
    def length(self) -> int:
        """Data length code (DLC) of the CAN frame, 0 to 8."""
        return self.requested if self.remote else len(self.data)

    @property
    def key(self) -> int:
        """The identifier, with the bit ``EXTENDED`` if it has 29 bits."""
        return self.id | EXTENDED if self.extended else self.id

    @property
    def arbitration(self) -> int:
        """Arbitration field of the CAN frame as a number.

        The CAN frame with the lowest number wins the arbitration.

        The arbitration field of a standard CAN frame contains the 11-bit identifier, the RTR bit
        and the IDE bit (0).  The arbitration field of an extended CAN frame contains the upper 11
        bits of the identifier, the SRR bit (1), the IDE bit (1), the lower 18 bits of the
        identifier, and the RTR bit.
        """
        if self.extended:
            return (self.id >> 18) << 21 | 0b11 << 19 | (self.id & 0x3FFFF) << 1 | int(self.remote)
        return self.id << 21 | int(self.remote) << 20

    def __str__(self) -> str:
        name = f"{self.id:08x}" if self.extended else f"{self.id:03x}"
        return f"{name}#R{self.requested}" if self.remote else f"{name}#{self.data.hex()}"


class ReceivedFrame(NamedTuple):
    """A CAN frame with its time of reception.

    - ``time``: time (ns) at which the frame was complete on the bus;
    - ``own``: ``True`` if this program has sent the frame itself.
    """

    time: int
    frame: CanFrame
    own: bool = False


class ErrorState(enum.Enum):
    """Error state of a CAN controller, which follows from its transmit and receive error counters.

    - ``ACTIVE``: both error counters are below 128;
    - ``PASSIVE``: an error counter has reached 128, and the controller no longer interrupts the
      frames of other nodes;
    - ``BUS_OFF``: the transmit error counter has reached 256, and the controller neither sends nor
      receives.
    """

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"


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


# -- time: whole nanoseconds, so that the simulated time has no rounding errors -----------------

NANOSECONDS: Final = 1_000_000_000
"""Nanoseconds in one second."""
NEVER: Final = 1 << 62
"""A time (ns) that is later than the time of every event."""


def to_ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


def counting_clock() -> Callable[[], int]:
    """Returns the clock of everything that drives in real time, which counts in the sleep too.

    ``time.monotonic`` of Linux stands while the computer is suspended.  A driver that reads it
    would go on after an hour in a closed laptop as if no time had passed: no gap, a command that
    still counts, and a ramp at a speed that the wheels no longer have.  Linux has
    ``CLOCK_BOOTTIME``, which counts.  ``CLOCK_MONOTONIC`` of macOS and the clock of Windows count,
    too.
    """
    for name in ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC"):
        number = getattr(time, name, None)
        if number is None:
            continue
        try:
            time.clock_gettime_ns(number)
        except OSError:  # an old kernel, or a sandbox that does not permit it
            continue
        return lambda: time.clock_gettime_ns(number)
    return time.monotonic_ns


elapsed_ns: Callable[[], int] = counting_clock()
"""Returns the time (ns) of the clock, which never goes back; its zero has no meaning.

The programs of a computer share the clock: a simulated bus tells its clients when it has started.
"""


def elapsed() -> float:
    """Returns the time (s) of the clock."""
    return elapsed_ns() / NANOSECONDS
