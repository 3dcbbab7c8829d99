"""Loading of calculators by name, built-in and from other packages, and their options."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import CalculatorChoice, Robot, Scalar
from thorvaldc.runtime import calculators
from thorvaldc.runtime.calculators.general import General


def robot_with(name: str, **options: Scalar) -> Robot:
    choice = CalculatorChoice(name, tuple(options.items()))
    return replace(make_robot(FOUR_STEERED), calculator=choice)


def diagnostic_of(robot: Robot) -> tuple[str, str]:
    with pytest.raises(DiagnosticError) as caught:
        calculators.for_robot(robot)
    diagnostic = caught.value.diagnostic
    assert diagnostic.span == robot.span
    return diagnostic.code.name, f"{diagnostic.message} ({diagnostic.hint})"


def test_every_builtin_calculator_loads_under_its_name() -> None:
    for name in calculators.PLUGINS.builtin:
        cls = calculators.calculator_class(name)
        assert cls.name == name
        assert cls.summary
    assert set(calculators.PLUGINS.builtin) <= set(calculators.calculator_names())


def test_unknown_calculator() -> None:
    code, text = diagnostic_of(robot_with("genera"))
    assert code == "calculator-unknown"
    assert "did you mean `general`?" in text


def test_calculator_for_another_robot() -> None:
    code, text = diagnostic_of(robot_with("differential"))
    assert code == "calculator-unsuited"
    assert "steered wheels (w0, w1, w2, w3)" in text
    assert "general" in text
    code, text = diagnostic_of(robot_with("one_wheel"))
    assert code == "calculator-unsuited"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hysterisis": 0.1}, "did you mean `hysteresis`?"),
        ({"colour": 0.1}, "its options: hysteresis, arrive_together"),
        ({"hysteresis": "0.1"}, "expected a number such as 0.02"),
        ({"hysteresis": True}, "expected a number such as 0.02"),
        ({"arrive_together": 1}, "expected true or false"),
        ({"hysteresis": -1}, "it must be 0 to 10 s"),
    ],
)
def test_invalid_options(options: dict[str, Scalar], message: str) -> None:
    code, text = diagnostic_of(robot_with("general", **options))
    assert code == "calculator-option"
    assert message in text


def test_calculator_gets_its_options() -> None:
    calculator = calculators.for_robot(robot_with("general", hysteresis=1, arrive_together=False))
    assert isinstance(calculator, General)
    options = calculator.options
    assert (options.hysteresis, options.arrive_together) == (1.0, False)


def test_all_errors_are_reported() -> None:
    errors = calculators.calculator_errors(robot_with("differential", hysteresis=1.0, colour="red"))
    assert [(e.diagnostic.code.name, e.option) for e in errors] == [
        ("calculator-unsuited", None),
        ("calculator-option", "hysteresis"),
        ("calculator-option", "colour"),
    ]
    errors = calculators.calculator_errors(robot_with("general", faulty_wheels=3, hysteresis=-1.0))
    assert [e.option for e in errors] == ["faulty_wheels", "hysteresis"]


CALCULATOR_MODULE = """
from dataclasses import dataclass
from thorvaldc.runtime.calculators.general import General, GeneralOptions

@dataclass(frozen=True)
class Options(GeneralOptions):
    colour: str = "red"
    first: float = 1.0
    last: float = 2.0

    def __post_init__(self):
        if self.first > self.last:
            raise ValueError("first is greater than last")

class Mine(General):
    name = "mine"
    summary = "as general"
    Options = Options

nothing = 3
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package that offers one calculator and two unusable entry points."""
    (tmp_path / "my_calculator.py").write_text(CALCULATOR_MODULE)
    info = tmp_path / "my_calculator-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-calculator\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[thorvaldc.base_calculators]\nmine = my_calculator:Mine\n"
        "three = my_calculator:nothing\ngone = my_calculator:Gone\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_calculator", raising=False)


@pytest.mark.usefixtures("package")
def test_calculator_of_another_package() -> None:
    """A calculator needs one file and one entry point."""
    assert "mine" in calculators.calculator_names()
    calculator = calculators.for_robot(robot_with("mine", colour="blue", last=3))
    assert calculator.name == "mine"
    options = calculator.options
    assert (options.colour, options.first, options.last) == ("blue", 1.0, 3.0)
    assert diagnostic_of(robot_with("min"))[1].endswith("(did you mean `mine`?)")


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("options", "invalid"),
    [
        ({"colour": 3}, ["colour"]),
        ({"last": 0.5}, ["last"]),
        ({"first": 1.9, "last": 1.5}, [None]),
        ({"lats": 0.5, "first": "x"}, ["lats", "first"]),
    ],
)
def test_plugin_checks_its_own_options(
    options: dict[str, Scalar], invalid: list[str | None]
) -> None:
    errors = calculators.calculator_errors(robot_with("mine", **options))
    assert [e.option for e in errors] == invalid
    assert {e.diagnostic.code.name for e in errors} == {"calculator-option"}


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("name", "message"), [("three", "no BaseCalculator"), ("gone", "cannot be loaded")]
)
def test_broken_package_is_a_diagnostic(name: str, message: str) -> None:
    code, text = diagnostic_of(robot_with(name))
    assert code == "calculator-unknown"
    assert message in text


@pytest.mark.usefixtures("package")
def test_robot_file_names_a_plugin(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "thorvaldc: 1\nname: one\nbase_calculator:\n  name: mine\n  options:\n"
        "    colour: 7\n    hysteresis: 0.1\n    hue: red\n"
        "modules:\n  frame: {type: frame/tube_rectangular}\n"
        + "".join(
            f"  w{i}: {{type: assembly/steered_drive, mount: frame.{port}}}\n"
            for i, port in enumerate(("front_left", "front_right", "rear_left", "rear_right"))
        )
    )
    errors = compile_file(file).report.errors
    assert [(d.code.name, d.span.line, d.span.column) for d in errors if d.span] == [
        ("calculator-option", 6, 13),
        ("calculator-option", 8, 10),
    ]
    file.write_text(file.read_text().replace("colour: 7", "colour: blue").replace("hue: red", ""))
    assert compile_file(file).model is not None
