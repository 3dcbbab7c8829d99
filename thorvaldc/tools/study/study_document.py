"""Reads study files: the robot, the variables, the constraints, the scenarios and the objectives.

The robot and the scenarios are compiled with each listed value and each limit of a range alone, so
that wrong paths and values are errors in the line of the study file that has them.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thorvaldc.compiler.hardware.purchase_reader import MoneyError, parse_money
from thorvaldc.compiler.result import Compilation, Compile, SourceFile
from thorvaldc.compiler.scenario.fleet_compilation import open_named_file
from thorvaldc.compiler.scenario.scenario_compilation import compile_scenario, metric_units
from thorvaldc.compiler.source.node import Node, Value
from thorvaldc.compiler.source.overrides import Change, Range
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.compiler.values.document_section import read_document
from thorvaldc.compiler.values.value_reader import ValueReader, entries, items
from thorvaldc.diagnostics import Proposal, Report, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import fact_quantity, facts_document, robot_facts
from thorvaldc.schema import keys_of

COLUMNS = ("sample", "status", "code", "message", "design", "key")
"""Columns of the table of designs that do not depend on the study."""
MEASURE = "measure"
"""In place of a scenario: the numbers of the function that a program gives to the study."""
MAX_DESIGNS = 100_000
MAX_SEARCHED = 5_000
"""Greatest number of designs of a search: the time for a proposal grows with the number."""

_ALWAYS_WRONG = ("module-type-unknown", "param-unknown", "param-range", "variation-path")
"""Names of errors outside of the codes TV2xx that a value causes whatever the other values are."""

Design = tuple[Value, ...]
"""The value of each variable of a study, in the order of the study file."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A value of the robot file or of a scenario that differs between the designs.

    Attributes
    ----------
    paths : dotted paths of the values, of a scenario with its name before: ``go.world.friction``.
    choices : listed values.  Empty for a range.
    range : range of the values, or ``None`` for listed ones.
    """

    name: str
    paths: tuple[str, ...]
    choices: tuple[Value, ...]
    range: Range | None = None

    def at(self, fraction: float) -> Value:
        """Returns the value at a fraction from 0 to 1 of the range or of the listed values."""
        if self.range is not None:
            return self.range.at(fraction)
        return self.choices[min(int(fraction * len(self.choices)), len(self.choices) - 1)]

    def tested_values(self) -> tuple[Value, ...]:
        """Returns the listed values, or the limits of the range."""
        if self.range is not None:
            return (self.range.quantity(self.range.least), self.range.quantity(self.range.most))
        return self.choices


@dataclass(frozen=True, slots=True)
class Constraint:
    """Bounds for a fact in SI units.  ``None``: no bound."""

    name: str
    fact: str
    at_least: float | None
    at_most: float | None


@dataclass(frozen=True, slots=True)
class Objective:
    """A fact or a metric of a scenario that the best design minimises or maximises.

    Either ``fact`` or ``metric`` is empty.  A metric is ``SCENARIO.NAME``.
    """

    name: str
    fact: str
    metric: str
    maximise: bool

    @property
    def goal(self) -> str:
        return "maximise" if self.maximise else "minimise"

    def value_of(self, result: Mapping[str, Any]) -> float | None:
        """Returns the value of the objective from the result of a design, or ``None`` without."""
        if self.fact:
            value = result["facts"].get(self.fact)
        else:
            scenario, _, metric = self.metric.partition(".")
            value = (result["metrics"].get(scenario) or {}).get(metric)
        return None if value is None else float(value)


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """The content of a study file.

    Attributes
    ----------
    robot : path of the robot file.
    scenarios : name and path of each scenario file.
    method, number, seed, batch : the selection of the designs, as in the study file.
    currency : currency of the prices of the robot (ISO 4217), or empty.
    library, trust : see ``thorvaldc.compile``.
    files : path and SHA-256 of each file that a design can depend on.
    meshes : name and SHA-256 of each mesh of the robot.
    """

    name: str
    description: str
    robot: Path
    variables: tuple[Variable, ...]
    constraints: tuple[Constraint, ...]
    scenarios: tuple[tuple[str, Path], ...]
    objectives: tuple[Objective, ...]
    method: str
    number: int
    seed: int
    batch: int
    currency: str
    library: tuple[Path, ...] = ()
    trust: bool = False
    files: tuple[tuple[str, str], ...] = ()
    meshes: tuple[tuple[str, str], ...] = ()

    @property
    def facts(self) -> set[str]:
        """Paths of the facts that the study needs."""
        return {c.fact for c in self.constraints} | {o.fact for o in self.objectives if o.fact}

    def changes(self, design: Design, scenario: str = "") -> dict[str, Value]:
        """Returns the values of a design by their paths in the robot file or in a scenario."""
        names = [name for name, _ in self.scenarios]
        places = (
            (place_of(path, names), value)
            for variable, value in zip(self.variables, design, strict=True)
            for path in variable.paths
        )
        return {path: value for (owner, path), value in places if owner == scenario}

    def question(self) -> str:
        """Returns all that the result of a design depends on, except its values, as a hash."""
        folder = self.robot.parent
        scenarios = dict(self.scenarios)
        content: list[Any] = [[os.path.relpath(path, folder), sha] for path, sha in self.files]
        content += self.meshes
        content += [[name, os.path.relpath(path, folder)] for name, path in scenarios.items()]
        content += [[v.name, *v.paths] for v in self.variables]
        content += [[c.name, c.fact, c.at_least, c.at_most] for c in self.constraints]
        content += [[o.name, o.fact, o.metric] for o in self.objectives]
        return _hash(content)

    def identity(self) -> str:
        """Returns the question, the variables' values, the goals and the selection as a hash.

        A table of another study is not one to show or to take the best design from.
        """
        parts = (self.variables, self.objectives, self.method, self.seed)
        return _hash([self.question(), *map(repr, parts)])


def place_of(path: str, scenarios: Collection[str]) -> tuple[str, str]:
    """Returns the scenario that a path of a variable begins with, or ``""``, and the rest."""
    first, _, rest = path.partition(".")
    return (first, rest) if first in scenarios else ("", path)


def _hash(content: list[Any]) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def compile_study(source: SourceFile, compile_robot: Compile) -> Compilation:
    """Compiles a study file.

    ``compile_robot`` is the function that compiles the robot file.  The model of the returned
    compilation is the robot that the study names, its ``tool_document`` a ``StudyPlan``.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    if source.document is not None:
        document = source.check_shape(source.document)
        robot = _opened(source, document.get("robot"), "robot", "fleet-in-fleet", report)
        if robot is not None:
            part = parts[robot.name] = compile_robot(robot)
            if isinstance(part.model, Robot):
                reader = _StudyReader(source, document, robot, part, compile_robot, report)
                compilation.tool_document = reader.read(parts)
                compilation.model = part.model
                compilation.files.update(reader.tried_files)
    return compilation.complete(source, report, parts)


def _opened(
    source: SourceFile, node: Node | None, kind: str, code: str, report: Report
) -> SourceFile | None:
    """Opens the file of a kind that a node names.

    Returns ``None`` and reports an error, ``code`` for a file of another kind.
    """
    if node is None or not isinstance(node.value, str):
        return None
    opened = open_named_file(source, node, report)
    if opened is not None and opened.kind != kind:
        message = f"`{opened.name}` is a {opened.kind}; a {kind} is needed"
        report.add(code, message, node.span)
        return None
    return opened


def fact_values(document: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yields the path and value of each number in the facts about a robot."""
    if isinstance(document, bool):
        return
    if isinstance(document, int | float):
        yield path, document
    elif isinstance(document, dict | list):
        pairs = document.items() if isinstance(document, dict) else enumerate(document)
        for key, value in pairs:
            yield from fact_values(value, f"{path}.{key}" if path else str(key))


@dataclass
class _StudyReader:
    """Reads the sections of a study document."""

    source: SourceFile
    document: Node
    robot_source: SourceFile
    robot: Compilation
    compile_robot: Compile
    report: Report

    def __post_init__(self) -> None:
        assert isinstance(self.robot.model, Robot)
        self.facts_document = facts_document(robot_facts(self.robot.model))
        self.facts = dict(fact_values(self.facts_document))
        self.currency: str = self.facts_document["purchase"]["currency"]
        self.scenario_files: dict[str, SourceFile] = {}
        self.tried_files: dict[str, Path] = {}

    def read(self, parts: dict[str, Compilation]) -> StudyPlan:
        """Returns the study, and adds the compilations of the scenarios to ``parts``."""
        self._check_names()
        self._read_scenarios(parts)
        sections = read_document(self.document, "study", ValueReader(self.report))
        samples = sections["samples"]
        plan = StudyPlan(
            sections["study"],
            sections["description"],
            self.robot_source.path,
            tuple(self._variables()),
            tuple(self._constraints()),
            tuple((name, opened.path) for name, opened in self.scenario_files.items()),
            tuple(self._objectives()),
            samples["method"],
            samples["number"],
            samples["seed"],
            samples["batch"],
            self.currency,
        )
        self._check_size(plan)
        return plan

    def _check_names(self) -> None:
        """Checks that each column of the table of designs has its own name."""
        used = dict.fromkeys(COLUMNS, "a column of each table of designs")
        for section in ("variables", "constraints", "scenarios", "objectives"):
            for name, node in entries(self.document.get(section)).items():
                if section == "scenarios" and name in (
                    MEASURE,
                    *entries(self.robot_source.document),
                ):
                    used[name] = "a section of the robot file, in the paths of variables"
                if name in used:
                    self.report.add(
                        "study-name",
                        f"the name `{name}` is also {used[name]}",
                        node.where,
                        hint="choose another name",
                    )
                used[name] = f"in `{section}`"

    def _read_scenarios(self, parts: dict[str, Compilation]) -> None:
        for name, node in entries(self.document.get("scenarios")).items():
            named = node.get("scenario")
            opened = _opened(self.source, named, "scenario", "study-name", self.report)
            if opened is not None:
                self.scenario_files[name] = opened
                parts[opened.name] = self._compile_scenario(opened)

    def _compile_scenario(self, opened: SourceFile) -> Compilation:
        silent = replace(self.robot, report=Report())  # the diagnostics of the robot are known
        return compile_scenario(opened, lambda part: silent, self.robot_source.path)

    # -- variables ------------------------------------------------------------------

    def _variables(self) -> Iterator[Variable]:
        used: dict[str, str] = {}
        for name, node in entries(self.document.get("variables")).items():
            for path in items(node.get("paths")):
                if path.value in used:
                    message = f"`{path.value}` is also a path of `{used[str(path.value)]}`"
                    self.report.add("study-value", message, path.span)
                used[str(path.value)] = name
            least, most, choices = (node.get(key) for key in ("min", "max", "values"))
            has_range = least is not None and most is not None
            if has_range == (choices is not None) or (least is None) != (most is None):
                message = f"the variable `{name}` needs either `min` and `max`, or `values`"
                self.report.add("study-value", message, node.where)
                continue
            paths = tuple(str(path.value) for path in items(node.get("paths")))
            values = tuple(item.value for item in items(choices) if item.value is not None)
            limits = None
            if least is not None and most is not None:
                limits = Range.parse(str(least.value), str(most.value))
                if limits is None:
                    self.report.add(
                        "study-value",
                        f"`{least.value}` to `{most.value}` is no range of `{name}`",
                        node.where,
                        hint="a range has two numbers with the same unit, the smaller one first",
                    )
            if not values and limits is None:
                continue
            variable = Variable(name, paths, values, limits)
            if not self._check_paths(items(node.get("paths"))):
                continue
            tested = items(choices) or [Node(v, node.where) for v in variable.tested_values()]
            path_nodes = items(node.get("paths"))
            if all(self._is_possible(variable, value, path_nodes) for value in tested):
                yield variable

    def _check_paths(self, paths: tuple[Node, ...]) -> bool:
        """Checks that paths begin in the robot file or a scenario."""
        names = entries(self.document.get("scenarios"))
        known = (*names, *keys_of("robot"))
        for path in paths:
            text, first = str(path.value), str(path.value).partition(".")[0]
            if first not in known:
                near = did_you_mean(text, [text.replace(first, name, 1) for name in known], "")
                self.report.add(
                    "study-value",
                    f"`{first}` is neither a section of the robot file nor a scenario of the study",
                    path.span,
                    hint=near or None,
                )
                return False
            if first in names:
                if first not in self.scenario_files:
                    return False  # its file is missing, which is reported
                if re.fullmatch(r"\w+\.(fleet|robots\.\w+\.robot)", text):
                    message = (
                        f"`{text}` changes nothing: a design replaces the robots of a scenario"
                    )
                    self.report.add("study-value", message, path.span)
                    return False
        return True

    def _is_possible(self, variable: Variable, value: Node, paths: tuple[Node, ...]) -> bool:
        """Compiles the robot and the scenarios with a value of a variable.

        Reports what is wrong with a path or with the value, and returns whether nothing is.  What
        the value causes elsewhere may be right together with other values.
        """
        for name, base in (("", self.robot_source), *self.scenario_files.items()):
            changes = tuple(
                Change(place, Node(value.value, value.span, node.span))
                for path, node in zip(variable.paths, paths, strict=True)
                for owner, place in [place_of(path, self.scenario_files)]
                if owner == name
            )
            if not changes:
                continue
            source = SourceFile(base.path, base.name, base.folder)
            source.change(changes)
            tried = self._compile_scenario(source) if name else self.compile_robot(source)
            self.tried_files.update(tried.files)
            file = value.span.file
            for error in tried.report.errors:
                if (
                    error.span is None
                    or error.span.file != os.path.normpath(base.folder / file)
                    or not (error.code.number.startswith("TV2") or error.code.name in _ALWAYS_WRONG)
                ):
                    continue
                hint = error.hint
                if isinstance(hint, Proposal):  # without its span
                    hint = Proposal(str(hint), *hint.replacements, is_example=hint.is_example)
                self.report.add(
                    error.code.name, error.message, Span(file, *error.span[1:]), hint=hint
                )
                return False
        return True

    # -- constraints and objectives -----------------------------------------------------

    def _constraints(self) -> Iterator[Constraint]:
        for name, node in entries(self.document.get("constraints")).items():
            fact = self._fact(node.get("fact"))
            quantity = fact_quantity(fact).kind if fact else ""
            least, most = (self._bound(node.get(key), quantity) for key in ("at_least", "at_most"))
            if node.get("at_least") is None and node.get("at_most") is None:
                message = f"the constraint `{name}` needs `at_least` or `at_most`"
                self.report.add("study-value", message, node.where)
            elif least is not None and most is not None and least > most:
                message = f"no number is within the bounds of `{name}`"
                self.report.add("study-value", message, node.where)
            if fact:
                yield Constraint(name, fact, least, most)

    def _bound(self, node: Node | None, quantity: str) -> float | None:
        """Returns a bound in SI units, of a price in the currency of the robot.

        ``quantity``: kind of quantity of the fact, or empty if the fact is unknown.
        """
        if node is None or node.value is None:
            return None
        text = str(node.value)
        try:
            if quantity == si.MONEY.kind:
                money = parse_money(text)
                if money.currency != self.currency:
                    raise MoneyError(
                        f"the bound is in {money.currency}, and the robot has prices in"
                        f" {self.currency}",
                        f"write the bound in {self.currency}; no currency is converted",
                    )
                return money.amount
            if isinstance(node.value, int | float):
                return float(node.value)
            return parse_quantity(text, quantity) if quantity else parse_any(text)
        except UnitError as error:
            self.report.add(error.code, error.message, node.span, hint=error.hint)
        except MoneyError as error:
            self.report.add("price-invalid", str(error), node.span, hint=error.hint)
        return None

    def _objectives(self) -> Iterator[Objective]:
        known = [
            f"{s}.{m}" for s in entries(self.document.get("scenarios")) for m in metric_units()
        ]
        for name, node in entries(self.document.get("objectives")).items():
            fact, metric, goal = (node.get(key) for key in ("fact", "metric", "goal"))
            metric_name = "" if metric is None else str(metric.value)
            if (fact is None) == (metric is None):
                message = f"the objective `{name}` needs either `fact` or `metric`"
                self.report.add("study-value", message, node.where)
                continue
            is_measured = metric_name.partition(".")[0] == MEASURE
            if metric is not None and not is_measured and metric_name not in known:
                self.report.add(
                    "study-name",
                    f"the study has no metric `{metric_name}`",
                    metric.span,
                    hint=did_you_mean(
                        metric_name, known, "write it as SCENARIO.METRIC; it has no scenarios"
                    ),
                )
                continue
            path = self._fact(fact) if fact is not None else ""
            yield Objective(name, path, metric_name, goal is not None and goal.value == "maximise")

    def _fact(self, node: Node | None) -> str:
        """Returns the path of a fact, or an empty text and reports an unknown fact."""
        if node is None or node.value is None:
            return ""
        path = str(node.value)
        if path in self.facts:
            return path
        message = f"the robot has no fact `{path}` that is a number"
        parent, inner = path.rpartition(".")[0], [f for f in self.facts if f.startswith(f"{path}.")]
        hint = did_you_mean(path, self.facts, "`thorvaldc info --json` shows the facts")
        if parent in self.facts:
            hint = Proposal(f"did you mean `{parent}`?", parent)
        elif inner:
            hint = Proposal(f"it has {', '.join(inner[:6])}", *inner[:6], is_example=True)
        purchase = self.facts_document["purchase"]
        reason = {"purchase.price": "no_price", "purchase.lead_time": "no_lead_time"}.get(path)
        if reason is not None:
            message = f"the fact `{path}` of the robot has no value: {purchase[reason]}"
            hint = "the section `purchase` of the robot file or of a module file states it"
        self.report.add("study-name", message, node.span, hint=hint)
        return ""

    def _check_size(self, plan: StudyPlan) -> None:
        """Checks the number of designs."""
        method, number = plan.method, plan.number
        size, most = number, MAX_DESIGNS
        if method == "grid":
            size = math.prod(len(variable.choices) or number for variable in plan.variables)
        elif method == "saltelli":
            size = number * (len(plan.variables) + 2)
        elif method == "search":
            most = MAX_SEARCHED
        node = (self.document.get("samples") or self.document).get("number") or self.document
        if size > most:
            message = f"the study has {size} designs; with `{method}` it may have {most}"
            self.report.add("out-of-range", message, node.where)
