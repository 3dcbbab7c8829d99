"""The base class of the model's classes, which are frozen dataclasses, and a cache of results."""

from __future__ import annotations

import dataclasses
import functools
import operator
import weakref
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar, cast, dataclass_transform


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


class _FieldsAtFirstUse:
    """The attribute ``__dataclass_fields__``, which the functions of ``dataclasses`` read."""

    def __get__(self, instance: object, owner: Any) -> Any:
        if not owner._names:
            return {}  # `Element` itself
        kept = {name: vars(owner)[name] for name in ("__annotations__", "__doc__", "__module__")}
        described: Any = type(owner.__name__, (), kept | owner._defaults)
        dataclasses.dataclass(init=False, repr=False, eq=False)(described)
        owner.__dataclass_fields__ = described.__dataclass_fields__
        return owner.__dataclass_fields__


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(dataclasses.field,))
class ElementType(type):
    """The metaclass of ``Element``: annotated names become slots and parameters of the class."""

    _names: tuple[str, ...]
    _defaults: dict[str, Any]

    def __new__(mcs, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> ElementType:
        """Create a class.

        Raises ``TypeError`` for what ``__init__`` of an element does not have: fields of another
        element as a base class, and defaults from a function.
        """
        names = tuple(namespace.get("__annotations__", ()))
        defaults = {key: namespace.pop(key) for key in names if key in namespace}
        if any(getattr(base, "_names", ()) for base in bases):
            raise TypeError(f"{name}: an element has no other element as its base class")
        for key, value in defaults.items():
            factory = getattr(value, "default_factory", dataclasses.MISSING)
            if isinstance(value, dataclasses.Field) and factory is not dataclasses.MISSING:
                raise TypeError(f"{name}.{key}: an element has no `default_factory`")
        namespace |= {"__match_args__": names, "__slots__": namespace.get("__slots__", names)}
        cls = super().__new__(mcs, name, bases, namespace)
        cls._names = names
        cls._defaults = defaults
        return cls


class Element(metaclass=ElementType):
    """Base class of the model's classes: frozen dataclasses with slots.

    Two elements of the model are equal if they have the same class and all compared fields are
    equal.

    The decorator ``dataclass`` would compile six methods for each of the 60 classes of the model
    at import, which takes a tenth of the processor time of a short ``check``.  Five of the methods
    are the same for all classes; ``__init__`` is compiled when the first object is made.
    """

    __slots__ = ("__weakref__",)
    __dataclass_fields__ = _FieldsAtFirstUse()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        cls = type(self)
        cls.__init__ = _init_method(cls)  # type: ignore[method-assign]
        cls.__init__(self, *args, **kwargs)

    def __setattr__(self, name: str, value: object) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, name) for name in type(self)._names)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        cls: Any = type(self)
        values = _values(cls)
        return values(self) == values(other)

    def __hash__(self) -> int:
        cls: Any = type(self)
        return hash(_values(cls)(self))

    def __repr__(self) -> str:
        shown = ", ".join(
            f"{name}={getattr(self, name)!r}" for name in _compared(cast(Hashable, type(self)))
        )
        return f"{type(self).__name__}({shown})"


def _init_method(cls: ElementType) -> Any:
    """Compile the method ``__init__`` of a class, which sets each slot from a parameter."""
    names = cls._names
    setters = {f"set_{name}": cls.__dict__[name].__set__ for name in names}
    defaults = {
        name: value.default if isinstance(value, dataclasses.Field) else value
        for name, value in cls._defaults.items()
    }
    parameters = [f"{name}=defaults[{name!r}]" if name in defaults else name for name in names]
    lines = [f"    set_{name}(self, {name})" for name in names]
    source = "\n".join([f"def __init__({', '.join(['self', *parameters])}):", *lines])
    scope: dict[str, Any] = {**setters, "defaults": defaults}
    exec(source, scope)
    return scope["__init__"]


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
