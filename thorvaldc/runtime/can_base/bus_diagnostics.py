"""What an operator is told of a robot's buses: the reasons against arming, and the state of each
part.

Consequences of a reported reason are not reported: the motors of a stopped robot are never enabled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from thorvaldc.runtime.base_interface import ComponentStatus
from thorvaldc.runtime.can_base.base_state import BaseState, StateChange
from thorvaldc.runtime.can_base.base_state_machine import BaseStateMachine
from thorvaldc.runtime.can_base.battery_supervision import BatterySupervision
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.motor_controller import MotorController

NEWEST = 5
"""Number of changes of the state that are shown."""


def arming_reasons(
    state_machine: BaseStateMachine, batteries: BatterySupervision, now: float
) -> Iterator[str]:
    """Yields the reasons of the base, of its motor controllers and of its batteries."""
    state = state_machine.state
    if state_machine.ending:
        yield "the driver is shutting down"
    elif state in (BaseState.FAULT, BaseState.ESTOP):
        yield f"the base is {state.value}, reset it first"
    elif state not in (BaseState.STANDBY, BaseState.READY):
        yield f"the base is {state.value}, not ready"
    for connection in state_machine.connections:
        problem = connection.impostor() or connection.problem(now)
        if problem:
            yield problem
        yield from connection.suspicious_devices()
        for controller in connection.controllers:
            reason = _controller_reason(controller, state)
            if reason and not problem.startswith(f"{controller.node.name}:"):
                yield f"{controller.node.name}: {reason}"
    yield from batteries.arming_reasons(now)


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


def component_statuses(
    state_machine: BaseStateMachine,
    batteries: BatterySupervision,
    changes: Sequence[StateChange],
    now: float,
) -> Iterator[ComponentStatus]:
    """Yields the statuses of the states, the buses, the motor controllers and the batteries."""
    newest = [f"{c.time:.2f} s {c.state.value} {c.reason}".strip() for c in changes[-NEWEST:]]
    yield ComponentStatus("states", "ok", state_machine.state.value, {"changes": newest})
    for connection in state_machine.connections:
        yield from _connection_statuses(connection, now)
    reason = batteries.reason
    for driver in batteries.batteries:
        battery = driver.state
        values = {
            "voltage": battery.voltage,
            "current": battery.current,
            "charge": battery.charge,
            "alarms": battery.alarms,
            "temperatures": battery.temperatures,
        }
        yield ComponentStatus(
            driver.node.name, "warning" if reason else "ok", reason or "ok", values
        )


def _connection_statuses(connection: BusConnection, now: float) -> Iterator[ComponentStatus]:
    receiver, problem = connection.receiver, connection.problem(now)
    values: dict[str, Any] = {
        "received": receiver.received,
        "dropped": receiver.dropped,
        "malformed": connection.malformed,
        "not_sent": connection.not_sent,
        "relayed": connection.relay.passed.total(),
    }
    level = "error" if problem or receiver.lost else "ok"
    yield ComponentStatus(f"bus {connection.bus.name}", level, problem or "ok", values)
    for controller in connection.controllers:
        problem = controller.problem or controller.power_loss
        values = {
            "homed": controller.homed,
            "follows": controller.follows,
            "error_code": f"{controller.error_code:#06x}",
        }
        level = "error" if problem or controller.error_code else "ok"
        yield ComponentStatus(controller.node.name, level, problem or "ok", values)
