"""New values for entries of a document, by their dotted paths: ``modules.frame.params.width``."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from thorvaldc.compiler.source.node import Node, Value
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span, did_you_mean

SETTING = "--set "
"""A span of a new value has a file name with this prefix, as in the option ``--set``."""

SHORT_FORMS = {"can": "id", "base_calculator": "name"}
"""Keys with a short form: ``can: 3`` is ``can: {id: 3}``, so that ``can.serial`` keeps the id."""


class Change(NamedTuple):
    """A new value for one entry of a document.

    ``path`` is the dotted path of the entry in the document.  ``value`` is the new value of the
    entry; nothing (``null``) removes it.  ``value.where`` is the source span of the path, for
    diagnostics.
    """

    path: str
    value: Node

    @property
    def text(self) -> str:
        """Text of the new value, for a table of the runs."""
        plain = self.value.plain()
        if isinstance(plain, str):
            return plain
        return json.dumps(plain, separators=(", ", ": "), ensure_ascii=False)


def read_changes(values: Mapping[str, object]) -> tuple[Change, ...]:
    """Returns values of Python by their dotted paths as changes of a document.

    A value is a text with a unit, a number, a truth value, a list, a mapping, or a ``Node``.
    Raises ``TypeError`` for another value.
    """
    if not isinstance(values, Mapping):
        raise TypeError(
            f"set: expected values by their paths such as {{'name': 'x'}}, got {values!r}"
        )
    return tuple(
        Change(path, value if isinstance(value, Node) else _node(value, Span(SETTING + path)))
        for path, value in values.items()
    )


def parse_change(text: str) -> Change:
    """Reads a text ``PATH=VALUE``, in which the value is YAML.

    Raises ``ValueError``.
    """
    path, equals, value = text.partition("=")
    path, report = path.strip(), Report()
    span = Span(SETTING + path)
    node = read_text(value.encode(), span.file, report) if equals and path else None
    if node is None or report.has_errors:
        raise ValueError(f"{text!r} is not PATH=VALUE, such as driver.rate=100 Hz")
    return Change(path, with_span(node, span))


def parse_choices(text: str) -> tuple[str, tuple[Node, ...]]:
    """Reads a text ``PATH=VALUES`` with one value, or several ones that are separated by commas.

    Raises ``ValueError``.
    """
    path, equals, values = text.partition("=")
    path, node = parse_change(f"{path}=[{values}]" if equals else text)
    if not isinstance(node.value, tuple) or not node.value:
        raise ValueError(f"{text!r} has no value")
    return path, node.value


# A quantity is a number with an optional unit, for example `-0.5 deg`.
_LIMIT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.][^.]*?)?\s*", re.ASCII
)


class Range(NamedTuple):
    """Values from ``least`` to ``most``, which have the unit ``unit``, or are whole numbers."""

    least: float
    most: float
    unit: str
    whole: bool

    @classmethod
    def parse(cls, low: str, high: str) -> Range | None:
        """Reads the limits of a range, which have one unit; a limit of 0 needs none.

        Returns ``None`` if they are no range.
        """
        first, last = _LIMIT.fullmatch(low), _LIMIT.fullmatch(high)
        if first is None or last is None:
            return None
        least, most = float(first[1]), float(last[1])
        units = {m[2] or "" for m in (first, last) if m[2] or float(m[1]) != 0.0}
        if len(units) > 1 or not least < most:
            return None
        unit = "".join(units)
        whole = not unit and all(re.fullmatch(r"\s*[-+]?\d+\s*", text) for text in (low, high))
        return cls(least, most, unit, whole)

    def at(self, fraction: float) -> Value:
        """Returns the value at a fraction from 0 to 1 of the range."""
        if self.whole:
            return min(int(self.least + fraction * (self.most - self.least + 1)), int(self.most))
        return self.quantity(self.least + fraction * (self.most - self.least))

    def quantity(self, value: float) -> Value:
        """Returns a value as a document contains it.

        It has 6 significant digits, because people read it in a robot file.
        """
        if self.whole:
            return round(value)
        number = float(f"{value:.6g}")
        return f"{number!r} {self.unit}" if self.unit else number


def with_span(node: Node, span: Span) -> Node:
    """Returns a copy of a YAML node in which every value has the same source span.

    Values from the command line have no line number in a file.
    """
    value = node.value
    if isinstance(value, dict):
        value = {key: with_span(entry, span) for key, entry in value.items()}
    elif isinstance(value, tuple):
        value = tuple(with_span(element, span) for element in value)
    return Node(value, span, span, node.quoted)


def _node(value: object, span: Span) -> Node:
    if isinstance(value, Mapping):
        return Node({str(k): _node(v, span) for k, v in value.items()}, span, span)
    if isinstance(value, (list, tuple)):
        return Node(tuple(_node(item, span) for item in value), span, span)
    if value is None or isinstance(value, (bool, int, float, str)):
        return Node(value, span, span)
    raise TypeError(f"{span.file}: expected a text, a number, a list or a mapping, got {value!r}")


def with_changes(document: Node, changes: Sequence[Change], report: Report) -> Node:
    """Returns the document with the changed values.

    Missing mappings on the path of a changed value are added.
    """
    for change in changes:
        document = with_change(document, change.path.split("."), change, report)
    return document


def with_change(node: Node, keys: Sequence[str], change: Change, report: Report) -> Node:
    """Returns a copy of a YAML node with one changed value.

    ``keys``: mapping keys and list indices that lead from the YAML node to the changed value.
    """
    if not keys:
        return change.value
    key, value = keys[0], node.value
    removes = len(keys) == 1 and change.value.value is None
    if isinstance(value, dict) and removes and key in value:
        return node._replace(value={name: entry for name, entry in value.items() if name != key})
    if isinstance(value, dict) and not removes:
        entry = value.get(key, Node({}, change.value.span, change.value.where))
        if len(keys) > 1 and key in SHORT_FORMS and isinstance(entry.value, int | str):
            entry = entry._replace(value={SHORT_FORMS[key]: entry})
        return node._replace(value={**value, key: with_change(entry, keys[1:], change, report)})
    if isinstance(value, tuple) and key.isascii() and key.isdigit() and int(key) < len(value):
        index = int(key)
        element = with_change(value[index], keys[1:], change, report)
        return node._replace(value=(*value[:index], element, *value[index + 1 :]))
    container, hint = "a single value", None
    if isinstance(value, dict):
        container, hint = "the document to remove", did_you_mean(key, value)
    if isinstance(value, tuple):
        container = f"a list of {len(value)}"
        hint = f"its elements are 0 to {len(value) - 1}" if value else None
    report.add(
        "variation-path",
        f"`{change.path}` does not exist: there is no `{key}` in {container}",
        change.value.where,
        hint=hint,
    )
    return node
