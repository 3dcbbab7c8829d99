"""The report of the first motion of a robot, as files: JSON, and an HTML page beside it."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.commissioning import commission_report
from thorvaldc.commissioning.commission_report import CommissionReport, FoundNode
from thorvaldc.diagnostics.files import write_file
from thorvaldc.model import Robot

_STYLE = """body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.2em .6em;
border-bottom:1px solid #ccc}.no{color:#b00020;font-weight:bold}.yes{color:#1b6e2e}
svg{background:#f4f4f4}h2{margin-top:1.5em}"""


def write_report(path: Path, robot: Robot, report: CommissionReport) -> None:
    """Writes a report, and its HTML page beside it.  Raises ``OSError``."""
    write_file(path, commission_report.report_text(report))
    write_file(path.with_suffix(".html"), page_of(robot, report))


def page_of(robot: Robot, report: CommissionReport) -> str:
    """Returns the report as an HTML page without scripts and external files."""
    title = f"First motion of {html.escape(robot.name)}"
    verdict = _verdict(report.passed, "passed" if report.passed else "not passed")
    facts = {
        "robot": report.robot,
        "interrupted": report.interruption,
        "date": report.date,
        "operator": report.operator,
        "program": f"thorvaldc {report.program}",
        "model": report.model,
    }
    changes = [f"{html.escape(f.text)}<br>{html.escape(f.change)}" for f in report.findings]
    parts = [
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title>",
        f"<style>{_STYLE}</style><h1>{title}: {verdict}</h1>",
        _table((name, html.escape(value)) for name, value in facts.items() if value),
        *([f"<h2>What to change</h2>{_list(changes)}"] if changes else []),
        f"<h2>Wheels</h2>{_picture(robot, report)}<h2>Motors</h2>",
        *_motors(report),
        "<h2>Devices</h2>",
        _table((html.escape(n.name), html.escape(_identity(n))) for n in report.nodes),
        _calibration(report),
        "</html>\n",
    ]
    return "".join(parts)


def _table(rows: Iterator[tuple[str, ...]]) -> str:
    """``rows``: cells in HTML."""
    cells = ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _list(items: list[str]) -> str:
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


def _verdict(passed: bool, text: str) -> str:
    return f"<span class='{'yes' if passed else 'no'}'>{html.escape(text)}</span>"


def _motors(report: CommissionReport) -> Iterator[str]:
    for motor in report.motors:
        state = _verdict(motor.state == commission_report.PASSED, motor.state)
        rows = [
            (
                html.escape(figure.name),
                html.escape(figure.value_text),
                html.escape(figure.bounds_text),
                _verdict(figure.passed, "ok" if figure.passed else "not in bounds"),
            )
            for figure in motor.figures
        ]
        rows += [(html.escape(name), "not tested", "", "") for name in motor.not_tested]
        yield f"<h3>{html.escape(motor.name)}: {state}</h3>{_table(iter(rows))}"


def _identity(node: FoundNode) -> str:
    numbers = {
        "id": node.id,
        "vendor": node.vendor,
        "product": node.product,
        "revision": node.revision,
        "serial": node.serial,
    }
    known = [f"{name} {number:#x}" for name, number in numbers.items() if number is not None]
    unknown = ["serial number unknown"] if node.serial is None else []
    return ", ".join([node.state, *known, *unknown])


def _picture(robot: Robot, report: CommissionReport) -> str:
    """Returns the wheels seen from above, the front up; those with a finding are red."""
    marked = {name for finding in report.findings for name in finding.motors}
    by_joint = {motor.joint: motor.name for motor in robot.actuators}
    scale = 200.0
    xs, ys = [w.x for w in robot.wheels], [w.y for w in robot.wheels]
    width = (max(ys) - min(ys)) * scale + 160
    height = (max(xs) - min(xs)) * scale + 120
    parts = [
        f"<svg width='{width:.0f}' height='{height:.0f}' role='img'>"
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
            f"{number} {html.escape(wheel.name)}</text>"
        )
    return "".join([*parts, "</svg>"])


def _calibration(report: CommissionReport) -> str:
    """Returns what `calibrate` has measured afterwards, with the errors that last."""
    if report.calibration is None:
        return ""
    rows = [
        (
            html.escape(wheel.name),
            _estimate(wheel.steering_offset, wheel.steering_offset_error, math.degrees(1.0), "deg"),
            _estimate(wheel.radius_ratio, wheel.radius_ratio_error, 1.0, ""),
        )
        for wheel in report.calibration.wheels
    ]
    heading = ("wheel", "steering offset", "radius ratio")
    errors = [
        f"{html.escape(error.name)}: {error.value:.4g}"
        for error in report.calibration.remaining_errors
    ]
    after = f"<p>Errors that remain, in SI units:</p>{_list(errors)}" if errors else ""
    return f"<h2>Calibration</h2>{_table(iter([heading, *rows]))}{after}"


def _estimate(value: float | None, error: float | None, scale: float, unit: str) -> str:
    if value is None or error is None:
        return "not determined"
    return f"{scale * value:.4f} +- {scale * error:.4f} {unit}".strip()
