"""Finds the units that the numbers of an expression need to have the expected dimension.

Before expressions had dimensions, ``${3.6 * length}`` was a mass: its numbers were SI values.  The
SI unit that such a number needs keeps the value of the expression: ``${3.6 kg/m * length}``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from thorvaldc.compiler.source.expression_dimensions import (
    EXPECTED,
    NONE,
    fits,
    multiply,
    number_dimension,
    unit_text,
)
from thorvaldc.compiler.source.expression_tokens import ExpressionError, Token, tokenize
from thorvaldc.compiler.source.expressions import evaluate, infer_dimension
from thorvaldc.compiler.source.unit_table import Dimension

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
            dimension = number_dimension(infer_dimension(new, scope))
            is_right = expected is None or (dimension is not None and fits(dimension, expected))
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
    length, area, volume = (EXPECTED[name] for name in ("length", "area", "volume"))
    goals = [expected] if expected is not None else []
    candidates = [multiply(goal, wrong, -1) for goal in goals for wrong in actual]
    candidates += [*goals, *actual]
    candidates += [multiply(goal, per, -1) for goal in goals for per in (length, area, volume)]
    candidates += [multiply(above, below, -1) for above, below in itertools.permutations(actual, 2)]
    whole = [c for c in candidates if not fits(c, NONE) and all(p == int(p) for p in c)]
    return list(dict.fromkeys(map(unit_text, whole)))
