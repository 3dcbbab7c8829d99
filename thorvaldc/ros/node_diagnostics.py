"""The statuses of the node on /diagnostics."""

from __future__ import annotations

from typing import Any

from thorvaldc.ros.messages import ERROR, OK, WARN, diagnostic_status
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriveMode

_FAULTS = (BaseState.FAULT.value, BaseState.ESTOP.value)
_LEVELS = {"ok": OK, "warning": WARN, "error": ERROR}
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
    if robot is not None:
        statuses += _component_statuses(name, hardware, robot)
    return statuses


def _verdict(robot: DrivenRobot, state: dict[str, Any]) -> tuple[bytes, str]:
    mode = robot.driver.state.mode
    if state["fault"]:
        return ERROR, str(state["fault"])
    if state.get("supervisor") in _FAULTS:
        return ERROR, str(state["supervisor"])
    if warnings := state.get("warnings"):
        return WARN, "; ".join(warnings)
    if state.get("paused"):
        return WARN, "the simulation is paused"
    if mode in _REFUSING:
        return WARN, ": ".join(filter(None, (mode.value, state["held"])))
    if state["not_followed"]:
        return WARN, str(state["not_followed"])
    return OK, mode.value


def _component_statuses(name: str, hardware: str, robot: DrivenRobot) -> list[Any]:
    """Returns the statuses of the control loop and of the parts of the base."""
    timing = robot.timing
    times = {
        "cycles": timing.cycles,
        "overruns": timing.overruns,
        "skipped": timing.skipped,
        "latest": timing.latest,
        "longest": timing.longest,
        "gaps": timing.gaps,
        "events": [f"{e.time:.2f} s {e.text}" for e in robot.events[-5:]],
    }
    level, text = WARN if timing.overruns else OK, f"{timing.overruns} overruns"
    return [
        diagnostic_status(f"{name}: timing", hardware, level, text, times),
        *(
            diagnostic_status(
                f"{name}: {part.name}", hardware, _LEVELS[part.level], part.text, dict(part.values)
            )
            for part in robot.base.component_statuses(robot.now)
        ),
    ]
