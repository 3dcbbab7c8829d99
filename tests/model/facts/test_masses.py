"""The price and the lead time of a robot."""

from __future__ import annotations

from dataclasses import replace

from tests.robots import make_robot
from thorvaldc.diagnostics import Span
from thorvaldc.model import Module, Purchase, Robot
from thorvaldc.model.facts.fact_tables import FactTable, fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts

DAY = 86400.0


def robot_with(*purchases: Purchase) -> Robot:
    modules = tuple(
        Module(f"m{number}", f"some/type_{number}", "", True, (), Span("r.yaml"), purchase)
        for number, purchase in enumerate(purchases)
    )
    links = tuple(replace(link, module="") for link in make_robot([(0, 0, "steered")]).links)
    return replace(make_robot([(0, 0, "steered")]), links=links, modules=modules)


def purchase_table(robot: Robot) -> FactTable | None:
    return next((t for t in fact_tables(robot_facts(robot)) if t.key == "purchase"), None)


def test_the_table_has_the_total_and_the_longest_lead_time() -> None:
    table = purchase_table(
        robot_with(Purchase(10.5, "EUR", "A", 2 * DAY), Purchase(5.0, "EUR", "", 0.0))
    )
    assert table is not None
    assert table.rows == (
        ("some/type_0", "1", "10.50 EUR", "10.50 EUR", "A", "2 d"),
        ("some/type_1", "1", "5.00 EUR", "5.00 EUR", "-", "0 d"),
        ("robot", "2", "", "15.50 EUR", "", "2 d"),
    )
    assert table.notes == ()


def test_the_table_names_what_is_missing() -> None:
    table = purchase_table(
        robot_with(Purchase(10.5, "EUR", "A", None), Purchase(None, "", "", DAY))
    )
    assert table is not None
    assert table.rows[-1] == ("robot", "2", "", "-", "", "-")
    assert table.notes == (
        "There is no total: `some/type_1` has no price.",
        "There is no longest lead time: `some/type_0` has no lead time.",
    )


def test_a_robot_without_purchase_data_has_no_table() -> None:
    assert purchase_table(robot_with(Purchase(None, "", "", None))) is None
