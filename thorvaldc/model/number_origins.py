"""Tells ``why`` where numbers come from.  Unless ``why`` asks, a number is returned as it is.

Python's operators and the functions of ``math`` pass origins on.  A number that follows from others
in another way, such as the result of a search, declares its inputs with ``derived``.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

from thorvaldc.diagnostics import Span

Number = TypeVar("Number")


class Follower(Protocol):
    """Marks numbers with their origins."""

    def read(self, value: Number, span: Span) -> Number: ...

    def derive(self, value: Number, inputs: tuple[object, ...]) -> Number: ...


follower: Follower | None = None
"""Set while ``why`` compiles a robot."""


def read_at(value: Number, span: Span) -> Number:
    """Returns a number, which was read from a document at ``span``."""
    return value if follower is None else follower.read(value, span)


def derived(value: Number, *inputs: object) -> Number:
    """Returns a number or text that was computed from ``inputs``.

    Inputs are numbers, and elements of the model and tuples with numbers.
    """
    return value if follower is None else follower.derive(value, inputs)


def least(*values: float) -> float:
    """Returns the least of some numbers, which follows from all of them."""
    return derived(min(values), values)
