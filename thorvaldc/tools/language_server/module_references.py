"""All references to a module of a robot, for the search of references and for renaming.

A robot document refers to a module by its name.  Scenarios, calibration files and files with bus
faults refer to the wheels and devices of a module: their names begin with the name of the module,
such as ``fl_wheel``.  A lock file contains the paths of modules.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.bus.lock_file import ADDRESSES, lock_path
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Span
from thorvaldc.tools.language_server.cursor import Path as KeyPath
from thorvaldc.tools.language_server.document_tree import place_at
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.language_server.open_document import OpenDocument
from thorvaldc.tools.language_server.places import reference_at, references_of

NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True)
class Use:
    """A use of the name of a module; ``span`` covers the name of the module alone."""

    document: OpenDocument
    span: Span
    is_definition: bool = False


def module_at(view: ModuleView, line: int, column: int) -> tuple[str, Span] | None:
    """Returns the name of the module at a line and column, and the span of the name."""
    place = place_at(view.tree, line, column)
    if place is None:
        return None
    if place.part == "key":
        is_module = len(place.path) == 2 and place.path[0] == "modules"
        return (str(place.path[1]), place.span) if is_module else None
    reference = reference_at(view, place, column)
    if reference is None or reference.kind != "module" or "." in reference.whole:
        return None
    return reference.name, reference.span


def uses_of(
    view: ModuleView, document: OpenDocument, name: str, others: Iterable[OpenDocument]
) -> list[Use]:
    """Returns all uses of a module in its robot document, and in the other documents.

    - ``others``: documents of the workspace.
    """
    uses = list(_in_robot(view, document, name))
    if view.kind != "robot":
        return uses
    modules = list(entries(view.tree.get("modules")))
    robot_name = view.tree.get("name")
    lock = os.path.realpath(lock_path(document.path))
    for other in others:
        if other.real_path == document.real_path:
            continue
        if other.kind is None and other.real_path != lock:
            continue
        tree = other.tree
        if tree is None:
            continue
        if other.real_path == lock:
            uses += (Use(other, span) for span in _in_lock(tree, name))
        elif other.kind == "calibration":
            node = tree.get("robot")
            if node is not None and robot_name is not None and node.value == robot_name.value:
                wheels = entries(tree.get("wheels")).values()
                uses += _derived(other, (wheel.key_span for wheel in wheels), name, modules)
        elif other.kind == "scenario" and _names_robot(tree, other.path, document.real_path):
            spans = (node.span for path, node in _scalars(tree) if path[-1:] == ("wheel",))
            uses += _derived(other, spans, name, modules)
    return uses


def _in_robot(view: ModuleView, document: OpenDocument, name: str) -> Iterator[Use]:
    definition = entries(view.tree.get("modules")).get(name)
    if definition is not None and definition.key_span is not None:
        span = definition.key_span
        yield Use(document, _inner(document, span, name), is_definition=True)
    modules = list(entries(view.tree.get("modules")))
    for path, node in _scalars(view.tree):
        for reference in references_of(view, path, node):
            if reference.kind == "module" and reference.whole == name:
                yield Use(document, reference.span)
        if len(path) == 3 and path[0] == "extras" and path[2] == "parent":
            value = str(node.value)
            if value != name and "." not in value:
                yield from _derived(document, [node.span], name, modules)


def _derived(
    document: OpenDocument, spans: Iterable[Span | None], name: str, modules: list[str]
) -> Iterator[Use]:
    """Yields the uses of a module in names such as ``fl_wheel``.

    A name belongs to the module with the longest name that is the start of it.
    """
    for span in spans:
        if span is None:
            continue
        text = document.source.span_text(span).strip("'\"")
        owners = [m for m in modules if text == m or text.startswith(f"{m}_")]
        if owners and max(owners, key=len) == name:
            yield Use(document, _inner(document, span, name))


def _inner(document: OpenDocument, span: Span, name: str) -> Span:
    """Returns the span of the name at the start of a span, which may have quotes."""
    quotes = 1 if document.source.span_text(span)[:1] in ("'", '"') else 0
    column = span.column + quotes
    return Span(span.file, span.line, column, span.line, column + len(name))


def _in_lock(tree: Node, name: str) -> Iterator[Span]:
    for path, node in _scalars(tree):
        key = node.key_span
        if path[:1] == (ADDRESSES,) and key is not None:
            module = str(path[-1])
            if module == name or module.startswith(f"{name}."):
                yield Span(key.file, key.line, key.column, key.line, key.column + len(name))


def _names_robot(tree: Node, path: Path, robot: str) -> bool:
    """Returns whether a scenario names a robot, directly or by a fleet."""
    named = [entry.get("robot") for entry in entries(tree.get("robots")).values()]
    fleet = tree.get("fleet")
    for node in (*named, fleet):
        if node is None or not isinstance(node.value, str) or "\0" in node.value:
            continue
        file = os.path.realpath(path.parent / node.value)
        if file == robot:
            return True
        if node is fleet and _fleet_names_robot(Path(file), robot):
            return True
    return False


def _fleet_names_robot(fleet: Path, robot: str) -> bool:
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report

    tree = read_file(fleet, str(fleet), Report())
    robots = entries(tree.get("robots")).values() if tree is not None else ()
    files = (entry.get("robot") for entry in robots)
    return any(os.path.realpath(fleet.parent / str(file.value)) == robot for file in files if file)


def _scalars(node: Node, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Node]]:
    if isinstance(node.value, dict):
        for key, child in node.value.items():
            yield from _scalars(child, (*path, key))
    elif isinstance(node.value, tuple):
        for index, child in enumerate(node.value):
            yield from _scalars(child, (*path, index))
    else:
        yield path, node
