"""Configuration files of the original, read as ROS reads them, with an account of every value.

ROS takes YAML 1.1 and the original code takes numbers in quotes and booleans as text,
so a scalar here is its text; what it means is decided where it is used.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import MAX_BYTES, MAX_VALUES, compose
from thorvaldc.diagnostics import Label, Report, Span

Key = tuple[str, ...]

_TRUE = ("true", "yes", "on", "y", "1", "1.0")
_FALSE = ("false", "no", "off", "n", "0", "0.0")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_ANGLE = re.compile(r"(deg|rad)\((.+)\)")


@dataclass(frozen=True, slots=True)
class Fate:
    """What became of a value: ``placed`` with where it went, or not, with why."""

    span: Span
    placed: bool
    text: str


class Account:
    """Every value of the file, and what became of it.

    Values that nobody asks for are reported in the end, so nothing is dropped silently.
    """

    def __init__(self, root: Node, report: Report) -> None:
        self.report = report
        self.fates: dict[Key, Fate] = {}
        self._root = root
        self._leaves: dict[Key, Node] = dict(_leaves(root, ()))
        self._left_out: dict[tuple[str, str], list[tuple[Key, Node]]] = {}

    def placed(self, key: Key, to: str) -> None:
        if key in self._leaves:
            self.fates[key] = Fate(self._leaves[key].span, True, to)

    def reported(self, key: Key, why: str) -> None:
        """The value stands in a diagnostic that has been made."""
        for leaf, node in self._leaves.items():
            if leaf[: len(key)] == key and leaf not in self.fates:
                self.fates[leaf] = Fate(node.span, False, why)

    def leave_out(self, key: Key, node: Node, why: str) -> None:
        """The value has no place; told in the end, once for all keys of that name."""
        self._left_out.setdefault((key[-1], why), []).append((key, node))
        self.reported(key, why)

    def finish(self) -> None:
        """Report what was left out and what nobody asked for."""
        for (name, why), found in self._left_out.items():
            owners = _shorten([".".join(key[:-1]) or "the file" for key, _ in found])
            self.report.add(
                "import-left-out",
                f"`{name}` of {owners} is left out: {why}",
                found[0][1].where,
                labels=[Label(node.where, "also here") for _, node in found[1:]],
            )
        for key in self._leaves:
            if key in self.fates:
                continue
            top = self._unknown_top(key)
            inside = [leaf for leaf in self._leaves if leaf[: len(top)] == top]
            more = "" if top == key else f" with the {len(inside)} values in it"
            self.report.add(
                "import-unknown-key",
                f"`{'.'.join(top)}`{more} is not known and left out",
                self._at(top).where,
                hint="if it matters to the robot, say it in the robot.yaml that is written",
            )
            for leaf in inside:
                self.fates[leaf] = Fate(self._leaves[leaf].span, False, "not known")

    def _unknown_top(self, key: Key) -> Key:
        """The shortest start of a key under which nothing at all was asked for."""
        for length in range(1, len(key)):
            top = key[:length]
            if not any(leaf[:length] == top for leaf in self.fates):
                return top
        return key

    def _at(self, key: Key) -> Node:
        node = self._root
        for name in key:
            value = node.value
            if isinstance(value, dict):
                node = value[name]
            elif isinstance(value, tuple):
                node = value[int(name)]
        return node


def _shorten(names: list[str]) -> str:
    shown = ", ".join(f"`{name}`" for name in names[:4])
    return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _leaves(node: Node, key: Key) -> Iterator[tuple[Key, Node]]:
    if isinstance(node.value, dict) and node.value:
        for name, child in node.value.items():
            yield from _leaves(child, (*key, name))
    elif isinstance(node.value, tuple) and node.value:
        for i, child in enumerate(node.value):
            yield from _leaves(child, (*key, str(i)))
    else:
        yield key, node


@dataclass(frozen=True, slots=True)
class Entry:
    """A mapping of the file, whose values are asked for by key."""

    key: Key
    node: Node
    account: Account

    @property
    def name(self) -> str:
        return self.key[-1] if self.key else ""

    @property
    def path(self) -> str:
        return ".".join(self.key)

    @property
    def report(self) -> Report:
        return self.account.report

    def has(self, key: str) -> bool:
        """Whether the key is there with a value."""
        child = self.node.get(key)
        return child is not None and child.value is not None

    def span(self, key: str) -> Span:
        child = self.node.get(key)
        return child.where if child is not None else self.node.where

    def entries(self, key: str) -> list[Entry]:
        """The mappings under a key, in file order: a mapping of mappings, or a list of them."""
        child = self.node.get(key)
        if child is None or child.value is None or child.value == "":
            self.account.placed((*self.key, key), "empty")
            return []
        if isinstance(child.value, tuple):
            items = [(str(i), item) for i, item in enumerate(child.value)]
        elif isinstance(child.value, dict):
            items = list(child.value.items())
            if not items:
                self.account.placed((*self.key, key), "empty")
        else:
            items = []
            self._wrong((*self.key, key), child, f"`{key}` is no mapping")
        found: list[Entry] = []
        for name, item in items:
            if isinstance(item.value, dict):
                found.append(Entry((*self.key, key, name), item, self.account))
            else:
                self._wrong((*self.key, key, name), item, f"`{key}.{name}` is no mapping")
        return found

    def child(self, key: str) -> Entry | None:
        """The mapping under a key."""
        child = self.node.get(key)
        if child is None or child.value is None:
            self.account.placed((*self.key, key), "empty")
            return None
        if not isinstance(child.value, dict):
            self._wrong((*self.key, key), child, f"`{key}` is no mapping")
            return None
        return Entry((*self.key, key), child, self.account)

    def number(
        self,
        key: str,
        to: str,
        *,
        default: float | None = None,
        low: float = -1000.0,
        high: float = 1000.0,
    ) -> float | None:
        """A finite number, quoted or not; ``default`` where the key is missing or empty.

        ``low`` and ``high`` bound it, both included.  ``None`` after a fault.
        """
        node = self.node.get(key)
        own = (*self.key, key)
        if node is None or node.value is None or node.value == "":
            self.account.placed(own, "empty")
            return default
        value = _number(node)
        if value is None:
            shown = f"`{node.value}`" if isinstance(node.value, str) else "a list or mapping"
            comma = isinstance(node.value, str) and "," in node.value
            self._wrong(
                own,
                node,
                f"`{key}` of `{self.path}` is {shown}; a number is wanted",
                "write a decimal point" if comma else None,
            )
            return None
        if not low <= value <= high:
            self._wrong(
                own,
                node,
                f"`{key}` of `{self.path}` is {value:g}; it must be from {low:g} to {high:g}",
            )
            return None
        self.account.placed(own, to)
        return value

    def integer(self, key: str, to: str, *, low: int, high: int) -> int | None:
        """A whole number within bounds, both included; ``None`` where missing or at fault."""
        value = self.number(key, to, low=-1e9, high=1e9)
        if value is None:
            return None
        if value != round(value) or not low <= value <= high:
            self._wrong(
                (*self.key, key),
                self.node.get(key) or self.node,
                f"`{key}` of `{self.path}` is {value:g}; "
                f"it must be a whole number from {low} to {high}",
            )
            return None
        return int(value)

    def boolean(self, key: str, to: str) -> bool | None:
        """A truth value in any of YAML 1.1's words; ``None`` where missing or at fault."""
        node = self.node.get(key)
        if node is None or node.value is None or node.value == "":
            self.account.placed((*self.key, key), "empty")
            return None
        text = str(node.value).strip().lower() if not isinstance(node.value, (dict, tuple)) else ""
        if text in _TRUE or text in _FALSE:
            self.account.placed((*self.key, key), to)
            return text in _TRUE
        self._wrong(
            (*self.key, key), node, f"`{key}` of `{self.path}` is no truth value", "true or false"
        )
        return None

    def text(self, key: str, to: str) -> str | None:
        node = self.node.get(key)
        if node is None or isinstance(node.value, (dict, tuple)):
            return None
        self.account.placed((*self.key, key), to)
        return str(node.value).strip() if node.value is not None else None

    def leave_out(self, key: str, why: str) -> None:
        """The value has no place in a robot.yaml, for this reason."""
        node = self.node.get(key)
        if node is not None:
            self.account.leave_out((*self.key, key), node, why)

    def fault(self, code: str, message: str, key: str = "", hint: str | None = None) -> None:
        """Report a fault of the entry or of one of its keys."""
        own = (*self.key, key) if key else self.key
        self.report.add(code, message, self.span(key) if key else self.node.where, hint=hint)
        self.account.reported(own, message)

    def _wrong(self, key: Key, node: Node, message: str, hint: str | None = None) -> None:
        self.report.add("import-value", message, node.span, hint=hint)
        self.account.fates.pop(key, None)
        self.account.reported(key, message)


def _number(node: Node) -> float | None:
    """A finite number, as ROS 1 reads it: YAML 1.1's forms, ``deg(90)``, ``rad(pi/2)``."""
    if not isinstance(node.value, str):
        return None
    text = node.value.strip().replace("_", "")
    angle = _ANGLE.fullmatch(text)
    if angle is not None:
        factor = math.pi / 180 if angle[1] == "deg" else 1.0
        inner = re.fullmatch(r"(-?)(?:([\d.]+)\*)?pi(?:/([\d.]+))?", angle[2].replace(" ", ""))
        if inner is not None:
            parts = [float(p) if p and _NUMBER.fullmatch(p) else 1.0 for p in inner.groups()[1:]]
            if parts[1] == 0.0:
                return None
            return factor * (-1 if inner[1] else 1) * parts[0] * math.pi / parts[1]
        return factor * float(angle[2]) if _NUMBER.fullmatch(angle[2]) else None
    if not node.quoted and re.fullmatch(r"[-+]?0[0-7]+", text):
        return float(int(text, 8))  # what YAML 1.1 makes of a leading zero
    if re.fullmatch(r"0x[0-9a-fA-F]{1,8}", text):
        return float(int(text, 16))
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


# -- the file --------------------------------------------------------------------------


def read_original(path: Path, display: str, report: Report) -> Node | None:
    """The file as a tree of mappings, lists and texts; ``None`` with the fault reported."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
        return None
    except IsADirectoryError:
        report.add("file-is-a-directory", f"`{display}` is a folder", Span(display))
        return None
    except (OSError, ValueError) as fault:
        reason = (fault.strerror if isinstance(fault, OSError) else None) or str(fault)
        report.add("file-unreadable", f"`{display}` cannot be read: {reason}", Span(display))
        return None
    raw = compose(data, display, report)
    if raw is None:
        return None
    return _Tree(display, report).node(raw, None)


class _Tree:
    """PyYAML's nodes as ours, with YAML 1.1's merge keys and the last of double keys."""

    def __init__(self, display: str, report: Report) -> None:
        self.display = display
        self.report = report
        self.open: list[int] = []
        self.count = 0

    def node(self, raw: Any, key_span: Span | None) -> Node | None:
        span = self.span(raw)
        self.count += 1
        if id(raw) in self.open or self.count > MAX_VALUES:
            code = "yaml-recursive-alias" if id(raw) in self.open else "yaml-too-many-values"
            text = "an alias refers to a value that contains it"
            if code == "yaml-too-many-values":
                text = f"the file has more than {MAX_VALUES} values, aliases expanded"
            self.report.add(code, text, span)
            return None
        if raw.id == "scalar":
            quoted = bool(raw.style)
            empty = not quoted and raw.value in ("", "~", "null", "Null", "NULL")
            if raw.tag.endswith(("degrees", "radians")):
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
        merged: dict[str, Node] = {}
        own: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            where = self.span(raw_key)
            if raw_key.id != "scalar":
                self.report.add("yaml-key-not-text", "a list or mapping cannot be a key", where)
                continue
            child = self.node(raw_value, where)
            if child is None:
                continue
            if raw_key.value == "<<" and not raw_key.style:
                parts = child.value if isinstance(child.value, tuple) else (child,)
                for part in parts:
                    for key, value in (part.value if isinstance(part.value, dict) else {}).items():
                        merged.setdefault(key, value)
                continue
            key = raw_key.value
            if key in own:
                self.report.add(
                    "import-duplicate-key",
                    f"the key `{key}` occurs twice; the last one counts, as in ROS",
                    where,
                    labels=[Label(own[key].where, "first used here")],
                )
            own[key] = child
        return {**merged, **own}

    def span(self, raw: Any) -> Span:
        start, end = raw.start_mark, raw.end_mark
        return Span(self.display, start.line + 1, start.column + 1, end.line + 1, end.column + 1)
