"""Numbers that know their origins, and pass them on to sums and to the texts of outputs.

Origins are the bits of an integer, so that those of a sum are ``a | b``.  While a target is
emitted, a traced number writes a mark before its digits.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from thorvaldc.compiler.source.expression_parser import FUNCTIONS

MARK = "\x7f"
"""Begins and ends a mark: a control character that no output has, in every encoding of outputs."""
_BINARY = ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "and", "or", "xor")
_SHIFTS = ("lshift", "rshift")
_UNARY: Any = (operator.neg, operator.pos, operator.abs, operator.invert)
_ROUNDED: Any = (divmod, round, math.floor, math.ceil, math.trunc)
_marks: dict[int, int] = {}
"""Number of the mark of each set of origins.  No number is used again: caches keep marks."""


class TracedNumber:
    """An ``int`` or ``float`` for all that the compiler and the backends do with it.

    It is no subclass, because ``2.0 * n`` of a subclass is a plain number.  ``origins`` are the
    bits of the places that the plain number ``number`` follows from.
    """

    __slots__ = ("number", "origins")
    writes_marks = False

    def __init__(self, number: Any, origins: int) -> None:
        self.number = number
        self.origins = origins

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return type(self.number)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.number, name)

    def __hash__(self) -> int:
        # A cache must not mix the origins of equal floats; an integer is also a key, such as an id.
        # The hash of an integer takes the bits n and n + 61 as equal, that of a text does not.
        return hash((self.number, hex(self.origins)) if isinstance(self, float) else self.number)

    def __repr__(self) -> str:
        return str(traced(repr(self.number), self.origins))

    def __format__(self, specification: str) -> str:
        return str(traced(format(self.number, specification), self.origins))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self.number), (self.number,)


def origin_sets() -> list[int]:
    """Returns the set of origins of each mark."""
    return list(_marks)


def plain(value: Any) -> Any:
    """Returns a value without origins, also of the items of tuples and lists."""
    if type(value) in (tuple, list):
        return type(value)(map(plain, value))
    return value.number if type(value) is TracedNumber else value


def origins_of(value: Any) -> int:
    """Returns the origins of a number, or of all numbers in tuples, lists and model elements."""
    if type(value) is TracedNumber:
        return value.origins
    names = getattr(value, "__match_args__", ())
    origins = 0
    for item in value if isinstance(value, tuple | list) else (getattr(value, n) for n in names):
        origins |= origins_of(item)
    return origins


def traced(value: Any, origins: int) -> Any:
    """Returns a number, the numbers of a tuple, or the text of an output with more origins."""
    if origins and type(value) is str and TracedNumber.writes_marks:
        return f"{MARK}{_marks.setdefault(origins, len(_marks))}{MARK}{value}"
    if type(value) in (tuple, list):
        return type(value)([traced(item, origins) for item in value])
    is_number = origins and type(value) in (int, float, TracedNumber)
    return TracedNumber(plain(value), origins | origins_of(value)) if is_number else value


def _lifted(function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function whose result has the origins of its arguments."""

    def lifted(*arguments: Any, **named: Any) -> Any:
        origins, numbers = 0, []
        for argument in arguments:  # mostly numbers: a footprint takes a million of these calls
            kind = type(argument)
            if kind is TracedNumber:
                origins |= argument.origins
                numbers.append(argument.number)
            elif kind is float or kind is int:
                numbers.append(argument)
            else:
                break
        else:
            number = function(*numbers, **named)
            if origins and type(number) is float:
                return TracedNumber(number, origins)
            return traced(number, origins)
        arguments = tuple(list(a) if isinstance(a, Iterator) else a for a in arguments)
        return traced(function(*map(plain, arguments), **named), origins_of(arguments))

    return lifted


def _binary(function: Callable[[Any, Any], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Returns the methods of an operator with a traced number on the left, and on the right."""
    lifted = _lifted(function)

    def on_the_left(first: Any, second: Any) -> Any:
        kind = type(second)
        if kind is TracedNumber:
            number, origins = function(first.number, second.number), first.origins | second.origins
        elif kind is float:
            number, origins = function(first.number, second), first.origins
        else:
            return lifted(first, second)
        return TracedNumber(number, origins)

    def on_the_right(second: Any, first: Any) -> Any:
        if type(first) is float:
            return TracedNumber(function(first, second.number), second.origins)
        return lifted(first, second)

    return on_the_left, on_the_right


def _without_origins(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *values: function(*map(plain, values))


def _comparison(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    def compare(first: Any, second: Any) -> Any:
        return function(first.number, second.number if type(second) is TracedNumber else second)

    return compare


def _set_methods() -> None:
    for name in _BINARY + _SHIFTS:
        on_the_left, on_the_right = _binary(getattr(operator, f"__{name}__"))
        setattr(TracedNumber, f"__{name}__", on_the_left)
        setattr(TracedNumber, f"__r{name}__", on_the_right)
    for function in _UNARY + _ROUNDED:
        setattr(TracedNumber, f"__{function.__name__.strip('_')}__", _lifted(function))
    compare = (operator.eq, operator.ne, operator.lt, operator.le, operator.gt, operator.ge)
    for function in compare:
        setattr(TracedNumber, f"__{function.__name__}__", _comparison(function))
    for function in (bool, int, float, operator.index):
        setattr(TracedNumber, f"__{function.__name__}__", _without_origins(function))


_set_methods()


@contextmanager
def traced_functions() -> Iterator[None]:
    """Within this context, the functions of ``math`` and of expressions pass origins on."""
    kept, expressions = {n: f for n, f in vars(math).items() if callable(f)}, dict(FUNCTIONS)
    lifted = {name: _lifted(function) for name, function in kept.items() if name[0] != "_"}
    try:
        vars(math).update(lifted)
        FUNCTIONS.update({n: (lifted.get(n, f), count) for n, (f, count) in expressions.items()})
        yield
    finally:
        vars(math).update(kept)
        FUNCTIONS.update(expressions)
