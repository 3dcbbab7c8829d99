"""Evaluates the expressions of module documents (``${...}``) to values in SI units."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.source import expression_parser as syntax
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import did_you_mean

MAX_ELEMENTS = 10_000

Number = int | float
_CONSTANTS: dict[str, Any] = {
    "pi": math.pi,
    "true": True,
    "false": False,
    "none": None,
    "True": True,
    "False": False,
    "None": None,
}


def expression_of(node: Node) -> str | None:
    """Returns the text between ``${`` and ``}``, or ``None`` if a YAML node is no expression."""
    value = node.value
    is_expression = isinstance(value, str) and value.startswith("${") and value.endswith("}")
    return str(value)[2:-1] if is_expression else None


def evaluate(text: str, scope: Mapping[str, Any]) -> Any:
    """Returns the value of an expression in SI units.

    - ``text``: the expression, which a document contains between ``${`` and ``}``.
    - ``scope``: value of each known name.  The value of a name is a number in SI units, a truth
      value, a text, a list or a mapping.  The expression ``a.key`` reads the key ``key`` of the
      mapping ``a``.

    A name is looked up in ``scope`` only when the expression needs its value.  The mapping
    ``scope`` can therefore compute a value when it is read.  If ``scope`` raises ``KeyError``, the
    name is unknown.  Raises ``ExpressionError`` if the expression has a syntax error, an unknown
    name or no value.  Other exceptions that ``scope`` raises are not caught.
    """
    return syntax.parse(text)(_Values(scope))


# -- values ---------------------------------------------------------------------------


def _show(value: Any) -> str:
    """Formats the value of an expression as text for an error message."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return f"the text `{value[:40]}`"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return "a module"


def _require_number(value: Any, offset: int, name: str) -> Number:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise syntax.ExpressionError(f"`{name}` requires a number, got {_show(value)}", offset)
    return value


def _require_truth(value: Any, offset: int, name: str) -> bool:
    """Returns an operand of an expression as a truth value.

    A parameter of a robot module counts as true if its value is another module.  A parameter of a
    robot module counts as false if its value is ``none``.  Raises ``ExpressionError`` if the
    operand cannot be converted to a truth value.
    """
    if isinstance(value, bool):
        return value
    if value is None or isinstance(value, Mapping):
        return value is not None
    raise syntax.ExpressionError(
        f"`{name}` requires true or false, got {_show(value)}",
        offset,
        hint="compare it, as in `count > 0`",
    )


def _require_finite(value: Any, offset: int) -> Any:
    """Checks the range of the result of an arithmetic operation, and returns the result unchanged.

    Raises ``ExpressionError`` if the result is an infinite float, nan or an integer of more than 64
    bits.
    """
    if isinstance(value, float):
        in_range = math.isfinite(value)
    else:
        in_range = not isinstance(value, int) or -(2**63) <= value < 2**63
    if not in_range:
        raise syntax.ExpressionError("the result is too large", offset)
    return value


class _Values:
    """The algebra of values.

    - ``scope``: value of each known name.
    """

    def __init__(self, scope: Mapping[str, Any]) -> None:
        self.scope = scope

    def constant(self, token: syntax.Token) -> Any:
        for name in token.divisors:
            if name in self.scope:
                raise syntax.ExpressionError(
                    f"`{name}` in `{token.text}` is a unit and also a known name",
                    token.offset,
                    hint=f"to divide by the value, write parentheses: `/ ({name})`",
                )
        return token.value

    def name(self, name: str, offset: int) -> Any:
        try:
            return self.scope[name]
        except KeyError:
            if name in _CONSTANTS:
                return _CONSTANTS[name]
        hint = (
            f"call a function with parentheses: `{name}(...)`" if name in syntax.FUNCTIONS else None
        )
        raise syntax.ExpressionError(
            f"unknown name `{name}`",
            offset,
            hint=hint or did_you_mean(name, self.scope, _list_names(self.scope)),
            code="expression-name",
        )

    def attribute(self, operand: Any, name: str, offset: int) -> Any:
        if not isinstance(operand, Mapping):
            raise syntax.ExpressionError(f"{_show(operand)} has no attribute `{name}`", offset)
        try:
            return operand[name]
        except KeyError:
            raise syntax.ExpressionError(
                f"unknown attribute `.{name}`",
                offset,
                hint=did_you_mean(name, operand, _list_names(operand)),
                code="expression-name",
            ) from None

    def element(self, operand: Any, index: Any, offset: int) -> Any:
        if not isinstance(operand, (list, tuple)):
            raise syntax.ExpressionError(f"{_show(operand)} has no elements", offset)
        if isinstance(index, float) and index.is_integer():
            index = int(index)
        if isinstance(index, bool) or not isinstance(index, int):
            raise syntax.ExpressionError(f"an index is a whole number, not {_show(index)}", offset)
        if not -len(operand) <= index < len(operand):
            raise syntax.ExpressionError(
                f"index {index} is outside a list of {len(operand)}",
                offset,
                hint="the first element has the index 0",
            )
        return operand[index]

    def choose(
        self, condition: syntax.Part, value: syntax.Part, otherwise: syntax.Part, offset: int
    ) -> Any:
        is_true = _require_truth(condition(self), offset, "if")
        return value(self) if is_true else otherwise(self)

    def logical(self, word: str, decisive: bool, operands: list[syntax.Part], offset: int) -> bool:
        """Stops at the first operand that decides the result."""
        for operand in operands:
            if _require_truth(operand(self), offset, word) is decisive:
                return decisive
        return not decisive

    def negate(self, operand: Any, is_odd: bool, offset: int) -> bool:
        return _require_truth(operand, offset, "not") is not is_odd

    def compare(self, symbol: str, left: Any, right: Any, offset: int) -> bool:
        if symbol in ("==", "!="):
            # In Python, the number 1 equals the truth value True.  In the expressions of module
            # documents, a number never equals a truth value.
            equal = isinstance(left, bool) == isinstance(right, bool) and bool(left == right)
            return equal is (symbol == "==")
        left = _require_number(left, offset, symbol)
        return _COMPARISONS[symbol](left, _require_number(right, offset, symbol))

    def signed(self, operand: Any, minus: bool, offset: int) -> Number:
        number = _require_number(operand, offset, "-" if minus else "+")
        return -number if minus else number

    def combine(self, symbol: str, left: Any, right: Any, offset: int) -> Any:
        return combine(symbol, left, right, offset)

    def call(self, name: str, arguments: list[Any], offset: int) -> Any:
        function, _ = syntax.FUNCTIONS[name]
        if name == "len":
            if not isinstance(arguments[0], (list, tuple, str)):
                raise syntax.ExpressionError(
                    f"`len` requires a list, got {_show(arguments[0])}", offset
                )
            return len(arguments[0])
        first = arguments[0]
        if name in ("min", "max") and len(arguments) == 1 and isinstance(first, (list, tuple)):
            arguments = list(first)
            if not arguments:
                raise syntax.ExpressionError(f"`{name}` of an empty list", offset)
        numbers = [_require_number(value, offset, name) for value in arguments]
        try:
            return _require_finite(function(*numbers), offset)
        except OverflowError:
            raise syntax.ExpressionError("the result is too large", offset) from None
        except ValueError:
            listed = ", ".join(_show(number) for number in numbers)
            raise syntax.ExpressionError(f"`{name}({listed})` has no value", offset) from None


def _list_names(scope: Mapping[str, Any]) -> str | None:
    names = ", ".join(f"`{name}`" for name in list(scope)[:12])
    return f"known names are {names}" if names else None


_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def combine(symbol: str, left: Any, right: Any, offset: int) -> Any:
    """Returns the value of an arithmetic operator, such as ``left + right``."""
    if symbol == "+":
        joined: Any = None
        if isinstance(left, str) and isinstance(right, str):
            joined = left + right
        elif isinstance(left, (list, tuple)) and isinstance(right, (list, tuple)):
            joined = [*left, *right]
        if joined is not None:
            if len(joined) > MAX_ELEMENTS:
                raise syntax.ExpressionError("the result is too long", offset)
            return joined
    left = _require_number(left, offset, symbol)
    right = _require_number(right, offset, symbol)
    try:
        return _require_finite(_OPERATIONS[symbol](left, right), offset)
    except ZeroDivisionError:
        raise syntax.ExpressionError(f"`{symbol}` divides by zero", offset) from None
    except OverflowError:
        raise syntax.ExpressionError("the result is too large", offset) from None
    except ValueError:
        message = f"`{_show(left)} {symbol} {_show(right)}` has no real value"
        raise syntax.ExpressionError(message, offset) from None


def _raise_to_power(base: Number, exponent: Number) -> Number:
    # A power with a large base or exponent is computed as a float, because a power of large Python
    # integers can take very long.
    if isinstance(base, int) and (
        not isinstance(exponent, int) or abs(exponent) > 64 or abs(base) > 2**31
    ):
        base = float(base)
    result = base**exponent
    if isinstance(result, complex):
        raise ValueError
    return result


_OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "**": _raise_to_power,
}
