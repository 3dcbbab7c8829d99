"""Names, operators and functions in the expressions of module documents (``${...}``).

Each public function of this module returns a closure that computes the value of one part of an
expression.  The expression parser builds a tree of closures.  The outermost closure returns the
value of the whole expression.  The argument of a closure is the scope, which maps each known name
to its value.  The parameter ``offset`` is the position of an operator or name in the expression,
for error messages.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.source.expression_tokens import ExpressionError, Token
from thorvaldc.diagnostics.suggest import did_you_mean

MAX_ELEMENTS = 10_000

Scope = Mapping[str, Any]
Evaluate = Callable[[Scope], Any]
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


def show(value: Any, bare: bool = False) -> str:
    """Formats the value of an expression as text for an error message.

    - ``bare``: returns only the value, such as ``a`` instead of ``the text `a```.
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return value if bare else f"the text `{value[:40]}`"
    if isinstance(value, (list, tuple)):
        if bare:
            return "[" + ", ".join(show(item, bare=True) for item in value) + "]"
        return f"a list of {len(value)}"
    return "a module"


def _require_number(value: Any, offset: int, name: str) -> Number:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ExpressionError(f"`{name}` requires a number, got {show(value)}", offset)
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
    raise ExpressionError(
        f"`{name}` requires true or false, got {show(value)}",
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
        raise ExpressionError("the result is too large", offset)
    return value


# -- values ---------------------------------------------------------------------------


def constant(token: Token) -> Evaluate:
    value = token.value
    if not token.divisors:
        return lambda scope: value

    def read(scope: Scope) -> Any:
        for name in token.divisors:
            if name in scope:
                raise ExpressionError(
                    f"`{name}` in `{token.text}` is a unit and also a known name",
                    token.offset,
                    hint=f"to divide by the value, write parentheses: `/ ({name})`",
                )
        return value

    return read


def look_up_name(name: str, offset: int) -> Evaluate:
    def look_up(scope: Scope) -> Any:
        try:
            return scope[name]
        except KeyError:
            if name in _CONSTANTS:
                return _CONSTANTS[name]
        hint = f"call a function with parentheses: `{name}(...)`" if name in FUNCTIONS else None
        raise ExpressionError(
            f"unknown name `{name}`",
            offset,
            hint=hint or did_you_mean(name, scope, _list_names(scope)),
            code="expression-name",
        )

    return look_up


def _list_names(scope: Scope) -> str | None:
    names = ", ".join(f"`{name}`" for name in list(scope)[:12])
    return f"known names are {names}" if names else None


def attribute(operand: Evaluate, name: str, offset: int) -> Evaluate:
    def read(scope: Scope) -> Any:
        value = operand(scope)
        if not isinstance(value, Mapping):
            raise ExpressionError(f"{show(value)} has no attribute `{name}`", offset)
        try:
            return value[name]
        except KeyError:
            raise ExpressionError(
                f"unknown attribute `.{name}`",
                offset,
                hint=did_you_mean(name, value, _list_names(value)),
                code="expression-name",
            ) from None

    return read


def element(operand: Evaluate, index: Evaluate, offset: int) -> Evaluate:
    def read(scope: Scope) -> Any:
        value, position = operand(scope), index(scope)
        if not isinstance(value, (list, tuple)):
            raise ExpressionError(f"{show(value)} has no elements", offset)
        if isinstance(position, float) and position.is_integer():
            position = int(position)
        if isinstance(position, bool) or not isinstance(position, int):
            raise ExpressionError(f"an index is a whole number, not {show(position)}", offset)
        if not -len(value) <= position < len(value):
            raise ExpressionError(
                f"index {position} is outside a list of {len(value)}",
                offset,
                hint="the first element has the index 0",
            )
        return value[position]

    return read


def list_of(elements: list[Evaluate]) -> Evaluate:
    return lambda scope: [element(scope) for element in elements]


# -- logic ----------------------------------------------------------------------------


def choose(condition: Evaluate, value: Evaluate, otherwise: Evaluate, offset: int) -> Evaluate:
    return lambda scope: (
        value(scope) if _require_truth(condition(scope), offset, "if") else otherwise(scope)
    )


def logical(word: str, decisive: bool, operands: list[Evaluate], offset: int) -> Evaluate:
    """Returns a closure that computes a chain of ``and`` operators or a chain of ``or`` operators.

    - ``word``: name of the operator in error messages.
    - ``decisive``: operand value that decides the result.  The operator ``and`` stops at the first
      false operand, and ``or`` at the first true operand.

    """

    def run(scope: Scope) -> bool:
        for operand in operands:
            if _require_truth(operand(scope), offset, word) is decisive:
                return decisive
        return not decisive

    return run


def negate(operand: Evaluate, count: int, offset: int) -> Evaluate:
    """Returns a closure that computes the logical negation of an operand ``count`` times."""
    odd = count % 2 == 1
    return lambda scope: _require_truth(operand(scope), offset, "not") is not odd


_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def compare(first: Evaluate, rest: list[tuple[str, Evaluate, int]]) -> Evaluate:
    """Returns a closure that computes a chain of comparisons, such as ``a < b <= c``.

    - ``first``: operand before the first operator.
    - ``rest``: a tuple (operator, right operand, offset) for each comparison of the chain.
    """

    def run(scope: Scope) -> bool:
        left = first(scope)
        for symbol, operand, offset in rest:
            right = operand(scope)
            if not _is_true(symbol, left, right, offset):
                return False
            left = right
        return True

    return run


def _is_true(symbol: str, left: Any, right: Any, offset: int) -> bool:
    if symbol in ("==", "!="):
        # In Python, the number 1 equals the truth value True.  In the expressions of module
        # documents, a number never equals a truth value.
        equal = isinstance(left, bool) == isinstance(right, bool) and bool(left == right)
        return equal is (symbol == "==")
    left = _require_number(left, offset, symbol)
    return _COMPARISONS[symbol](left, _require_number(right, offset, symbol))


# -- arithmetic -----------------------------------------------------------------------


def signed(operand: Evaluate, minus: bool, offset: int) -> Evaluate:
    if minus:
        return lambda scope: -_require_number(operand(scope), offset, "-")
    return lambda scope: _require_number(operand(scope), offset, "+")


def chain(first: Evaluate, rest: list[tuple[str, Evaluate, int]]) -> Evaluate:
    """Returns a closure that computes a chain of arithmetic operators, such as ``a + b - c``.

    - ``first``: operand before the first operator.
    - ``rest``: a tuple (operator, right operand, offset) for each operator.

    Arithmetic operators of equal precedence are applied from left to right.
    """

    def run(scope: Scope) -> Any:
        value = first(scope)
        for symbol, operand, offset in rest:
            value = combine(symbol, value, operand(scope), offset)
        return value

    return run


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
                raise ExpressionError("the result is too long", offset)
            return joined
    left = _require_number(left, offset, symbol)
    right = _require_number(right, offset, symbol)
    try:
        return _require_finite(_OPERATIONS[symbol](left, right), offset)
    except ZeroDivisionError:
        raise ExpressionError(f"`{symbol}` divides by zero", offset) from None
    except OverflowError:
        raise ExpressionError("the result is too large", offset) from None
    except ValueError:
        message = f"`{show(left)} {symbol} {show(right)}` has no real value"
        raise ExpressionError(message, offset) from None


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


# -- functions ------------------------------------------------------------------------


def call(name: str, arguments: list[Evaluate], offset: int) -> Evaluate:
    function, _ = FUNCTIONS[name]

    def run(scope: Scope) -> Any:
        values = [argument(scope) for argument in arguments]
        if name == "len":
            if not isinstance(values[0], (list, tuple, str)):
                raise ExpressionError(f"`len` requires a list, got {show(values[0])}", offset)
            return len(values[0])
        if name in ("min", "max") and len(values) == 1 and isinstance(values[0], (list, tuple)):
            values = list(values[0])
            if not values:
                raise ExpressionError(f"`{name}` of an empty list", offset)
        numbers = [_require_number(value, offset, name) for value in values]
        try:
            return _require_finite(function(*numbers), offset)
        except OverflowError:
            raise ExpressionError("the result is too large", offset) from None
        except ValueError:
            listed = ", ".join(show(number) for number in numbers)
            raise ExpressionError(f"`{name}({listed})` has no value", offset) from None

    return run


# Functions of the expression language: name -> (Python function, number of arguments).  The number
# of arguments is 0 for a function that takes one or more arguments.
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "min": (lambda *values: min(values), 0),
    "max": (lambda *values: max(values), 0),
    "abs": (abs, 1),
    "sqrt": (math.sqrt, 1),
    "hypot": (math.hypot, 0),
    "sin": (math.sin, 1),
    "cos": (math.cos, 1),
    "tan": (math.tan, 1),
    "asin": (math.asin, 1),
    "acos": (math.acos, 1),
    "atan": (math.atan, 1),
    "atan2": (math.atan2, 2),
    "floor": (math.floor, 1),
    "ceil": (math.ceil, 1),
    "len": (len, 1),
}
