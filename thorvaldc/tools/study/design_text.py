"""The text of a robot file with other values at some paths, as a study writes it."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Iterable

from thorvaldc.compiler.source.node import Node, Value, edited, insertion, yaml_text
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span

_QUANTITY = re.compile(
    r"[-+]?\d+(\.\d+)?(e[-+]?\d+)? [a-zA-Z%][\w/^]*( [a-zA-Z][\w/^]*)*", re.ASCII
)


class PathError(Exception):
    """Exception: a path leads to no value that can be replaced."""


def find_value(document: Node, path: str) -> tuple[Node, tuple[str, ...]]:
    """Returns the value at a path, or the last value on the path and the keys that it lacks."""
    keys, node = path.split("."), document
    for index, key in enumerate(keys):
        inner = {str(name): child for name, child in node.children()}.get(key)
        if inner is None:
            return node, tuple(keys[index:])
        node = inner
    return node, ()


def shared_spans(document: Node) -> set[Span]:
    """Returns the spans of the scalars that occur several times, as aliases of an anchor."""
    spans = Counter(n.span for _, n in document.walk() if not isinstance(n.value, dict | tuple))
    return {span for span, number in spans.items() if number > 1}


def with_replaced_values(text: str, values: Iterable[tuple[str, Value]]) -> str:
    """Returns the text of a YAML document with new values at some paths.

    A missing key is added at the start of its mapping.  Raises ``PathError``, also if the text is
    no document.
    """
    document = _parsed(text)
    aliases = shared_spans(document)
    edits: dict[Span, str] = {}
    missing: list[tuple[str, Value]] = []
    for path, value in values:
        node, keys = find_value(document, path)
        if keys:
            missing.append((path, value))
        elif node.span in aliases:
            raise PathError(f"a YAML alias repeats the value of `{path}`: write it in each place")
        else:
            edits[node.span] = value_text(value)
    text = edited(text, edits)
    for path, value in missing:
        # Each addition moves the text behind it.
        mapping, keys = find_value(_parsed(text), path)
        if not keys or not isinstance(mapping.value, dict) or mapping.span.line == 0:
            raise PathError(f"`{path}` cannot be added")
        added = value_text(value)
        for key in reversed(keys[1:]):
            added = f"{{{key}: {added}}}"
        proposal = insertion("", mapping, keys[0], added, is_example=False)
        assert proposal.span is not None
        text = edited(text, {proposal.span: proposal.replacements[0]})
    return text


def value_text(value: Value) -> str:
    """Returns a scalar as YAML text."""
    if isinstance(value, str) and _QUANTITY.fullmatch(value):
        return value  # ``0.7 m``, which needs no quotes
    return yaml_text(value)


@functools.lru_cache(maxsize=4)
def _parsed(text: str) -> Node:
    """Returns the document of a text; the designs of a study replace values in the same text."""
    document = read_text(text.encode(), "", Report())
    if document is None:
        raise PathError("the robot file is not a YAML document")
    return document
