"""The content of the report, from the results of the checks; its text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from thorvaldc.commissioning import commission_report
from thorvaldc.commissioning.commission_report import CheckedMotor, CommissionReport, FoundNode
from thorvaldc.commissioning.scan_result import ScanEntry
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.model_json import model_hash
from thorvaldc.tools.commission.assembly_findings import findings, measured_offset
from thorvaldc.tools.commission.results import MotorResult


def report_of(
    robot: Robot,
    results: Mapping[str, MotorResult],
    kept: Mapping[str, CheckedMotor],
    entries: Iterable[ScanEntry],
    *,
    operator: str,
    date: str,
    interruption: str = "",
) -> CommissionReport:
    """Returns the report.

    - ``results``: new results by motor; ``kept``: motors of an earlier report;
    - ``entries``: the devices on the buses.
    """
    all_findings = tuple(findings(robot, results))
    blamed = {name for finding in all_findings for name in finding.motors}

    def checked(motor: Actuator) -> CheckedMotor:
        key = commission_report.motor_key(robot, motor)
        result = results.get(motor.name)
        if result is None:
            return CheckedMotor(motor.name, motor.node, motor.channel, key)
        observation = result.observation
        return CheckedMotor(
            motor.name,
            motor.node,
            motor.channel,
            key,
            _state(result, motor.name in blamed),
            date,
            operator,
            None if observation.moved is None else observation.moved.name,
            _known(observation.seen),
            _known(observation.zero),
            tuple(result.figures),
            tuple(result.not_tested),
        )

    return CommissionReport(
        robot.name,
        model_hash(robot),
        program_version(),
        date,
        operator,
        interruption,
        tuple(map(FoundNode.of, entries)),
        all_findings,
        tuple(kept.get(m.name) or checked(m) for m in commission_report.driven_joints(robot)),
    )


def _state(result: MotorResult, is_blamed: bool) -> str:
    if is_blamed:
        return commission_report.FAILED
    return commission_report.LEFT_OUT if result.skipped else commission_report.PASSED


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def summary(report: CommissionReport, width: int | None) -> str:
    """Returns the report as a text for the terminal."""
    rows = [("motor", "controller", "state")]
    rows += [(m.name, f"{m.node} {m.channel}", m.state) for m in report.motors]
    parts = [text_table(rows, width)]
    parts += [f"{m.name}: {text}" for m in report.motors for text in m.not_tested]
    parts += [f"{f.text}\n    {f.change}" for f in report.findings]
    if report.interruption:
        parts.append(f"interrupted: {report.interruption}")
    return "\n".join(parts)


def calibration_text(robot: Robot, results: Mapping[str, MotorResult]) -> str:
    """Returns a calibration file with the measured zeros, or an empty text without one."""
    names = {wheel.steering_joint: wheel.name for wheel in robot.wheels if wheel.steering_joint}
    lines = [
        f"  {names[moved.joint]}: {{steering_offset: {math.degrees(offset):.1f} deg}}"
        for result in results.values()
        if (moved := result.observation.moved) is not None
        and (offset := measured_offset(result.observation)) is not None
    ]
    if not lines:
        return ""
    return "\n".join(["thorvaldc: 1", f"robot: {robot.name}", "wheels:", *sorted(lines), ""])
