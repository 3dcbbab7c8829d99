"""The report of the first motion of a robot, as files: JSON, and an HTML page beside it."""

from __future__ import annotations

import math
from pathlib import Path

from thorvaldc.commissioning import commission_report
from thorvaldc.commissioning.commission_report import CheckedMotor, CommissionReport, FoundNode
from thorvaldc.commissioning.scan_result import numbers_text
from thorvaldc.diagnostics.files import write_file
from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_page import escape, page, table_html
from thorvaldc.model.facts.fact_tables import FactTable

_NOT_IN_BOUNDS = "not in bounds"
_STYLE = """\
section { overflow-x: auto; }
td { overflow-wrap: anywhere; }
svg { width: auto; max-width: 100%; }
.fault { color: #b00020; font-weight: 600; }
"""


def write_report(path: Path, robot: Robot, report: CommissionReport) -> None:
    """Writes a report, and its HTML page beside it.  Raises ``OSError``."""
    write_file(path, commission_report.report_text(report))
    write_file(path.with_suffix(".html"), page_of(robot, report))


def page_of(robot: Robot, report: CommissionReport) -> str:
    """Returns the report as an HTML page without scripts and external files."""
    facts = {
        "robot": report.robot,
        "interrupted": report.interruption,
        "date": report.date,
        "operator": report.operator,
        "model": report.model,
    }
    stated = tuple(item for item in facts.items() if item[1])
    sections = [table_html(FactTable("report", "Report", (), stated))]
    if report.findings:
        changes = tuple((finding.text, finding.change) for finding in report.findings)
        columns = ("finding", "change")
        sections.append(table_html(FactTable("changes", "What to change", columns, changes)))
    sections.append(_picture(robot, report))
    for number, motor in enumerate(report.motors):
        sections.append(table_html(_motor(number, motor), (_NOT_IN_BOUNDS,)))
    devices = tuple((node.name, _identity(node)) for node in report.nodes)
    sections.append(table_html(FactTable("devices", "Devices", (), devices)))
    if report.calibration is not None:
        sections.append(table_html(_calibration(report.calibration)))
    title = f"First motion of {robot.name}: {'passed' if report.passed else 'not passed'}"
    about = f"Written by thorvaldc {report.program}"
    return page(title, title, about, "".join(sections), _STYLE)


def _motor(number: int, motor: CheckedMotor) -> FactTable:
    rows = [
        (f.name, f.value_text, f.bounds_text, "ok" if f.passed else _NOT_IN_BOUNDS)
        for f in motor.figures
    ]
    rows += [(name, "not tested", "", "") for name in motor.not_tested]
    columns = ("check", "value", "bounds", "verdict")
    title = f"Motor {motor.name}: {motor.state}"
    return FactTable(f"motor-{number}", title, columns, tuple(rows), (1, 2))


def _identity(node: FoundNode) -> str:
    place = "" if node.id is None else f"id {node.id:#x}"
    numbers = numbers_text(node.vendor, node.product, node.revision, node.serial)
    unknown = "serial number unknown" if node.serial is None else ""
    return ", ".join(filter(None, (node.state, place, numbers, unknown)))


def _picture(robot: Robot, report: CommissionReport) -> str:
    """Returns the wheels seen from above, the front up; those with a finding are red."""
    marked = {name for finding in report.findings for name in finding.motors}
    by_joint = {motor.joint: motor.name for motor in robot.actuators}
    scale = 200.0
    xs, ys = [w.x for w in robot.wheels], [w.y for w in robot.wheels]
    width = (max(ys) - min(ys)) * scale + 160
    height = (max(xs) - min(xs)) * scale + 120
    parts = [
        "<section aria-labelledby='wheels'><h2 id='wheels'>Wheels</h2>"
        f"<svg width='{width:.0f}' height='{height:.0f}' role='img' aria-labelledby='picture'>"
        "<title id='picture'>The wheels from above; those with a finding are red</title>"
        f"<text x='{width / 2.0:.0f}' y='20' text-anchor='middle'>front</text>"
    ]
    for number, wheel in enumerate(robot.wheels, 1):
        x = (max(ys) - wheel.y) * scale + 80
        y = (max(xs) - wheel.x) * scale + 60
        motors = {by_joint.get(wheel.spin_joint), by_joint.get(wheel.steering_joint or "")}
        colour = "#b00020" if motors & marked else "#333"
        parts.append(
            f"<rect x='{x - 15:.0f}' y='{y - 35:.0f}' width='30' height='70' rx='6'"
            f" fill='{colour}'/><text x='{x:.0f}' y='{y + 52:.0f}' text-anchor='middle'>"
            f"{number} {escape(wheel.name)}</text>"
        )
    return "".join([*parts, "</svg></section>\n"])


def _calibration(result: commission_report.CalibrationResult) -> FactTable:
    """Returns what `calibrate` has measured afterwards, with the errors that last."""
    rows = tuple(
        (
            wheel.name,
            _estimate(wheel.steering_offset, wheel.steering_offset_error, math.degrees(1.0), "deg"),
            _estimate(wheel.radius_ratio, wheel.radius_ratio_error, 1.0, ""),
        )
        for wheel in result.wheels
    )
    errors = ", ".join(f"{error.name} {error.value:.4g}" for error in result.remaining_errors)
    notes = (f"Errors that remain, in SI units: {errors}.",) if errors else ()
    columns = ("wheel", "steering offset", "radius ratio")
    return FactTable("calibration", "Calibration", columns, rows, (1, 2), notes)


def _estimate(value: float | None, error: float | None, scale: float, unit: str) -> str:
    if value is None or error is None:
        return "not determined"
    return f"{scale * value:.4f} +- {scale * error:.4f} {unit}".strip()
