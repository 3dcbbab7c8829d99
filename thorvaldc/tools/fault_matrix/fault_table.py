"""The fault matrix as a Markdown table and as JSON values."""

from __future__ import annotations

import hashlib
import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from thorvaldc import __version__
from thorvaldc.diagnostics.text_layout import markdown_table, text_table
from thorvaldc.model import Robot
from thorvaldc.model.model_json import to_json
from thorvaldc.model.stopping import BUS_LOST, SwerveBound, swerve_bounds
from thorvaldc.tools.fault_matrix.fault_cases import DRIVING, MOVING_PHASES, PHASES
from thorvaldc.tools.fault_matrix.fault_limits import rest_limit
from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix, FaultRow
from thorvaldc.tools.fault_matrix.fault_reaction import Reaction

SIMULATED = (
    "The reactions were measured on a simulated bus with simulated drives and motors. They do not"
    " replace tests on the hardware, and a stop in software is not a safety function."
)
HEADINGS = ("fault", "drives", *PHASES, "at rest", "promised", "unasked motion")


def model_hash(robot: Robot) -> str:
    """Returns the SHA-256 of the ``model.json`` of the robot, which also its build contains."""
    return hashlib.sha256(to_json(robot).encode()).hexdigest()


def matrix_json(matrix: FaultMatrix, rows: Sequence[FaultRow], file: str) -> dict[str, Any]:
    """Returns the fault matrix as JSON values, with times in s, paths in m and speeds in m/s."""
    robot, twist = matrix.robot, matrix.twist
    return {
        "robot": robot.name,
        "file": file,
        "model_sha256": model_hash(robot),
        "thorvaldc": __version__,
        "simulated": True,
        "note": SIMULATED,
        "driving": twist._asdict(),
        "swerve": {
            bound.kind: bound.yaw for bound in swerve_bounds(robot) if math.isfinite(bound.yaw)
        },
        "passed": all(row.passed for row in rows),
        "faults": [row_json(robot, row) for row in rows],
    }


def row_json(robot: Robot, row: FaultRow) -> dict[str, Any]:
    """Returns the reactions to one fault as JSON values."""
    phases = {}
    for phase, reaction in row.reactions.items():
        limits: dict[str, float] = {}
        if phase in row.case.detection:
            limits["reaction"] = row.case.detection[phase]
        if phase in MOVING_PHASES and reaction.rest_time is not None:
            time, distance = rest_limit(robot, row.case, phase)
            limits |= {"rest_time": time, "rest_distance": distance}
        finite = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        phases[phase] = {
            **reaction.as_json(),
            "promised": finite,
            "broken": list(row.broken.get(phase, ())),
        }
    return {
        "fault": row.case.name,
        "drives": row.case.drives,
        "passed": row.passed,
        "phases": phases,
    }


def markdown(
    matrix: FaultMatrix, rows: Sequence[FaultRow], file: str, width: int | None = None
) -> Iterator[str]:
    """Yields the lines of a Markdown page with the fault matrix.

    ``width``: number of columns of the terminal, or ``None`` for a file.  On a terminal the matrix
    is a text table, because a table in Markdown has one line per row.
    """
    robot, twist = matrix.robot, matrix.twist
    yield f"# Faults of the robot {robot.name}"
    yield ""
    yield SIMULATED if width is None else textwrap.fill(SIMULATED, width)
    yield ""
    yield f"- Robot file: `{file}`"
    yield f"- SHA-256 of its model.json: `{model_hash(robot)}`"
    yield f"- thorvaldc {__version__}"
    yield f"- Driving: {twist.vx:.2f} m/s in curves of {abs(twist.wz):.2f} rad/s to both sides"
    for bound in swerve_bounds(robot):
        yield f"- Yaw, straight ahead: {_swerve_text(bound)}"
    yield ""
    cells = [HEADINGS, *(row_cells(robot, row) for row in rows)]
    if width is None:
        yield from markdown_table(cells, aligned=True)
    else:
        yield text_table(cells, width)
    broken = [(row, phase, text) for row in rows for phase, texts in row.broken.items()
              for text in texts]  # fmt: skip
    yield ""
    if broken:
        yield "Promises that are not kept:"
        yield ""
        for row, phase, text in broken:
            yield f"- {row.case.name} ({row.case.drives}), {phase}: {text}"
    else:
        yield "All promises are kept."


def _swerve_text(bound: SwerveBound) -> str:
    bus = f"the bus `{bound.bus}`"
    cause = f"the driver loses {bus}" if bound.kind == BUS_LOST else f"{bus} is silent"
    if math.isinf(bound.yaw):
        return f"no bound if {cause}, because a drive has no watchdog"
    return f"at most {math.ceil(math.degrees(bound.yaw))} deg if {cause}"


def row_cells(robot: Robot, row: FaultRow) -> tuple[str, ...]:
    """Returns the cells of the table for one fault."""
    phases = [_reaction(row.reactions.get(phase)) for phase in PHASES]
    moving = [(p, r) for p, r in row.reactions.items() if p in MOVING_PHASES]
    rests = [r for _, r in moving if r.rest_time is not None]
    rest = ""
    if rests and len(rests) == len(moving):
        time = max(r.rest_time or 0.0 for r in rests)
        distance = max(r.rest_distance or 0.0 for r in rests)
        rest = f"{_rounded_up(time, 10)} s, {_rounded_up(distance, 20)} m"
    unasked = max((r.unasked for r in row.reactions.values() if r.moved_unasked), default=None)
    return (
        row.case.name,
        row.case.drives,
        *phases,
        rest,
        _promise(robot, row, moving),
        "none" if unasked is None else f"+{unasked:.2f} m/s",
    )


def _reaction(reaction: Reaction | None) -> str:
    if reaction is None:
        return ""
    if reaction.after is None:
        return reaction.reaction
    return f"{reaction.reaction} in {_rounded_up(reaction.after, 10)} s"


def _promise(robot: Robot, row: FaultRow, moving: list[tuple[str, Reaction]]) -> str:
    """Returns the promised time until the reaction, and time and distance until the robot stands,
    for the phase driving."""
    parts = []
    limit = max(row.case.detection.values(), default=None)
    if limit is not None:
        parts.append(f"{_rounded_up(limit, 10)} s")
    if any(r.rest_time is not None for p, r in moving if p == DRIVING):
        time, distance = rest_limit(robot, row.case, DRIVING)
        finite = math.isfinite(time)
        known = [f"{_rounded_up(time, 10)} s", f"{_rounded_up(distance, 20)} m"] if finite else []
        parts += known or ["unlimited"]
    return ", ".join(parts)


def _rounded_up(value: float, parts: int) -> str:
    """Returns a value rounded up to a whole number of parts, so that single cycles do not change
    the table."""
    rounded = math.ceil(parts * value - 1e-6) / parts
    return f"{rounded:.2f}" if parts > 10 else f"{rounded:.1f}"
