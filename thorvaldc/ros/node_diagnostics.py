"""The statuses of the node on /diagnostics."""

from __future__ import annotations

from typing import Any

from thorvaldc.ros.driven_robot import DrivenRobot, RobotOnBuses
from thorvaldc.ros.messages import ERROR, OK, WARN, diagnostic_status
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.driver import DriveMode

_FAULTS = (BaseState.FAULT, BaseState.ESTOP)
_REFUSING = (DriveMode.TIMED_OUT, DriveMode.WAITING, DriveMode.HELD)


def diagnostic_statuses(name: str, node: Any, robot: DrivenRobot | None) -> list[Any]:
    """Returns the statuses of a ``BaseDriverNode``: driver, commands, timing, nodes of the buses.

    ``name``: full name of the node, which each status begins with.
    """
    hardware = node.model.name
    commands = node.inputs.summary()
    if node.clock_watch.problem:
        commands["clock"] = node.clock_watch.problem
    refuses = any(count for count, _ in node.inputs.refused.values())
    commands_text = "some twists were refused" if refuses else "ok"
    if robot is None:
        level, text = (ERROR, node.problem) if node.problem else (WARN, "inactive")
        statuses = [diagnostic_status(f"{name}: driver", hardware, level, text, {})]
    else:
        state = robot.state()
        for key in ("batteries", "outputs", "cycles", "overruns"):
            state.pop(key, None)
        state["base"] = node.values["base"]
        state["parameter_set"] = node.values["parameter_set"]
        level, text = _verdict(robot, state)
        statuses = [diagnostic_status(f"{name}: driver", hardware, level, text, state)]
    statuses.append(
        diagnostic_status(
            f"{name}: commands", hardware, WARN if refuses else OK, commands_text, commands
        )
    )
    if isinstance(robot, RobotOnBuses):
        statuses += _bus_statuses(name, hardware, robot)
    return statuses


def _verdict(robot: DrivenRobot, state: dict[str, Any]) -> tuple[bytes, str]:
    mode = robot.driver.state.mode
    if state["fault"]:
        return ERROR, str(state["fault"])
    if isinstance(robot, RobotOnBuses) and robot.runner.state in _FAULTS:
        return ERROR, str(robot.runner.state.value)
    if warnings := state.get("warnings"):
        return WARN, "; ".join(warnings)
    if state.get("paused"):
        return WARN, "the simulation is paused"
    if mode in _REFUSING:
        return WARN, ": ".join(filter(None, (mode.value, state["held"])))
    return OK, mode.value


def _bus_statuses(name: str, hardware: str, robot: RobotOnBuses) -> list[Any]:
    """Returns the statuses of the control loop, the buses, the motor controllers and batteries."""
    runner, now = robot.runner, robot.now
    timing = runner.timing
    times = {
        "cycles": timing.cycles,
        "overruns": timing.overruns,
        "skipped": timing.skipped,
        "latest": timing.latest,
        "longest": timing.longest,
        "gaps": timing.gaps,
        "changes": [
            f"{c.time:.2f} s {c.state.value} {c.reason}".strip() for c in runner.changes[-5:]
        ],
        "events": [f"{e.time:.2f} s {e.text}" for e in runner.events[-5:]],
    }
    statuses = [
        diagnostic_status(
            f"{name}: timing",
            hardware,
            WARN if timing.overruns else OK,
            f"{timing.overruns} overruns",
            times,
        )
    ]
    for connection in runner.base.connections:
        receiver, problem = connection.receiver, connection.problem(now)
        values: dict[str, Any] = {
            "received": receiver.received,
            "dropped": receiver.dropped,
            "malformed": connection.malformed,
            "not_sent": connection.not_sent,
            "relayed": connection.relay.passed.total(),
        }
        bus = f"{name}: bus {connection.bus.name}"
        level = ERROR if problem or receiver.lost else OK
        statuses.append(diagnostic_status(bus, hardware, level, problem or "ok", values))
        for controller in connection.controllers:
            problem = controller.problem or controller.power_loss
            values = {
                "homed": controller.homed,
                "follows": controller.follows,
                "error_code": f"{controller.error_code:#06x}",
            }
            level = ERROR if problem or controller.error_code else OK
            status = f"{name}: {controller.node.name}"
            statuses.append(diagnostic_status(status, hardware, level, problem or "ok", values))
    supervision = runner.battery_supervision
    for battery, reported in runner.batteries().items():
        reports: dict[str, Any] = {
            "voltage": reported.voltage,
            "current": reported.current,
            "charge": reported.charge,
            "alarms": reported.alarms,
            "temperatures": reported.temperatures,
        }
        level = WARN if supervision.reason else OK
        text = supervision.reason or "ok"
        statuses.append(diagnostic_status(f"{name}: {battery}", hardware, level, text, reports))
    return statuses
