"""The report of the first motion of a robot as an HTML page."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.model import Robot

YES = "yes"
"""Unit of a figure that is 1 for yes and 0 for no, and must be 1."""
_STYLE = """body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.2em .6em;
border-bottom:1px solid #ccc}.no{color:#b00020;font-weight:bold}.yes{color:#1b6e2e}
svg{background:#f4f4f4}h2{margin-top:1.5em}"""


def page_of(robot: Robot, report: Mapping[str, Any]) -> str:
    """Returns the report as an HTML page without scripts and external files."""
    verdict = _verdict(report["passed"], "passed", "not passed")
    facts = {
        "robot": report["robot"],
        "result": report["interruption"] or "",
        "date": report["date"],
        "operator": report["operator"],
        "program": f"thorvaldc {report['program']}",
        "model": report["model"],
    }
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(str(value))}</td></tr>"
        for name, value in facts.items()
        if value
    )
    changes = "".join(
        f"<li>{html.escape(f['text'])}<br>{html.escape(f['change'])}</li>"
        for f in report["findings"]
    )
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>First motion of"
        f" {html.escape(robot.name)}</title><style>{_STYLE}</style>"
        f"<h1>First motion of {html.escape(robot.name)}: {verdict}</h1><table>{rows}</table>"
        + (f"<h2>What to change</h2><ul>{changes}</ul>" if changes else "")
        + f"<h2>Wheels</h2>{_picture(robot, report)}<h2>Motors</h2>{''.join(_motors(report))}"
        + f"<h2>Devices</h2>{_nodes(report)}"
        + f"{_calibration(report)}</html>\n"
    )


def _verdict(passed: bool, yes: str, no: str) -> str:
    return f"<span class='{'yes' if passed else 'no'}'>{yes if passed else no}</span>"


def _motors(report: Mapping[str, Any]) -> Iterator[str]:
    for motor in report["motors"]:
        state = _verdict(motor["passed"], motor["state"], motor["state"])
        yield f"<h3>{html.escape(motor['name'])}: {state}</h3><table>"
        for figure in motor.get("figures", ()):
            verdict = _verdict(figure["passed"], "ok", "not in bounds")
            yield (
                f"<tr><td>{html.escape(figure['name'])}</td><td>{_value(figure)}</td>"
                f"<td>{_bounds(figure)}</td><td>{verdict}</td></tr>"
            )
        for text in motor.get("not_tested", ()):
            yield f"<tr><td>{html.escape(text)}</td><td>not tested</td><td></td><td></td></tr>"
        yield "</table>"


def _value(figure: Mapping[str, Any]) -> str:
    if figure["unit"] == YES:
        return "yes" if figure["value"] else "no"
    value = "not reached" if figure["value"] is None else f"{figure['value']:.2f}"
    return f"{value} {figure['unit']}"


def _bounds(figure: Mapping[str, Any]) -> str:
    if figure["unit"] == YES:
        return "yes"
    return f"{figure['least']:.2f} to {figure['most']:.2f}"


def _nodes(report: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(str(node['name']))}</td><td>{html.escape(_identity(node))}</td></tr>"
        for node in report["nodes"]
    )
    return f"<table>{rows}</table>"


def _identity(node: Mapping[str, Any]) -> str:
    return ", ".join(f"{k} {v}" for k, v in node.items() if k != "name" and v not in (None, []))


def _picture(robot: Robot, report: Mapping[str, Any]) -> str:
    """Returns the wheels seen from above, the front up; those with a finding are red."""
    marked = {name for finding in report["findings"] for name in finding["motors"]}
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


def _calibration(report: Mapping[str, Any]) -> str:
    """Returns what `calibrate` has found afterwards, with the errors that last."""
    calibration = report.get("calibration")
    if calibration is None:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(wheel['name'])}</td>"
        f"<td>{_estimate(wheel['steering_offset'], math.degrees(1.0), 'deg')}</td>"
        f"<td>{_estimate(wheel['radius_ratio'], 1.0, '')}</td></tr>"
        for wheel in calibration["wheels"]
    )
    errors = "".join(
        f"<li>{html.escape(name)}: {value:.4g}</li>"
        for name, value in calibration["remaining_errors"].items()
    )
    return (
        "<h2>Calibration</h2><table><tr><th>wheel</th><th>steering offset</th>"
        f"<th>radius ratio</th></tr>{rows}</table>"
        + (f"<p>Errors that remain, in SI units:</p><ul>{errors}</ul>" if errors else "")
    )


def _estimate(estimate: Mapping[str, Any] | None, scale: float, unit: str) -> str:
    if estimate is None or not estimate["determined"]:
        return "not determined"
    return f"{scale * estimate['value']:.4f} +- {scale * estimate['standard_error']:.4f} {unit}"
