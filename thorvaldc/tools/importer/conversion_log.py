"""Logs how each value of an original configuration file is converted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span

Key = tuple[str, ...]

_MAX_SHOWN = 4  # largest number of names that a message lists


@dataclass(frozen=True, slots=True)
class Conversion:
    """Conversion of one value of an original configuration file.

    If ``converted`` is true, ``text`` is the path of the value in robot.yaml.  If ``converted`` is
    false, ``text`` is the reason why the value is not converted.
    """

    span: Span
    converted: bool
    text: str


class ConversionLog:
    """Log with the conversion of every value of an original configuration file.

    The log contains an entry for each scalar, each empty list and each empty mapping.

    The method ``finish`` reports every value of the file that was not converted.
    """

    def __init__(self, root: Node, report: Report) -> None:
        self.report = report
        self.conversions: dict[Key, Conversion] = {}
        self._root = root
        self._leaves: dict[Key, Node] = dict(_leaves(root, ()))
        self._left_out: dict[tuple[str, str], list[tuple[Key, Node]]] = {}

    def add_converted(self, key: Key, target: str) -> None:
        """Logs that a value is converted to the path ``target`` in robot.yaml."""
        if key in self._leaves:
            self.conversions[key] = Conversion(self._leaves[key].span, True, target)

    def add_reported(self, key: Key, reason: str) -> None:
        """Logs that a diagnostic explains why the values below ``key`` are not converted.

        Values that already are in the log are not changed.
        """
        for leaf, node in self._leaves.items():
            if leaf[: len(key)] == key and leaf not in self.conversions:
                self.conversions[leaf] = Conversion(node.span, False, reason)

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
                self.conversions[leaf] = Conversion(self._leaves[leaf].span, False, "unknown")

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


def _leaves(node: Node, key: Key) -> Iterator[tuple[Key, Node]]:
    if isinstance(node.value, dict) and node.value:
        for name, child in node.value.items():
            yield from _leaves(child, (*key, name))
    elif isinstance(node.value, tuple) and node.value:
        for i, child in enumerate(node.value):
            yield from _leaves(child, (*key, str(i)))
    else:
        yield key, node
