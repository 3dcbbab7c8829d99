"""Names of values of the model, such as ``wheels.fl.radius``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

from thorvaldc.diagnostics import DiagnosticError, Span, did_you_mean

_SHORT = {"limits": "driver", "motors": "actuators", "drives": "actuators"}
MOST_SHOWN = 6


class Value(NamedTuple):
    """A value of a robot, with its unit, and the span and the module of the element that has it."""

    value: Any
    span: Span | None = None
    module: str = ""
    unit: str = ""


NOBODY = Value(None)


def values_of(item: Any, name: str = "", owner: Value = NOBODY) -> Iterator[tuple[str, Value]]:
    """Yields the values of a part of the model by their names; a vector also as a whole."""
    if is_dataclass(item):
        span, module = getattr(item, "span", owner.span), getattr(item, "module", owner.module)
        owner = Value(None, span, module)
        left_out = ("span", "data", "described")
        names = [field.name for field in fields(item) if field.name not in left_out]
        parts = [(key, getattr(item, key)) for key in names]
    elif isinstance(item, dict):
        parts = list(item.items())
    elif isinstance(item, tuple | list):
        parts = _items(item)
    else:
        parts = []
    if not is_dataclass(item) and not isinstance(item, dict) and not any(map(_is_group, parts)):
        yield name, owner._replace(value=item)
    for key, part in parts:
        yield from values_of(part, f"{name}.{key}" if name else key, owner)


def _is_group(part: tuple[str, Any]) -> bool:
    return is_dataclass(part[1]) or isinstance(part[1], dict | tuple | list)


def _items(items: Any) -> list[tuple[str, Any]]:
    """Returns the elements of a list with their names, or else with their numbers."""
    if len(items) == 3 and not is_dataclass(items[0]) and not isinstance(items[0], tuple | list):
        return list(zip("xyz", items, strict=True))
    if all(isinstance(i, tuple) and len(i) == 2 and isinstance(i[0], str) for i in items):
        return list(items)
    names = [getattr(i, "name", getattr(i, "joint", str(n))) for n, i in enumerate(items)]
    is_unique = len(set(names)) == len(names)
    return [(name if is_unique else str(n), items[n]) for n, name in enumerate(names)]


def find_value(values: Mapping[str, Value], text: str) -> str:
    """Returns the name of the one value that a text names, with the fewest parts left out.

    A part may be shortened: ``fl`` for ``fl_wheel``.  Raises ``DiagnosticError``
    (``why-path-unknown``) if there is no such value or more than one.
    """
    parts = [part for part in text.replace("[", ".").replace("]", "").split(".") if part]
    costs = {name: cost for name in values if (cost := _cost(name.split("."), parts)) is not None}
    best = [name for name in costs if costs[name] == min(costs.values())]
    if len(best) == 1:
        return best[0]
    words = dict.fromkeys(word for name in values for word in name.split("."))
    missing = [part for part in parts if not any(_is_short(part, word) for word in words)]
    if missing:
        hint = did_you_mean(missing[0], words, fixable=False)
        raise unknown(f"the robot has no value `{missing[0]}`", hint)
    near = best or [
        n for n in values if parts and _cost(f"{n}.".split("."), [*parts, ""]) is not None
    ]
    hint = f"known: {', '.join(near[:MOST_SHOWN])}" + ", ..." * (len(near) > MOST_SHOWN)
    raise unknown(f"`{text}` is not a single value", hint if near else None)


def _is_short(part: str, key: str) -> bool:
    return key in (part, f"max_{part}", _SHORT.get(part)) or key.startswith(f"{part}_")


def _cost(keys: list[str], parts: list[str]) -> int | None:
    """Returns how many keys the parts leave out or shorten, or ``None`` without a match."""
    cost, rest = 0, list(parts)
    if not rest or not _is_short(rest[-1], keys[-1]):
        return None
    for key in reversed(keys):
        cost += key != rest.pop() if rest and _is_short(rest[-1], key) else 2
    return None if rest else cost


def unknown(message: str, hint: str | None = None) -> DiagnosticError:
    return DiagnosticError("why-path-unknown", message, hint=hint)


def next_names(names: Iterable[str], start: str) -> list[str]:
    """Returns what can follow ``start`` in names, up to the next point that is a choice."""
    fitting = [name for name in names if name.startswith(start)]
    ends = {name[: name.find(".", len(start)) + 1 or None] for name in fitting}
    if len(ends) == 1 and (only := ends.pop()) != start:
        return next_names(fitting, only) if only.endswith(".") else [only]
    return sorted(ends) or fitting
