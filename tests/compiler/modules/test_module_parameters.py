"""Parameters and expressions, tested by the size of a box that depends on them."""

from __future__ import annotations

import pytest

from tests.workshop import CART, Workshop
from thorvaldc.model import Box

PARAM = 'description: Of it., source: "chosen: for a test"'
BOX = """
mount: {{kinds: [clamp], link: box}}
links:
  box:
    parts:
      - {{shape: {{box: {size}}}, mass: 1 kg, source: "chosen: for a test"}}
"""


def document(params: str, size: str, let: str = "") -> str:
    return f"params:\n{params}\n{let}\n" + BOX.format(size=size)


def size(workshop: Workshop, module: str, params: str = "") -> tuple[float, ...]:
    shape = workshop.part(module, params).link("part_box").visuals[0].shape
    assert isinstance(shape, Box)
    return shape.size


@pytest.mark.parametrize(
    ("kind", "default", "given", "expression", "value"),
    [
        ("quantity: length", "0.1", "200 mm", "e", 0.2),
        ("quantity: length", "0.1", "0.3", "e", 0.3),
        ("quantity: ratio", "2:1", "5:2", "e * 1 m", 2.5),
        ("quantity: angle", "0", "180 deg", "e / pi * 1 m", 1.0),
        ("quantity: angular_velocity", "1", "30 rpm", "e / pi * 1 m s", 1.0),
        ("type: integer", "1", "3", "e * 1 m", 3.0),
        ("type: integer", "1", "3.0", "e * 1 m", 3.0),
        ("type: boolean", "false", "true", "7 m if e else 8 m", 7.0),
        ("type: text", "a", "b", "7 m if e == 'b' else 8 m", 7.0),
        ("type: list, quantity: length", "[]", "[1, 250 mm]", "e[1] * len(e)", 0.5),
    ],
)
def test_kinds_of_parameters(
    workshop: Workshop, kind: str, default: str, given: str, expression: str, value: float
) -> None:
    module = document(
        f"  e: {{{kind}, default: {default}, {PARAM}}}", f'["${{{expression}}}", 1, 1]'
    )
    assert size(workshop, module, f"e: {given}")[0] == pytest.approx(value)


def test_default_applies_without_argument(workshop: Workshop) -> None:
    module = document(f"  e: {{quantity: length, default: 20 mm, {PARAM}}}", '["${e}", 1, 1]')
    assert size(workshop, module)[0] == 0.02


@pytest.mark.parametrize("default", ["5 kg", "3"])
def test_a_wrong_default_is_reported_by_each_compilation(workshop: Workshop, default: str) -> None:
    """Defaults without expressions are computed once for all uses of a module."""
    params = f"  e: {{quantity: length, default: {default}, maximum: 2 m, {PARAM}}}"
    workshop.module("t/wrong", document(params, '["${e}", 1, 1]'))
    parts = "".join(
        f"    p{k}: {{type: t/wrong, mount: {{parent: body, xyz: [{k}, 0, 1]}}}}\n" for k in (1, 2)
    )
    first, second = (
        [diagnostic.code.name for diagnostic in workshop.diagnostics(f"{CART}{parts}")]
        for _ in range(2)
    )
    assert first == second
    assert first[0] in ("wrong-dimension", "param-range")


def test_a_default_may_be_an_expression_over_other_parameters(workshop: Workshop) -> None:
    params = f"""
  outer: {{quantity: length, default: "${{inner + 10 mm}}", {PARAM}}}
  inner: {{quantity: length, default: 30 mm, {PARAM}}}"""
    module = document(params, '["${outer}", "${inner}", 1]')
    assert size(workshop, module) == (0.04, 0.03, 1.0)
    assert size(workshop, module, "inner: 50 mm")[:2] == (0.060000000000000005, 0.05)
    assert size(workshop, module, "outer: 50 mm")[:2] == (0.05, 0.03)


def test_let_values_in_any_order_and_with_units(workshop: Workshop) -> None:
    let = """let:
  third: ${second + first}
  second: ${first * 2}
  first: 100 mm
  several: [1, 20 mm, "${first}"]
  word: "100 mm"
"""
    params = f"  e: {{quantity: length, default: 1, {PARAM}}}"
    sizes = '["${third}", "${several[1]}", "${1 m if word == \'100 mm\' else 2 m}"]'
    assert size(workshop, document(params, sizes, let)) == pytest.approx((0.3, 0.02, 1.0))


def test_list_parameter_as_a_vector(workshop: Workshop) -> None:
    params = f"  e: {{type: list, quantity: length, default: [1, 20 mm, 300 mm], {PARAM}}}"
    assert size(workshop, document(params, '"${e}"')) == (1.0, 0.02, 0.3)


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        ("quantity: length", "3 kg"),
        ("quantity: length", "true"),
        ("quantity: length", "[1]"),
        ("quantity: length", "long"),
        ("quantity: length", "none"),
        ("type: integer", "3.5"),
        ("type: integer", "3 m"),
        ("type: boolean", "1"),
        ("type: boolean", '"true"'),
        ("type: text", "3"),
        ("type: list, quantity: length", "3"),
        ("type: list, quantity: length", "[1, 3 kg]"),
        ("type: module", "3"),
        ("type: module", "[t/block]"),
    ],
)
def test_value_of_wrong_type_causes_one_diagnostic(
    workshop: Workshop, kind: str, given: str
) -> None:
    default = {"boolean": "false", "text": "a", "list": "[]", "module": "none"}
    written = default.get(kind.split(",")[0].removeprefix("type: "), "1")
    module = document(
        f"  e: {{{kind}, default: {written}, {PARAM}}}",
        '["${1 m if e else 2 m}", 1, 1]',
    )
    codes = workshop.part_codes(module, f"e: {given}")
    assert len(codes) == 1, codes
    assert codes[0] in ("wrong-type", "wrong-dimension", "bad-quantity")


def test_limits_are_inclusive_and_may_be_expressions(workshop: Workshop) -> None:
    params = f"""
  wall: {{quantity: length, default: 5 mm, minimum: 1 mm, maximum: "${{edge / 2}}", {PARAM}}}
  edge: {{quantity: length, default: 100 mm, {PARAM}}}"""
    module = document(params, '["${edge}", 1, 1]')
    assert workshop.part_codes(module, "wall: 1 mm") == []
    assert workshop.part_codes(module, "wall: 50 mm") == []
    assert workshop.part_codes(module, "wall: 0.9 mm") == ["param-range"]
    assert workshop.part_codes(module, "wall: 51 mm") == ["param-range"]
    assert workshop.part_codes(module, "wall: 51 mm, edge: 102 mm") == []


def test_choices_are_compared_as_values(workshop: Workshop) -> None:
    params = f"  e: {{quantity: length, default: 20 mm, choices: [20 mm, 5 cm], {PARAM}}}"
    module = document(params, '["${e}", 1, 1]')
    assert size(workshop, module, "e: 50 mm")[0] == 0.05
    assert workshop.part_codes(module, "e: 5") == ["param-range"]


def test_message_shows_the_value_of_an_expression(workshop: Workshop) -> None:
    workshop.module(
        "t/outer",
        f"""
        params:
          e: {{quantity: length, default: 1, {PARAM}}}
        modules:
          inner: {{type: t/inner, params: {{e: "${{e / 4}}"}}}}
        """,
    )
    workshop.module(
        "t/inner",
        document(f"  e: {{quantity: length, minimum: 0.3, {PARAM}}}", '["${e}", 1, 1]'),
    )
    (diagnostic,) = [
        d
        for d in workshop.diagnostics(f"{CART}    part: {{type: t/outer, mount: body.front}}")
        if d.code.name == "param-range"
    ]
    assert "0.25" in diagnostic.message
    assert [label.span.file.rsplit("/", 1)[-1] for label in diagnostic.labels][-1] == "robot.yaml"


def test_none_from_an_assembly_selects_the_default(workshop: Workshop) -> None:
    workshop.module(
        "t/outer",
        f"""
        params:
          e: {{quantity: length, default: none, {PARAM}}}
        modules:
          inner: {{type: t/inner, params: {{e: "${{e}}"}}}}
        """,
    )
    workshop.module(
        "t/inner",
        document(f"  e: {{quantity: length, default: 40 mm, {PARAM}}}", '["${e}", 1, 1]'),
    )
    robot = workshop.robot(f"{CART}    part: {{type: t/outer, mount: body.front}}")
    assert robot.link("part_inner_box").visuals[0].shape == Box((0.04, 1.0, 1.0))
    modules = f"{CART}    part: {{type: t/outer, mount: body.front, params: {{e: 50 mm}}}}"
    assert workshop.robot(modules).link("part_inner_box").visuals[0].shape == Box((0.05, 1.0, 1.0))


def test_null_is_not_a_number(workshop: Workshop) -> None:
    module = document(f"  e: {{quantity: length, default: none, {PARAM}}}", '["${e}", 1, 1]')
    assert workshop.part_codes(module) == ["wrong-type"]


def test_error_in_a_value_is_reported_once(workshop: Workshop) -> None:
    let = 'let: {a: "${b + 1}", b: "${sqrt(0 - 4)}", c: "${a + b}"}'
    params = f"  e: {{quantity: length, default: 1, {PARAM}}}"
    module = document(params, '["${a}", "${b}", "${c}"]', let)
    assert workshop.part_codes(module) == ["expression-value"]


def test_cyclic_value_is_reported_with_its_chain(workshop: Workshop) -> None:
    let = 'let: {a: "${b}", b: "${c * 2}", c: "${b + 1}"}'
    workshop.module(
        "t/part", document(f"  e: {{type: integer, default: 1, {PARAM}}}", '["${a}", 1, 1]', let)
    )
    diagnostics = workshop.diagnostics(f"{CART}    part: {{type: t/part, mount: body.front}}")
    (diagnostic,) = [d for d in diagnostics if d.code.name == "expression-cycle"]
    assert "b -> c -> b" in diagnostic.message


def test_length_of_a_chain_of_values_is_limited(workshop: Workshop) -> None:
    def chain(length: int) -> str:
        steps = "".join(f"  a{i}: ${{a{i + 1}}}\n" for i in range(length))
        let = f"let:\n{steps}  a{length}: 1 m\n"
        return document(f"  e: {{type: integer, default: 1, {PARAM}}}", '["${a0}", 1, 1]', let)

    assert workshop.part_codes(chain(29)) == []
    assert workshop.part_codes(chain(2000)) == ["expression-cycle"]


def test_a_module_is_chosen_by_name_or_with_parameters(workshop: Workshop) -> None:
    workshop.module(
        "t/holder",
        f"""
        params:
          held: {{type: module, default: none, {PARAM}}}
        modules:
          base: {{type: t/block}}
          held: {{type: "${{held}}", mount: {{parent: base, xyz: [0, 0, 1]}}}}
        """,
    )
    cart = CART + "    part: {type: t/holder, mount: body.front%s}"
    assert [x.name for x in workshop.robot(cart % "").links if "held" in x.name] == []
    named = workshop.robot(cart % ", params: {held: t/block}")
    assert named.link("part_held_box").inertial.mass == 10.0  # type: ignore[union-attr]
    chosen = "{type: t/block, params: {mass: 3 kg}}"
    with_params = workshop.robot(cart % f", params: {{held: {chosen}}}")
    assert with_params.link("part_held_box").inertial.mass == 3.0  # type: ignore[union-attr]
    quoted = workshop.robot(cart % ', params: {held: "none"}')
    assert [x.name for x in quoted.links if "held" in x.name] == []


def test_parameters_of_a_chosen_module_can_be_read(workshop: Workshop) -> None:
    params = f"  held: {{type: module, default: t/block, {PARAM}}}"
    module = document(params, '["${held.mass / 1000 kg * 1 m if held else 5 m}", 1, 1]')
    assert size(workshop, module)[0] == 0.01
    assert size(workshop, module, "held: none")[0] == 5.0
    assert size(workshop, module, "held: {type: t/block, params: {mass: 2 kg}}")[0] == 0.002


def test_module_that_chooses_itself_is_reported(workshop: Workshop) -> None:
    params = f"  held: {{type: module, default: t/part, {PARAM}}}"
    assert workshop.part_codes(document(params, "[1, 1, 1]")) == []
    module = document(params, '["${deep}", 1, 1]', 'let: {deep: "${held.held.deep}"}')
    assert workshop.part_codes(module) != []


@pytest.mark.parametrize("value", ["1e13", "-2e12", "1e-16"])
def test_numbers_have_a_range(workshop: Workshop, value: str) -> None:
    module = document(f"  e: {{quantity: number, default: 1, {PARAM}}}", "[1, 1, 1]")
    assert workshop.part_codes(module, f"e: {value}") == ["number-out-of-range"]
    assert workshop.part_codes(module, "e: 1e12") == []
    assert workshop.part_codes(module, "e: 0") == []


def test_a_parameter_comes_before_a_constant_of_its_name(workshop: Workshop) -> None:
    module = document(f"  pi: {{quantity: number, default: 3, {PARAM}}}", '["${pi * 1 m}", 1, 1]')
    assert size(workshop, module)[0] == 3.0
