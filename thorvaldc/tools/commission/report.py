"""The report of the checks as JSON, as an HTML page and as text."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from thorvaldc.commissioning.commission_report import FORMAT, VERSION, content_hash
from thorvaldc.commissioning.scan_result import ScanEntry
from thorvaldc.diagnostics.files import finite
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import Actuator, Robot
from thorvaldc.tools.commission.assembly_findings import findings
from thorvaldc.tools.commission.questions import joints, wheel_numbers
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
    found = findings(robot, results)
    for name, result in results.items():
        result.findings = [finding for finding in found if name in finding.motors]
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
        "passed": not found and not interruption and all(motor["passed"] for motor in motors),
        "interruption": interruption,
        "nodes": [_node(entry) for entry in entries],
        "findings": [{"motors": list(f.motors), "text": f.text, "change": f.change} for f in found],
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
    if result is None or result.skipped:
        return content | ({} if result is None else {"state": "left out"})
    observation = result.observation
    return content | {
        "passed": result.passed,
        "state": "passed" if result.passed else "failed",
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


# -- HTML ------------------------------------------------------------------------------------------

_STYLE = """body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.2em .6em;
border-bottom:1px solid #ccc}.no{color:#b00020;font-weight:bold}.yes{color:#1b6e2e}
svg{background:#f4f4f4}h2{margin-top:1.5em}"""


def as_html(robot: Robot, report: Mapping[str, Any]) -> str:
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
    found = "".join(
        f"<li>{html.escape(f['text'])}<br>{html.escape(f['change'])}</li>"
        for f in report["findings"]
    )
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>First motion of"
        f" {html.escape(robot.name)}</title><style>{_STYLE}</style>"
        f"<h1>First motion of {html.escape(robot.name)}: {verdict}</h1><table>{rows}</table>"
        + (f"<h2>What to change</h2><ul>{found}</ul>" if found else "")
        + f"<h2>Wheels</h2>{_picture(robot, report)}<h2>Motors</h2>{''.join(_motors(report))}"
        + f"<h2>Devices</h2>{_nodes(report)}</html>\n"
    )


def _verdict(passed: bool, yes: str, no: str) -> str:
    return f"<span class='{'yes' if passed else 'no'}'>{yes if passed else no}</span>"


def _motors(report: Mapping[str, Any]) -> Iterator[str]:
    for motor in report["motors"]:
        state = _verdict(motor["passed"], motor["state"], motor["state"])
        yield f"<h3>{html.escape(motor['name'])}: {state}</h3><table>"
        for figure in motor.get("figures", ()):
            value = "not reached" if figure["value"] is None else f"{figure['value']:.2f}"
            verdict = _verdict(figure["passed"], "ok", "not in bounds")
            yield (
                f"<tr><td>{html.escape(figure['name'])}</td><td>{value} {figure['unit']}</td>"
                f"<td>{figure['least']:.2f} to {figure['most']:.2f}</td><td>{verdict}</td></tr>"
            )
        for text in motor.get("not_tested", ()):
            yield f"<tr><td>{html.escape(text)}</td><td>not tested</td><td></td><td></td></tr>"
        yield "</table>"


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
    found = {name for finding in report["findings"] for name in finding["motors"]}
    by_joint = {motor.joint: motor.name for motor in joints(robot)}
    scale = 200.0
    xs, ys = [w.x for w in robot.wheels], [w.y for w in robot.wheels]
    width = (max(ys) - min(ys)) * scale + 160
    height = (max(xs) - min(xs)) * scale + 120
    parts = [f"<svg width='{width:.0f}' height='{height:.0f}' role='img'>"]
    for wheel, number in zip(robot.wheels, wheel_numbers(robot).values(), strict=True):
        x = (max(ys) - wheel.y) * scale + 80
        y = (max(xs) - wheel.x) * scale + 60
        motors = {by_joint.get(wheel.spin_joint), by_joint.get(wheel.steering_joint or "")}
        colour = "#b00020" if motors & found else "#333"
        parts.append(
            f"<rect x='{x - 15:.0f}' y='{y - 35:.0f}' width='30' height='70' rx='6'"
            f" fill='{colour}'/><text x='{x:.0f}' y='{y + 52:.0f}' text-anchor='middle'>"
            f"{number} {html.escape(wheel.name)}</text>"
        )
    return "".join([*parts, "</svg>"])
