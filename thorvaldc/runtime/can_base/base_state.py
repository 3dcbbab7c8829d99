"""The states of a base on its CAN buses; ``base_state_machine`` has the transitions."""

from __future__ import annotations

import enum


class BaseState(enum.Enum):
    """State of the base.

    - ``INIT``: listens to the bus;
    - ``PREOP``: brings all nodes to the NMT state pre-operational;
    - ``CONFIG``: compares the nodes with the robot file and starts them;
    - ``HOMING``: powers the motors, homes the steerings and turns them straight ahead;
    - ``READY``: stands and waits for a commanded twist;
    - ``ACTIVE``: drives;
    - ``STOPPING``: ramps to rest, because the command is too old;
    - ``FAULT``, ``ESTOP``: quick stop of all motors, until ``reset``.
    """

    INIT = "init"
    PREOP = "preop"
    CONFIG = "config"
    HOMING = "homing"
    READY = "ready"
    ACTIVE = "active"
    STOPPING = "stopping"
    FAULT = "fault"
    ESTOP = "estop"

    @property
    def drives(self) -> bool:
        """``True`` in the states in which the wheels follow commands."""
        return self in (BaseState.READY, BaseState.ACTIVE, BaseState.STOPPING)

    @property
    def starts(self) -> bool:
        """``True`` in the states of the start-up."""
        return self in (BaseState.INIT, BaseState.PREOP, BaseState.CONFIG, BaseState.HOMING)
