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
        number = id(model)
        if number not in _results:
            reference = weakref.ref(model, lambda _: _results.pop(number, None))
            _results[number] = (reference, {})
        results = _results[number][1]
        key = (function, args, tuple(kwargs.items()))
        if key not in results:
            results[key] = function(model, *args, **kwargs)
        result: Result = results[key]
        return result

    return cached
