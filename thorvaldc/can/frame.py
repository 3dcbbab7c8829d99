"""Classical CAN frames (ISO 11898-1), and the default sizes of the send and receive queues."""

from __future__ import annotations

from typing import NamedTuple

SEND_LIMIT = 32
"""Default size of a send queue, in frames."""
RECEIVE_LIMIT = 1024
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
