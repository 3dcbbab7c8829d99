"""A cache of results that are computed from a model, for functions that several targets call."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

Model = TypeVar("Model")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
SIZE = 16
"""Number of results that each function keeps. A result keeps its model alive."""


def once_per_model(
    function: Callable[Concatenate[Model, Arguments], Result],
) -> Callable[Concatenate[Model, Arguments], Result]:
    """Return the function with a cache of its last 16 results.

    The first argument is a frozen model, which the cache recognises by its identity: the hash of a
    model with nine wheels takes 1 ms. The other arguments must be hashable. Callers must not change
    the result.
    """
    results: dict[object, tuple[Model, Result]] = {}

    @functools.wraps(function)
    def cached(model: Model, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        key = (id(model), args, tuple(kwargs.items()))
        entry = results.get(key)
        if entry is None:  # the entry keeps its model alive, so that no other model has its id
            entry = (model, function(model, *args, **kwargs))
            while len(results) >= SIZE:
                results.pop(next(iter(results)), None)
            results[key] = entry
        return entry[1]

    return cached
