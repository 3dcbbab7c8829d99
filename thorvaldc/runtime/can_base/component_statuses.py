"""The state of each part of a robot's buses, for the diagnostics of an operator."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from thorvaldc.runtime.base_interface import ComponentStatus
from thorvaldc.runtime.can_base.bus_connection import BusConnection

if TYPE_CHECKING:
    from thorvaldc.runtime.can_base.can_base import CanBase

NEWEST = 5
"""Number of changes of the state that are shown."""


def component_statuses(base: CanBase, now: float) -> Iterator[ComponentStatus]:
    """Yields the statuses of the states, the buses, the motor controllers and the batteries."""
    changes = [f"{c.time:.2f} s {c.state.value} {c.reason}".strip() for c in base.changes[-NEWEST:]]
    yield ComponentStatus("states", "ok", base.state.value, {"changes": changes})
    for connection in base.connections:
        yield from _connection_statuses(connection, now)
    reason = base.battery_supervision.reason
    for name, battery in base.batteries().items():
        values = {
            "voltage": battery.voltage,
            "current": battery.current,
            "charge": battery.charge,
            "alarms": battery.alarms,
            "temperatures": battery.temperatures,
        }
        yield ComponentStatus(name, "warning" if reason else "ok", reason or "ok", values)


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
