"""Calculators by name, from here and from other packages."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import CalculatorChoice, Robot, Scalar
from thorvaldc.runtime import calculators
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.faults import RuntimeFault


def choosing(name: str, **options: Scalar) -> Robot:
    choice = CalculatorChoice(name, tuple(options.items()))
    return replace(make_robot(FOUR_STEERED), calculator=choice)


def code_of(robot: Robot) -> tuple[str, str]:
    with pytest.raises(RuntimeFault) as caught:
        calculators.for_robot(robot)
    diagnostic = caught.value.diagnostic
    assert diagnostic.span == robot.origin
    return diagnostic.code.name, f"{diagnostic.message} ({diagnostic.hint})"


def test_every_builtin_calculator_loads_under_its_name() -> None:
    for name in calculators.BUILTIN:
        cls = calculators.calculator_class(name)
        assert cls.name == name
        assert cls.summary
    assert set(calculators.BUILTIN) <= set(calculators.names())


def test_unknown_calculator() -> None:
    code, text = code_of(choosing("genera"))
    assert code == "calculator-unknown"
    assert "did you mean `general`?" in text


def test_calculator_for_another_robot() -> None:
    code, text = code_of(choosing("differential"))
    assert code == "calculator-unsuited"
    assert "steered wheels (w0, w1, w2, w3)" in text
    assert "general" in text
    code, text = code_of(choosing("one_wheel"))
    assert code == "calculator-unsuited"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"hysterisis": 0.1}, "did you mean `hysteresis`?"),
        ({"colour": 0.1}, "its options: hysteresis, arrive_together"),
        ({"hysteresis": "0.1"}, "expected a number such as 0.02"),
        ({"hysteresis": True}, "expected a number such as 0.02"),
        ({"arrive_together": 1}, "expected true or false"),
        ({"hysteresis": -1}, "it must be 0 to 10 s"),
    ],
)
def test_wrong_options(options: dict[str, Scalar], said: str) -> None:
    code, text = code_of(choosing("general", **options))
    assert code == "calculator-option"
    assert said in text


def test_options_arrive() -> None:
    made = calculators.for_robot(choosing("general", hysteresis=1, arrive_together=False))
    assert isinstance(made, General)
    assert (made.options.hysteresis, made.options.arrive_together) == (1.0, False)


def test_calculator_of_another_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One file and one entry point are all that a calculator needs."""
    (tmp_path / "my_calculator.py").write_text(
        "from thorvaldc.runtime.calculators.general import General\n"
        "class Mine(General):\n"
        "    name = 'mine'\n"
        "    summary = 'as general'\n"
    )
    info = tmp_path / "my_calculator-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-calculator\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[thorvaldc.base_calculators]\nmine = my_calculator:Mine\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_calculator", raising=False)
    assert "mine" in calculators.names()
    assert calculators.for_robot(choosing("mine")).name == "mine"
