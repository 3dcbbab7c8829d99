"""Joins values in braces that a comma without quotes has split, such as ``{width: 0,9 m}``.

YAML reads ``{width: 0,9 m}`` as two entries: ``width: 0`` and the key ``9 m`` without a value.
"""

from __future__ import annotations

import re

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.scalars import plain_scalar
from thorvaldc.diagnostics import Proposal, Report, Span

_ELEMENT = re.compile(r"[+-]?\d[\w.+-]*( ?[A-Za-z°%][\w/^]*)?")
_DECIMALS = re.compile(r"\d+(\s*[A-Za-z°%].*)?")


def joined(values: dict[str, Node], report: Report) -> dict[str, Node]:
    """Returns the entries of a YAML mapping in braces, with split values joined.

    Reports each split value.
    """
    if all(node.value is not None for node in values.values()):
        return values
    result: dict[str, Node] = {}
    lists: dict[str, list[Node]] = {}  # elements of lists without brackets
    for key, node in values.items():
        last_key, last = next(reversed(result.items()), (None, None))
        if last_key is None or last is None or node.value is not None or node.key_span is None:
            result[key] = node
            continue
        span = Span(last.span.file, *last.span[1:3], *node.key_span[3:5])
        is_adjacent = node.key_span[1:3] == (last.span.end_line, last.span.end_column + 1)
        if isinstance(last.value, int) and is_adjacent and _DECIMALS.fullmatch(key):
            text = f"{last.value}.{key}"
            report.add(
                "bad-quantity",
                f"`{last.value},{key}` is two entries: a comma separates entries",
                span,
                hint=Proposal(f"write a decimal point: `{text}`", text),
            )
            result[last_key] = Node(text, span, last.key_span)
        elif isinstance(last.value, str) and last.value.startswith("(") and not last.quoted:
            result[last_key] = Node(f"{last.value}, {key}", span, last.key_span)
        elif not is_adjacent and _is_element(last) and _ELEMENT.fullmatch(key):
            element = Node(plain_scalar(key, node.key_span, report), node.key_span)
            elements = lists.setdefault(last_key, [last])
            elements.append(element)
            result[last_key] = Node(tuple(elements), span, last.key_span)
        else:
            result[key] = node
    for key in lists:
        text = "[" + ", ".join(str(element.value) for element in lists[key]) + "]"
        report.add(
            "wrong-type",
            f"`{key}` has {len(lists[key])} values without brackets; a comma ends an entry",
            result[key].span,
            hint=Proposal(f"write `{text}`", text),
        )
    return result


def _is_element(node: Node) -> bool:
    """Returns whether a value is a number or a quantity, or the start of a list of them."""
    if isinstance(node.value, tuple):
        return True
    return not isinstance(node.value, bool) and bool(_ELEMENT.fullmatch(str(node.value)))
