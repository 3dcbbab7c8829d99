"""The places where the names in a document are defined."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.compiler.modules.library import FILE, ModuleType
from thorvaldc.diagnostics import Span
from thorvaldc.tools.language_server.document_tree import node_at, place_at
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.language_server.places import Reference, reference_at

Target = tuple[Path, Span]
"""A file, and a span in it."""

TOP = Span("", 1, 1, 1, 1)


def definition_at(view: ModuleView, line: int, column: int) -> Target | None:
    """Returns where the name at a line and column, which start at 1, is defined."""
    place = place_at(view.tree, line, column)
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
    section = {"module": "modules", "port": "ports", "motor": "motors"}[reference.kind]
    if not owner:
        node = node_at(view.tree, ("modules", reference.name))
        return (view.path, node.where) if node is not None else None
    return _in_module(_type_at(view, owner), section, reference.name) or _in_module(
        _type_at(view, owner), "modules", reference.name
    )


def _name_target(view: ModuleView, reference: Reference) -> Target | None:
    first, _, rest = reference.whole.partition(".")
    for section in ("params", "let"):
        node = node_at(view.tree, (section, first))
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
