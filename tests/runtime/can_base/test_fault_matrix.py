"""Injected faults in each phase: reactions within the promised time, as in docs/faults.md."""

from __future__ import annotations

import re

import pytest

from tests.runtime.can_base.fault_matrix import (
    BEGIN,
    CASES,
    END,
    PAGE,
    PHASES,
    ROBOTS,
    Case,
    react,
    row,
)
from thorvaldc.runtime.can_base.base_state import BaseState


@pytest.mark.parametrize("drives", ROBOTS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_reaction(case: Case, drives: str) -> None:
    robot = ROBOTS[drives]()
    reactions = {phase: react(robot, phase, case.fault) for phase in PHASES}
    for phase, reaction in reactions.items():
        limit = case.reaction[phase]
        if limit is None:
            assert reaction.state in (None, BaseState.FAULT), phase
        else:
            assert reaction.state is BaseState.FAULT, phase
            assert reaction.after is not None
            assert reaction.after <= limit, phase
        if reaction.state is not None or phase != "driving":
            assert reaction.rest is not None, f"{phase}: it still moves"
            assert reaction.rest <= case.rest, phase
    lines = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0].splitlines()
    line = row(case, drives, reactions)
    assert any(agree(line, other) for other in lines), f"{line}\n(make golden writes it)"


def agree(line: str, other: str) -> bool:
    """Returns whether two rows agree; times may differ by a few control cycles."""
    number = re.compile(r"[0-9]+\.[0-9]+")
    if number.sub("", line) != number.sub("", other):
        return False
    pairs = zip(number.findall(line), number.findall(other), strict=True)
    return all(abs(float(a) - float(b)) < 0.31 for a, b in pairs)
