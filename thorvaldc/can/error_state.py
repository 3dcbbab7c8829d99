"""The error state of a CAN controller (ISO 11898-1)."""

from __future__ import annotations

import enum


class ErrorState(enum.Enum):
    """Of a controller: ``PASSIVE`` from 128 of either counter, ``BUS_OFF`` from 256 sent."""

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"
