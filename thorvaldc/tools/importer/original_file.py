"""Reads a configuration file of the original system by the YAML rules of ROS.

ROS reads YAML 1.1, and the original system accepts numbers and Booleans in quotes.  Every scalar of
the file is therefore returned as text.  The class ``OriginalMapping`` converts the text to a number
or a Boolean.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import MAX_BYTES, MAX_VALUES, compose
from thorvaldc.diagnostics import Label, Report, Span

# A parameter of ROS 2 with its path, such as `motor_drives.drive0.x`.
_DOTTED = re.compile(r"[A-Za-z_]\w*(\.\w+)+")


def read_original(path: Path, display: str, report: Report) -> Node | None:
    """Returns the YAML document, in which every scalar is a text.

    Returns ``None`` and reports an error if the file cannot be read.
    """
    data = read_bytes(path, display, report, limit=MAX_BYTES + 1, cut=True)
    if data is None:
        return None
    yaml_node = compose(data, display, report)
    if yaml_node is None:
        return None
    return _NodeConverter(display, report).node(yaml_node, None)


class _NodeConverter:
    """Converts nodes of the package PyYAML to ``Node``.

    Merge keys (``<<``) of YAML 1.1 are supported.  If a mapping contains a key twice, the last
    value is used, as in ROS.
    """

    def __init__(self, display: str, report: Report) -> None:
        self.display = display
        self.report = report
        # Python ids of the lists and mappings that contain the current node
        self.open: list[int] = []
        self.count = 0

    def node(self, raw: Any, key_span: Span | None) -> Node | None:
        span = self.span(raw)
        self.count += 1
        if id(raw) in self.open:
            message = "an alias refers to a value that contains it"
            self.report.add("yaml-recursive-alias", message, span)
            return None
        if self.count > MAX_VALUES:
            message = f"the file has more than {MAX_VALUES} values, aliases expanded"
            self.report.add("yaml-too-many-values", message, span)
            return None
        if raw.id == "scalar":
            quoted = bool(raw.style)
            empty = not quoted and raw.value in ("", "~", "null", "Null", "NULL")
            if raw.tag.endswith(("degrees", "radians")):
                # rosparam: `!degrees 90` means `deg(90)`
                return Node(f"{raw.tag[-7:-4]}({raw.value})", span, key_span, quoted)
            return Node(None if empty else raw.value, span, key_span, quoted)
        self.open.append(id(raw))
        value: dict[str, Node] | tuple[Node, ...]
        if raw.id == "mapping":
            value = self.mapping(raw)
        else:
            items = [self.node(item, None) for item in raw.value]
            value = tuple(item for item in items if item is not None)
        self.open.pop()
        return Node(value, span, key_span)

    def mapping(self, raw: Any) -> dict[str, Node]:
        merged_values: dict[str, Node] = {}
        values: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            key_span = self.span(raw_key)
            if raw_key.id != "scalar":
                message = "expected text as the key, got a list or mapping"
                self.report.add("yaml-key-not-text", message, key_span)
                continue
            child = self.node(raw_value, key_span)
            if child is None:
                continue
            if raw_key.value == "<<" and not raw_key.style:
                # The value of a merge key is a mapping or a list of mappings.  If two mappings
                # contain the same key, the first mapping is used.
                for part in child.value if isinstance(child.value, tuple) else (child,):
                    for key, value in (part.value if isinstance(part.value, dict) else {}).items():
                        merged_values.setdefault(key, value)
                continue
            key = raw_key.value
            if key in values:
                self.report_duplicate(key, key_span, values[key])
            values[key] = child
        return self.nested({**merged_values, **values})

    def nested(self, values: dict[str, Node]) -> dict[str, Node]:
        """Returns the mapping with dotted keys as nested mappings.

        ROS 2 accepts the parameter `drive0.x` as the key `x` in the mapping `drive0`.
        """
        nested: dict[str, Node] = {}
        for key, child in values.items():
            if not _DOTTED.fullmatch(key):
                self.put(nested, key, child)
                continue
            first, *others = key.split(".")
            for name in reversed(others):
                child = Node({name: child}, child.span, child.key_span)
            self.put(nested, first, child)
        return nested

    def put(self, values: dict[str, Node], key: str, child: Node) -> None:
        """Adds a value to a mapping.  Two mappings with the same key become one."""
        known = values.get(key)
        if known is not None and isinstance(known.value, dict) and isinstance(child.value, dict):
            merged = dict(known.value)
            for name, value in child.value.items():
                self.put(merged, name, value)
            child = Node(merged, known.span, known.key_span)
        elif known is not None:
            self.report_duplicate(key, child.where, known)
        values[key] = child

    def report_duplicate(self, key: str, span: Span, first: Node) -> None:
        self.report.add(
            "import-duplicate-key",
            f"the key `{key}` occurs twice; the last one counts, as in ROS",
            span,
            labels=[Label(first.where, "first used here")],
        )

    def span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        return Span(self.display, start.line + 1, start.column + 1, end.line + 1, end.column + 1)
