"""Prices, suppliers and lead times of modules."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import thorvaldc
from thorvaldc.compiler.hardware.purchase_reader import Money, MoneyError, parse_money
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import facts_document, robot_facts

WEIGHT = """\
thorvaldc: 1
description: A weight.
params:
  kilograms: {quantity: number, default: 10, description: Size., source: "chosen: an example"}
  delivery: {quantity: time, default: 2 weeks, description: Delivery., source: "chosen: an example"}
mount: {kinds: [frame_clamp]}
links: {body: {parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 5 kg, source: "chosen: an example"}]}}
"""
PURCHASE = 'purchase: {price: "${20 * kilograms}", currency: NOK, lead_time: "${delivery}"}\n'
CART = """\
thorvaldc: 1
name: cart
library: [modules]
modules:
  frame: {type: frame/tube_rectangular}
  a: {type: caster/swivel, mount: frame.front_left}
  b: {type: caster/swivel, mount: frame.front_right}
  c: {type: caster/swivel, mount: frame.rear_center}
  w: {type: ballast/weight, mount: frame.front_center, params: {kilograms: 20}}
"""


def compiled(folder: Path, purchase: str, weight: str = PURCHASE) -> thorvaldc.Compilation:
    module = folder / "modules/ballast/weight/module.yaml"
    module.parent.mkdir(parents=True)
    module.write_text(WEIGHT + weight)
    (folder / "robot.yaml").write_text(CART + purchase)
    return thorvaldc.compile(folder / "robot.yaml")


def facts_of(folder: Path, purchase: str, weight: str = PURCHASE) -> dict[str, Any]:
    compilation = compiled(folder, purchase, weight)
    assert isinstance(compilation.model, Robot), compilation.report
    facts: dict[str, Any] = facts_document(robot_facts(compilation.model))["purchase"]
    return facts


def test_the_prices_of_all_modules_make_the_price_of_the_robot(tmp_path: Path) -> None:
    """The robot file states prices by type, and one of them for a single module."""
    facts = facts_of(
        tmp_path,
        "purchase:\n"
        "  frame/tube_rectangular: {price: 1000 NOK, lead_time: 3 d}\n"
        "  caster/swivel: {price: 100.50 NOK, supplier: Hjul AS, lead_time: 1 d}\n"
        "  b: {price: 80 NOK}\n",
    )
    assert facts["price"] == 1000 + 2 * 100.5 + 80 + 400
    assert facts["currency"] == "NOK"
    assert facts["lead_time"] == 14 * 86400
    assert not facts["no_price"]
    rows = [(i["type"], i["count"], i["price"], i["total"], i["supplier"]) for i in facts["items"]]
    assert rows == [
        ("frame/tube_rectangular", 1, 1000.0, 1000.0, ""),
        ("caster/swivel", 2, 100.5, 201.0, "Hjul AS"),
        ("caster/swivel", 1, 80.0, 80.0, "Hjul AS"),
        ("ballast/weight", 1, 400.0, 400.0, ""),
    ]


def test_a_missing_price_is_named(tmp_path: Path) -> None:
    facts = facts_of(tmp_path, "purchase: {caster/swivel: {price: 100 NOK, lead_time: 0 d}}\n")
    assert facts["price"] is None
    assert facts["no_price"] == "`frame/tube_rectangular` has no price"
    assert facts["without_price"] == ["frame/tube_rectangular"]
    assert facts["lead_time"] is None
    assert facts["no_lead_time"] == "`frame/tube_rectangular` has no lead time"


def test_no_currency_is_converted(tmp_path: Path) -> None:
    purchase = "purchase: {caster/swivel: {price: 9 EUR}, frame/tube_rectangular: {price: 1 NOK}}\n"
    facts = facts_of(tmp_path, purchase)
    assert facts["price"] is None
    assert facts["currency"] == ""
    assert facts["no_price"] == "the prices are in NOK and EUR"


@pytest.mark.parametrize(
    ("purchase", "weight", "code"),
    [
        ("purchase: {d: {price: 1 NOK}}\n", PURCHASE, "module-unknown"),
        ("purchase: {caster/swivle: {price: 1 NOK}}\n", PURCHASE, "module-type-unknown"),
        ("purchase: {a: {lead_time: 21}}\n", PURCHASE, "bad-quantity"),
        ("purchase: {a: {lead_time: 21 kg}}\n", PURCHASE, "wrong-dimension"),
        ("purchase: {a: {lead_time: -1 d}}\n", PURCHASE, "out-of-range"),
        ("purchase: {a: {price: -1 NOK}}\n", PURCHASE, "price-invalid"),
        ("purchase: {a: {price: 1 NOK, currency: EUR}}\n", PURCHASE, "price-invalid"),
        ("purchase: {a: {price: 1, currency: NKO}}\n", PURCHASE, "price-invalid"),
        ("purchase: {a: {price: -1, currency: NOK}}\n", PURCHASE, "price-invalid"),
        ("", 'purchase: {price: "${20 * kilograms}"}\n', "price-invalid"),
        ("", 'purchase: {price: "${kilograms > 2}", currency: NOK}\n', "price-invalid"),
        ("", 'purchase: {price: "${[1, 2]}", currency: NOK}\n', "price-invalid"),
        ("", 'purchase: {price: "${20 * kilo}", currency: NOK}\n', "expression-name"),
    ],
)
def test_wrong_purchase_data(tmp_path: Path, purchase: str, weight: str, code: str) -> None:
    assert code in [error.code.name for error in compiled(tmp_path, purchase, weight).report.errors]


def test_an_assembly_states_no_price(tmp_path: Path) -> None:
    folder = tmp_path / "modules/ballast/pair"
    folder.mkdir(parents=True)
    text = (
        "thorvaldc: 1\ndescription: Two.\npurchase: {price: 1 NOK}\n"
        "modules: {one: {type: ballast/weight}}\n"
    )
    (folder / "module.yaml").write_text(text)
    report = compiled(tmp_path, "  p: {type: ballast/pair, mount: frame.rear_left}\n").report
    (error,) = [e for e in report.errors if e.code.name == "conflicting-keys"]
    assert "`modules` and `purchase` exclude each other" in error.message


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("1250", "1250 EUR"),
        ("1250 eur", "did you mean `EUR`?"),
        ("1250 EURO", "did you mean `EUR`?"),
        ("1250€", "write `1250 EUR`"),
        ("$ 9.90", "write `9.90 USD`"),
        ("EUR 12", "12 EUR"),
        ("1,250 EUR", "1250 EUR"),
        ("2000000000000 EUR", "smaller"),
    ],
)
def test_texts_that_are_no_money(text: str, hint: str) -> None:
    with pytest.raises(MoneyError) as raised:
        parse_money(text)
    assert hint in raised.value.hint


def test_money() -> None:
    assert parse_money("1250 EUR") == Money(1250.0, "EUR")
    assert parse_money(" 0.05NOK ") == Money(0.05, "NOK")
