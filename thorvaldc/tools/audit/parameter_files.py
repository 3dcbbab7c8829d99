"""Reads ROS parameter files to sections, one for each node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.node import Node, plain_scalar
from thorvaldc.compiler.source.reader import MAX_DEPTH, MAX_VALUES, compose
from thorvaldc.diagnostics import CODES, Diagnostic, Label, Report, Span
from thorvaldc.tools.audit.audit_facts import Fact, ParameterSection

_KEY = "ros__parameters"
MAX_PARAMETERS = 20_000


class UnreadableYaml(Exception):
    """Raised if a file is not YAML; ``diagnostic`` contains the reason."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.message)
        self.diagnostic = diagnostic


def read_yaml(data: bytes, display: str, report: Report) -> Node | None:
    """Returns the document of a YAML file as ROS reads it, or ``None`` if it is empty.

    ROS merges mappings with the same key, and of two values it takes the last one, which is
    reported if they differ.  Raises ``UnreadableYaml``.
    """
    strict = Report()
    root = compose(data, display, strict)
    if root is None:
        if any(d.code.name == "yaml-empty" for d in strict):
            return None
        raise UnreadableYaml(strict.sorted()[0])
    converter = _Converter(display, report)
    try:
        return converter.node(root, None, 0)
    except OverflowError:
        text = f"the document has more than {MAX_VALUES} values, aliases expanded"
        raise UnreadableYaml(
            Diagnostic(CODES["yaml-too-many-values"], text, Span(display))
        ) from None


class _Converter:
    """Converts the nodes of PyYAML; repeated keys, merge keys and aliases are allowed."""

    def __init__(self, file: str, report: Report) -> None:
        self.file = file
        self.report = report
        self.count = 0
        self.ignored = Report()  # words such as `yes`: readers of ROS know them

    def span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        if raw.id != "scalar":
            return Span(
                self.file, start.line + 1, start.column + 1, start.line + 1, start.column + 2
            )
        return Span(self.file, start.line + 1, start.column + 1, end.line + 1, end.column + 1)

    def node(self, raw: Any, key_span: Span | None, depth: int) -> Node:
        self.count += 1
        if self.count > MAX_VALUES or depth > MAX_DEPTH:  # also an alias that contains itself
            raise OverflowError
        span = self.span(raw)
        if raw.id == "scalar":
            value = raw.value if raw.style else plain_scalar(raw.value, span, self.ignored)
            return Node(value, span, key_span, bool(raw.style))
        if raw.id == "sequence":
            return Node(tuple(self.node(v, None, depth + 1) for v in raw.value), span, key_span)
        values: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            key = str(raw_key.value) if raw_key.id == "scalar" else ""
            value = self.node(raw_value, self.span(raw_key), depth + 1)
            if key == "<<" and isinstance(value.value, dict):
                values = {**value.value, **values}
            elif key in values:
                values[key] = self.merged(key, values[key], value)
            else:
                values[key] = value
        return Node(values, span, key_span)

    def merged(self, key: str, first: Node, last: Node) -> Node:
        """Returns the value of a key that occurs twice in one mapping."""
        if isinstance(first.value, dict) and isinstance(last.value, dict):
            values = dict(first.value)
            for name, value in last.value.items():
                values[name] = self.merged(name, values[name], value) if name in values else value
            return Node(values, first.span, first.key_span)
        if first.plain() != last.plain() and first.key_span != last.key_span:
            self.report.add(
                "audit-key-twice",
                f"the key `{key}` occurs twice with different values; ROS uses the last one",
                last.where,
                hint="keep one of them",
                labels=[Label(first.where, "first used here")],
            )
        return last


def parameter_sections(document: Node, display: str, path: Path) -> list[ParameterSection]:
    """Returns the sections of a document in the order of the file; other keys are ignored."""
    sections: list[ParameterSection] = []

    def collect(node: Node, name: str) -> None:
        if not isinstance(node.value, dict):
            return
        for key, child in node.value.items():
            if key == _KEY:
                values = flattened(child)
                sections.append(ParameterSection(name, display, path, child.where, values))
            else:
                collect(child, f"{name}/{key.strip('/')}" if name else key.strip("/"))

    collect(document, "")
    return sections


def flattened(node: Node) -> dict[str, Node]:
    """Returns the parameters of a node by their dotted names; lists stay lists."""
    values: dict[str, Node] = {}

    def collect(inner: Node, prefix: str) -> None:
        if isinstance(inner.value, dict):
            for key, child in inner.value.items():
                collect(child, f"{prefix}.{key}" if prefix else key)
        elif len(values) < MAX_PARAMETERS:
            values[prefix] = inner

    collect(node, "")
    return values


def bus_facts(document: Node) -> list[Fact]:
    """Returns the CANopen node ids in a bus.yml of ros2_canopen, by the name of the device."""
    if not isinstance(document.value, dict) or "master" not in document.value:
        return []
    facts: list[Fact] = []

    def collect(node: Node, name: str, depth: int) -> None:
        node_id = node.get("node_id")
        if node_id is not None and isinstance(node_id.value, int):
            facts.append(Fact("bus node id", f"`{name}`", node_id.value, node_id.span, "", (name,)))
        elif isinstance(node.value, dict) and depth < 3 and name not in ("options", "defaults"):
            for key, child in node.value.items():
                collect(child, key, depth + 1)

    for key, child in document.value.items():
        collect(child, key, 0)
    return facts
