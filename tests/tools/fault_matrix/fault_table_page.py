"""The tables of docs/faults.md: two robots with different drives, joints behind topics, the ground.

``python -m tests.tools.fault_matrix.fault_table_page`` writes the tables into docs/faults.md.  It
writes nothing if a stop has no time and distance, or breaks another promise.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import thorvaldc
from tests.simulation.bus.robots import ROBOTS
from tests.tools.fault_matrix import joint_topic_faults
from thorvaldc.diagnostics.text_layout import markdown_table
from thorvaldc.model import Robot
from thorvaldc.tools.fault_matrix import ground_faults
from thorvaldc.tools.fault_matrix.fault_matrix import (
    HEADINGS,
    FaultMatrix,
    FaultRow,
    row_cells,
    row_json,
)

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
BEGIN, END = "<!-- made by tests/tools/fault_matrix/fault_table_page.py -->\n", "<!-- end -->\n"
TOPICS = "<!-- made by tests/tools/fault_matrix/joint_topic_faults.py -->\n"
GROUND = "<!-- made by tests/tools/fault_matrix/fault_table_page.py: ground -->\n"
GROUND_HEADINGS = ("robot", *ground_faults.HEADINGS)
GROUND_ROBOTS = ("4wd4ws_wide", "2wd0ws_greenhouse")
"""Examples with and without an IMU."""


def rows(drives: str, jobs: int = 1, *, batteries: bool = True) -> tuple[Robot, list[FaultRow]]:
    """Returns the robot and its fault matrix, where ``drives`` names the drives.

    ``batteries``: ``False`` for a matrix without the faults of batteries.
    """
    robot = ROBOTS[drives]()
    matrix = FaultMatrix(robot)
    matrix.cases = [
        replace(case, drives=drives)
        for case in matrix.cases
        if batteries or not case.name.startswith("battery")
    ]
    return robot, matrix.rows(jobs)


def cells(drives: str) -> Iterator[Mapping[str, Any]]:
    """Yields the cells of the table and the reactions of each fault.

    The reactions to batteries do not depend on the drives, and take long.
    """
    robot, fault_rows = rows(drives, batteries=drives == "Thorvald script")
    for row in fault_rows:
        yield {"cells": row_cells(robot, row), **row_json(robot, row)}


def table() -> Iterator[str]:
    by_fault: dict[str, list[tuple[str, ...]]] = {}
    for drives in ROBOTS:
        robot, fault_rows = rows(drives, os.cpu_count() or 1)
        for row in fault_rows:
            if not row.passed:
                raise ValueError(f"{row.case.name}: {dict(row.broken)}")
            by_fault.setdefault(row.case.name, []).append(row_cells(robot, row))
    lines = [line for lines in by_fault.values() for line in lines]
    return markdown_table([HEADINGS, *lines], aligned=True)


def ground_cells() -> Iterator[tuple[str, ...]]:
    """Yields the rows of the table of the ground."""
    for name in GROUND_ROBOTS:
        robot = thorvaldc.load(PAGE.parents[1] / "examples" / name / "robot.yaml")
        for row in ground_faults.ground_rows(robot, ground_faults.ground_faults(robot)):
            yield (name, *ground_faults.ground_cells(row))


def replaced(page: str, begin: str, lines: Iterable[str]) -> str:
    """Returns the page with other lines between ``begin`` and ``END``."""
    head, _, tail = page.partition(begin)
    return head + begin + "".join(f"{line}\n" for line in lines) + END + tail.partition(END)[2]


def main() -> int:
    if sys.argv[1:]:
        print(json.dumps(list(cells(sys.argv[1]))))
        return 0
    faults = list(table())
    topics = markdown_table(
        [joint_topic_faults.HEADINGS, *joint_topic_faults.cells()], aligned=True
    )
    ground = markdown_table([GROUND_HEADINGS, *ground_cells()], aligned=True)
    page = replaced(PAGE.read_text(encoding="utf-8"), BEGIN, faults)
    page = replaced(page, GROUND, ground)
    PAGE.write_text(replaced(page, TOPICS, topics), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
