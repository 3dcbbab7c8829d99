"""All references to a module of a robot, for the search of references and for renaming.

A robot document refers to a module by its name, and so do the units that extend it.  Scenarios,
calibration files and files with bus faults refer to the wheels and devices of a module: their names
begin with the name of the module, such as ``fl_wheel``.  A lock file contains the paths of modules.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from thorvaldc.compiler.modules.library import FILE, ModuleType
from thorvaldc.compiler.source.lock_file import ADDRESSES, lock_path
from thorvaldc.compiler.source.node import KeyPath, Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Span
from thorvaldc.tools.language_server import open_document
from thorvaldc.tools.language_server.module_view import ModuleView

# -- references in a document -----------------------------------------------------------

_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
_NAME = re.compile(r"[A-Za-z_]\w*")
_Dotted = Literal["module", "port", "motor", "joint"]


@dataclass(frozen=True)
class Reference:
    """A name in a document that refers to something.

    - ``kind``: ``module`` of the document; ``port``, ``motor`` or ``joint`` of such a module;
      ``type`` of a module; ``file``; ``name`` of a parameter or `let` value in an expression.
    - ``name``: the name, such as ``front_left``, or the path of a file.
    - ``whole``: the dotted reference up to the name, such as ``frame.front_left``.
    - ``span``: span of the name.
    """

    kind: Literal["module", "port", "motor", "joint", "type", "file", "name"]
    name: str
    whole: str
    span: Span


def reference_at(view: ModuleView, place: open_document.Place, column: int) -> Reference | None:
    """Returns the reference at a column of a value, or ``None``."""
    if place.part == "key" or not isinstance(place.node.value, str):
        return None
    references = list(references_of(view, place.path, place.node))
    for reference in references:
        if reference.span.column <= column <= reference.span.end_column:
            return reference
    return references[0] if len(references) == 1 and references[0].kind == "type" else None


def references_of(view: ModuleView, path: tuple[str | int, ...], node: Node) -> Iterator[Reference]:
    """Yields the references in a scalar at a path of the document."""
    text = node.value
    if not isinstance(text, str) or node.span.line != node.span.end_line:
        return
    if "${" in text:
        yield from _names(node, text)
    elif path[-1:] == ("type",) and view.load(text) is not None:
        yield Reference("type", text, text, node.span)
    elif kind := _dotted_kind(path):
        yield from _dotted(view, node, text, kind)
    elif view.load(text) is not None and path[:1] != ("library",):
        yield Reference("type", text, text, node.span)
    elif _is_file(view, path, text):
        yield Reference("file", text, text, node.span)


def _dotted_kind(path: tuple[str | int, ...]) -> _Dotted | None:
    """Returns what the last name of a dotted reference at a path names."""
    inside = path[2:] if path[:1] == ("modules",) and len(path) > 2 else ()
    if inside in (("mount",), ("mount", "port")):
        return "port"
    if inside == ("mount", "parent"):
        return "module"
    if len(inside) == 2 and inside[0] == "channels":
        return "motor"
    if len(path) == 3 and path[0] == "extras" and path[2] == "parent":
        return "port"
    if len(path) == 3 and path[0] == "couplings" and path[2] in ("joint", "follows"):
        return "joint"
    if len(path) == 2 and path[0] in ("ports", "motors"):
        return "port" if path[0] == "ports" else "motor"
    return "module" if path == ("can",) else None


def _dotted(view: ModuleView, node: Node, text: str, kind: _Dotted) -> Iterator[Reference]:
    if _DOTTED.fullmatch(text) is None:
        return
    names = text.split(".")
    start = 0
    for index, name in enumerate(names):
        is_last = index == len(names) - 1
        own = kind if is_last and index > 0 else "module"
        yield Reference(own, name, ".".join(names[: index + 1]), _part(node, start, name))
        start += len(name) + 1


def _names(node: Node, text: str) -> Iterator[Reference]:
    """Yields the names in an expression; the second name of ``wheel.radius`` is a part."""
    for match in _DOTTED.finditer(text):
        whole = ""
        for name in _NAME.finditer(match[0]):
            whole = f"{whole}.{name[0]}".lstrip(".")
            span = _part(node, match.start() + name.start(), name[0])
            yield Reference("name", name[0], whole, span)


def _part(node: Node, start: int, text: str) -> Span:
    """Returns the span of a part of a scalar, ``start`` characters after its first one."""
    column = node.span.column + start + (1 if node.quoted else 0)
    return Span(node.span.file, node.span.line, column, node.span.line, column + len(text))


def _is_file(view: ModuleView, path: tuple[str | int, ...], text: str) -> bool:
    if path[-1:] in (("description",), ("source",), ("name",)) or len(text) > 300 or "\0" in text:
        return False
    try:
        return (view.path.parent / text).is_file()
    except (OSError, ValueError):
        return False


NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True)
class Use:
    """A use of the name of a module; ``span`` covers the name of the module alone."""

    document: open_document.OpenDocument
    span: Span
    is_definition: bool = False


def module_at(view: ModuleView, line: int, column: int) -> tuple[str, Span] | None:
    """Returns the name of the module at a line and column, and the span of the name."""
    place = view.place_at(line, column)
    if place is None:
        return None
    if place.part == "key":
        keys = ((n, s) for n, s in _keys(view) if s.line == line and column >= s.column)
        return next(((n, s) for n, s in keys if column <= s.end_column), None)
    reference = reference_at(view, place, column)
    if reference is None or reference.kind != "module" or "." in reference.whole:
        return None
    return reference.name, reference.span


def _keys(view: ModuleView) -> Iterator[tuple[str, Span]]:
    """Yields the names of modules that are keys of a document, with their spans.

    The name may be a part of the path of a value: ``modules.fl.can: 3`` in a unit.
    """
    for key, node in entries(view.tree).items():
        first, *others = key.split(".") if view.is_unit else [key]
        if first != "modules":
            continue
        if others:
            yield others[0], _part_of_key(node, key, len(first) + 1, others[0])
        else:
            for name, module in entries(node).items():
                yield name, _part_of_key(module, name, 0, name)


def _part_of_key(node: Node, key: str, start: int, text: str) -> Span:
    where = node.where
    column = where.column + start + (where.end_column - where.column - len(key)) // 2  # a quote
    return Span(where.file, where.line, column, where.line, column + len(text))


Robots = list[tuple[ModuleView, open_document.OpenDocument]]


def robots_of(
    view: ModuleView,
    document: open_document.OpenDocument,
    name: str,
    others: Iterable[open_document.OpenDocument],
) -> tuple[Robots, Path | None]:
    """Returns the robot document that has a module, and the units that inherit it from there.

    Also returns the file of a design that is in no folder of the workspace, or ``None``.
    """
    if view.kind != "robot":
        return [(view, document)], None
    documents = {other.real_path: other for other in others if other.kind == "robot"}
    documents[document.real_path] = document
    designs = {path: _designs(path, documents) for path in documents}

    def view_of(path: str) -> ModuleView:
        robot = documents[path]
        return view if robot is document else ModuleView("robot", robot.path, robot.tree, ())

    known = [path for path in designs[document.real_path] if path in documents]
    owners = (path for path in reversed(known) if name in dict(_keys(view_of(path))))
    owner = next(owners, document.real_path)
    outside = next((Path(p) for p in designs[document.real_path] if p not in documents), None)
    return [(view_of(p), documents[p]) for p in documents if owner in designs[p]], outside


def _designs(path: str, documents: Mapping[str, open_document.OpenDocument]) -> list[str]:
    """Returns the paths of a robot document, its design, the design of that, and so on."""
    paths: list[str] = []
    while path not in paths:
        paths.append(path)
        tree = documents[path].tree if path in documents else None
        link = tree.get("extends") if tree is not None else None
        if link is None or not isinstance(link.value, str) or "\0" in link.value:
            break
        path = os.path.realpath(documents[path].path.parent / link.value)
    return paths


def uses_of(robots: Robots, name: str, others: Iterable[open_document.OpenDocument]) -> list[Use]:
    """Returns all uses of a module in the robot documents of ``robots_of``, and in the others.

    - ``others``: documents of the workspace.
    """
    uses = [use for robot in robots for use in _of_robot(*robot, name, others)]
    return list(dict.fromkeys(uses))  # a scenario may name several of the robots


def _of_robot(
    view: ModuleView,
    document: open_document.OpenDocument,
    name: str,
    others: Iterable[open_document.OpenDocument],
) -> list[Use]:
    uses = list(_in_robot(view, document, name))
    if view.kind != "robot":
        return uses
    modules = _modules(view, name)
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


def _in_robot(view: ModuleView, document: open_document.OpenDocument, name: str) -> Iterator[Use]:
    for key, span in _keys(view):
        if key == name:
            yield Use(document, span, is_definition=True)
    modules = _modules(view, name)
    for written_path, node in _scalars(view.tree):
        path = view.full_path(written_path)
        for reference in references_of(view, path, node):
            if reference.kind == "module" and reference.whole == name:
                yield Use(document, reference.span)
        if len(path) == 3 and path[0] == "extras" and path[2] == "parent":
            value = str(node.value)
            if value != name and "." not in value:
                yield from _derived(document, [node.span], name, modules)


def _modules(view: ModuleView, name: str) -> list[str]:
    """Returns the modules of a robot, and one that a unit may remove."""
    return [*entries(view.document.get("modules")), name]


def _derived(
    document: open_document.OpenDocument,
    spans: Iterable[Span | None],
    name: str,
    modules: list[str],
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


def _inner(document: open_document.OpenDocument, span: Span, name: str) -> Span:
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


def _scalars(node: Node) -> Iterator[tuple[KeyPath, Node]]:
    for path, value in node.walk():
        if not isinstance(value.value, dict | tuple):
            yield path, value


# -- definitions ------------------------------------------------------------------------

Target = tuple[Path, Span]
"""A file, and a span in it."""

TOP = Span("", 1, 1, 1, 1)


def definition_at(view: ModuleView, line: int, column: int) -> Target | None:
    """Returns where the name at a line and column, which start at 1, is defined."""
    place = view.place_at(line, column)
    if place is None:
        return None
    if place.part == "key":
        parameter = view.parameter_at(place.path)
        if parameter is not None:
            return _file_of(parameter.module), parameter.declaration.where
        module = view.type_of(place.path) if place.path[:1] == ("modules",) else None
        return (_file_of(module), TOP) if module is not None and len(place.path) == 2 else None
    reference = reference_at(view, place, column)
    return _target(view, reference) if reference is not None else None


def _target(view: ModuleView, reference: Reference) -> Target | None:
    if reference.kind == "type":
        module = view.load(reference.name)
        return (_file_of(module), TOP) if module is not None else None
    if reference.kind == "file":
        return view.path.parent / reference.name, TOP
    if reference.kind == "name":
        return _name_target(view, reference)
    owner = reference.whole.rpartition(".")[0]
    section = f"{reference.kind}s"
    if not owner:
        node = open_document.node_at(view.document, ("modules", reference.name))
        return (Path(node.where.file), node.where) if node is not None else None
    module = _type_at(view, owner)
    return _in_module(module, section, reference.name) or _in_module(
        module, "modules", reference.name
    )


def _name_target(view: ModuleView, reference: Reference) -> Target | None:
    first, _, rest = reference.whole.partition(".")
    for section in ("params", "let"):
        node = open_document.node_at(view.tree, (section, first))
        if node is None:
            continue
        if not rest:
            return view.path, node.where
        default = node.get("default")
        module = view.load(default.value) if default is not None else None
        return _in_module(module, "params", rest) or _in_module(module, "wheel", rest)
    return None


def _type_at(view: ModuleView, path: str) -> ModuleType | None:
    instance = view.root
    for name in path.split("."):
        if name not in instance.children:
            return None
        instance = instance.children[name]
    return instance.type


def _in_module(module: ModuleType | None, section: str, name: str) -> Target | None:
    node = module.section(section).get(name) if module is not None else None
    return (_file_of(module), node.where) if node is not None and module is not None else None


def _file_of(module: ModuleType) -> Path:
    return module.folder / FILE
