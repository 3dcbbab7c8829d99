"""Variations of a scenario document: every combination of values, and draws from ranges."""

from __future__ import annotations

import hashlib
import itertools
import json
import random
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from thorvaldc.compiler.compilation import SETTING
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span

MOST = 100_000
"""More runs than these are a mistake."""
NOISE_SEED = "noise.seed"

# A number and what stands behind it: `-0.5 deg`.
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*([^\d\s.][^.]*?)?\s*", re.ASCII)
_RANGE = re.compile(rf"(\s*{_NUMBER}[^.]*?)\.\.({_NUMBER}.*)", re.ASCII)


class Change(NamedTuple):
    """The value at a path in place of what stands there; its ``where`` is that of the path."""

    path: str
    value: Node

    @property
    def text(self) -> str:
        """The value in a table."""
        plain = self.value.plain()
        if isinstance(plain, str):
            return plain
        return json.dumps(plain, separators=(", ", ": "), ensure_ascii=False)


@dataclass(frozen=True, slots=True)
class Varied:
    """What one path gets: ``choices``, or numbers of ``unit`` from ``least`` to ``most``."""

    path: str
    choices: tuple[Node, ...]
    least: float = 0.0
    most: float = 0.0
    unit: str = ""
    whole: bool = False
    span: Span | None = None

    def drawn(self, seed: int, draw: int) -> Node:
        """The value of a draw; it depends on nothing else."""
        said = f"{seed} {draw} {self.path}"
        chance = random.Random(hashlib.sha256(said.encode()).digest())
        if self.whole:
            return self._node(chance.randint(int(self.least), int(self.most)))
        return self._node(chance.uniform(self.least, self.most))

    def ends(self) -> tuple[Node, Node]:
        """The least and the largest value of a range."""
        return self._node(self.least), self._node(self.most)

    def _node(self, value: float) -> Node:
        number = int(value) if self.whole else value
        span = self.span or Span("")
        return Node(f"{number!r} {self.unit}" if self.unit else number, span, span)


@dataclass(frozen=True, slots=True)
class Variations:
    """What varies, how often the ranges are drawn from, and by which seed."""

    varied: tuple[Varied, ...]
    draws: int = 1
    seed: int = 0
    noise_seed: int | None = None

    @property
    def size(self) -> int:
        found = self.draws
        for one in self.varied:
            found *= max(len(one.choices), 1)
        return found

    def all(self) -> Iterator[tuple[Change, ...]]:
        """Every run's changes: combinations in order, the last value the fastest, then draws.

        A draw is the same for every combination.  Where there are several, a scenario's
        noise is drawn anew for each.
        """
        lists = [one for one in self.varied if one.choices]
        ranges = [one for one in self.varied if not one.choices]
        for values in itertools.product(*(one.choices for one in lists)):
            chosen = dict(zip((one.path for one in lists), values, strict=True))
            for draw in range(self.draws):
                drawn = {one.path: one.drawn(self.seed, draw) for one in ranges}
                here = {**chosen, **drawn}
                changes = [Change(one.path, here[one.path]) for one in self.varied]
                if self.noise_seed is not None and self.draws > 1 and NOISE_SEED not in here:
                    span = Span("")
                    changes.append(Change(NOISE_SEED, Node(self.noise_seed + draw, span, span)))
                yield tuple(changes)

    def single(self) -> Iterator[Change]:
        """Every value that a path gets, one by one; of ranges the ends."""
        for one in self.varied:
            for value in one.choices or one.ends():
                yield Change(one.path, value)


def read_variations(
    document: Node, settings: Sequence[str], draws: int | None, seed: int | None, report: Report
) -> Variations:
    """What a scenario's document says under ``variations``, and ``PATH=...`` of ``settings``.

    A setting is a list of values with commas or a range ``LOW..HIGH``; it takes the place
    of what the document says of the path, as do ``draws`` and ``seed``.
    """
    node = document.get("variations")
    vary = node.get("vary") if node is not None else None
    entries = vary.value if vary is not None and isinstance(vary.value, dict) else {}
    varied = {path: _varied(path, value, report) for path, value in entries.items()}
    for text in settings:
        path, _, values = text.partition("=")
        varied[path.strip()] = _setting(path.strip(), values, report)
    noise = document.get("noise")
    own = noise.get("seed") if noise is not None else None
    first = own.value if own is not None and isinstance(own.value, int) else 0
    found = Variations(
        tuple(one for one in varied.values() if one is not None),
        draws if draws is not None else _whole(node, "draws", 1),
        seed if seed is not None else _whole(node, "seed", 0),
        None if noise is None else first,
    )
    for change in found.single():
        changed(document, [change], report)
    if found.size > MOST:
        report.add(
            "out-of-range",
            f"there are {found.size} variations; there must be at most {MOST}",
            (node or document).where,
        )
    return found


def _varied(path: str, node: Node, report: Report) -> Varied | None:
    if isinstance(node.value, tuple):
        choices = tuple(value._replace(key_span=value.span) for value in node.value)
        return Varied(path, choices, span=node.where)
    low, high = node.get("min"), node.get("max")
    if low is None or high is None:
        return None
    return _range(path, str(low.value), str(high.value), node.where, report)


def _setting(path: str, text: str, report: Report) -> Varied | None:
    name = f"{SETTING}{path}"
    ends = _RANGE.fullmatch(text)
    if ends is not None:
        return _range(path, ends[1], ends[2], Span(name), report)
    said = Report()
    node = read_text(f"[{text}]".encode(), name, said)
    values = node.value if node is not None else None
    if said.has_errors or not isinstance(values, tuple) or not values:
        report.add(
            "variation-value",
            f"`{text}` is no list of values",
            Span(name),
            hint="values with commas between them, or a range such as 0.3..0.9",
        )
        return None
    span = Span(name)
    return Varied(path, tuple(_at(value, span) for value in values), span=span)


def _at(node: Node, span: Span) -> Node:
    """The node as if all of it stood at ``span``: on the command line there are no lines."""
    value = node.value
    if isinstance(value, dict):
        value = {key: _at(entry, span) for key, entry in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_at(entry, span) for entry in value)
    return Node(value, span, span, node.quoted)


def _range(path: str, low: str, high: str, span: Span, report: Report) -> Varied | None:
    first, last = _QUANTITY.fullmatch(low), _QUANTITY.fullmatch(high)
    if first is None or last is None:
        wrong = low if first is None else high
        report.add(
            "variation-value",
            f"`{wrong}` is no end of a range of `{path}`; it must be a number, with its unit",
            span,
        )
        return None
    least, most = float(first[1]), float(last[1])
    units = [unit or "" for unit in (first[2], last[2])]
    if least == 0.0 and not units[0]:
        units[0] = units[1]
    if most == 0.0 and not units[1]:
        units[1] = units[0]
    if units[0] != units[1]:
        report.add(
            "variation-value",
            f"the range of `{path}` is from {low.strip()} to {high.strip()}, in two units",
            span,
            hint="give both ends in the same unit",
        )
        return None
    if not least < most:
        report.add(
            "variation-value",
            f"the range of `{path}` is from {low.strip()} to {high.strip()}; "
            "its end must be more than its beginning",
            span,
        )
        return None
    whole = not units[0] and all(re.fullmatch(r"\s*[-+]?\d+\s*", text) for text in (low, high))
    return Varied(path, (), least, most, units[0], whole, span)


def _whole(node: Node | None, key: str, default: int) -> int:
    found = node.get(key) if node is not None else None
    return found.value if found is not None and isinstance(found.value, int) else default


def changed(document: Node, changes: Sequence[Change], report: Report) -> Node:
    """The document with other values at some paths; mappings on the way are made."""
    for change in changes:
        document = _put(document, change.path.split("."), change, report)
    return document


def without_variations(document: Node) -> Node:
    """The document without its own variations."""
    if not isinstance(document.value, dict):
        return document
    rest = {key: node for key, node in document.value.items() if key != "variations"}
    return document._replace(value=rest)


def _put(node: Node, steps: Sequence[str], change: Change, report: Report) -> Node:
    if not steps:
        return change.value
    step, inner = steps[0], node.value
    if isinstance(inner, dict):
        below = inner.get(step, Node({}, change.value.span, change.value.where))
        return node._replace(value={**inner, step: _put(below, steps[1:], change, report)})
    if isinstance(inner, tuple) and step.isascii() and step.isdigit() and int(step) < len(inner):
        number = int(step)
        entry = _put(inner[number], steps[1:], change, report)
        return node._replace(value=(*inner[:number], entry, *inner[number + 1 :]))
    what = "a list" if isinstance(inner, tuple) else "a single value"
    hint = None
    if isinstance(inner, tuple):
        what = f"a list of {len(inner)}"
        hint = f"its entries are 0 to {len(inner) - 1}" if inner else None
    report.add(
        "variation-path",
        f"`{change.path}` leads nowhere: `{step}` is looked for in {what}",
        change.value.where,
        hint=hint,
    )
    return node
