"""Reads numbers, Booleans and texts from a mapping of an original configuration file."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.tools.importer.conversion_log import ConversionLog, Key

# Texts for true and false: the Boolean words of YAML 1.1, and the numbers 1 and 0.
_TRUE = ("true", "yes", "on", "y", "1", "1.0")
_FALSE = ("false", "no", "off", "n", "0", "0.0")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_ANGLE = re.compile(r"(deg|rad)\((.+)\)")
_MULTIPLE_OF_PI = re.compile(r"(-?)(?:([\d.]+)\*)?pi(?:/([\d.]+))?")


@dataclass(frozen=True, slots=True)
class OriginalMapping:
    """A mapping of an original configuration file.

    Every method that reads a value adds the conversion of the value to ``log``.  The argument
    ``target`` is the path of the converted value in robot.yaml.  Errors are added to the report of
    ``log``.
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
        """Returns the value of a key that contains a mapping.

        Returns ``None`` if the key is missing, or if the value is empty or not a mapping.
        """
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
        """Returns the value of a key as a number, or ``default`` if the key is missing or empty.

        Returns ``None`` and reports an error if the value is not a finite number from ``low`` to
        ``high``.  A number may be written in quotes.
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
        """Returns the value of a key as an integer from ``low`` to ``high``.

        Returns ``None`` if the key is missing or the value is not valid.
        """
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
        """Returns the value of a key as a Boolean.

        All Boolean words of YAML 1.1 are accepted.  Returns ``None`` if the key is missing or the
        value is not valid.
        """
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
        """Returns the value of a key as text.

        Returns ``None`` if the key is missing, or if the value is null, a list or a mapping.
        """
        node = self.node.get(key)
        if node is None or isinstance(node.value, (dict, tuple)):
            return None
        self.log.add_converted((*self.key, key), target)
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

    def _report_value(self, key: Key, node: Node, message: str, hint: str | None = None) -> None:
        self.report.add("import-value", message, node.span, hint=hint)
        self.log.add_error(key, message)


def _kind(node: Node) -> str:
    """Describes the value of a YAML node for an error message."""
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    return "nothing" if node.value is None else f"`{node.value}`"


def _number(node: Node) -> float | None:
    """Returns the value of a YAML node as a number, converted by the rules of ROS 1.

    Returns ``None`` if the value is not a finite number.

    ROS 1 accepts the number formats of YAML 1.1, such as ``0x1F``, ``017`` and ``1_000``.  ROS 1
    also accepts angles such as ``deg(90)`` and ``rad(2*pi/3)``.  An angle is converted to radians.
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
