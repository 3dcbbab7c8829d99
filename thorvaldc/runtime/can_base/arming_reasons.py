"""Reasons of a robot's buses against arming it.

Consequences of a reported reason are not reported: the motors of a stopped robot are never enabled.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.can_base.motor_controller import MotorController

if TYPE_CHECKING:
    from thorvaldc.runtime.can_base.can_base import CanBase


def arming_reasons(base: CanBase, now: float) -> Iterator[str]:
    """Yields the reasons of the base, of its motor controllers and of its batteries."""
    yield from _state_reasons(base)
    for connection in base.connections:
        problem = connection.impostor() or connection.problem(now)
        if problem:
            yield problem
        yield from connection.suspicious_devices()
        for controller in connection.controllers:
            reason = _controller_reason(controller, base.state)
            if reason and not problem.startswith(f"{controller.node.name}:"):
                yield f"{controller.node.name}: {reason}"
    yield from base.battery_supervision.arming_reasons(now)


def _state_reasons(base: CanBase) -> Iterator[str]:
    """Requires that the robot stands, and that all start-up checks have passed."""
    if base.state_machine.ending:
        yield "the driver is shutting down"
    elif base.state in (BaseState.FAULT, BaseState.ESTOP):
        yield f"the base is {base.state.value}, reset it first"
    elif base.state not in (BaseState.STANDBY, BaseState.READY):
        yield f"the base is {base.state.value}, not ready"


def _controller_reason(controller: MotorController, state: BaseState) -> str:
    if controller.problem or controller.power_loss:
        return controller.problem or controller.power_loss
    if controller.error_code:
        return f"emergency {controller.error_code:#06x}"
    if state is not BaseState.READY:  # the base homes and enables the motors before it is ready
        return ""
    if not controller.homed:
        return "it is not homed"
    return "" if controller.follows else "its motors are not enabled"
