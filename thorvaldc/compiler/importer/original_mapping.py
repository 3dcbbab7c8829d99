"""Typed access to a mapping of an original configuration file."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from thorvaldc.compiler.importer.conversion_log import ConversionLog, Key
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span

# The Boolean words of YAML 1.1, and numbers: the original code compares texts.
_TRUE = ("true", "yes", "on", "y", "1", "1.0")
_FALSE = ("false", "no", "off", "n", "0", "0.0")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_ANGLE = re.compile(r"(deg|rad)\((.+)\)")
_MULTIPLE_OF_PI = re.compile(r"(-?)(?:([\d.]+)\*)?pi(?:/([\d.]+))?")


@dataclass(frozen=True, slots=True)
class OriginalMapping:
    """A mapping of the file.

    Every access to a value writes to ``log``.  ``target`` is the path in robot.yaml to which
    the caller converts the value.  Errors go to the report of the log.
    """

    key: Key
    node: Node
    log: ConversionLog

    @property
    def name(self) -> str:
        """The last key of the path; empty for the document itself."""
        return self.key[-1] if self.key else ""

    @property
    def path(self) -> str:
        """The keys from the top of the document, joined by dots."""
        return ".".join(self.key)

    @property
    def location(self) -> str:
        """Path and line, for a comment in robot.yaml."""
        return f"{self.path}, line {self.node.where.line}"

    @property
    def report(self) -> Report:
        """The report of the log."""
        return self.log.report

    def has(self, key: str) -> bool:
        """Returns whether the key exists and its value is not null."""
        child = self.node.get(key)
        return child is not None and child.value is not None

    def span(self, key: str) -> Span:
        """Returns the span of a key; if the key is missing, the span of the mapping."""
        child = self.node.get(key)
        return child.where if child is not None else self.node.where

    def children(self, key: str) -> list[OriginalMapping]:
        """Returns the mappings in the mapping or list under ``key``, in file order."""
        child = self.node.get(key)
        child_key = (*self.key, key)
        if child is None or child.value is None or child.value == "":
            self.log.add_converted(child_key, "empty")
            return []
        items: list[tuple[str, Node]] = []
        if isinstance(child.value, tuple):
            items = [(str(i), item) for i, item in enumerate(child.value)]
        elif isinstance(child.value, dict):
            items = list(child.value.items())
            if not items:
                self.log.add_converted(child_key, "empty")
        else:
            self._report_value(child_key, child, f"`{key}`: expected a mapping, got {_kind(child)}")
        mappings: list[OriginalMapping] = []
        for name, item in items:
            if isinstance(item.value, dict):
                mappings.append(OriginalMapping((*child_key, name), item, self.log))
            else:
                message = f"`{key}.{name}`: expected a mapping, got {_kind(item)}"
                self._report_value((*child_key, name), item, message)
        return mappings

    def child(self, key: str) -> OriginalMapping | None:
        """Returns the mapping under a key; ``None`` if it is missing, empty or no mapping."""
        child = self.node.get(key)
        child_key = (*self.key, key)
        if child is None or child.value is None:
            self.log.add_converted(child_key, "empty")
            return None
        if not isinstance(child.value, dict):
            self._report_value(child_key, child, f"`{key}`: expected a mapping, got {_kind(child)}")
            return None
        return OriginalMapping(child_key, child, self.log)

    def number(
        self,
        key: str,
        target: str,
        *,
        default: float | None = None,
        low: float = -1000.0,
        high: float = 1000.0,
    ) -> float | None:
        """Returns a finite number, quoted or not; ``default`` if the key is missing or empty.

        ``low`` and ``high`` are inclusive bounds.  ``None`` after an error.
        """
        node = self.node.get(key)
        value_key = (*self.key, key)
        if node is None or node.value is None or node.value == "":
            self.log.add_converted(value_key, "empty")
            return default
        value = _number(node)
        if value is None:
            has_comma = isinstance(node.value, str) and "," in node.value
            self._report_value(
                value_key,
                node,
                f"`{key}` of `{self.path}`: expected a number, got {_kind(node)}",
                "write a decimal point instead of the comma" if has_comma else None,
            )
            return None
        if not low <= value <= high:
            self._report_value(
                value_key,
                node,
                f"`{key}` of `{self.path}`: expected a number from {low:g} to {high:g}, "
                f"got {value:g}",
            )
            return None
        self.log.add_converted(value_key, target)
        return value

    def integer(self, key: str, target: str, *, low: int, high: int) -> int | None:
        """Returns an integer within inclusive bounds; ``None`` if it is missing or invalid."""
        value = self.number(key, target, low=-1e9, high=1e9)
        if value is None:
            return None
        if value != round(value) or not low <= value <= high:
            self._report_value(
                (*self.key, key),
                self.node.get(key) or self.node,
                f"`{key}` of `{self.path}`: expected an integer from {low} to {high}, "
                f"got {value:g}",
            )
            return None
        return int(value)

    def boolean(self, key: str, target: str) -> bool | None:
        """Returns a Boolean, in any spelling of YAML 1.1; ``None`` if missing or invalid."""
        node = self.node.get(key)
        if node is None or node.value is None or node.value == "":
            self.log.add_converted((*self.key, key), "empty")
            return None
        text = str(node.value).strip().lower() if not isinstance(node.value, (dict, tuple)) else ""
        if text in _TRUE or text in _FALSE:
            self.log.add_converted((*self.key, key), target)
            return text in _TRUE
        self._report_value(
            (*self.key, key),
            node,
            f"`{key}` of `{self.path}`: expected true or false, got {_kind(node)}",
        )
        return None

    def text(self, key: str, target: str) -> str | None:
        """Returns a scalar as text; ``None`` if it is missing, null, a list or a mapping."""
        node = self.node.get(key)
        if node is None or isinstance(node.value, (dict, tuple)):
            return None
        self.log.add_converted((*self.key, key), target)
        return str(node.value).strip() if node.value is not None else None

    def leave_out(self, key: str, reason: str) -> None:
        """Logs that robot.yaml cannot express the value of ``key``, if the key exists."""
        node = self.node.get(key)
        if node is not None:
            self.log.leave_out((*self.key, key), node, reason)

    def report_error(self, code: str, message: str, key: str = "", hint: str | None = None) -> None:
        """Reports an error of the mapping, or of the value of ``key``."""
        error_key = (*self.key, key) if key else self.key
        self.report.add(code, message, self.span(key) if key else self.node.where, hint=hint)
        self.log.add_reported(error_key, message)

    def _report_value(self, key: Key, node: Node, message: str, hint: str | None = None) -> None:
        self.report.add("import-value", message, node.span, hint=hint)
        self.log.add_error(key, message)


def _kind(node: Node) -> str:
    """Returns the text of a scalar, or the kind of the value, for a message."""
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    return "nothing" if node.value is None else f"`{node.value}`"


def _number(node: Node) -> float | None:
    """Returns a finite number as ROS 1 reads it; ``None`` for anything else.

    ROS 1 accepts the numbers of YAML 1.1 (``0x1F``, ``017``, ``1_000``) and the angles of
    rosparam, ``deg(90)`` and ``rad(2*pi/3)``, which become radians.
    """
    if not isinstance(node.value, str):
        return None
    text = node.value.strip().replace("_", "")
    angle = _ANGLE.fullmatch(text)
    if angle is not None:
        factor = math.pi / 180 if angle[1] == "deg" else 1.0
        multiple = _MULTIPLE_OF_PI.fullmatch(angle[2].replace(" ", ""))
        if multiple is not None:
            numerator, denominator = (
                float(part) if part and _NUMBER.fullmatch(part) else 1.0
                for part in multiple.groups()[1:]
            )
            if denominator == 0.0:
                return None
            return factor * (-1 if multiple[1] else 1) * numerator * math.pi / denominator
        return factor * float(angle[2]) if _NUMBER.fullmatch(angle[2]) else None
    if not node.quoted and re.fullmatch(r"[-+]?0[0-7]+", text):
        return float(int(text, 8))  # a leading zero means octal in YAML 1.1
    if re.fullmatch(r"0x[0-9a-fA-F]{1,8}", text):
        return float(int(text, 16))
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None
