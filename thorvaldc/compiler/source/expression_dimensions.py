"""Physical dimensions of the expressions of module documents (``${...}``).

The module has the same functions as ``expression_operations``.  Their closures compute the
dimension of a part of an expression instead of its value, in both branches of a choice and on both
sides of ``and`` and ``or``.  An angle has no dimension in an expression, as in SI: ``arm * 15 deg``
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
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from thorvaldc.compiler.source import expression_operations as operations
from thorvaldc.compiler.source.expression_tokens import ExpressionError, Token
from thorvaldc.compiler.source.unit_table import BASE_UNITS, PLAIN, QUANTITIES, Dimension
from thorvaldc.compiler.source.units import UnitError, parse_with_dimension

NONE = PLAIN.dimension
MAX_POWER = 1000
_TOLERANCE = 1e-6  # of an exponent, which a root can make a fraction


class Dimensions(Protocol):
    """The names that an expression may use, with their dimensions."""

    def dimension(self, name: str) -> Any:
        """Returns the dimension of a name.  Raises ``KeyError`` if the name is unknown."""


Infer = Callable[[Dimensions], Any]


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


# -- values -------------------------------------------------------------------------


def constant(token: Token) -> Infer:
    if token.dimension is not None:
        dimension = without_angle(token.dimension)
        return lambda scope: dimension
    value = token.value if token.kind == "number" else None
    return lambda scope: value


def look_up_name(name: str, offset: int) -> Infer:
    def look_up(scope: Dimensions) -> Any:
        try:
            return scope.dimension(name)
        except KeyError:
            return math.pi if name == "pi" else None

    return look_up


def attribute(operand: Infer, name: str, offset: int) -> Infer:
    def read(scope: Dimensions) -> Any:
        part = operand(scope)
        try:
            return part(name) if callable(part) else None
        except KeyError:
            return None

    return read


def element(operand: Infer, index: Infer, offset: int) -> Infer:
    def read(scope: Dimensions) -> Any:
        position = index(scope)
        _require_plain(position, offset, "[", "a number without a unit")
        return element_of(operand(scope), position)

    return read


def element_of(part: Any, position: Any) -> Any:
    """Returns the dimension of an element of a list."""
    if not isinstance(part, list) or not part:
        return None
    if all(other == part[0] for other in part):
        return part[0]
    is_inside = isinstance(position, int) and -len(part) <= position < len(part)
    return part[position] if is_inside else None


def list_of(elements: list[Infer]) -> Infer:
    return lambda scope: [element(scope) for element in elements]


# -- logic --------------------------------------------------------------------------


def choose(condition: Infer, value: Infer, otherwise: Infer, offset: int) -> Infer:
    def run(scope: Dimensions) -> Any:
        condition(scope)
        first, second = value(scope), otherwise(scope)
        if isinstance(first, list) and isinstance(second, list):
            return [_common([*first, *second], offset, "if")]
        if callable(first) or isinstance(first, list):
            return first
        return _common([first, second], offset, "if") or second

    return run


def logical(word: str, decisive: bool, operands: list[Infer], offset: int) -> Infer:
    return lambda scope: [operand(scope) for operand in operands] and None


def negate(operand: Infer, count: int, offset: int) -> Infer:
    return lambda scope: operand(scope) and None


def compare(first: Infer, rest: list[tuple[str, Infer, int]]) -> Infer:
    def run(scope: Dimensions) -> None:
        left = first(scope)
        for symbol, operand, offset in rest:
            right = operand(scope)
            _common((left, right), offset, symbol)
            left = right

    return run


# -- arithmetic ---------------------------------------------------------------------


def signed(operand: Infer, minus: bool, offset: int) -> Infer:
    def run(scope: Dimensions) -> Any:
        part = operand(scope)
        return -part if minus and isinstance(part, int | float) else part

    return run


def chain(first: Infer, rest: list[tuple[str, Infer, int]]) -> Infer:
    def run(scope: Dimensions) -> Any:
        part = first(scope)
        for symbol, operand, offset in rest:
            part = _combine(symbol, part, operand(scope), offset)
        return part

    return run


def _combine(symbol: str, left: Any, right: Any, offset: int) -> Any:
    if isinstance(left, int | float) and isinstance(right, int | float):
        try:
            return operations.combine(symbol, left, right, offset)
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


# -- functions ----------------------------------------------------------------------


def call(name: str, arguments: list[Infer], offset: int) -> Infer:
    def run(scope: Dimensions) -> Any:
        parts = [argument(scope) for argument in arguments]
        if name in ("min", "max", "hypot", "abs"):
            return _common(parts[0] if isinstance(parts[0], list) else parts, offset, name)
        if name == "sqrt":
            return _to_power(parts[0], 0.5, offset)
        if name == "atan2":
            _common(parts, offset, name)
        elif name in ("floor", "ceil"):
            _require_plain(parts[0], offset, name, "a number without a unit")
        elif name != "len":
            _require_plain(parts[0], offset, name, "an angle or a number without a unit")
        return NONE

    return run
