"""The hazard log: each fault and each rule has a hazard, and each hazard a test that exists."""

from __future__ import annotations

import pytest

from tests.tools.fault_matrix import hazard_page
from tests.tools.fault_matrix.hazard_page import FAULTS, HAZARDS_PAGE, Hazard, Row


def test_the_page_is_made_from_the_fault_tables_and_the_rules() -> None:
    assert hazard_page.text() == HAZARDS_PAGE.read_text(encoding="utf-8"), "make golden writes it"


@pytest.mark.parametrize("name", ["test_gone", "test_a_missing"])
def test_a_hazard_whose_test_is_gone_is_not_written(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = "tests/runtime/can_base/test_bus_loop.py::" + name
    first = FAULTS[0]._replace(tests=(*FAULTS[0].tests, gone))
    monkeypatch.setattr(hazard_page, "FAULTS", (first, *FAULTS[1:]))
    with pytest.raises(ValueError, match=f"the test {gone} is gone"):
        hazard_page.text()


def test_a_fault_or_a_rule_without_a_hazard_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="`a meteorite` belongs to 0 hazards"):
        hazard_page.owned(FAULTS, ["a meteorite"])
    with pytest.raises(ValueError, match=r"nothing is called .*driver process killed"):
        hazard_page.owned(FAULTS, ["client hangs"])
    monkeypatch.setitem(hazard_page.RULES, "another rule", ("publish", None))
    with pytest.raises(ValueError, match="`another rule` belongs to 0 hazards"):
        hazard_page.text()


def test_the_bounds_are_the_longest_of_all_rows() -> None:
    rows = [
        Row("a", "fault in 0.2 s; rest 1.1 s, 0.70 m", "0.3 s, 1.2 s, 1.05 m"),
        Row("b", "stops in 0.1 s; rest 1.0 s, 0.80 m", "1.6 s, 1.60 m"),
        Row("c", "continues; no stop, 0.35 m/s", ""),
        Row("d", "", "3.1 s"),
    ]
    assert hazard_page.reactions(rows) == "fault (1), stops (1), continues (1), within 0.2 s"
    assert hazard_page.rests(rows) == (
        "1.1 s, 0.80 m of 1.6 s, 1.60 m; no stop: speed wrong by 0.35 m/s"
    )
    hazard = Hazard("a drive", "", (".*",), (hazard_page.ROWS,), "nothing")
    (line,) = hazard_page.fault_lines([hazard], rows)
    assert line[:2] == ("a drive", "none")
    assert line[-1] == "nothing"
