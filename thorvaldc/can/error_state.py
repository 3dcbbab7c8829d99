"""The error state of a CAN controller (ISO 11898-1)."""

from __future__ import annotations

import enum


class ErrorState(enum.Enum):
    """Depends on the transmit and the receive error counter.

    ``PASSIVE``: a counter has reached 128; the controller does not interrupt other nodes' frames.
    ``BUS_OFF``: the transmit error counter has reached 256; it takes no part in the traffic.
    """

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"
