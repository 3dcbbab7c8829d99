"""States of a robot base on CAN; the module ``base_state_machine`` defines the transitions."""

from __future__ import annotations

import enum
from typing import NamedTuple


class BaseState(enum.Enum):
    """State of a robot base whose motors are controlled over CAN.

    - ``INIT``: the driver listens to the bus and sends nothing;
    - ``PREOP``: the driver brings all nodes to the NMT state pre-operational;
    - ``CONFIG``: the driver compares the nodes with the robot file and starts the nodes;
    - ``STANDBY``: a steering joint is not homed; the motors are off until the robot is armed or the
      steering is homed on request;
    - ``HOMING``: the driver enables the motors, homes the steering and turns the wheels straight;
    - ``READY``: the robot stands and waits for a commanded twist;
    - ``ACTIVE``: the robot drives;
    - ``STOPPING``: the robot ramps to rest, because the commanded twist is too old;
    - ``FAULT``, ``ESTOP``: all motors are in quick stop until ``reset`` is called; motors that do
      not obey are stopped by other means, see ``stop_ladder``.
    """

    INIT = "init"
    PREOP = "preop"
    CONFIG = "config"
    STANDBY = "standby"
    HOMING = "homing"
    READY = "ready"
    ACTIVE = "active"
    STOPPING = "stopping"
    FAULT = "fault"
    ESTOP = "estop"

    @property
    def drives(self) -> bool:
        """``True`` if the state of the base is READY, ACTIVE or STOPPING, so that the wheels follow
        commands."""
        return self in (BaseState.READY, BaseState.ACTIVE, BaseState.STOPPING)

    @property
    def starts(self) -> bool:
        """``True`` if the state of the base is one of the start-up states INIT, PREOP, CONFIG and
        HOMING."""
        return self in (BaseState.INIT, BaseState.PREOP, BaseState.CONFIG, BaseState.HOMING)


class StateChange(NamedTuple):
    """A change of the state of the base.

    - ``time``: time of the change, s.
    - ``state``: new state of the base.
    - ``reason``: reason for the state FAULT or ESTOP.
    """

    time: float
    state: BaseState
    reason: str
