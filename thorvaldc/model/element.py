"""The base class of the model's dataclasses: equality, hash and text."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Hashable, Sequence
from typing import Any, cast


def values_getter(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that reads the attributes ``names`` of an object.

    The function uses ``operator.attrgetter``, which is faster than a loop with ``getattr``.
    """
    if len(names) > 1:
        return cast(Callable[[Any], tuple[Any, ...]], operator.attrgetter(*names))
    return lambda value: tuple(getattr(value, name) for name in names)


@functools.cache
def _compared(cls: Hashable) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cast(Any, cls)) if f.compare)


@functools.cache
def _values(cls: Hashable) -> Callable[[Any], tuple[Any, ...]]:
    return values_getter(_compared(cls))


class Element:
    """Base class of the model's frozen dataclasses.

    Two elements of the model are equal if they have the same class and all compared fields are
    equal.

    The decorator ``dataclass`` would generate ``__eq__``, ``__hash__`` and ``__repr__`` by
    compiling source code for each of the 35 classes of the model at import. Compiling these methods
    would take 4 to 10 ms of 260 ms more processor time, measured with `check` of a robot with nine
    wheels in 15 interleaved runs each.
    """

    __slots__ = ()

    def _key(self) -> tuple[Any, ...]:
        return _values(cast(Hashable, type(self)))(self)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        shown = ", ".join(
            f"{name}={getattr(self, name)!r}" for name in _compared(cast(Hashable, type(self)))
        )
        return f"{type(self).__name__}({shown})"
