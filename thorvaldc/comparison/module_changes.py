"""Finds the modules that were added, removed, renamed, moved, exchanged or given other values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.comparison.leaf_differences import ABSENT
from thorvaldc.comparison.module_outline import ModuleOutline, Outline
from thorvaldc.comparison.robot_difference import (
    ADDED,
    CHANGED,
    REMOVED,
    ModuleChange,
    ValueChange,
)

RENAMED, MOVED, EXCHANGED = "renamed", "moved", "exchanged"


def find_renames(before: Outline, after: Outline) -> dict[str, str]:
    """Returns the new names of renamed modules of the robot file, by their old names.

    A removed module and an added module are one renamed module if both have the same type and the
    same place, and no other module has.
    """
    removed = [module for name, module in before.items() if "." not in name and name not in after]
    added = [module for name, module in after.items() if "." not in name and name not in before]
    renames: dict[str, str] = {}
    while True:
        # A module that is mounted on a renamed module is recognised after its carrier.
        pairs = [(a, b) for a in removed for b in added if _same_place_and_type(a, b, renames)]
        unique = [
            (a, b)
            for a, b in pairs
            if a.path not in renames
            and [x for x, _ in pairs].count(a) == 1
            and [y for _, y in pairs].count(b) == 1
        ]
        if not unique:
            return renames
        renames.update({a.path: b.path for a, b in unique})


def renamed_document(document: Any, renames: Mapping[str, str], modules: Outline) -> Any:
    """Returns a document of a model in which modules have their new names.

    The names of links, joints, nodes and frames start with the name of their module.
    """
    if not renames:
        return document
    names = sorted({name for name in modules if "." not in name}, key=len, reverse=True)

    def rename(text: str) -> str:
        for name in names:
            if text == name or text.startswith((f"{name}_", f"{name}.")):
                return renames.get(name, name) + text[len(name) :]
        return text

    def visit(value: Any) -> Any:
        if isinstance(value, dict):
            return {rename(key): visit(item) for key, item in value.items()}
        if isinstance(value, list):
            return [visit(item) for item in value]
        return rename(value) if isinstance(value, str) else value

    return visit(document)


def module_changes(
    before: Outline, after: Outline, renames: Mapping[str, str]
) -> Iterator[ModuleChange]:
    """Yields the changes of modules, those of the robot before the change first.

    A change inside of an assembly is not listed if the assembly itself has another type or other
    parameters, which cause it.
    """
    covered: set[str] = set()
    for old_path, old in before.items():
        path = _renamed(old_path, renames)
        new = after.get(path)
        if _is_covered(path, covered):
            continue
        if new is None:
            covered.add(path)
            yield ModuleChange((REMOVED,), path, old_path, old.type, "", old.place, "")
            continue
        change = _change(old, new, renames)
        if change is not None:
            if EXCHANGED in change.kinds or change.parameters:
                covered.add(path)
            yield change
    known = {_renamed(path, renames) for path in before}
    for path, new in after.items():
        if path not in known and not _is_covered(path, covered):
            covered.add(path)
            yield ModuleChange((ADDED,), path, "", "", new.type, "", new.place)


def _change(
    old: ModuleOutline, new: ModuleOutline, renames: Mapping[str, str]
) -> ModuleChange | None:
    """Returns the change of a module that both robots have, or ``None`` if there is none."""
    kinds = []
    if old.path != new.path and "." not in old.path:
        kinds.append(RENAMED)
    if old.type and new.type and old.type != new.type:
        kinds.append(EXCHANGED)
    if not _same_place(old, new, renames):
        kinds.append(MOVED)
    parameters: list[ValueChange] = []
    if old.type and old.type == new.type:
        for name in dict.fromkeys([*old.parameters, *new.parameters]):
            a, b = old.parameters.get(name), new.parameters.get(name)
            if a != b:
                unit = next(p.unit for p in (b, a) if p is not None)
                x, y = (ABSENT if p is None else p.value for p in (a, b))
                parameters.append(ValueChange("modules", (new.path,), name, x, y, unit))
    if parameters or (not old.type and old.shape != new.shape):
        kinds.append(CHANGED)
    if not kinds:
        return None
    return ModuleChange(
        tuple(kinds),
        new.path,
        old.path,
        old.type,
        new.type,
        old.place,
        new.place,
        tuple(parameters),
    )


def _same_place_and_type(a: ModuleOutline, b: ModuleOutline, renames: Mapping[str, str]) -> bool:
    same_type = a.type == b.type if a.type and b.type else a.shape == b.shape
    return same_type and _same_place(a, b, renames)


def _same_place(a: ModuleOutline, b: ModuleOutline, renames: Mapping[str, str]) -> bool:
    return _renamed(a.carrier, renames) == b.carrier and all(
        abs(x - y) < 1e-9 for x, y in zip(_pose(a), _pose(b), strict=True)
    )


def _pose(module: ModuleOutline) -> tuple[float, ...]:
    return module.pose or (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def _renamed(path: str, renames: Mapping[str, str]) -> str:
    """Returns the new path of a module, port or link."""
    for separator in (".", "_"):
        first, found_separator, rest = path.partition(separator)
        if first in renames:
            return renames[first] + found_separator + rest
    return path


def _is_covered(path: str, covered: set[str]) -> bool:
    parts = path.split(".")
    return any(".".join(parts[:n]) in covered for n in range(1, len(parts)))
