"""The file of a unit: it names the robot file of its design and states what differs.

The path of a value is its keys, joined by dots; a key of the top may be a path itself.  A value
replaces that of the design at its path, as one of ``--set`` does.  A unit inherits everything but
the name, by which builds and commissioning reports tell robots apart.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.compiler.source.input_file import DOCUMENTS, check_no_link_outside, report_missing
from thorvaldc.compiler.source.node import Node, describe_node
from thorvaldc.compiler.source.overrides import SHORT_FORMS, Change, with_change
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.source.units import UnitError, parse_with_dimension
from thorvaldc.compiler.validation.document_check import compiled_kind, report_wrong_kind
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span, did_you_mean
from thorvaldc.schema import inlined

_Path = tuple[str, ...]
_Value = tuple[_Path, Node, Node | None]
_VERSION, _EXTENDS, _NAME = "thorvaldc", "extends", "name"
_NOTHING = Node(None, Span(""))
_WHY_NAMES = "builds and commissioning reports are told apart by the names of robots"


def with_design(document: Node, files: dict[str, Path], path: Path, report: Report) -> Node | None:
    """Returns the document of a unit with the entries of its design, or ``None`` if there is none.

    ``files``: the function adds the files of the design, which may be a unit of another one.
    """
    units, links, real_paths = [document], list[Node](), {os.path.realpath(path)}
    while (link := units[-1].get(_EXTENDS)) is not None:
        if not isinstance(link.value, str):
            message = f"expected the file of the design, got {describe_node(link)}"
            report.add("wrong-type", message, link.span, hint="as in `design.yaml`")
            return None
        links.append(link)
        folder, path = path.parent, path.parent / link.value
        name = posixpath.normpath(posixpath.join(posixpath.dirname(link.span.file), link.value))
        if not os.path.isfile(path):
            report_missing("unit-design", folder, link, DOCUMENTS, report)
            return None
        if os.path.realpath(path) in real_paths:
            message = f"`extends` leads in a circle: {' -> '.join(str(x.value) for x in links)}"
            report.add("unit-design", message, links[0].span, hint="name the file of the design")
            return None
        if not check_no_link_outside(path, path.parent, name, report, link.span):
            return None
        files[name] = path
        real_paths.add(os.path.realpath(path))
        design = read_file(path, name, report)
        if design is None:
            return None
        if report_wrong_kind(design, Report()) or compiled_kind(design) != "robot":
            report.add("unit-design", f"`{link.value}` is no robot file", link.span)
            return None
        units.append(design)
    merged = units.pop()
    while units:
        merged = _merged(merged, units.pop(), report)
    return merged


def _merged(design: Node, unit: Node, report: Report) -> Node:
    """Returns the document of a design with the values of a unit."""
    stated, inherited = entries(unit), entries(design)
    own = {key: stated[key] for key in (_VERSION, _EXTENDS) if key in stated}
    version = inlined("robot")["properties"][_VERSION]["const"]
    if _VERSION in own and own[_VERSION].value == version:
        own |= {_VERSION: inherited.get(_VERSION, own[_VERSION])}  # another one is an error there
    rest = {k: node for k, node in inherited.items() if k not in (_VERSION, _EXTENDS)}
    document = unit._replace(value={**own, **rest})
    spans: dict[_Path, Span] = {}  # of the keys of the unit
    for path in [path for path in stated if path not in own]:
        first, whole = _nested(path, stated[path])
        for keys, node, target in _values((first,), whole, entries(document).get(first)):
            name, where = ".".join(keys), node.where
            if spans.setdefault(keys, where) is not where:
                labels = [Label(spans[keys], FIRST_USE)]
                message = f"the key `{name}` occurs twice"
                report.add("yaml-duplicate-key", message, where, hint="keep one", labels=labels)
                continue
            if node.value is None and node.span[1:3] == node.span[3:5]:
                hint = "write `null` if the unit lacks it; else write its value"
                report.add("wrong-type", f"`{name}` has no value", where, hint=hint)
                continue
            if target is not None and is_same_value(node, target):
                message = f"`{name}` is {describe_node(node)} in the design, too"
                hint = _WHY_NAMES if name == _NAME else "remove it"
                report.add("unit-unchanged", message, where, hint=hint)
            document = with_change(document, keys, Change(name, node), report)
    known = entries(design.get("modules"))
    for name, module in entries(document.get("modules")).items():
        if name not in known and isinstance(module.value, dict) and "type" not in module.value:
            near = did_you_mean(name, known, "a module that a unit adds has a `type`")
            message = f"the design has no module `{name}`"
            report.add("variation-path", message, module.where, hint=near)
            document = with_change(document, ("modules", name), Change(name, _NOTHING), report)
    if (_NAME,) not in spans:
        document = with_change(document, (_NAME,), Change(_NAME, _NOTHING), Report())
    return document


def _nested(path: str, node: Node) -> tuple[str, Node]:
    """Returns the first key of a dotted path, and the value of this key with the further ones."""
    keys = path.split(".") if all(path.split(".")) else [path]
    where = node.where
    column = where.column + (where.end_column - where.column - len(path)) // 2  # after a quote
    spans = []
    for key in keys:
        spans.append(Span(where.file, where.line, column, where.line, column + len(key)))
        column += len(key) + 1
    value = node._replace(key_span=spans[-1])
    for number in range(len(keys) - 1, 0, -1):
        whole = Span(*spans[number][:3], value.span.end_line, value.span.end_column)
        value = Node({keys[number]: value}, whole, spans[number - 1])
    return keys[0], value


def _values(keys: _Path, node: Node, target: Node | None) -> Iterator[_Value]:
    """Yields the values in a node of a unit with their paths, and what the design has there."""
    if isinstance(node.value, dict) and target is not None:
        is_short = keys[-1] in SHORT_FORMS and isinstance(target.value, int | str)
        has_items = isinstance(target.value, tuple) and all(map(str.isdigit, node.value or "x"))
        if isinstance(target.value, dict) or is_short or has_items:
            children = {str(key): child for key, child in target.children()}
            for key, inner in node.value.items():
                yield from _values((*keys, key), inner, children.get(key))
            return
    yield keys, node, target


def is_same_value(first: Node, second: Node) -> bool:
    """Returns whether two values are equal, also in other units; a number without one is in SI."""
    if isinstance(first.value, tuple) and isinstance(second.value, tuple):
        is_as_long = len(first.value) == len(second.value)
        return is_as_long and all(map(is_same_value, first.value, second.value))
    try:
        (value, unit), (other, of_other) = (
            parse_with_dimension(str(node.value)) for node in (first, second)
        )
        if unit is None and of_other is None and isinstance(first.value, str):
            return first.value == str(second.value)  # `01` and `1` are two serial numbers
        return value == other and (unit == of_other or None in (unit, of_other))
    except UnitError:
        return repr(first.plain()) == repr(second.plain())
