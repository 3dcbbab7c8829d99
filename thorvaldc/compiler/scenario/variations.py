"""Creates variations of a scenario document.

A scenario is run with all combinations of listed values and with random values from ranges.
"""

from __future__ import annotations

import hashlib
import itertools
import random
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.overrides import SETTING, Change, with_changes, with_span
from thorvaldc.compiler.source.reader import read_file, read_text
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report, Span

MAX_RUNS = 100_000
NOISE_SEED = "noise.seed"

# A quantity is a number with an optional unit, for example `-0.5 deg`.
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*([^\d\s.][^.]*?)?\s*", re.ASCII)
_RANGE = re.compile(rf"(\s*{_NUMBER}[^.]*?)\.\.({_NUMBER}.*)", re.ASCII)


@dataclass(frozen=True, slots=True)
class VariedPath:
    """The values that one entry of a scenario document gets in the runs of a scenario.

    The values of a varied entry are given as a list or as a range.

    Attributes
    ----------
    path : dotted path of the entry.
    choices : listed values.  Empty for a range.
    least : lower limit of the range.
    most : upper limit of the range.
    unit : unit of the limits.
    whole : if true, only whole numbers are drawn from the range.
    span : span of the list or range.
    """

    path: str
    choices: tuple[Node, ...]
    least: float = 0.0
    most: float = 0.0
    unit: str = ""
    whole: bool = False
    span: Span | None = None

    def draw(self, seed: int, number: int) -> Node:
        """Returns a random value from the range of the varied entry.

        The random value depends only on ``seed``, on ``number`` (the number of the random draw) and
        on the path in the document.  The random values of other paths therefore do not change the
        random value.
        """
        key = f"{seed} {number} {self.path}"
        generator = random.Random(hashlib.sha256(key.encode()).digest())
        if self.whole:
            return self._node(generator.randint(int(self.least), int(self.most)))
        return self._node(generator.uniform(self.least, self.most))

    def limits(self) -> tuple[Node, Node]:
        """Returns the least and the greatest value of the range."""
        return self._node(self.least), self._node(self.most)

    def _node(self, value: float) -> Node:
        number = int(value) if self.whole else value
        span = self.span or Span("")
        return Node(f"{number!r} {self.unit}" if self.unit else number, span, span)


@dataclass(frozen=True, slots=True)
class Variations:
    """All variations of a scenario document.

    Attributes
    ----------
    varied : the varied paths with their values.
    draws : number of random draws from the ranges.
    seed : seed of the random draws.
    noise_seed : seed of the sensor noise in the scenario, or ``None`` for a scenario without noise.
    """

    varied: tuple[VariedPath, ...]
    draws: int = 1
    seed: int = 0
    noise_seed: int | None = None

    @property
    def size(self) -> int:
        """Number of runs of the scenario with all variations."""
        size = self.draws
        for varied in self.varied:
            size *= max(len(varied.choices), 1)
        return size

    def runs(self) -> Iterator[tuple[Change, ...]]:
        """Yields the changes of the scenario document for each run.

        The combinations of listed values are yielded in order, and the value of the last path
        changes first.  Each combination of listed values is run with every random draw.  Each
        random draw has the same random values in all combinations.  With several random draws, each
        random draw has a different seed of the sensor noise.
        """
        lists = [varied for varied in self.varied if varied.choices]
        ranges = [varied for varied in self.varied if not varied.choices]
        for values in itertools.product(*(varied.choices for varied in lists)):
            chosen = dict(zip((varied.path for varied in lists), values, strict=True))
            for number in range(self.draws):
                drawn = {varied.path: varied.draw(self.seed, number) for varied in ranges}
                value_by_path = {**chosen, **drawn}
                changes = [Change(v.path, value_by_path[v.path]) for v in self.varied]
                is_varied = NOISE_SEED in value_by_path
                if self.noise_seed is not None and self.draws > 1 and not is_varied:
                    span = Span("")
                    changes.append(Change(NOISE_SEED, Node(self.noise_seed + number, span, span)))
                yield tuple(changes)

    def single_changes(self) -> Iterator[Change]:
        """Yields a change for each listed value and for each limit of a range."""
        for varied in self.varied:
            for value in varied.choices or varied.limits():
                yield Change(varied.path, value)


def read_variations(
    document: Node, settings: Sequence[str], draws: int | None, seed: int | None, report: Report
) -> Variations:
    """Reads the section ``variations`` of a scenario document and options of the command line.

    Parameters
    ----------
    document : the scenario document.
    settings : texts of the form ``PATH=VALUES``.  The values are separated by commas, or the
        values are a range ``LOW..HIGH``.  A setting replaces the values of the path in the
        document.
    draws : number of random draws, or ``None`` for the number in the document.
    seed : seed of the random draws, or ``None`` for the seed in the document.
    report : collects the diagnostics.
    """
    node = document.get("variations")
    vary = node.get("vary") if node is not None else None
    varied = {path: _read_values(path, value, report) for path, value in entries(vary).items()}
    for text in settings:
        path, _, values = text.partition("=")
        varied[path.strip()] = _read_setting(path.strip(), values, report)
    noise = document.get("noise")
    variations = Variations(
        tuple(varied_path for varied_path in varied.values() if varied_path is not None),
        draws if draws is not None else _integer(node, "draws", 1),
        seed if seed is not None else _integer(node, "seed", 0),
        None if noise is None else _integer(noise, "seed", 0),
    )
    for change in variations.single_changes():
        with_changes(document, [change], report)
    if variations.size > MAX_RUNS:
        report.add(
            "out-of-range",
            f"there are {variations.size} variations; there must be at most {MAX_RUNS}",
            (node or document).where,
        )
    return variations


def _read_values(path: str, node: Node, report: Report) -> VariedPath | None:
    """Reads the values of a path in the section `vary` of a scenario document.

    The section `vary` contains for each path a list of values, or a range with the keys `min` and
    `max`.
    """
    if isinstance(node.value, tuple):
        choices = tuple(value._replace(key_span=value.span) for value in node.value)
        return VariedPath(path, choices, span=node.where)
    low, high = node.get("min"), node.get("max")
    if low is None or high is None:
        return None
    return read_range(path, str(low.value), str(high.value), node.where, report)


def _read_setting(path: str, text: str, report: Report) -> VariedPath | None:
    """Reads the values of a path from a command line option, which contains YAML text."""
    span = Span(f"{SETTING}{path}")
    limits = _RANGE.fullmatch(text)
    if limits is not None:
        return read_range(path, limits[1], limits[2], span, report)
    yaml_report = Report()
    node = read_text(f"[{text}]".encode(), span.file, yaml_report)
    values = node.value if node is not None else None
    if yaml_report.has_errors or not isinstance(values, tuple) or not values:
        report.add(
            "variation-value",
            f"`{text}` is not a list of values",
            span,
            hint="separate values by commas, or write a range such as 0.3..0.9",
        )
        return None
    return VariedPath(path, tuple(with_span(value, span) for value in values), span=span)


def read_range(path: str, low: str, high: str, span: Span, report: Report) -> VariedPath | None:
    """Reads the two limits of a range of values.

    Both limits of the range must have the same unit.  A limit of 0 needs no unit.
    """
    first, last = _QUANTITY.fullmatch(low), _QUANTITY.fullmatch(high)
    if first is None or last is None:
        invalid = low if first is None else high
        report.add(
            "variation-value",
            f"`{invalid}` is not a limit of a range of `{path}`; "
            "it must be a number, with its unit",
            span,
        )
        return None
    least, most = float(first[1]), float(last[1])
    low_unit, high_unit = first[2] or "", last[2] or ""
    if least == 0.0 and not low_unit:
        low_unit = high_unit
    if most == 0.0 and not high_unit:
        high_unit = low_unit
    range_text = f"the range of `{path}` is from {low.strip()} to {high.strip()}"
    if low_unit != high_unit:
        report.add(
            "variation-value",
            f"{range_text}, in two units",
            span,
            hint="give both limits in the same unit",
        )
        return None
    if not least < most:
        report.add(
            "variation-value", f"{range_text}; its end must be more than its beginning", span
        )
        return None
    whole = not low_unit and all(re.fullmatch(r"\s*[-+]?\d+\s*", text) for text in (low, high))
    return VariedPath(path, (), least, most, low_unit, whole, span)


def _integer(node: Node | None, key: str, default: int) -> int:
    entry = node.get(key) if node is not None else None
    return entry.value if entry is not None and isinstance(entry.value, int) else default


def without_variations(document: Node) -> Node:
    """Returns the scenario document without the section ``variations``."""
    if not isinstance(document.value, dict):
        return document
    rest = {key: node for key, node in document.value.items() if key != "variations"}
    return document._replace(value=rest)


def plan_variations(
    path: Path | str,
    settings: Sequence[str] = (),
    draws: int | None = None,
    seed: int | None = None,
    *,
    from_document: bool = True,
    report: Report,
) -> Variations | None:
    """Returns the variations of a scenario.

    The scenario document and the argument ``settings`` define the variations.  With
    ``from_document=False`` only ``settings`` defines the variations.  Returns ``None`` if the file
    is not a scenario.  The function ``read_variations`` describes the arguments ``settings``,
    ``draws`` and ``seed``.
    """
    document_report = Report()  # compile_file reports these problems again, so they are dropped
    document = read_file(Path(path), str(path), document_report)
    if document is None:
        report.extend(document_report)
        return Variations(())
    if document.get("scenario") is None:
        return None
    check(document, "scenario", document_report)
    document = without_invalid_values(document, document_report)
    if not from_document:
        document = without_variations(document)
    return read_variations(document, settings, draws, seed, report)
