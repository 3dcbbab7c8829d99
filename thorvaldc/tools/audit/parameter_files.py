"""Reads ROS parameter files to sections, one for each node."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Diagnostic, Report
from thorvaldc.tools.audit.audit_facts import ParameterSection

_KEY = "ros__parameters"
MAX_PARAMETERS = 20_000


class UnreadableYaml(Exception):
    """Raised if a file is not YAML; ``diagnostic`` contains the reason."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.message)
        self.diagnostic = diagnostic


def read_yaml(data: bytes, display: str) -> tuple[Node | None, Report]:
    """Returns the document of a YAML file, and the diagnostics of the strict reader.

    The document is ``None`` if the file is empty.  Raises ``UnreadableYaml``.
    """
    report = Report()
    document = read_text(data, display, report)
    if document is None and not any(d.code.name == "yaml-empty" for d in report):
        raise UnreadableYaml(report.sorted()[0])
    return document, report


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
