"""The base class of the model's dataclasses (equality, hash and text), and a cache of results."""

from __future__ import annotations

import dataclasses
import functools
import operator
import weakref
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar, cast


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


# -- results that are computed from a model, for functions that several targets call --------

Model = TypeVar("Model")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_results: dict[int, tuple[weakref.ref[Any], dict[Any, Any]]] = {}
"""The results of each living model, by the ``id`` of the model."""


def once_per_model(
    function: Callable[Concatenate[Model, Arguments], Result],
) -> Callable[Concatenate[Model, Arguments], Result]:
    """Return the function with a cache that keeps its results as long as the model exists.

    The first argument is a ``Robot`` or a ``Fleet``. The cache recognises it by its identity,
    because the hash of a robot with nine wheels takes 1 ms. The other arguments must be hashable.
    The result must not refer to the model, and callers must not change the result.
    """

    @functools.wraps(function)
    def cached(model: Model, /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        results = _results_of(model)
        key = (function, args, tuple(kwargs.items()))
        if key not in results:
            results[key] = function(model, *args, **kwargs)
        result: Result = results[key]
        return result

    return cached


def _results_of(model: Any) -> dict[Any, Any]:
    number = id(model)
    entry = _results.get(number)
    if entry is None:
        entry = (weakref.ref(model, lambda _: _results.pop(number, None)), {})
        _results[number] = entry
    return entry[1]
