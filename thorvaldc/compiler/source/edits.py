"""Changes of the text of a YAML document, for hints that propose a change."""

from __future__ import annotations

import json
import re

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.scalars import is_plain_text
from thorvaldc.diagnostics import Proposal, Span

# Texts that need no quotes in a YAML flow mapping, such as `frame.front_left`, `650 mm` or `42:1`.
_NEEDS_NO_QUOTES = re.compile(r"(?!.*:(\s|$))[\w.+/-][\w.,:;+*/^%° ()'=-]*", re.ASCII)


def yaml_text(value: object) -> str:
    """Returns a Python value as YAML text in one line, with quotes where YAML needs them."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {yaml_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(yaml_text, value)) + "]"
    if isinstance(value, str):
        plain = "," not in value and _NEEDS_NO_QUOTES.fullmatch(value) and is_plain_text(value)
        return value if plain else json.dumps(value, ensure_ascii=False)
    return str(value)


def insertion(hint: str, mapping: Node, key: str, value: str, *, is_example: bool) -> Proposal:
    """Returns the hint that proposes to add an entry at the start of a YAML mapping.

    - ``hint``: text of the hint.
    - ``value``: YAML text of the value.
    """
    entries = mapping.value if isinstance(mapping.value, dict) else {}
    first = next(iter(entries.values()), None)
    start, entry = mapping.span, f"{key}: {value}"
    if first is not None and first.where[:3] == start[:3]:
        # The keys of a YAML mapping without braces start in the same column.
        entry += "\n" + " " * (start.column - 1)
        column = start.column
    else:
        column = start.column + 1  # after the brace
        entry += ", " if first is not None else ""
    span = Span(start.file, start.line, column, start.line, column)
    return Proposal(hint, entry, span=span, is_example=is_example)


def removal(hint: str, mapping: Node, key: str) -> Proposal | str:
    """Returns the hint that proposes to remove an entry of a YAML mapping.

    Returns ``hint`` as plain text if the mapping has no other entry.
    """
    entries = list(mapping.value.items()) if isinstance(mapping.value, dict) else []
    index = next((i for i, (name, _) in enumerate(entries) if name == key), None)
    if index is None or len(entries) < 2:
        return hint
    node = entries[index][1]
    if index + 1 < len(entries):
        start, end = node.where[1:3], entries[index + 1][1].where[1:3]
    else:
        start, end = entries[index - 1][1].span[3:5], node.span[3:5]
    if start >= end:  # An alias has the source span of its anchor.
        return hint
    return Proposal(hint, "", span=Span(node.span.file, *start, *end))
