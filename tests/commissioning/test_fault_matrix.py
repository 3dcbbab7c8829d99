"""Each injected fault in each phase of a flash: the flash goes on or stops, and can be resumed."""

from __future__ import annotations

import pytest

from tests.commissioning.fault_matrix import (
    BEGIN,
    CASES,
    END,
    LONGEST,
    PAGE,
    Case,
    reactions,
    row,
)
from tests.slow import one_quick_of

STOPS = ("bus-error", "flash-stopped", "plan-impossible", "plan-changed")


@pytest.mark.parametrize("case", one_quick_of(4, CASES), ids=lambda case: case.name)
def test_reaction(case: Case) -> None:
    by_phase = reactions(case)
    for phase, reaction in by_phase.items():
        assert reaction.resumed, phase
        if reaction.code:
            assert reaction.code in STOPS, phase
            assert reaction.after <= LONGEST, phase
    table = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    line = row(case, by_phase)
    hint = f"{line}\n(python -m tests.commissioning.fault_matrix writes it)"
    assert line in table.splitlines(), hint
