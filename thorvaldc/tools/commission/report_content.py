"""The report of the checks as JSON and as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from thorvaldc.commissioning.commission_report import FORMAT, VERSION, content_hash
from thorvaldc.commissioning.scan_result import ScanEntry
from thorvaldc.diagnostics.files import finite
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import Actuator, Robot
from thorvaldc.tools.commission.assembly_findings import findings
from thorvaldc.tools.commission.questions import joints
from thorvaldc.tools.commission.results import MotorResult


def motor_key(robot: Robot, motor: Actuator) -> str:
    """Returns the hash of a motor and its controller; its result is void if they change."""
    nodes = [n for bus in robot.buses for n in bus.nodes if n.name == motor.node]
    return content_hash(motor, *nodes)


def kept_motors(robot: Robot, report: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns the motors of an earlier report that have passed and have not changed since then."""
    keys = {motor.name: motor_key(robot, motor) for motor in joints(robot)}
    earlier = {str(m.get("name")): m for m in report.get("motors", ()) if isinstance(m, dict)}
    return {
        name: motor
        for name, motor in earlier.items()
        if motor.get("passed") is True and motor.get("key") == keys.get(name)
    }


def as_json(
    robot: Robot,
    results: Mapping[str, MotorResult],
    kept: Mapping[str, dict[str, Any]],
    entries: Iterable[ScanEntry],
    *,
    operator: str,
    date: str,
    interruption: str = "",
) -> dict[str, Any]:
    """Returns the report.

    - ``results``: new results by motor; ``kept``: motors of an earlier report;
    - ``entries``: the devices on the buses.
    """
    named = findings(robot, results)
    for name, result in results.items():
        result.findings = [finding for finding in named if name in finding.motors]
    motors = [
        kept[motor.name] if motor.name in kept else _motor(robot, motor, results, date, operator)
        for motor in joints(robot)
    ]
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": robot.name,
        "model": content_hash(robot),
        "program": program_version(),
        "date": date,
        "operator": operator,
        "passed": not named and not interruption and all(motor["passed"] for motor in motors),
        "interruption": interruption,
        "nodes": [_node(entry) for entry in entries],
        "findings": [{"motors": list(f.motors), "text": f.text, "change": f.change} for f in named],
        "motors": motors,
    }


def _node(entry: ScanEntry) -> dict[str, Any]:
    identity = {} if entry.identity is None else entry.identity._asdict()
    return {"name": entry.node, "state": entry.verdict, "id": entry.device_id, **identity}


def _motor(
    robot: Robot, motor: Actuator, results: Mapping[str, MotorResult], date: str, operator: str
) -> dict[str, Any]:
    result = results.get(motor.name)
    content: dict[str, Any] = {
        "name": motor.name,
        "node": motor.node,
        "channel": motor.channel,
        "key": motor_key(robot, motor),
        "passed": False,
        "state": "not tested",
    }
    if result is None:
        return content
    observation = result.observation
    return content | {
        "passed": result.passed,
        "state": "left out" if result.skipped else "passed" if result.passed else "failed",
        "date": date,
        "operator": operator,
        "moved": observation.moved.name if observation.moved is not None else None,
        "seen": finite(observation.seen),
        "zero": finite(observation.zero),
        "figures": [
            {
                "name": f.name,
                "value": finite(f.value),
                "unit": f.unit,
                "least": f.least,
                "most": f.most,
                "passed": f.passed,
            }
            for f in result.figures
        ],
        "not_tested": result.not_tested,
    }


# -- text ------------------------------------------------------------------------------------------


def summary(report: Mapping[str, Any], width: int | None) -> str:
    """Returns the report as a text for the terminal."""
    rows = [("motor", "controller", "state")]
    rows += [(m["name"], f"{m['node']} {m['channel']}", m["state"]) for m in report["motors"]]
    parts = [text_table(rows, width)]
    parts += [f"{f['text']}\n    {f['change']}" for f in report["findings"]]
    if report["interruption"]:
        parts.append(f"interrupted: {report['interruption']}")
    return "\n".join(parts)


def calibration_text(robot: Robot, results: Mapping[str, MotorResult]) -> str:
    """Returns a calibration file with the measured zeros, empty without a measured one."""
    lines = []
    for wheel in robot.wheels:
        for result in results.values():
            observation = result.observation
            moved = observation.moved
            if moved is None or moved.joint != wheel.steering_joint:
                continue
            is_found = any(moved.name in f.motors and "offset" in f.change for f in result.findings)
            if is_found and not math.isnan(observation.zero):
                offset = math.degrees(moved.encoder_offset + observation.zero)
                lines.append(f"  {wheel.name}: {{steering_offset: {offset:.1f} deg}}")
    return "\n".join(["thorvaldc: 1", f"robot: {robot.name}", "wheels:", *lines, ""]) * bool(lines)
