"""Faults in each phase: the reactions keep their promises, and are those of docs/faults.md."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_slow
from tests.tools.fault_matrix.fault_table_page import BEGIN, END, PAGE


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
    assert unasked == [
        "a wheel creeps at rest",
        "a slope turns a wheel at rest",
        "a wheel runs away at full speed",
    ], "the faults that are a motion themselves"
    page = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    for row in fault_rows:
        hint = f"{row['cells']}\n(make golden writes it)"
        assert any(agree(row["cells"], line) for line in lines), hint
    on_page = {line[0] for line in lines if line[1] == drives}
    missing = on_page - {row["fault"] for row in fault_rows}
    assert all(name.startswith("battery") for name in missing), "make golden writes it"


def agree(cells: list[str], line: list[str]) -> bool:
    """Returns whether two rows agree; times (s) and paths (m) may differ by a few cycles."""
    number = re.compile(r"[0-9]+\.[0-9]+")
    one, other = "|".join(cells[2:]), "|".join(line[2:])
    if cells[:2] != line[:2] or number.sub("", one) != number.sub("", other):
        return False
    pairs = zip(number.findall(one), number.findall(other), strict=True)
    return all(abs(float(a) - float(b)) < 0.31 for a, b in pairs)
