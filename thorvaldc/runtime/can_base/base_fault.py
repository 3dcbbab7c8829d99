"""Why a base on CAN has stopped, as values that a program can compare."""

from __future__ import annotations

import enum
from typing import NamedTuple


class Cause(enum.Enum):
    """Kind of the cause of a fault or stop.

    - ``STOP``: safety stop; ``START``: start-up checks; ``ABSENT``: a controller is silent then;
    - ``GAP``: control cycle too late or missing;
    - ``MASTER``: another master is on the bus; ``BUS``: a bus or its interface fails;
    - ``POWER``: a power stage has no voltage, such as after the emergency stop button was pressed;
    - ``DRIVE``: a drive reports an error; ``SILENCE``: it stops sending or leaves OPERATIONAL;
    - ``RESTART``: it restarted; ``SECOND``: another device has its id;
    - ``MOTION``: a motor does not do what it was commanded to; ``HOMING``: no home position;
    - ``OTHER``: all other causes.
    """

    STOP = "stop"
    START = "start"
    ABSENT = "absent"
    GAP = "gap"
    MASTER = "master"
    BUS = "bus"
    POWER = "power"
    DRIVE = "drive"
    SILENCE = "silence"
    RESTART = "restart"
    SECOND = "second device"
    MOTION = "motion"
    HOMING = "homing"
    OTHER = "other"


class Fault(NamedTuple):
    """Cause of a fault or stop: ``reason`` as text, and the node that it concerns, if any."""

    cause: Cause
    reason: str
    node: str = ""

    @property
    def text(self) -> str:
        return f"{self.node}: {self.reason}" if self.node else self.reason
