"""Each fault in each phase of a flash: it goes on or stops with words, and can be resumed."""

from __future__ import annotations

import pytest

from tests.commissioning.fault_matrix import BEGIN, END, LONGEST, PAGE, found, row
from tests.runtime.can_base.fault_matrix import CASES, Case

STOPS = ("bus-error", "flash-stopped", "plan-impossible", "plan-changed")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_reaction(case: Case) -> None:
    reactions = found(case)
    for phase, reaction in reactions.items():
        assert reaction.resumed, phase
        if reaction.fault:
            assert reaction.fault in STOPS, phase
            assert reaction.after <= LONGEST, phase
    table = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    line = row(case, reactions)
    again = f"{line}\n(python -m tests.commissioning.fault_matrix writes it)"
    assert line in table.splitlines(), again
