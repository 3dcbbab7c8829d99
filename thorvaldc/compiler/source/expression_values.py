"""What the parts of an expression compute: each function here returns a closure over a scope."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.source.expression_tokens import ExpressionError, Token
from thorvaldc.diagnostics.suggest import did_you_mean

MAX_ELEMENTS = 10_000

Evaluate = Callable[[Mapping[str, Any]], Any]
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


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def shown(value: Any, plain: bool = False) -> str:
    """A value for a message: its kind and the value."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if _is_number(value):
        return repr(value)
    if isinstance(value, str):
        return value if plain else f"the text `{value[:40]}`"
    if isinstance(value, (list, tuple)):
        if plain:
            return "[" + ", ".join(shown(item, plain=True) for item in value) + "]"
        return f"a list of {len(value)}"
    return "a module"


def _checked(value: Any, offset: int) -> Any:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ExpressionError("the result is too large", offset)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ExpressionError("the result is too large", offset)
    return value


def _number_or_refuse(value: Any, offset: int, what: str) -> Number:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ExpressionError(f"{what} wants a number, not {shown(value)}", offset)
    return value


def _truth(value: Any, offset: int, what: str) -> bool:
    """A module that was chosen counts as true, one that is `none` as false."""
    if isinstance(value, bool):
        return value
    if value is None or isinstance(value, Mapping):
        return value is not None
    raise ExpressionError(
        f"{what} wants true or false, not {shown(value)}",
        offset,
        hint="compare it, as in `count > 0`",
    )


def constant(token: Token) -> Evaluate:
    value = token.value
    if not token.divisors:
        return lambda scope: value

    def read(scope: Mapping[str, Any]) -> Any:
        for name in token.divisors:
            if name in scope:
                raise ExpressionError(
                    f"`{name}` in `{token.text}` is a unit, and a name here as well",
                    token.offset,
                    hint=f"to divide by the value, write parentheses: `/ ({name})`",
                )
        return value

    return read


def look_up_name(name: str, offset: int) -> Evaluate:
    constant = _CONSTANTS.get(name)
    is_constant = name in _CONSTANTS

    def look_up(scope: Mapping[str, Any]) -> Any:
        try:
            return scope[name]
        except KeyError:
            if is_constant:
                return constant
        hint = f"a function is called: `{name}(...)`" if name in FUNCTIONS else None
        raise ExpressionError(
            f"there is no `{name}` here",
            offset,
            hint=hint or did_you_mean(name, scope, _known(scope)),
            code="expression-name",
        )

    return look_up


def _known(scope: Mapping[str, Any]) -> str | None:
    names = list(scope)
    if not names:
        return None
    return "known are " + ", ".join(f"`{name}`" for name in names[:12])


def attribute(inner: Evaluate, name: str, offset: int) -> Evaluate:
    def read(scope: Mapping[str, Any]) -> Any:
        value = inner(scope)
        if not isinstance(value, Mapping):
            raise ExpressionError(f"{shown(value)} has no `.{name}`", offset)
        try:
            return value[name]
        except KeyError:
            raise ExpressionError(
                f"there is no `.{name}` here",
                offset,
                hint=did_you_mean(name, value, _known(value)),
                code="expression-name",
            ) from None

    return read


def index(inner: Evaluate, index: Evaluate, offset: int) -> Evaluate:
    def read(scope: Mapping[str, Any]) -> Any:
        value, at = inner(scope), index(scope)
        if not isinstance(value, (list, tuple)):
            raise ExpressionError(f"{shown(value)} has no elements", offset)
        if isinstance(at, float) and at.is_integer():
            at = int(at)
        if isinstance(at, bool) or not isinstance(at, int):
            raise ExpressionError(f"an index is a whole number, not {shown(at)}", offset)
        if not -len(value) <= at < len(value):
            raise ExpressionError(
                f"there is no element {at} in a list of {len(value)}",
                offset,
                hint="the first element is 0",
            )
        return value[at]

    return read


def list_of(elements: list[Evaluate]) -> Evaluate:
    return lambda scope: [element(scope) for element in elements]


def choose(condition: Evaluate, value: Evaluate, other: Evaluate, offset: int) -> Evaluate:
    return lambda scope: value(scope) if _truth(condition(scope), offset, "`if`") else other(scope)


def logical(word: str, decisive: bool, operands: list[Evaluate], offset: int) -> Evaluate:
    what = f"`{word}`"

    def run(scope: Mapping[str, Any]) -> bool:
        for operand in operands:
            if _truth(operand(scope), offset, what) is decisive:
                return decisive
        return not decisive

    return run


def negate(inner: Evaluate, odd: bool, offset: int) -> Evaluate:
    return lambda scope: _truth(inner(scope), offset, "`not`") is not odd


def compare(first: Evaluate, rest: list[tuple[str, Evaluate, int]]) -> Evaluate:
    def run(scope: Mapping[str, Any]) -> bool:
        left = first(scope)
        for symbol, inner, offset in rest:
            right = inner(scope)
            if not _holds(symbol, left, right, offset):
                return False
            left = right
        return True

    return run


def _holds(symbol: str, left: Any, right: Any, offset: int) -> bool:
    if symbol in ("==", "!="):
        # 1 is not true here, as it would be in Python.
        same = isinstance(left, bool) == isinstance(right, bool) and left == right
        return bool(same) if symbol == "==" else not same
    a = _number_or_refuse(left, offset, f"`{symbol}`")
    b = _number_or_refuse(right, offset, f"`{symbol}`")
    if symbol == "<":
        return a < b
    if symbol == "<=":
        return a <= b
    return a > b if symbol == ">" else a >= b


def signed(inner: Evaluate, minus: bool, offset: int) -> Evaluate:
    if minus:
        return lambda scope: -_number_or_refuse(inner(scope), offset, "`-`")
    return lambda scope: _number_or_refuse(inner(scope), offset, "`+`")


def chain(first: Evaluate, rest: list[tuple[str, Evaluate, int]]) -> Evaluate:
    """``first`` combined with each of ``rest`` (operator, operand, offset), left to right."""

    def run(scope: Mapping[str, Any]) -> Any:
        value = first(scope)
        for symbol, operand, offset in rest:
            value = _combine(symbol, value, operand(scope), offset)
        return value

    return run


def _combine(symbol: str, a: Any, b: Any, offset: int) -> Any:
    if symbol == "+":
        joined: Any = None
        if isinstance(a, str) and isinstance(b, str):
            joined = a + b
        elif isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
            joined = [*a, *b]
        if joined is not None:
            if len(joined) > MAX_ELEMENTS:
                raise ExpressionError("the result is too long", offset)
            return joined
    a = _number_or_refuse(a, offset, f"`{symbol}`")
    b = _number_or_refuse(b, offset, f"`{symbol}`")
    try:
        return _checked(_OPERATIONS[symbol](a, b), offset)
    except ZeroDivisionError:
        raise ExpressionError(f"`{symbol}` divides by zero", offset) from None
    except OverflowError:
        raise ExpressionError("the result is too large", offset) from None
    except ValueError:
        raise ExpressionError(
            f"`{shown(a)} {symbol} {shown(b)}` has no real value", offset
        ) from None


def _raise_to(a: Number, b: Number) -> Number:
    if isinstance(a, int) and (not isinstance(b, int) or abs(b) > 64 or abs(a) > 2**31):
        a = float(a)  # also bounds the work
    result = a**b
    if isinstance(result, complex):
        raise ValueError
    return result


_OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "%": lambda a, b: a % b,
    "**": _raise_to,
}


def call(
    name: str, function: Callable[..., Any], arguments: list[Evaluate], offset: int
) -> Evaluate:
    what = f"`{name}`"

    def run(scope: Mapping[str, Any]) -> Any:
        values = [argument(scope) for argument in arguments]
        if name == "len":
            if not isinstance(values[0], (list, tuple, str)):
                raise ExpressionError(f"{what} wants a list, not {shown(values[0])}", offset)
            return len(values[0])
        if name in ("min", "max") and len(values) == 1 and isinstance(values[0], (list, tuple)):
            values = list(values[0])
            if not values:
                raise ExpressionError(f"{what} of an empty list", offset)
        numbers = [_number_or_refuse(value, offset, what) for value in values]
        try:
            return _checked(function(*numbers), offset)
        except OverflowError:
            raise ExpressionError("the result is too large", offset) from None
        except ValueError:
            listed = ", ".join(shown(number) for number in numbers)
            raise ExpressionError(f"`{name}({listed})` has no value", offset) from None

    return run


# Function and number of arguments; 0 stands for one or more.
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
