"""A cache of results that are computed from a model, for functions that several targets call."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

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


def with_results_of(copy: Model, model: Any, *functions: Callable[[Any], Any]) -> Model:
    """Return a changed copy of a model, whose results of these functions are those of the model.

    What was changed must have no influence on them.
    """
    results = {(each.__wrapped__, (), ()): each(model) for each in functions}  # type: ignore[attr-defined]
    _results_of(copy).update(results)
    return copy


def _results_of(model: Any) -> dict[Any, Any]:
    number = id(model)
    entry = _results.get(number)
    if entry is None:
        entry = (weakref.ref(model, lambda _: _results.pop(number, None)), {})
        _results[number] = entry
    return entry[1]
