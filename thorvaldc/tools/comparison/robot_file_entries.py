"""The entries that differ between two robot files: what a unit of the first one would state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from thorvaldc.comparison.robot_difference import (
    ABSENT,
    Difference,
    LeafDifference,
    RobotDifference,
    ValuePath,
)
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.overrides import SHORT_FORMS
from thorvaldc.compiler.values.unit_file import is_same_value
from thorvaldc.model import Robot, robots_by_name

_OF_THE_FILE = ("thorvaldc", "extends")
"""Keys that each file has for itself."""


def with_entries(difference: Difference, before: Compilation, after: Compilation) -> Difference:
    """Returns a comparison with the entries that differ between the robot files."""
    if difference.is_equal:
        return difference  # such as other words, or a warning that is accepted
    pairs = [_documents(compilation) for compilation in (before, after)]
    if isinstance(difference, RobotDifference):
        (old,), (new,) = (pair.values() for pair in pairs)
        return replace(difference, entries=_entries(old, new))
    robots = [
        (name, replace(robot, entries=_entries(pairs[0].get(name), pairs[1].get(name))))
        for name, robot in difference.robots
    ]
    return replace(difference, robots=tuple(robots))


def _documents(compilation: Compilation) -> dict[str, Node | None]:
    """Returns the robot files, with the entries of their designs, by the names of the robots.

    A build has none.
    """
    model = compilation.model
    robots = {"": model} if isinstance(model, Robot) else robots_by_name(model) if model else {}
    roots = {name: compilation.instances.get(r.span.file) for name, r in robots.items()}
    return {name: root.entry if root is not None else None for name, root in roots.items()}


def _entries(before: Node | None, after: Node | None) -> tuple[LeafDifference, ...]:
    if before is None or after is None:
        return ()
    return tuple(_differences(before, after, ()))


def _differences(before: Node, after: Node, path: ValuePath) -> Iterator[LeafDifference]:
    """Yields the values of ``after`` that make the documents equal, where ``before`` gets them."""
    key = SHORT_FORMS.get(path[-1] if path else "")
    if key and isinstance(before.value, dict) != isinstance(after.value, dict):
        before, after = (
            side if isinstance(side.value, dict) else side._replace(value={key: side})
            for side in (before, after)
        )
    if not isinstance(before.value, dict) or not isinstance(after.value, dict):
        if not is_same_value(before, after):
            yield LeafDifference(path, before.plain(), after.plain())
        return
    for key in dict.fromkeys([*before.value, *after.value]):
        old, new, inner = before.value.get(key), after.value.get(key), (*path, key)
        if "." in key and path:  # no part of a path: the mapping with this key is the value
            if old is None or new is None or list(_differences(old, new, ())):
                sides = (ABSENT if s is None else {key: s.plain()} for s in (old, new))
                yield LeafDifference(path, *sides)
            continue
        if inner[0] in _OF_THE_FILE:
            continue
        if old is not None and new is not None:
            yield from _differences(old, new, inner)
        else:
            yield LeafDifference(inner, *(ABSENT if s is None else s.plain() for s in (old, new)))
