"""Hints for expressions with a wrong dimension: the units that their numbers need."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Protocol

from thorvaldc.compiler.source.expression_dimensions import (
    NONE,
    Dimensions,
    fits,
    in_words,
    multiply,
    number_dimension,
    unit_text,
)
from thorvaldc.compiler.source.expression_tokens import ExpressionError, tokenize
from thorvaldc.compiler.source.expressions import expression_of, infer_dimension
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_repair import with_units
from thorvaldc.compiler.source.unit_table import Dimension
from thorvaldc.diagnostics import Proposal


class Names(Dimensions, Protocol):
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
    hint = f"{in_words(wrong)} is not {expected_words or in_words(actual[-1])}"
    repaired = with_units(text, names, expected, actual)
    has_coefficient = any("." in token.text for token in tokenize(text) if token.kind == "number")
    if expected is not None and len(actual) == 1 and not (repaired and has_coefficient):
        factor = multiply(expected, wrong, -1)
        proposal = _hint_of_let(names, text, expected, factor, hint)
        if proposal is not None:
            return proposal
        if repaired is None and fits(wrong, NONE):
            operand = text if re.fullmatch(r"[\w.]+", text) else f"({text})"
            repaired = f"{operand} * 1 {unit_text(expected)}"
        elif repaired is None and all(power == int(power) for power in factor):
            hint += f"; a coefficient in `{unit_text(factor)}` would make it one"
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
        dimension = number_dimension(names.dimension(token.text)) if node is not None else None
        if node is None or dimension is None:
            continue
        goal = multiply(dimension, factor)
        try:
            part = infer_dimension(text, _WithDimension(names, token.text, goal))
        except ExpressionError:
            continue
        inner, result = expression_of(node), number_dimension(part)
        if result is None or not fits(result, expected):
            continue
        if inner is None:
            shown = written = f"{node.value} {unit_text(goal)}"
        else:
            repaired = with_units(inner, names, goal, (dimension,))
            if repaired is None or '"' in repaired:
                continue
            shown = f"${{{repaired}}}"
            written = f'"{shown}"'
        return Proposal(f"{hint}: write `{token.text}: {shown}`", written, span=node.span)
    return None
