"""Checks that a robot on its buses must pass before it is armed.

Each check is a function that returns its reasons against arming.  All reasons of all checks are
reported together, so that the operator can remove them in one go.  Consequences of a reported
reason are not reported: the motors of a stopped robot are never enabled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.se2 import ZERO_TWIST

if TYPE_CHECKING:
    from thorvaldc.runtime.runner import BaseRunner

PreArmCheck = Callable[["BaseRunner", float], Iterable[str]]
"""Function that returns the reasons against arming, from the runner and the time (s)."""
GAP_MEMORY = 2.0
"""Time (s) after a gap in time in which the base is not armed."""


def check_state(runner: BaseRunner, now: float) -> Iterator[str]:
    """Requires the state READY: the robot stands, and all start-up checks have passed."""
    if runner.base.state_machine.ending:
        yield "the driver is shutting down"
    elif runner.state in (BaseState.FAULT, BaseState.ESTOP):
        yield f"the base is {runner.state.value}, reset it first"
    elif runner.state is not BaseState.READY:
        yield f"the base is {runner.state.value}, not ready"


def check_stop(runner: BaseRunner, now: float) -> Iterator[str]:
    if runner.base.state_machine.stop_engaged:
        yield "the safety stop is engaged"


def check_command(runner: BaseRunner, now: float) -> Iterator[str]:
    """Refuses to arm while a motion is commanded, which would start at once."""
    if runner.driver.commanded_twist(now) != ZERO_TWIST:
        yield "a motion is commanded; command zero first"


def check_time_gaps(runner: BaseRunner, now: float) -> Iterator[str]:
    gap = runner.timing.latest_gap
    if gap is not None and now - gap[0] < GAP_MEMORY:
        yield (
            f"there was no control cycle for {gap[1] * 1000.0:.0f} ms, {now - gap[0]:.1f} s ago;"
            " is the computer too busy?"
        )


def check_controllers(runner: BaseRunner, now: float) -> Iterator[str]:
    for connection in runner.base.connections:
        problem = connection.impostor() or connection.problem(now)
        if problem:
            yield problem
        yield from connection.suspicious_devices()
        for controller in connection.controllers:
            reason = _controller_reason(controller, runner.state)
            if reason and not problem.startswith(f"{controller.node.name}:"):
                yield f"{controller.node.name}: {reason}"


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


def check_batteries(runner: BaseRunner, now: float) -> Iterator[str]:
    """Requires that each battery reports enough charge and no alarm, and allows a discharge."""
    yield from runner.battery_supervision.arming_reasons(now)


PRE_ARM_CHECKS: tuple[PreArmCheck, ...] = (
    check_state,
    check_stop,
    check_command,
    check_time_gaps,
    check_controllers,
    check_batteries,
)
