"""Hints for expressions with a wrong dimension: the units that their numbers need."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

from thorvaldc.compiler.source import dimensions
from thorvaldc.compiler.source.expression_parser import ExpressionError, Token, tokenize
from thorvaldc.compiler.source.expressions import evaluate, expression_of
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import Dimension
from thorvaldc.diagnostics import Proposal


class Names(dimensions.Dimensions, Protocol):
    """Names of expressions, with values and dimensions."""

    def let_node(self, name: str) -> Node | None:
        """Returns the node of a `let` value."""


def dimension_hint(
    names: Names,
    text: str,
    expected: Dimension | None,
    actual: Sequence[Dimension],
    expected_words: str = "",
) -> str:
    """Returns the hint for an expression with a wrong dimension.

    The hint names both dimensions.  It proposes the units that the numbers of the expression need,
    if the value of the expression stays the same with them.

    - ``text``: an expression that has a value.
    - ``expected``: expected dimension, or ``None`` if every dimension is allowed.
    - ``actual``: dimension of the expression, or the two dimensions in it that do not fit.
    - ``expected_words``: name of the expected dimension, if ``actual`` has one element.
    """
    wrong = actual[0]
    hint = (
        f"{dimensions.in_words(wrong)} is not {expected_words or dimensions.in_words(actual[-1])}"
    )
    repaired = with_units(text, names, expected, actual)
    has_coefficient = any("." in token.text for token in tokenize(text) if token.kind == "number")
    if expected is not None and len(actual) == 1 and not (repaired and has_coefficient):
        factor = dimensions.multiply(expected, wrong, -1)
        proposal = _hint_of_let(names, text, expected, factor, hint)
        if proposal is not None:
            return proposal
        operand = text if re.fullmatch(r"[\w.]+", text) else f"({text})"
        if repaired is None and dimensions.fits(wrong, dimensions.NONE):
            repaired = f"{operand} * 1 {dimensions.unit_text(expected)}"
        elif repaired is None and dimensions.fits(expected, dimensions.NONE):
            repaired = f"{operand} / 1 {dimensions.unit_text(wrong)}"
        elif repaired is None and all(power == int(power) for power in factor):
            hint += f"; a coefficient in `{dimensions.unit_text(factor)}` would make it one"
    if repaired is None or '"' in repaired:
        return hint
    return Proposal(f"{hint}: write `${{{repaired}}}`", f'"${{{repaired}}}"')


class _WithDimension:
    """Names of expressions, one of which has another dimension."""

    def __init__(self, names: Names, name: str, dimension: Dimension) -> None:
        self.names = names
        self.changed = (name, dimension)

    def dimension(self, name: str) -> Any:
        return self.changed[1] if name == self.changed[0] else self.names.dimension(name)


def _hint_of_let(
    names: Names, text: str, expected: Dimension, factor: Dimension, hint: str
) -> Proposal | None:
    """Returns the hint to give a unit to a number of a `let` value that the expression uses.

    ``factor``: quotient of the expected dimension and that of the expression.
    """
    for token in tokenize(text):
        node = names.let_node(token.text) if token.kind == "name" else None
        dimension = (
            dimensions.number_dimension(names.dimension(token.text)) if node is not None else None
        )
        if node is None or dimension is None:
            continue
        goal = dimensions.multiply(dimension, factor)
        try:
            part = dimensions.infer_dimension(text, _WithDimension(names, token.text, goal))
        except ExpressionError:
            continue
        inner, result = expression_of(node), dimensions.number_dimension(part)
        if result is None or not dimensions.fits(result, expected):
            continue
        if inner is None:
            shown = written = f"{node.value} {dimensions.unit_text(goal)}"
        else:
            repaired = with_units(inner, names, goal, (dimension,))
            if repaired is None or '"' in repaired:
                continue
            shown = f"${{{repaired}}}"
            written = f'"{shown}"'
        return Proposal(f"{hint}: write `{token.text}: {shown}`", written, span=node.span)
    return None


# -- units that the numbers of an expression need ---------------------------------

# Before expressions had dimensions, ``${3.6 * length}`` was a mass: its numbers were SI values.
# The SI unit that such a number needs keeps the value of the expression: ``${3.6 kg/m * length}``.

MAX_LITERALS = 6
MAX_CHANGES = 2  # numbers that get a unit


def with_units(
    text: str, scope: Any, expected: Dimension | None, actual: Sequence[Dimension]
) -> str | None:
    """Returns an expression with units at its numbers, which has the expected dimension.

    - ``text``: an expression with wrong dimensions.
    - ``scope``: names of the expression, with values and dimensions.
    - ``expected``: expected dimension, or ``None`` if every dimension is allowed.
    - ``actual``: dimension of the expression, or the two dimensions in it that do not fit.

    Returns ``None`` if no one or two units give the expected dimension and the same value.
    """
    units = _units(expected, actual)
    literals = [t for t in tokenize(text) if t.kind == "number" and t.dimension is None]
    literals.sort(key=lambda token: "." not in token.text)  # a coefficient rather than a count
    value = evaluate(text, scope)
    for changed in _changes(literals[:MAX_LITERALS], units):
        new = text
        for token, unit in sorted(changed, key=lambda change: -change[0].offset):
            end = token.offset + len(token.text)
            new = f"{new[:end]} {unit}{new[end:]}"
        try:
            dimension = dimensions.number_dimension(dimensions.infer_dimension(new, scope))
            is_right = expected is None or (
                dimension is not None and dimensions.fits(dimension, expected)
            )
            if is_right and evaluate(new, scope) == value:
                return new
        except ExpressionError:
            continue
    return None


def _changes(literals: list[Token], units: list[str]) -> Iterator[list[tuple[Token, str]]]:
    for number in range(1, MAX_CHANGES + 1):
        for tokens in itertools.combinations(literals, number):
            for chosen in itertools.product(units, repeat=number):
                yield list(zip(tokens, chosen, strict=True))


def _units(expected: Dimension | None, actual: Sequence[Dimension]) -> list[str]:
    """Returns the units that a number of the expression may need, the most likely ones first."""
    length, area, volume = (dimensions.EXPECTED[name] for name in ("length", "area", "volume"))
    goals = [expected] if expected is not None else []
    candidates = [dimensions.multiply(goal, wrong, -1) for goal in goals for wrong in actual]
    candidates += [*goals, *actual]
    candidates += [
        dimensions.multiply(goal, per, -1) for goal in goals for per in (length, area, volume)
    ]
    candidates += [
        dimensions.multiply(above, below, -1) for above, below in itertools.permutations(actual, 2)
    ]
    whole = [
        c
        for c in candidates
        if not dimensions.fits(c, dimensions.NONE) and all(p == int(p) for p in c)
    ]
    return list(dict.fromkeys(map(dimensions.unit_text, whole)))
