"""Faults in each phase: the reactions keep their promises, and are those of docs/faults.md.

Each stop on the page has a time and a path, and each phase without a stop an error of the speed.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from contextlib import nullcontext

import pytest

from tests.ros.virtual_topics import VirtualTopics
from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_slow
from tests.tools.fault_matrix import joint_topic_faults
from tests.tools.fault_matrix.fault_table_page import BEGIN, END, PAGE, TOPICS
from thorvaldc.tools.fault_matrix.fault_reaction import STOPS

MOTIONS = [
    "a wheel creeps at rest",
    "a slope turns a wheel at rest",
    "a wheel runs away at full speed",
]
"""The faults that are a motion themselves, which only a person can end."""
NUMBER = r"[0-9]+\.[0-9]+"
REST, NO_STOP = f"rest {NUMBER} s, {NUMBER} m", f"no stop, {NUMBER} m/s"


def lines_of(begin: str) -> list[list[str]]:
    """Returns the cells of a table on the page, without its headings."""
    table = PAGE.read_text(encoding="utf-8").partition(begin)[2].partition(END)[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    return rows[2:]


@pytest.mark.parametrize(("begin", "first", "end"), [(BEGIN, 2, 6), (TOPICS, 1, 3)])
def test_every_phase_on_the_page_has_a_rest_or_an_error_of_the_speed(
    begin: str, first: int, end: int
) -> None:
    rows = lines_of(begin)
    assert len(rows) > 5
    for row in rows:
        assert any(row[first:end])
        for cell in filter(None, row[first:end]):
            reaction, _, rest = cell.partition("; ")
            stops = reaction.split(" in ")[0] in STOPS and row[0] not in MOTIONS
            assert re.fullmatch(REST if stops else f"{REST}|{NO_STOP}", rest), row


def test_joints_behind_topics_are_stopped_as_on_the_page() -> None:
    """Frozen joint states once let the robot drive on for ever, and had no time and no path."""
    lines = lines_of(TOPICS)
    cells = list(joint_topic_faults.cells())
    assert [row[0] for row in cells] == [line[0] for line in lines]
    for row, line in zip(cells, lines, strict=True):
        assert agree(["", "", *row[1:]], ["", "", *line[1:]]), f"{row}\n(make golden writes it)"


def test_a_stop_without_a_rest_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine ignores its commands."""
    (fault,) = [
        f for f in joint_topic_faults.faults(joint_topic_faults.robot()) if "disarms" in f.name
    ]

    def ignore(rig: VirtualTopics) -> None:
        fault.inject(rig)
        rig.engine.write = lambda commands, now: None  # type: ignore[method-assign]

    for inject, problem in ((fault.inject, ""), (ignore, "the wheels still turn")):
        row = fault._replace(inject=inject)
        monkeypatch.setattr(joint_topic_faults, "faults", lambda robot, row=row: [row])
        context = pytest.raises(ValueError, match=problem) if problem else nullcontext()
        with context:
            assert list(joint_topic_faults.cells())


@pytest.mark.parametrize("drives", mostly_slow(reversed(ROBOTS), quick=0, slow=1))
def test_every_promise_is_kept_and_is_on_the_page(drives: str) -> None:
    """The matrix runs in a process of its own, which copies itself for each fault."""
    command = [sys.executable, "-m", "tests.tools.fault_matrix.fault_table_page", drives]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    fault_rows = json.loads(output)
    broken = [
        f"{row['fault']}, {phase}: {problem}"
        for row in fault_rows
        for phase, reaction in row["phases"].items()
        for problem in reaction["broken"]
    ]
    assert broken == []
    unasked = [row["fault"] for row in fault_rows if row["cells"][-1] != "none"]
    assert unasked == MOTIONS
    lines = lines_of(BEGIN)
    for row in fault_rows:
        hint = f"{row['cells']}\n(make golden writes it)"
        assert any(agree(row["cells"], line) for line in lines), hint
    on_page = {line[0] for line in lines if line[1] == drives}
    missing = on_page - {row["fault"] for row in fault_rows}
    assert all(name.startswith("battery") for name in missing), "make golden writes it"


def agree(cells: list[str], line: list[str]) -> bool:
    """Returns whether two rows agree; times (s) and paths (m) may differ by a few cycles."""
    number = re.compile(NUMBER)
    one, other = "|".join(cells[2:]), "|".join(line[2:])
    if cells[:2] != line[:2] or number.sub("", one) != number.sub("", other):
        return False
    pairs = zip(number.findall(one), number.findall(other), strict=True)
    return all(abs(float(a) - float(b)) < 0.31 for a, b in pairs)
