"""Calculators by name, from here and from other packages."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import CalculatorChoice, Robot, Scalar
from thorvaldc.runtime import calculators
from thorvaldc.runtime.calculators.general import General


def choosing(name: str, **options: Scalar) -> Robot:
    choice = CalculatorChoice(name, tuple(options.items()))
    return replace(make_robot(FOUR_STEERED), calculator=choice)


def code_of(robot: Robot) -> tuple[str, str]:
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
    assert set(calculators.PLUGINS.builtin) <= set(calculators.names())


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


def test_all_that_is_wrong_is_said() -> None:
    found = calculators.faults(choosing("differential", hysteresis=1.0, colour="red"))
    assert [(f.diagnostic.code.name, f.option) for f in found] == [
        ("calculator-unsuited", None),
        ("calculator-option", "hysteresis"),
        ("calculator-option", "colour"),
    ]
    found = calculators.faults(choosing("random_pairs", parallel=2.0, seed=1, hysteresis=-1.0))
    assert [f.option for f in found] == ["parallel", "hysteresis"]


MINE = """
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
    """An installed package with calculators, one of which is none and one of which is broken."""
    (tmp_path / "my_calculator.py").write_text(MINE)
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
    """One file and one entry point are all that a calculator needs."""
    assert "mine" in calculators.names()
    made = calculators.for_robot(choosing("mine", colour="blue", last=3))
    assert made.name == "mine"
    assert (made.options.colour, made.options.first, made.options.last) == ("blue", 1.0, 3.0)
    assert code_of(choosing("min"))[1].endswith("(did you mean `mine`?)")


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"colour": 3}, ["colour"]),
        ({"last": 0.5}, ["last"]),
        ({"first": 1.9, "last": 1.5}, [None]),
        ({"lats": 0.5, "first": "x"}, ["lats", "first"]),
    ],
)
def test_its_own_schema_checks_its_options(
    options: dict[str, Scalar], where: list[str | None]
) -> None:
    found = calculators.faults(choosing("mine", **options))
    assert [f.option for f in found] == where
    assert {f.diagnostic.code.name for f in found} == {"calculator-option"}


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("name", "said"), [("three", "no BaseCalculator"), ("gone", "cannot be loaded")]
)
def test_a_broken_package_is_no_traceback(name: str, said: str) -> None:
    code, text = code_of(choosing(name))
    assert code == "calculator-unknown"
    assert said in text


@pytest.mark.usefixtures("package")
def test_a_robots_file_may_name_it(tmp_path: Path) -> None:
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
    found = compile_file(file).report.errors
    assert [(d.code.name, d.span.line, d.span.column) for d in found if d.span] == [
        ("calculator-option", 6, 13),
        ("calculator-option", 8, 10),
    ]
    file.write_text(file.read_text().replace("colour: 7", "colour: blue").replace("hue: red", ""))
    assert compile_file(file).model is not None
