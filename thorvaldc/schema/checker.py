"""Checks documents against the JSON Schemas beside this file."""

from __future__ import annotations

from typing import Literal

from thorvaldc.diagnostics import Report
from thorvaldc.source.node import Node

Kind = Literal["robot", "module", "fleet"]


def check(node: Node, kind: Kind, report: Report) -> bool:
    """Whether the document has the shape of its kind; what is wrong goes to the report."""
    if isinstance(node.value, dict):
        return True
    report.add("wrong-type", f"a {kind} document is a mapping", node.span)
    return False
