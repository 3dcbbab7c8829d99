"""Dimensions of expressions in module documents: errors, hints, quick fixes."""

from __future__ import annotations

from typing import ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.compiler.modules.test_module_parameters import PARAM
from tests.workshop import CART, Workshop
from thorvaldc.compiler.source.dimensions import (
    EXPECTED,
    fits,
    in_words,
    infer_dimension,
    multiply,
    number_dimension,
    unit_text,
)
from thorvaldc.compiler.source.expression_parser import ExpressionError
from thorvaldc.compiler.source.unit_table import QUANTITIES, Dimension
from thorvaldc.compiler.source.units import parse_with_dimension
from thorvaldc.diagnostics import Diagnostic

PARAMS = f"""
  len: {{quantity: length, default: 2.5 m, {PARAM}}}
  turn: {{quantity: angle, default: 30 deg, {PARAM}}}
  n: {{type: integer, default: 3, {PARAM}}}
  xs: {{type: list, quantity: length, default: [1, 20 mm], {PARAM}}}
  held: {{type: module, default: t/block, {PARAM}}}"""


def module(mass: str = "1 kg", side: str = "1", place: str = "0", let: str = "") -> str:
    return f"""params:{PARAMS}
{let}
mount: {{kinds: [clamp], link: box}}
links:
  box:
    parts:
      - shape: {{box: [{side}, 1, 1]}}
        xyz: [{place}, 0, 0]
        mass: {mass}
        source: "chosen: for a test"
"""


def diagnostics(workshop: Workshop, text: str) -> list[Diagnostic]:
    workshop.module("t/part", text)
    every = workshop.diagnostics(f"{CART}    part: {{type: t/part, mount: body.front}}")
    return [d for d in every if d.code.name in ("wrong-dimension", "number-without-unit")]


def quoted(expression: str) -> str:
    return f'"${{{expression}}}"'


@pytest.mark.parametrize(
    ("key", "expression", "words"),
    [
        ("mass", "5 kg + 2 m", "a mass is not a length"),
        ("mass", "len", "a length is not a mass"),
        ("mass", "sqrt(len)*1 kg", "a quantity in m^0.5 kg is not a mass"),
        ("mass", "sin(len)*1 kg", "a length is not a number without a unit"),
        ("mass", "len**2", "an area is not a mass"),
        ("mass", "max(5 kg, len)", "a mass is not a length"),
        ("mass", "5 kg if len > 2 kg else 3 kg", "a length is not a mass"),
        ("side", "2 kg", "a mass is not a length"),
        ("place", "370 mm + 2 kg", "a length is not a mass"),
        # Branches and operands that are not computed.
        ("mass", "5 kg if len > 1 m else 3 m", "a mass is not a length"),
        ("mass", "5 kg if n > 2 or len > 2 kg else 3 kg", "a length is not a mass"),
        ("mass", "[5 kg, len][1]", "a length is not a mass"),
        ("mass", "held.mass * len", "a quantity in m kg is not a mass"),
        ("mass", "xs[1]", "a length is not a mass"),
        ("mass", "max(xs)", "a length is not a mass"),
        ("mass", "5 kg ** n", None),
        ("mass", "(5 kg) ** len", "a length is not a number without a unit"),
        ("mass", "floor(len) * 1 kg", "a length is not a number without a unit"),
        ("mass", "atan2(len, 1 kg) * 1 kg", "a length is not a mass"),
        ("mass", "len % 2 kg", "a length is not a mass"),
        ("mass", "5 kg if len == 2 kg else 3 kg", "a length is not a mass"),
        ("side", "xs[2 m - 1 m]", None),
        # An index that the expression does not state.
        ("mass", "[1 kg, 2 m, 3 kg, 4 kg][n]", "a mass is not a length"),
        ("mass", "[1 m, 2 m, 3 m, 4 m][n]", "a length is not a mass"),
        ("mass", "[1, 2, 3, 4][n]", None),
        ("mass", "[[1 kg, 1 m], [2 kg, 2 kg]][n - 2][0 if n > 2 else 1]", "a length is not a mass"),
        ("mass", "[[1 kg, 1 m], [2 kg, 2 m]][n - 2][1]", "a length is not a mass"),
    ],
)
def test_wrong_expressions(
    workshop: Workshop, key: str, expression: str, words: str | None
) -> None:
    text = module(**{key: quoted(expression)})
    if words is None:
        assert workshop.part_codes(text) != []
        return
    (diagnostic,) = diagnostics(workshop, text)
    assert diagnostic.code.number == "TV211"
    assert diagnostic.hint is not None
    assert diagnostic.hint.startswith(words)
    assert diagnostic.span is not None
    line = (workshop.folder / "my_modules/t/part/module.yaml").read_text().splitlines()
    assert f"${{{expression}}}" in line[diagnostic.span.line - 1]
    assert diagnostic.fixes == ()


@pytest.mark.parametrize(
    ("key", "expression"),
    [
        ("mass", "3.6 kg/m * len"),
        ("mass", "2700 kg/m^3 * pi * 2 mm * (len - 2 mm) * len"),
        ("mass", "max(0.3 kg, 2.0 kg/m * len)"),
        ("mass", "held.mass / 2 if held else 5 kg"),
        ("mass", "max(0, 5 kg)"),
        ("mass", "5 kg if len > 0 else 0"),
        ("mass", "sqrt(len) * sqrt(len) * 1 kg/m"),
        ("mass", "len ** (1/2) * len ** 0.5 * 1 kg/m"),
        ("mass", "(len / 1 m) ** n * 1 kg"),
        ("mass", "20 N / 9.81 m/s^2"),
        ("side", "len * sin(turn)"),
        ("side", "hypot(len, xs[0])"),
        ("side", "turn * 100 mm"),
        ("side", "(xs + [1 m])[-1]"),
        ("side", "len(xs) * 1 m"),
        ("side", "floor(len / 1 mm) * 1 mm"),
        ("place", "-len / 2 * cos(pi / 3)"),
        ("mass", "[0, 1 kg, 2 kg, 3 kg][n]"),
        ("mass", "[[1 kg, 1 m], [2 kg, 2 m]][n - 2][0]"),
        ("side", "[1 kg, 2 m][1] * [1, 2, 3, 4][n]"),
        ("mass", "[held, held][n - 2].mass"),
    ],
)
def test_right_expressions(workshop: Workshop, key: str, expression: str) -> None:
    assert workshop.part_codes(module(**{key: quoted(expression)})) == []


@pytest.mark.parametrize(
    ("expression", "repaired"),
    [
        ("3.6 * len", "3.6 kg/m * len"),
        ("2700 * pi * 0.002 * len * len", "2700 kg/m^2 * pi * 0.002 * len * len"),
        ("0.15 + 0.4 * len", "0.15 kg + 0.4 kg/m * len"),
        ("max(0.3, 2.0 * len)", "max(0.3 kg, 2.0 kg/m * len)"),
        ("5 kg + 2 * len", "5 kg + 2 kg/m * len"),
        ("5 kg if len > 2 else 3 kg", "5 kg if len > 2 m else 3 kg"),
        ("n", "n * 1 kg"),
        ("7", "7 kg"),
    ],
)
def test_the_quick_fix_of_an_old_module_keeps_its_value(
    workshop: Workshop, expression: str, repaired: str
) -> None:
    (diagnostic,) = diagnostics(workshop, module(quoted(expression)))
    assert diagnostic.hint is not None
    text = diagnostic.fixes[0].text.strip('"')
    assert text in diagnostic.hint
    if expression.startswith("2700"):  # either number may be the density
        assert "kg/m^2" in text
    else:
        assert text == f"${{{repaired}}}"
    assert workshop.part_codes(module(f'"{text}"')) == []


@pytest.mark.parametrize(
    ("density", "repaired"),
    [('"${1.8 * 2}"', '"${1.8 kg/m * 2}"'), ("3.6", "3.6 kg/m")],
)
def test_the_coefficient_may_be_a_let_value(
    workshop: Workshop, density: str, repaired: str
) -> None:
    (diagnostic,) = diagnostics(
        workshop, module(quoted("density * len"), let=f"let: {{density: {density}}}")
    )
    (fix,) = diagnostic.fixes
    assert fix.text == repaired
    fixed = module(quoted("density * len"), let=f"let: {{density: {repaired}}}")
    assert workshop.part_codes(fixed) == []
    inertial = workshop.part(fixed).link("part_box").inertial
    assert inertial is not None
    assert inertial.mass == 9.0


def test_a_hint_names_the_unit_of_a_missing_coefficient(workshop: Workshop) -> None:
    (diagnostic,) = diagnostics(workshop, module(quoted("len / 2")))
    assert diagnostic.hint is not None
    assert "`kg/m`" in diagnostic.hint


def test_dimensions_of_loop_variables_and_arguments(workshop: Workshop) -> None:
    right = module(quoted("y * 1 kg/m"), let='let: {ys: [1 m, "${len}"]}')
    right += '        for: {y: "${ys}"}\n'
    assert workshop.part_codes(right) == []
    assert workshop.part_codes(right.replace("y * 1 kg/m", "y")) == ["wrong-dimension"]
    assert workshop.part_codes(right.replace("${ys}", "${[1, 2]}")) == ["wrong-dimension"]
    inner = "modules:\n  block: {type: t/block, params: {mass: '${len}'}}\n"
    assert workshop.part_codes(f"params:{PARAMS}\n{inner}") == ["wrong-dimension"]


def test_an_integer_has_no_dimension(workshop: Workshop) -> None:
    for given_value, codes in (("len * 2", ["wrong-dimension"]), ("len / 1 m * 2", [])):
        workshop.module(
            "t/inner",
            module().replace("default: 3,", "default: 3, minimum: 0,"),
        )
        outer = f"params:{PARAMS}\nmodules:\n"
        outer += f"  inner: {{type: t/inner, params: {{n: '${{{given_value}}}'}}}}\n"
        assert workshop.part_codes(outer) == codes


def test_a_long_chain_of_values_in_a_branch_that_is_not_computed(workshop: Workshop) -> None:
    steps = "".join(f"  a{i}: ${{a{i + 1}}}\n" for i in range(3000))
    text = module(quoted("1 kg if true else a0"), let=f"let:\n{steps}  a3000: 1 m")
    assert workshop.part_codes(text) == []


@pytest.mark.parametrize("mass", ["a0", "1 kg if true else a0"])
def test_deeply_nested_values_in_a_chain(workshop: Workshop, mass: str) -> None:
    nested = "abs(" * 38
    steps = "".join(f"  a{i}: ${{{nested}a{i + 1}{')' * 38}}}\n" for i in range(28))
    codes = workshop.part_codes(module(quoted(mass), let=f"let:\n{steps}  a28: 1 kg"))
    assert set(codes) <= {"expression-cycle"}


@pytest.mark.parametrize("number", ["700", '"700"', '" 700 "', '"7e2"', "\"${'700'}\""])
def test_a_quoted_number_is_told_like_an_unquoted_one(workshop: Workshop, number: str) -> None:
    (diagnostic,) = diagnostics(workshop, module(side=number))
    assert diagnostic.code.number == "TV219"
    assert diagnostic.message == (
        "`700` without a unit is a length of 700 m, which is unusual on a robot"
    )
    assert [fix.text for fix in diagnostic.fixes] == ["700 mm", "700 m"]


def test_a_repeated_part_is_repaired_once(workshop: Workshop) -> None:
    text = module(quoted("0.1 + 0.2 * len + 0.3 * n"))
    text += f"        for: {{i: [{', '.join(map(str, range(1000)))}]}}\n"
    assert workshop.part_codes(text) == ["wrong-dimension"]


# -- expressions of known dimension -----------------------------------------------------

UNITS = ("m", "kg", "s", "mm", "N", "rad", "kg/m", "N/m", "kg/m^2", "kg/m^3", "m/s^2", "J")


class _Names:
    names: ClassVar = {
        "len": EXPECTED["length"],
        "load": EXPECTED["mass"],
        "turn": EXPECTED["angle"],
    }

    def dimension(self, name: str) -> Dimension:
        return self.names[name]


def _of(text: str) -> Dimension:
    dimension = number_dimension(infer_dimension(text, _Names()))
    assert dimension is not None
    return dimension


@st.composite
def right_expressions(draw: st.DrawFn, depth: int = 3) -> str:
    """An expression whose parts fit."""
    kind = draw(st.integers(0, 8)) if depth else draw(st.integers(0, 1))
    if kind == 0:
        return f"{draw(st.integers(1, 9))} {draw(st.sampled_from(UNITS))}"
    if kind == 1:
        return draw(st.sampled_from(tuple(_Names.names)))
    one = draw(right_expressions(depth=depth - 1))
    two = f"({one}) * {draw(st.integers(2, 5))}"
    other = draw(right_expressions(depth=depth - 1))
    return {
        2: f"({one}) * ({other})",
        3: f"({one}) / ({other})",
        4: f"({one}) + ({two})",
        5: f"max({one}, {two})",
        6: f"({one} if {one} > {two} else -({two}))",
        7: f"sin(({one}) / ({two})) * ({other})",
        8: f"(sqrt({one}) * sqrt({two}))",
    }[kind]


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    right_expressions(),
    st.sampled_from(sorted(EXPECTED)),
    st.sampled_from(["+", "-", "%", ">", "max", "if"]),
)
def test_a_wrong_part_of_a_right_expression_is_found(
    right: str, quantity: str, operator: str
) -> None:
    dimension, other = _of(right), EXPECTED[quantity]
    number = f"7 {QUANTITIES[quantity].unit}" if QUANTITIES[quantity].unit != "1" else "7"
    text = {
        "max": f"max({right}, {number})",
        "if": f"({right}) if 1 > 2 else {number}",
    }.get(operator, f"({right}) {operator} {number}")
    if fits(dimension, other):
        infer_dimension(text, _Names())
        return
    with pytest.raises(ExpressionError) as caught:
        infer_dimension(text, _Names())
    assert caught.value.code == "wrong-dimension"
    assert in_words(other) in caught.value.message


@given(st.tuples(*(st.integers(-3, 3) for _ in range(7))))
def test_the_text_of_a_unit_is_read_back(powers: Dimension) -> None:
    dimension = multiply(powers, (0, 0, 0, 0, 0, powers[5], 0), -1)
    text = unit_text(dimension)
    if text == "1":
        return
    _, read = parse_with_dimension(f"1 {text}")
    assert read is not None
    assert fits((*read[:5], 0, read[6]), dimension)
    assert fits(_of(f"1 {text}"), dimension)
