"""Reads a configuration file of the original system by the YAML rules of ROS.

ROS reads YAML 1.1, and the original system accepts numbers and Booleans in quotes.  Every scalar of
the file is therefore returned as text.  The class ``OriginalMapping`` converts the text to a number
or a Boolean.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.node import Node, describe_node
from thorvaldc.compiler.source.reader import MAX_BYTES, MAX_VALUES, compose
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span

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
            labels=[Label(first.where, FIRST_USE)],
        )

    def span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        return Span(self.display, start.line + 1, start.column + 1, end.line + 1, end.column + 1)


# -- the log of conversions -------------------------------------------------------------

Key = tuple[str, ...]

_MAX_SHOWN = 4  # largest number of names that a message lists


@dataclass(frozen=True, slots=True)
class Conversion:
    """Conversion of one value of an original configuration file.

    ``reason`` says why the value is not converted; it is empty for a converted value.
    """

    span: Span
    reason: str


class ConversionLog:
    """Log with the conversion of every value of an original configuration file.

    The log contains an entry for each scalar, each empty list and each empty mapping.

    The method ``finish`` reports every value of the file that was not converted.
    """

    def __init__(self, root: Node, report: Report) -> None:
        self.report = report
        self.conversions: dict[Key, Conversion] = {}
        self._root = root
        self._leaves: dict[Key, Node] = {
            tuple(map(str, path)): node
            for path, node in root.walk()
            if not (isinstance(node.value, dict | tuple) and node.value)
        }
        self._left_out: dict[tuple[str, str], list[tuple[Key, Node]]] = {}

    def add_converted(self, key: Key) -> None:
        """Logs that a value is converted, or that it is empty."""
        if key in self._leaves:
            self.conversions[key] = Conversion(self._leaves[key].span, "")

    def add_reported(self, key: Key, reason: str) -> None:
        """Logs that a diagnostic explains why the values below ``key`` are not converted.

        Values that already are in the log are not changed.
        """
        for leaf, node in self._leaves.items():
            if leaf[: len(key)] == key and leaf not in self.conversions:
                self.conversions[leaf] = Conversion(node.span, reason)

    def add_error(self, key: Key, message: str) -> None:
        """Logs an error of a value, and replaces an earlier log entry of the value."""
        self.conversions.pop(key, None)
        self.add_reported(key, message)

    def leave_out(self, key: Key, node: Node, reason: str) -> None:
        """Logs that robot.yaml cannot express a value.

        The method ``finish`` reports all values with the same key name and reason in one
        diagnostic.
        """
        self._left_out.setdefault((key[-1], reason), []).append((key, node))
        self.add_reported(key, reason)

    def finish(self) -> None:
        """Reports the values that robot.yaml cannot express and the values with unknown keys."""
        for (name, reason), values in self._left_out.items():
            owners = _shorten([".".join(key[:-1]) or "the file" for key, _ in values])
            self.report.add(
                "import-left-out",
                f"`{name}` of {owners} is left out: {reason}",
                values[0][1].where,
                labels=[Label(node.where, "also here") for _, node in values[1:]],
            )
        for key in self._leaves:
            if key in self.conversions:
                continue
            unknown_key = self._unknown_key(key)
            unknown_leaves = [
                leaf for leaf in self._leaves if leaf[: len(unknown_key)] == unknown_key
            ]
            contents = "" if unknown_key == key else f" with its {len(unknown_leaves)} values"
            self.report.add(
                "import-unknown-key",
                f"`{'.'.join(unknown_key)}`{contents} is unknown and left out",
                self._node(unknown_key).where,
                hint="if the robot needs it, add it to the robot.yaml that is written",
            )
            for leaf in unknown_leaves:
                self.conversions[leaf] = Conversion(self._leaves[leaf].span, "unknown")

    def _unknown_key(self, key: Key) -> Key:
        """Returns the path of the outermost mapping around ``key`` that has no value in the log.

        If there is no such mapping, the method returns ``key``.
        """
        for length in range(1, len(key)):
            prefix = key[:length]
            if not any(leaf[:length] == prefix for leaf in self.conversions):
                return prefix
        return key

    def _node(self, key: Key) -> Node:
        node = self._root
        for name in key:
            value = node.value
            if isinstance(value, dict):
                node = value[name]
            elif isinstance(value, tuple):
                node = value[int(name)]
        return node


def _shorten(names: list[str]) -> str:
    listed = ", ".join(f"`{name}`" for name in names[:_MAX_SHOWN])
    return listed + (f" and {len(names) - _MAX_SHOWN} more" if len(names) > _MAX_SHOWN else "")


# -- numbers, Booleans and texts --------------------------------------------------------

# Texts for true and false: the Boolean words of YAML 1.1, and the numbers 1 and 0.
_TRUE = ("true", "yes", "on", "y", "1", "1.0")
_FALSE = ("false", "no", "off", "n", "0", "0.0")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_ANGLE = re.compile(r"(deg|rad)\((.+)\)")


@dataclass(frozen=True, slots=True)
class OriginalMapping:
    """A mapping of an original configuration file.

    Every method that reads a value adds the conversion of the value to ``log``.  Errors are added
    to the report of ``log``.
    """

    key: Key
    node: Node
    log: ConversionLog

    @property
    def name(self) -> str:
        """Last key in the path of the mapping, or an empty text for the whole document."""
        return self.key[-1] if self.key else ""

    @property
    def path(self) -> str:
        """Keys that lead from the document to the mapping, joined by dots."""
        return ".".join(self.key)

    @property
    def location(self) -> str:
        """Path and line number of the mapping, for a comment in robot.yaml."""
        return f"{self.path}, line {self.node.where.line}"

    @property
    def report(self) -> Report:
        """Report that contains the diagnostics of the conversion."""
        return self.log.report

    def has(self, key: str) -> bool:
        """Returns whether the mapping contains a key with a value other than null."""
        child = self.node.get(key)
        return child is not None and child.value is not None

    def span(self, key: str) -> Span:
        """Returns the span of a key, or the span of the mapping if the key is missing."""
        child = self.node.get(key)
        return child.where if child is not None else self.node.where

    def children(self, key: str) -> list[OriginalMapping]:
        """Returns the mappings that the value of ``key`` contains, in the order of the file.

        The value of ``key`` is a mapping or a list of mappings.
        """
        child = self._value(key)
        if child is None:
            return []
        items: list[tuple[str, Node]] = []
        if isinstance(child.value, tuple):
            items = [(str(i), item) for i, item in enumerate(child.value)]
        elif isinstance(child.value, dict):
            items = list(child.value.items())
            if not items:
                self.log.add_converted((*self.key, key))
        else:
            self._reject(child, f"`{key}`: expected a mapping, got {describe_node(child)}", key)
        mappings: list[OriginalMapping] = []
        for name, item in items:
            if isinstance(item.value, dict):
                mappings.append(OriginalMapping((*self.key, key, name), item, self.log))
            else:
                message = f"`{key}.{name}`: expected a mapping, got {describe_node(item)}"
                self._reject(item, message, key, name)
        return mappings

    def _value(self, key: str) -> Node | None:
        """Returns the value of a key, or ``None`` if it is missing or empty, which is logged."""
        node = self.node.get(key)
        if node is None or node.value is None or node.value == "":
            self.log.add_converted((*self.key, key))
            return None
        return node

    def number(
        self,
        key: str,
        *,
        default: float | None = None,
        low: float = -1000.0,
        high: float = 1000.0,
    ) -> float | None:
        """Returns the value of a key as a number, or ``default`` if the key is missing or empty.

        Returns ``None`` and reports an error if the value is not a finite number from ``low`` to
        ``high``.  A number may be written in quotes.
        """
        node = self._value(key)
        if node is None:
            return default
        value = _number(node)
        subject = f"`{key}` of `{self.path}`"
        if value is None:
            has_comma = isinstance(node.value, str) and "," in node.value
            hint = "write a decimal point instead of the comma" if has_comma else None
            message = f"{subject}: expected a number, got {describe_node(node)}"
            self._reject(node, message, key, hint=hint)
            return None
        if not low <= value <= high:
            message = f"{subject}: expected a number from {low:g} to {high:g}, got {value:g}"
            self._reject(node, message, key)
            return None
        self.log.add_converted((*self.key, key))
        return value

    def integer(self, key: str, *, low: int, high: int) -> int | None:
        """Returns the value of a key as an integer from ``low`` to ``high``.

        Returns ``None`` if the key is missing or the value is not valid.
        """
        value = self.number(key, low=-1e9, high=1e9)
        if value is None:
            return None
        if value != round(value) or not low <= value <= high:
            expected = f"an integer from {low} to {high}, got {value:g}"
            message = f"`{key}` of `{self.path}`: expected {expected}"
            self._reject(self.node.get(key) or self.node, message, key)
            return None
        return int(value)

    def boolean(self, key: str) -> bool | None:
        """Returns the value of a key as a Boolean.

        All Boolean words of YAML 1.1 are accepted.  Returns ``None`` if the key is missing or the
        value is not valid.
        """
        node = self._value(key)
        if node is None:
            return None
        text = str(node.value).strip().lower() if not isinstance(node.value, (dict, tuple)) else ""
        if text in _TRUE or text in _FALSE:
            self.log.add_converted((*self.key, key))
            return text in _TRUE
        shown = describe_node(node)
        self._reject(node, f"`{key}` of `{self.path}`: expected true or false, got {shown}", key)
        return None

    def text(self, key: str) -> str | None:
        """Returns the value of a key as text.

        Returns ``None`` if the key is missing, or if the value is null, a list or a mapping.
        """
        node = self.node.get(key)
        if node is None or isinstance(node.value, (dict, tuple)):
            return None
        self.log.add_converted((*self.key, key))
        return str(node.value).strip() if node.value is not None else None

    def leave_out(self, key: str, reason: str) -> None:
        """Logs that robot.yaml cannot express the value of a key.

        A key that the mapping does not contain is not logged.
        """
        node = self.node.get(key)
        if node is not None:
            self.log.leave_out((*self.key, key), node, reason)

    def report_error(self, code: str, message: str, key: str = "", hint: str | None = None) -> None:
        """Reports an error of the value of ``key``, or of the whole mapping if ``key`` is empty."""
        error_key = (*self.key, key) if key else self.key
        self.report.add(code, message, self.span(key) if key else self.node.where, hint=hint)
        self.log.add_reported(error_key, message)

    def _reject(self, node: Node, message: str, *keys: str, hint: str | None = None) -> None:
        self.report.add("import-value", message, node.span, hint=hint)
        self.log.add_error((*self.key, *keys), message)


def _number(node: Node) -> float | None:
    """Returns the value of a YAML node as a number, converted by the rules of ROS 1.

    Returns ``None`` if the value is not a finite number.

    ROS 1 accepts the number formats of YAML 1.1, such as ``0x1F``, ``017`` and ``1_000``.  ROS 1
    also accepts angles such as ``deg(90)``.  An angle is converted to radians.
    """
    if not isinstance(node.value, str):
        return None
    text = node.value.strip().replace("_", "")
    angle = _ANGLE.fullmatch(text)
    if angle is not None:
        factor = math.pi / 180 if angle[1] == "deg" else 1.0
        return factor * float(angle[2]) if _NUMBER.fullmatch(angle[2]) else None
    if not node.quoted and re.fullmatch(r"[-+]?0[0-7]+", text):
        return float(int(text, 8))  # a leading zero means octal in YAML 1.1
    if re.fullmatch(r"0x[0-9a-fA-F]{1,8}", text):
        return float(int(text, 16))
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None
