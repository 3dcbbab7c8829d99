"""Formats the summary of a bus monitor as lines of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thorvaldc.diagnostics.text_layout import text_table

SHOWN_EMERGENCIES = 5


def monitor_lines(summary: Mapping[str, Any]) -> list[str]:
    """Returns the summary of a CAN bus as lines of text.

    The text contains a headline, the nodes, the EMCY messages, the CAN frames that are not in the
    CAN map, and the CAN frames of the CAN map with their signal values.
    """
    lines = [_headline(summary), ""]
    lines += _nodes(summary["nodes"])
    lines += _emergencies(summary["emergencies"], summary["time"])
    lines += _unknown(summary["unknown"])
    rows = [("id", "frame", "period", "age", "values"), *map(_frame, summary["frames"])]
    return [*lines, "", *text_table(rows, right=(0, 2, 3), least=(3, 30, 7, 7, 0)).splitlines()]


def page(lines: Sequence[str], height: int, first: int) -> list[str]:
    """Returns ``height`` lines of the bus monitor text, starting at the line with the index
    ``first``.

    If the text has more than ``height`` lines, the last returned line shows the scroll position.
    """
    height = max(height, 3)
    if len(lines) <= height:
        return list(lines)
    first = min(max(first, 0), len(lines) - height + 1)
    shown = list(lines[first : first + height - 1])
    return [*shown, f"-- {first + 1} to {first + len(shown)} of {len(lines)} lines; arrow keys --"]


def _headline(summary: Mapping[str, Any]) -> str:
    """Returns robot, bus, bit rate, load and the state of this computer's CAN controller."""
    parts = [
        f"{summary['robot']} {summary['bus']}",
        f"{summary['bitrate'] // 1000} kbit/s",
        f"load {_percent(summary['load'])} (highest {_percent(summary['highest_load'])}, "
        f"budget {_percent(summary['load_budget'])})",
        f"{summary['frames_per_second']:.0f} frames/s",
    ]
    controller = summary.get("controller", "")
    if controller not in ("", "error-active"):
        parts.append(f"OWN CONTROLLER: {controller.upper()}")
    if summary.get("overruns"):
        parts.append(f"{summary['overruns']} frames lost by this program")
    return "  ".join(parts)


def _nodes(nodes: Sequence[Mapping[str, Any]]) -> list[str]:
    if not nodes:
        return []
    rows = [("node", "id", "state", "")]
    rows += [(node["name"], str(node["id"]), *_state(node)) for node in nodes]
    return text_table(rows, right=(1,), least=(0, 3, 17, 0)).splitlines()


def _state(node: Mapping[str, Any]) -> tuple[str, str]:
    """Returns the NMT state of a node, and the states of its drives with the flags that are set."""
    drive = ", ".join(
        name.replace("_", " ") if state is None else f"{name} {state}"
        for name, state in node["drive"].items()
    )
    state = node["nmt"] or ("-" if node["heard"] is not None else "no frame yet")
    return (f"{state}  SILENT" if node["silent"] else state), drive


def _emergencies(emergencies: Sequence[Mapping[str, Any]], now: float) -> list[str]:
    lines = [""] if emergencies else []
    for emergency in emergencies[-SHOWN_EMERGENCIES:]:
        text = "no error" if emergency["over"] else f"error {emergency['code']:#06x}"
        register = (
            "" if emergency["register"] is None else f" register {emergency['register']:#04x}"
        )
        data = f" data {emergency['data']}" if emergency["data"].strip("0") else ""
        age = now - emergency["time"]
        lines.append(f"EMCY {age:.1f} s ago  {emergency['node']}: {text}{register}{data}")
    return lines


def _unknown(frames: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [""] if frames else []
    for frame in frames:
        name = f"{frame['id']:08x}" if frame["extended"] else f"{frame['id']:03x}"
        lines.append(
            f"NOT IN THE MAP {name}  {frame['count']} frames  {_time(frame['period'])}  "
            f"{_time(frame['age'])} ago  {frame['data']}".rstrip()
        )
    return lines


def _frame(frame: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{frame['id']:x}",
        frame["name"],
        _time(frame["period"]),
        _time(frame["age"]),
        "  ".join(filter(None, (frame["problem"].upper(), _values(frame)))),
    )


def _values(frame: Mapping[str, Any]) -> str:
    units, flags = frame["units"], frame["flags"]
    return "  ".join(
        name if name in flags else f"{name} {_value(value)} {units.get(name, '')}".rstrip()
        for name, value in frame["values"].items()
        if value or name not in flags
    )


def _value(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, int) else f"{value + 0.0:.4g}"


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    if seconds < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 100.0 else f"{seconds:.0f} s"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
