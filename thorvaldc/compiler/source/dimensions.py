"""Physical dimensions of the expressions of module documents (``${...}``).

The dimension of an expression is computed in both branches of a choice and on both sides of ``and``
and ``or``.  An angle has no dimension in an expression, as in SI: ``arm * 15 deg``
is a length.  The dimension of a part is one of:

- a ``Dimension``: a number with this dimension.
- a number: a number of the expression without a unit, which has no dimension.  Its value is known,
  so that it can be an exponent or an index.  The number 0 fits every dimension.
- a list: the dimensions of the elements of a list.
- a function: a module or a controller channel.  It returns the dimension of an attribute, or raises
  ``KeyError``.
- ``None``: no number, or a number of unknown dimension.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable
from typing import Any, Protocol

from thorvaldc.compiler.source.expression_parser import ExpressionError, Part, Token, parse
from thorvaldc.compiler.source.expressions import combine
from thorvaldc.compiler.source.unit_table import BASE_UNITS, PLAIN, QUANTITIES, Dimension
from thorvaldc.compiler.source.units import UnitError, parse_with_dimension

NONE = PLAIN.dimension
MAX_POWER = 1000
_TOLERANCE = 1e-6  # of an exponent, which a root can make a fraction


class Dimensions(Protocol):
    """The names that an expression may use, with their dimensions."""

    def dimension(self, name: str) -> Any:
        """Returns the dimension of a name.  Raises ``KeyError`` if the name is unknown."""


class DimensionError(ExpressionError):
    """Raised if two parts of an expression have dimensions that do not fit.

    - ``first``, ``second``: the two dimensions.
    """

    def __init__(self, message: str, offset: int, first: Dimension, second: Dimension) -> None:
        super().__init__(message, offset, code="wrong-dimension")
        self.first = first
        self.second = second


# -- dimensions ---------------------------------------------------------------------


def without_angle(dimension: Dimension) -> Dimension:
    """Returns a dimension of a unit as it counts in expressions: the radian is 1."""
    return (*dimension[:5], 0, dimension[6])


EXPECTED = {name: without_angle(kind.dimensions[0]) for name, kind in QUANTITIES.items()}
"""Dimension of each kind of quantity in expressions."""


def written_dimension(text: str) -> Any:
    """Returns the dimension of a number with a unit, and ``None`` for another text."""
    try:
        value, dimension = parse_with_dimension(text)
    except UnitError:
        return None
    return value if dimension is None else without_angle(dimension)


def number_dimension(part: Any) -> Dimension | None:
    """Returns the dimension of a number, or ``None`` if it is unknown or fits every dimension."""
    if isinstance(part, tuple):
        return part
    return NONE if isinstance(part, int | float) and part != 0 else None


def fits(first: Dimension, second: Dimension) -> bool:
    """Returns whether two dimensions are equal."""
    return first == second or all(
        abs(a - b) < _TOLERANCE for a, b in zip(first, second, strict=True)
    )


def multiply(first: Dimension, second: Dimension, sign: int = 1) -> Dimension:
    """Returns the dimension of ``first * second``, or of ``first / second`` if ``sign`` is -1."""
    return tuple(map(operator.add if sign > 0 else operator.sub, first, second))


def in_words(dimension: Dimension) -> str:
    """Returns the name of a dimension, such as ``a length`` or ``a quantity in kg/m``."""
    if fits(dimension, NONE):
        return "a number without a unit"
    kinds = [QUANTITIES[name] for name, known in EXPECTED.items() if fits(known, dimension)]
    return " or ".join(map(str, kinds[:2])) or f"a quantity in {unit_text(dimension)}"


def unit_text(dimension: Dimension) -> str:
    """Returns the SI unit of a dimension, such as ``kg/m``, as an expression reads it."""
    if fits(dimension, NONE):
        return "1"
    for name, known in EXPECTED.items():
        if fits(known, dimension):
            return QUANTITIES[name].unit
    powers = [(base, power) for base, power in zip(BASE_UNITS, dimension, strict=True) if power]
    above = [_power_text(base, power) for base, power in powers if power > 0]
    if not above:
        return " ".join(_power_text(base, power) for base, power in powers)
    return "/".join([" ".join(above), *(_power_text(b, -p) for b, p in powers if p < 0)])


def _power_text(base: str, power: float) -> str:
    return base if power == 1 else f"{base}^{power:g}"


def _common(parts: Iterable[Any], offset: int, name: str) -> Dimension | None:
    """Returns the common dimension of several numbers, which ``name`` compares or adds."""
    common: Dimension | None = None
    for part in parts:
        dimension = number_dimension(part)
        if dimension is None:
            continue
        if common is not None and not fits(common, dimension):
            both = f"{in_words(common)} and {in_words(dimension)}"
            message = f"`{name}` requires equal dimensions, not {both}"
            raise DimensionError(message, offset, common, dimension)
        common = common or dimension
    return common


def _require_plain(part: Any, offset: int, name: str, expected: str) -> None:
    dimension = number_dimension(part)
    if dimension is not None and not fits(dimension, NONE):
        message = f"`{name}` requires {expected}, not {in_words(dimension)}"
        raise DimensionError(message, offset, dimension, NONE)


def _to_power(part: Any, exponent: float, offset: int) -> Dimension | None:
    dimension = number_dimension(part)
    if dimension is None:
        return None
    result = tuple(power * exponent for power in dimension)
    if max(map(abs, result)) > MAX_POWER:
        raise ExpressionError("the exponent is too large", offset)
    return result


# -- parts of an expression ---------------------------------------------------------


def infer_dimension(text: str, scope: Dimensions) -> Any:
    """Returns the dimension of an expression.

    - ``text``: the expression, which a document contains between ``${`` and ``}``.

    Raises ``DimensionError`` if parts of the expression have dimensions that do not fit.
    """
    return parse(text)(_DimensionAlgebra(scope))


def element_of(part: Any, position: Any) -> Any:
    """Returns the dimension of an element of a list."""
    if not isinstance(part, list) or not part:
        return None
    if all(other == part[0] for other in part):
        return part[0]
    is_inside = isinstance(position, int) and -len(part) <= position < len(part)
    return part[position] if is_inside else None


def _any_of(parts: list[Any], offset: int) -> Any:
    """Returns the dimension of one of several parts, which must be the same for all of them."""
    if parts and all(isinstance(part, list) and len(part) == len(parts[0]) for part in parts):
        return [_any_of(list(elements), offset) for elements in zip(*parts, strict=True)]
    return _common(parts, offset, "[")


class _DimensionAlgebra:
    """The algebra of dimensions."""

    def __init__(self, scope: Dimensions) -> None:
        self.scope = scope

    def constant(self, token: Token) -> Any:
        if token.dimension is not None:
            return without_angle(token.dimension)
        return token.value if token.kind == "number" else None

    def name(self, name: str, offset: int) -> Any:
        try:
            return self.scope.dimension(name)
        except KeyError:
            return math.pi if name == "pi" else None

    def attribute(self, operand: Any, name: str, offset: int) -> Any:
        try:
            return operand(name) if callable(operand) else None
        except KeyError:
            return None

    def element(self, operand: Any, index: Any, offset: int) -> Any:
        _require_plain(index, offset, "[", "a number without a unit")
        known = element_of(operand, index)
        if known is not None or not isinstance(operand, list) or isinstance(index, int):
            return known
        return _any_of(operand, offset)  # the expression does not say which

    def choose(self, condition: Part, value: Part, otherwise: Part, offset: int) -> Any:
        condition(self)
        first, second = value(self), otherwise(self)
        if isinstance(first, list) and isinstance(second, list):
            return [_common([*first, *second], offset, "if")]
        if callable(first) or isinstance(first, list):
            return first
        return _common([first, second], offset, "if") or second

    def logical(self, word: str, decisive: bool, operands: list[Part], offset: int) -> None:
        for operand in operands:
            operand(self)

    def negate(self, operand: Any, is_odd: bool, offset: int) -> None:
        return None

    def compare(self, symbol: str, left: Any, right: Any, offset: int) -> None:
        _common((left, right), offset, symbol)

    def signed(self, operand: Any, minus: bool, offset: int) -> Any:
        return -operand if minus and isinstance(operand, int | float) else operand

    def combine(self, symbol: str, left: Any, right: Any, offset: int) -> Any:
        if isinstance(left, int | float) and isinstance(right, int | float):
            try:
                return combine(symbol, left, right, offset)
            except ExpressionError:
                return NONE  # of a branch that is not computed
        if symbol == "+" and isinstance(left, list) and isinstance(right, list):
            return [*left, *right]
        if symbol in "+-%":
            return _common((left, right), offset, symbol)
        if symbol == "**":
            _require_plain(right, offset, "**", "an exponent without a unit")
            if isinstance(right, int | float):
                return _to_power(left, right, offset)
            base = number_dimension(left)
            if base is None or fits(base, NONE):
                return base
            raise ExpressionError(
                f"the exponent of {in_words(base)} must be a number of the expression",
                offset,
                hint="write it as in `x ** 2`, or divide the base by its unit: `(x / 1 m) ** n`",
                code="wrong-dimension",
            )
        first, second = number_dimension(left), number_dimension(right)
        if first is None or second is None:
            return None
        return multiply(first, second, -1 if symbol == "/" else 1)

    def call(self, name: str, arguments: list[Any], offset: int) -> Any:
        first = arguments[0]
        if name in ("min", "max", "hypot", "abs"):
            return _common(first if isinstance(first, list) else arguments, offset, name)
        if name == "sqrt":
            return _to_power(first, 0.5, offset)
        if name == "atan2":
            _common(arguments, offset, name)
        elif name in ("floor", "ceil"):
            _require_plain(first, offset, name, "a number without a unit")
        elif name != "len":
            _require_plain(first, offset, name, "an angle or a number without a unit")
        return NONE
