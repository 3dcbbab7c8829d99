"""The model as JSON and back, driven by the dataclasses' own type hints."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import types
import typing
from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

from thorvaldc.diagnostics import Span
from thorvaldc.model import robot as _robot
from thorvaldc.model.element import values_getter
from thorvaldc.model.fleet import Fleet
from thorvaldc.model.robot import Robot

FORMAT = "thorvaldc-model"
VERSION = 2

# Left out of the JSON form: mesh bytes lie beside it as files.
_SKIPPED = {("Mesh", "data")}

T = TypeVar("T")


class ModelFormatError(ValueError):
    """The text is not a model of this version; the message says why."""


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


@functools.cache
def _fields(cls: type) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cls) if (cls.__name__, f.name) not in _SKIPPED)


_SHAPES = frozenset(typing.get_args(_robot.Shape))


def _is_plain(hint: Any) -> bool:
    """Whether values of this type are JSON as they stand (JSON writes a tuple as a list)."""
    if hint is Ellipsis or hint in (bool, int, float, str, type(None)):
        return True
    arguments = typing.get_args(hint)
    return bool(arguments) and all(_is_plain(argument) for argument in arguments)


@functools.cache
def _plan(cls: Hashable) -> tuple[tuple[str, ...], Callable[[Any], tuple[Any, ...]], list[str]]:
    """The fields of a class, what gets their values, and which are not plain."""
    hints, names = _hints(cast(Any, cls)), _fields(cast(Any, cls))
    return names, values_getter(names), [name for name in names if not _is_plain(hints[name])]


def _encode(value: Any) -> Any:
    cls: type[Any] = type(value)
    if cls is Span:
        return (value.file, value.line, value.column, value.end_line, value.end_column)
    if cls is tuple:
        return [_encode(v) for v in value]
    if value is None:
        return None
    names, values, nested = _plan(cast(Hashable, cls))
    out = dict(zip(names, values(value), strict=True))
    for name in nested:
        out[name] = _encode(out[name])
    if cls in _SHAPES:
        out["kind"] = cls.__name__
    return out


def _decode(hint: Any, value: Any) -> Any:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        members: tuple[Any, ...] = typing.get_args(hint)
        if value is None:
            if type(None) in members:
                return None
            raise ModelFormatError(f"expected {hint}, found null")
        shapes = {m.__name__: m for m in members if m in _SHAPES}
        if len(shapes) > 1:
            kind = value["kind"]
            return _decode(shapes[kind], {k: v for k, v in value.items() if k != "kind"})
        rest = [m for m in members if m is not type(None)]
        if len(rest) == 1:
            return _decode(rest[0], value)
        return _plain(tuple(rest), value)
    if hint is Span:
        return Span(*value)
    if dataclasses.is_dataclass(hint):
        hints = _hints(typing.cast(type, hint))
        cls = typing.cast(type, hint)
        return cls(**{name: _decode(hints[name], value[name]) for name in _fields(cls)})
    if origin is tuple:
        _plain((list,), value)
        args = typing.get_args(hint)
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_decode(args[0], v) for v in value)
        if len(args) != len(value):
            raise ModelFormatError(f"expected {len(args)} values, found {len(value)}")
        return tuple(_decode(a, v) for a, v in zip(args, value, strict=True))
    if hint is float:
        return float(_plain((int, float), value))
    return _plain((hint,), value)


def _plain(types_: tuple[type, ...], value: Any) -> Any:
    if type(value) not in types_ or (type(value) is float and not math.isfinite(value)):
        wanted = " or ".join(t.__name__ for t in types_)
        raise ModelFormatError(f"expected {wanted}, found {str(value)[:40]}")
    return value


def to_json(model: Robot | Fleet) -> str:
    """The model as JSON text, without mesh bytes; ``from_json`` reads it back equal."""
    kind = type(model).__name__
    head = {"format": FORMAT, "version": VERSION, "kind": kind, "model": _encode(model)}
    return json.dumps(head, ensure_ascii=False, separators=(",", ":"), allow_nan=False) + "\n"


def from_json(text: str) -> Robot | Fleet:
    """Rebuild a model from ``to_json``'s text.

    Raises ``ModelFormatError`` where the text is not such a model.
    """
    try:
        head = json.loads(text)
        if head["format"] != FORMAT:
            raise ModelFormatError(f"not a {FORMAT} file")
        if head["version"] != VERSION:
            raise ModelFormatError(f"version {head['version']}; this program reads {VERSION}")
        cls = {"Robot": Robot, "Fleet": Fleet}[head["kind"]]
        decoded: Robot | Fleet = _decode(cls, head["model"])
        return decoded
    except ModelFormatError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, RecursionError) as fault:
        raise ModelFormatError(f"not a {FORMAT} file: {fault!r}") from fault
