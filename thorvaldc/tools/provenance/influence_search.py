"""Finds the values of documents that influence one number of a robot, by group tests.

All values of the documents are changed at once, each by its own small amount.  If the number stays
the same, none of them influences it.  Otherwise both halves of the group are tested.  For k
influences among n values this takes about k log2(n) compilations instead of n.

The relative changes differ from value to value, so that two influences do not cancel each other.
An influence is local: the branch of ``max`` or ``if`` that is not taken has none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.source.units import parse_any
from thorvaldc.diagnostics import Diagnostic, Span
from thorvaldc.model import Robot
from thorvaldc.tools.provenance.robot_probe import RobotProbe
from thorvaldc.tools.provenance.source_values import SourceValue, incremented, scaled

SMALL_CHANGE = 1e-4
"""Relative change of a value for a number that follows continuously."""
LARGE_CHANGE = 0.05
"""Relative change of a value for an integer, which rounding would hide."""
INTEGER_STEPS = (1, 9, 50)
"""Changes of an integer; a changed node id may be that of another node, or too large."""
MOST_WITH_EXPRESSIONS = 8
"""Most sources of a number whose expressions are searched as well."""

MOST_SECTIONS = 2
"""Number of sections around a value in which an error refuses the value."""

Observe = Callable[[Robot], Any]
"""Function that returns the observed value of a robot, or ``None`` if there is no such value."""


@dataclass(frozen=True)
class Influence:
    """A value of a document that influences the observed number.

    Attributes
    ----------
    source : the value in the document.
    effect : relative change of the number for a relative change of the source: 1 if the number is
        proportional to the source.  ``None`` if one of the two is 0, an integer or no number.
    """

    source: SourceValue
    effect: float | None


@dataclass(frozen=True)
class SearchResult:
    """Influences on a number.

    Attributes
    ----------
    influences : in the order of the documents.
    is_complete : false if the search ended at the limit of compilations.
    """

    influences: list[Influence]
    is_complete: bool


class InfluenceSearch:
    """The search for the influences on one number."""

    def __init__(self, probe: RobotProbe, observe: Observe, most_compilations: int) -> None:
        self.probe = probe
        self.observe = observe
        robot, _ = probe.compile({})
        assert robot is not None, "the robot was compiled before"
        self.value = observe(robot)
        is_integer = isinstance(self.value, int) and not isinstance(self.value, bool)
        self.change = LARGE_CHANGE if is_integer else SMALL_CHANGE
        self._limit = probe.count + most_compilations
        self._influences: list[Influence] = []

    def run(self, values: Sequence[SourceValue]) -> SearchResult:
        """Returns the values that influence the number, in the order of ``values``.

        Expressions are searched only if the number has few sources: they are steps on the way
        from a source to the number, and a sum over the robot has hundreds of them.
        """
        constants = [value for value in values if not value.is_expression]
        accepted = self._search(self._scaled(constants))
        # A factor of 2 leaves whole milliseconds and whole numbers whole.
        refused = [value for value in constants if value not in accepted]
        self._search({value: scaled(value.node.value, 1.0) for value in refused})
        known = {influence.source for influence in self._influences}
        integers = [value for value in constants if value.is_integer and value not in known]
        for step in INTEGER_STEPS:
            changes = {value: incremented(value.node.value, step) for value in integers}
            accepted = self._search(changes)
            integers = [value for value in integers if value not in accepted]
        if len(self._influences) <= MOST_WITH_EXPRESSIONS:
            self._search(self._scaled([value for value in values if value.is_expression]))
        order = {value: number for number, value in enumerate(values)}
        self._influences.sort(key=lambda influence: order[influence.source])
        return SearchResult(self._influences, not self._is_over)

    def _search(self, changes: dict[SourceValue, Any]) -> dict[SourceValue, Any]:
        """Adds the influences among some changes, and returns the changes that are no errors."""
        accepted = self._accepted(changes)
        self._split(list(accepted.items()))
        return accepted

    @property
    def _is_over(self) -> bool:
        return self.probe.count >= self._limit

    def _scaled(self, values: Sequence[SourceValue]) -> dict[SourceValue, Any]:
        # The golden ratio spreads the changes evenly between 1 and 2 times the least change.
        return {
            value: scaled(value.node.value, self.change * (1.0 + number * 0.6180339887 % 1.0))
            for number, value in enumerate(values)
        }

    def _accepted(self, changes: dict[SourceValue, Any]) -> dict[SourceValue, Any]:
        """Returns the changes that compile without errors.

        One compilation reports all errors of a stage with the spans of the values, so that few
        compilations remove all values that cannot be scaled, such as ids and expressions with a
        text.
        """
        accepted = dict(changes)
        while accepted and not self._is_over:
            robot, errors = self.probe.compile(accepted)
            if robot is not None:
                return accepted
            refused = _refused(accepted, errors)
            if not refused:
                # The error is where two values meet.
                return self._accepted_by_halves(accepted)
            for value in refused:
                del accepted[value]
        return accepted

    def _accepted_by_halves(self, changes: dict[SourceValue, Any]) -> dict[SourceValue, Any]:
        if len(changes) == 1 or self._is_over:
            return {}
        items = list(changes.items())
        middle = len(items) // 2
        halves = [self._accepted(dict(items[:middle])), self._accepted(dict(items[middle:]))]
        return {**halves[0], **halves[1]}

    def _split(self, changes: list[tuple[SourceValue, Any]], *, is_known: bool = False) -> bool:
        """Adds the influences among some changes to the result.

        ``is_known``: whether an influence is among the changes.  Returns whether there is one.
        """
        if not changes or self._is_over:
            return False
        if not is_known or len(changes) == 1:
            robot, _ = self.probe.compile(dict(changes))
            observed = self.observe(robot) if robot is not None else None
            if robot is not None and observed == self.value:
                return False
            if len(changes) == 1:
                if robot is None:
                    return self._try_alone(changes[0][0])
                effect = self._effect(changes[0], observed)
                self._influences.append(Influence(changes[0][0], effect))
                return True
        middle = len(changes) // 2
        is_in_first = self._split(changes[:middle])
        # Without an influence in the first half, there must be one in the second half.
        self._split(changes[middle:], is_known=not is_in_first)
        return True

    def _try_alone(self, value: SourceValue) -> bool:
        """Tests an integer whose first change is an error without the others, such as a node id."""
        for step in INTEGER_STEPS[1:] if value.is_integer else ():
            robot, _ = self.probe.compile({value: incremented(value.node.value, step)})
            if robot is not None:
                if self.observe(robot) == self.value:
                    return False
                self._influences.append(Influence(value, None))
                return True
        return False

    def _effect(self, change: tuple[SourceValue, Any], observed: Any) -> float | None:
        value, new = change
        return relative_effect(value, _relative_change(value, new), self.value, observed)

    def robots_with_other_numbers(self, values: Sequence[SourceValue]) -> Iterator[Robot]:
        """Yields the robot with other integers, and with all other numbers scaled.

        Only numbers that can be changed together are changed.
        """
        constants = [value for value in values if not value.is_expression]
        integers = [value for value in constants if value.is_integer]
        for changes in (
            {value: incremented(value.node.value, 1) for value in integers},
            self._scaled(constants),
        ):
            robot, _ = self.probe.compile(self._accepted(changes))
            if robot is not None:
                yield robot


def relative_effect(source: SourceValue, change: float, before: Any, after: Any) -> float | None:
    """Returns the relative change of a number per relative change ``change`` of its source.

    Returns ``None`` for a source of 0, and for a number that is 0 or is no number.
    """
    is_zero = not change or (isinstance(source.node.value, int | float) and not source.node.value)
    if is_zero or not (_is_number(before) and _is_number(after) and before):
        return None
    return float((after - before) / before / change)


def _relative_change(value: SourceValue, new: Any) -> float:
    old = value.node.value
    if isinstance(old, int | float):
        return float((new - old) / old) if old else 0.0
    return _factor_of(value, new)


def _factor_of(value: SourceValue, new: str) -> float:
    """Returns the relative change of a quantity or an expression from its texts."""
    old = str(value.node.value)
    if old.startswith("${"):
        return float(new[new.rindex("*") + 1 : -1]) - 1.0
    first = float(parse_any(old))
    return float(parse_any(new)) / first - 1.0 if first else 0.0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _refused(values: Iterable[SourceValue], errors: Iterable[Diagnostic]) -> list[SourceValue]:
    """Returns the values at the places of errors; if there are none, those of their sections; if
    there are none, those of the documents of modules with errors.

    The span of an error in a module is the module in the robot file, and a label has its place in
    the document of the module.
    """
    places: set[tuple[str, int, int]] = set()
    sections: set[tuple[str, int, int]] = set()
    files: set[str] = set()
    for error in errors:
        labels = [_place(label.span) for label in error.labels]
        own = [_place(error.span)] if error.span is not None else []
        places.update(own, labels)
        sections.update(labels or own)
        files.update(label.span.file for label in error.labels)
    values = list(values)
    refused = [
        value
        for value in values
        if _place(value.span) in places
        or (value.node.key_span is not None and _place(value.node.key_span) in places)
    ]
    refused = refused or [
        value
        for value in values
        if any(_place(span) in sections for span in value.sections[:MOST_SECTIONS])
    ]
    return refused or [value for value in values if value.span.file in files]


def _place(span: Span) -> tuple[str, int, int]:
    return span.file, span.line, span.column
