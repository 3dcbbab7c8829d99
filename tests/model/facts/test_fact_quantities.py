"""The kinds of quantities of the facts."""

from __future__ import annotations

from fnmatch import fnmatchcase

import pytest

from tests.examples import ROBOTS, example_robot
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.model.facts.fact_quantities import MONEY, PATTERNS, fact_quantity
from thorvaldc.model.facts.facts_document import facts_document
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.tools.study.study_compilation import fact_values


@pytest.mark.parametrize("name", ROBOTS)
def test_each_fact_has_one_kind_of_quantity(name: str) -> None:
    """A new fact without a kind of quantity could not have a bound with a unit."""
    for path, _ in fact_values(facts_document(robot_facts(example_robot(name)))):
        kinds = [
            quantity
            for quantity, patterns in PATTERNS.items()
            if any(fnmatchcase(path, pattern) for pattern in patterns)
        ]
        assert len(kinds) == 1, f"{path}: {kinds}"
        assert fact_quantity(path) == kinds[0]
        assert kinds[0] in (*QUANTITIES, MONEY)
