"""Finds the values of documents that influence one number of a robot, by group tests.

All values of the documents are changed at once, each by its own small amount.  If the number stays
the same, none of them influences it.  Otherwise both halves of the group are tested.  For k
influences among n values this takes about k log2(n) compilations instead of n.

The relative changes differ from value to value, so that two influences do not cancel each other.
An influence is local: the branch of ``max`` or ``if`` that is not taken has none.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from thorvaldc.compiler.elaborate import elaborate
from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.pipeline import library_folders_of, many_compilations, read_robot_lock
from thorvaldc.compiler.result import Compilation, SourceFile
from thorvaldc.compiler.robot_settings.robot_sections import read_design
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import Diagnostic, Report, Span
from thorvaldc.model import Robot

# -- numbers and expressions in the documents of a robot --------------------------------

Key = str | int
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
# Keys whose values are text for readers, or the version of the language.
_TEXT_KEYS = ("description", "source", "thorvaldc", "name", "color")


@dataclass(frozen=True)
class SourceValue:
    """A number or an expression in a document of the robot.

    Attributes
    ----------
    keys : keys and list indices from the root of the document to the value.
    node : the YAML node with the span of the value.
    sections : spans of the keys of the sections that contain the value, the innermost first.
    """

    keys: tuple[Key, ...]
    node: Node
    sections: tuple[Span, ...] = ()

    @property
    def span(self) -> Span:
        return self.node.span

    @property
    def is_expression(self) -> bool:
        return isinstance(self.node.value, str) and "${" in self.node.value

    @property
    def is_integer(self) -> bool:
        return isinstance(self.node.value, int)

    @property
    def key_path(self) -> str:
        """Text of the position, such as ``links.body.parts[0].mass``."""
        return key_text(self.keys)


def key_text(keys: Iterable[Key]) -> str:
    """Returns keys and indices as text, such as ``links.body.parts[0].mass``."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else key
    return text


def all_nodes(
    node: Node, keys: tuple[Key, ...] = (), sections: tuple[Span, ...] = ()
) -> Iterator[SourceValue]:
    """Yields all nodes of a document, a mapping or list before its content."""
    yield SourceValue(keys, node, sections)
    for key, item in node.children():
        yield from all_nodes(item, (*keys, key), (node.where, *sections))


def source_values(document: Node) -> Iterator[SourceValue]:
    """Yields the numbers, quantities and expressions of a document."""
    for value in all_nodes(document):
        if _is_numeric(value.node) and not any(key in _TEXT_KEYS for key in value.keys):
            yield value


def _is_numeric(node: Node) -> bool:
    value = node.value
    if isinstance(value, bool) or value is None:
        return False
    if isinstance(value, int | float):
        return not node.quoted
    if not isinstance(value, str):
        return False
    if value.startswith("${") and value.endswith("}"):
        return True
    if not _NUMBER.match(value):
        return False
    try:
        parse_any(value)
    except UnitError:
        return False
    return True


def incremented(value: Any, step: int) -> Any:
    """Returns an integer value of a node, changed by ``step``."""
    return value + step


def scaled(value: Any, change: float) -> Any:
    """Returns the value of a node, changed by the relative amount ``change``.

    A value of 0 becomes ``change`` in its own unit.
    """
    if isinstance(value, int | float):
        return value * (1.0 + change) if value else change
    if value.startswith("${"):
        return f"${{({value[2:-1]}) * {1.0 + change!r}}}"
    match = _NUMBER.match(value)
    number = float(match[1]) if match else 0.0
    new = number * (1.0 + change) if number else change
    return f"{new!r}{value[match.end() :] if match else ''}"


def with_values(document: Node, values: Iterable[tuple[tuple[Key, ...], Any]]) -> Node:
    """Returns a copy of a document in which the values at some keys are replaced."""
    tree: dict[Any, Any] = {}
    for keys, value in values:
        branch = tree
        for key in keys[:-1]:
            branch = branch.setdefault(key, {})
        branch[keys[-1]] = _Leaf(value)
    return _rebuilt(document, tree) if tree else document


@dataclass(frozen=True)
class _Leaf:
    value: Any


def _rebuilt(node: Node, tree: Any) -> Node:
    if isinstance(tree, _Leaf):
        return node._replace(value=tree.value)
    if isinstance(node.value, dict):
        changed = {key: _rebuilt(node.value[key], branch) for key, branch in tree.items()}
        return node._replace(value={**node.value, **changed})
    items = list(node.value) if isinstance(node.value, tuple) else []
    for index, branch in tree.items():
        items[index] = _rebuilt(items[index], branch)
    return node._replace(value=tuple(items))


# -- the robot with other values in its documents ---------------------------------------

Changes = Mapping[SourceValue, Any]
"""New values of nodes."""


class _ChangedLibrary(Library):
    """A library in which documents of module types have changed values."""

    def __init__(
        self,
        folders: Sequence[tuple[Path, str]],
        changes: Mapping[str, list[tuple[tuple[Key, ...], Any]]],
    ) -> None:
        super().__init__(folders)
        self._changes = changes
        self._changed: dict[str, ModuleType] = {}

    def load(self, name: str, node: Node, report: Report) -> ModuleType | None:
        if name in self._changed:
            return self._changed[name]
        module = super().load(name, node, report)
        if module is None or module.display not in self._changes:
            return module
        document = with_values(module.document, self._changes[module.display])
        self._changed[name] = replace(module, document=document)
        return self._changed[name]


class RobotProbe:
    """One robot file, compiled with changed values.

    The stages after the reading of the files are those of ``compile_robot``; the checks of the
    finished model are left out, because they change nothing in it.

    Parameters
    ----------
    path : path of the robot file, which has no errors.
    library : additional folders with modules.
    trust : whether xacro files are expanded without restrictions.
    on_compilation : called with the number of compilations, for a display of the progress.
    stack : temporary files and worker processes end when the stack is closed.
    """

    def __init__(self, path: Path, library: Sequence[Path], trust: bool, stack: ExitStack) -> None:
        stack.enter_context(many_compilations())
        self.path = path
        self.trust = trust
        self.count = 0
        self.on_compilation: Callable[[int], None] = lambda count: None
        self.source = SourceFile(path, path.name, path.parent)
        document = self.source.document
        assert document is not None, "the file was compiled before"
        self.document = self.source.check_shape(document)
        report = Report()
        self.folders = library_folders_of(self.document, path.parent, library, report)
        self._lock = read_robot_lock(self.source, Compilation.of(self.source), report)
        self._temporary = stack.enter_context(tempfile.TemporaryDirectory(prefix="thorvaldc-why-"))

    @cached_property
    def instances(self) -> Instance:
        """The tree of module instances without changes."""
        return Resolver(Library(self.folders), Report()).resolve(self.document)

    @cached_property
    def documents(self) -> dict[str, Node]:
        """The documents of the robot by their name in spans: robot file, calibration, modules."""
        library = Library(self.folders)
        used: dict[str, Node] = {self.source.name: self.document}
        calibration = self._calibration()
        if calibration is not None:
            used[str(self._calibration_name())] = calibration
        Resolver(library, Report()).resolve(self.document)
        for name in library.names():
            module = library._types.get(name)
            if module is not None:
                used[module.display] = module.document
        return used

    def values(self) -> list[SourceValue]:
        """Returns the numbers and expressions of all documents, in the order of the documents."""
        return [value for document in self.documents.values() for value in source_values(document)]

    def compile(self, changes: Changes) -> tuple[Robot | None, list[Diagnostic]]:
        """Compiles the robot with changed values.

        Returns the model, or ``None`` and the errors.
        """
        self.count += 1
        self.on_compilation(self.count)
        by_file: dict[str, list[tuple[tuple[Key, ...], Any]]] = {}
        for value, new in changes.items():
            by_file.setdefault(value.span.file, []).append((value.keys, new))
        document = with_values(self.document, by_file.get(self.source.name, ()))
        calibration = self._calibration_name()
        if calibration in by_file:
            document = self._with_calibration(document, by_file[str(calibration)])
        report = Report()
        resolver = Resolver(_ChangedLibrary(self.folders, by_file), report)
        robot = elaborate(
            document,
            resolver.resolve(document),
            resolver,
            self.path.parent,
            report,
            {},
            lock=self._lock,
            trust=self.trust,
        )
        design = read_design(document, report)
        if report.has_errors or robot is None:
            return None, report.errors
        return replace(robot, design_slope=design.slope), []

    def _calibration_name(self) -> str | None:
        node = self.document.get("calibration")
        return str(node.value) if node is not None else None

    def _calibration(self) -> Node | None:
        name = self._calibration_name()
        return read_file(self.path.parent / name, name, Report()) if name is not None else None

    def _with_calibration(
        self, document: Node, values: Iterable[tuple[tuple[Key, ...], Any]]
    ) -> Node:
        """Writes the calibration with changed values, and returns the robot document with it."""
        root = self._calibration()
        assert root is not None
        import yaml

        path = Path(self._temporary) / "calibration.yaml"
        text = yaml.safe_dump(with_values(root, values).plain(), sort_keys=False)
        path.write_text(text, encoding="utf-8")
        return with_values(document, [(("calibration",), str(path))])


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

    def run(self, values: Sequence[SourceValue]) -> list[Influence]:
        """Returns the values that influence the number, in the order of ``values``.

        The search ends early at the limit of compilations, see ``is_over``.
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
        return self._influences

    def _search(self, changes: dict[SourceValue, Any]) -> dict[SourceValue, Any]:
        """Adds the influences among some changes, and returns the changes that are no errors."""
        accepted = self._accepted(changes)
        self._split(list(accepted.items()))
        return accepted

    @property
    def is_over(self) -> bool:
        """Whether the search has reached the limit of compilations."""
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
        while accepted and not self.is_over:
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
        if len(changes) == 1 or self.is_over:
            return {}
        items = list(changes.items())
        middle = len(items) // 2
        halves = [self._accepted(dict(items[:middle])), self._accepted(dict(items[middle:]))]
        return {**halves[0], **halves[1]}

    def _split(self, changes: list[tuple[SourceValue, Any]], *, is_known: bool = False) -> bool:
        """Adds the influences among some changes to the result.

        ``is_known``: whether an influence is among the changes.  Returns whether there is one.
        """
        if not changes or self.is_over:
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
    if str(old).startswith("${"):
        return float(new[new.rindex("*") + 1 : -1]) - 1.0
    first = float(parse_any(str(old)))
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
