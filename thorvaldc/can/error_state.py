"""Error state of a CAN controller (ISO 11898-1)."""

from __future__ import annotations

import enum


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
