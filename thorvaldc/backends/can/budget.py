"""Load of each CAN bus and worst-case response times of its CAN frames, as JSON and as a Markdown
table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.backends.can.canmap import json_text
from thorvaldc.diagnostics.text_layout import markdown_table
from thorvaldc.model import Bus, FrameDefinition, Robot
from thorvaldc.model.bus_timing import worst_case_bits

FORMAT = "thorvaldc-can-budget"
VERSION = 1
HEAD = (
    *("id", "frame", "from", "bytes", "bits"),
    *("period ms", "load %", "response ms", "deadline ms"),
)
RIGHT = (0, *range(3, len(HEAD)))  # columns of numbers


def budget_json(robot: Robot) -> str:
    """Return the load of each CAN bus and the response time of each CAN frame as JSON text."""
    return json_text(
        {
            "format": FORMAT,
            "version": VERSION,
            "robot": robot.name,
            "buses": [
                {
                    "name": bus.name,
                    "bitrate": bus.bitrate,
                    "load": bus.load,
                    "frames": [_row(bus, frame) for frame in _by_urgency(bus)],
                }
                for bus in robot.buses
            ],
        }
    )


def _by_urgency(bus: Bus) -> list[FrameDefinition]:
    return sorted(bus.frames, key=lambda frame: frame.cob_id)


def _row(bus: Bus, frame: FrameDefinition) -> dict[str, Any]:
    bits = worst_case_bits(frame.length)
    interval = frame.period or frame.minimum_interval
    return {
        "name": frame.name,
        "cob_id": frame.cob_id,
        "producer": frame.producer,
        "length": frame.length,
        "bits": bits,
        "transmission_time": bits / bus.bitrate,
        "period": frame.period,
        "minimum_interval": frame.minimum_interval,
        "load": bits / bus.bitrate / interval if interval else None,
        "response_time": frame.response_time,
        "deadline": frame.deadline,
    }


def budget_table(robot: Robot) -> str:
    """Return the load of each CAN bus and the response time of each CAN frame as Markdown tables.

    The columns of the Markdown tables are aligned.
    """
    lines = [
        f"# Load of the buses of {robot.name}",
        "",
        "Most urgent first. Response: the longest time until a frame is received when all others",
        "come at the worst instant (Davis, Burns, Bril, Lukkien 2007); that of commands, of SYNC",
        "and of what follows SYNC counts from the beginning of the control cycle. No period: sent",
        "on demand, one such frame of the master in a cycle; an SDO is answered within a cycle.",
    ]
    for bus in robot.buses:
        lines += ["", f"## {bus.name}", ""]
        lines.append(f"{bus.bitrate / 1000:g} kbit/s, load {100 * bus.load:.1f} % at worst.")
        lines += ["", *_table(bus)]
    return "\n".join(lines) + "\n"


def _table(bus: Bus) -> Iterator[str]:
    rows = [HEAD]
    for frame in _by_urgency(bus):
        load = _row(bus, frame)["load"]
        rows.append(
            (
                f"0x{frame.cob_id:03x}",
                frame.name,
                frame.producer,
                str(frame.length),
                str(worst_case_bits(frame.length)),
                _milliseconds(frame.period or frame.minimum_interval, "g"),
                f"{100 * load:.2f}" if load else "-",
                _milliseconds(frame.response_time, ".3f"),
                _milliseconds(frame.deadline, "g"),
            )
        )
    return markdown_table(rows, right=RIGHT, aligned=True)


def _milliseconds(time: float | None, form: str) -> str:
    return format(round(time * 1000, 6), form) if time is not None else "-"
