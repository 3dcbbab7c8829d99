"""Compiles study files.

A study names a robot, variables, constraints, scenarios and objectives.  The compilation of a study
compiles the robot, each scenario with the robot, and the robot with each listed value and each
limit of a range alone.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thorvaldc.compiler.hardware.purchase_reader import MoneyError, parse_money
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.pipeline import library_folders_of
from thorvaldc.compiler.result import Compilation, Compile, SourceFile
from thorvaldc.compiler.scenario.fleet_compilation import open_named_file
from thorvaldc.compiler.scenario.scenario_compilation import compile_scenario, metric_units
from thorvaldc.compiler.source.input_file import read_bytes, unsaved_texts
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import MAX_BYTES
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Proposal, Report, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import fact_quantity, facts_document, robot_facts
from thorvaldc.tools.study import study_definition as definition
from thorvaldc.tools.study.design_text import (
    PathError,
    find_value,
    shared_spans,
    with_replaced_values,
)
from thorvaldc.tools.study.study_definition import Study, Variable

# A quantity is a number with an optional unit, for example `-0.5 deg`.
_LIMIT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.][^.]*?)?\s*", re.ASCII
)
MAX_DESIGNS = 1_000_000
MAX_SEARCHED = 5_000
"""Greatest number of designs of a search: the time for a proposal grows with the number."""
_WRONG_WITH_ALL_DESIGNS = ("module-type-unknown",)
"""Names of errors outside of the codes TV2xx that a value causes whatever the other values are."""


def compile_study(source: SourceFile, compile_robot: Compile) -> Compilation:
    """Compiles a study file.

    ``compile_robot`` is the function that compiles the robot file.  The model of the returned
    compilation is the robot that the study names.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    tried_files: dict[str, Path] = {}
    if source.document is not None:
        document = source.check_shape(source.document)
        robot_source = _opened(source, document.get("robot"), "robot", "fleet-in-fleet", report)
        if robot_source is not None:
            part = parts[robot_source.name] = compile_robot(robot_source)
            if isinstance(part.model, Robot):
                reader = _StudyReader(source, document, robot_source, part, compile_robot, report)
                compilation.tool_document = reader.read(parts)
                tried_files = reader.tried_files
                compilation.model = part.model
    compilation.complete(source, report, parts)
    compilation.files.update(tried_files)  # of module types that a variable can have
    return compilation


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


def _read_range(
    path: str, low: str, high: str, span: Span, report: Report
) -> tuple[float, float, str, bool] | None:
    """Reads the two limits of a range of values: least, most, unit, whether only whole numbers.

    Both limits of the range must have the same unit.  A limit of 0 needs no unit.
    """
    first, last = _LIMIT.fullmatch(low), _LIMIT.fullmatch(high)
    if first is None or last is None:
        invalid = low if first is None else high
        report.add(
            "study-value",
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
            "study-value",
            f"{range_text}, in two units",
            span,
            hint="give both limits in the same unit",
        )
        return None
    if not least < most:
        report.add("study-value", f"{range_text}; its end must be more than its beginning", span)
        return None
    whole = not low_unit and all(re.fullmatch(r"\s*[-+]?\d+\s*", text) for text in (low, high))
    return least, most, low_unit, whole


def fact_values(document: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yields the path and value of each number in the facts about a robot."""
    if isinstance(document, bool):
        return
    if isinstance(document, int | float):
        yield path, document
    elif isinstance(document, dict | list):
        items = document.items() if isinstance(document, dict) else enumerate(document)
        for key, value in items:
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
        self.choice_inputs: list[tuple[str, str, str]] = []
        self.tried_files: dict[str, Path] = {}

    def read(self, parts: dict[str, Compilation]) -> Study:
        """Returns the study, and adds the compilations of the scenarios to ``parts``."""
        self._check_names()
        scenarios = tuple(self._scenarios(parts))
        digest = hashlib.sha256()
        for name in sorted(parts):
            digest.update(f"{name}\0{parts[name].source_sha256}\0".encode())
        samples = {key: node.value for key, node in entries(self.document.get("samples")).items()}
        number, seed, batch = (
            value if isinstance(value := samples.get(key), int) else default
            for key, default in (("number", 1), ("seed", 0), ("batch", definition.DEFAULT_BATCH))
        )
        title, description = (
            "" if node is None else str(node.value)
            for node in map(self.document.get, ("study", "description"))
        )
        study = Study(
            name=title,
            description=description,
            robot=self.robot_source.path,
            variables=tuple(self._variables()),
            constraints=tuple(self._constraints()),
            scenarios=scenarios,
            objectives=tuple(self._objectives()),
            currency=self.currency,
            samples=definition.Samples(str(samples.get("method")), number, seed, batch),
        )
        self._check_size(study)
        return replace(study, inputs=digest.hexdigest(), choice_inputs=tuple(self.choice_inputs))

    def _check_names(self) -> None:
        """Checks that each column of the table of designs has its own name."""
        used = dict.fromkeys(definition.STATUS_COLUMNS, "a column of each table of designs")
        for section in ("variables", "constraints", "scenarios", "objectives"):
            for name, node in entries(self.document.get(section)).items():
                if name in used:
                    self.report.add(
                        "study-name",
                        f"the name `{name}` is also {used[name]}",
                        node.where,
                        hint="the results have a column of each name: choose another one",
                    )
                used[name] = f"in `{section}`"

    def _scenarios(self, parts: dict[str, Compilation]) -> Iterator[tuple[str, Any]]:
        # The diagnostics of the robot are already in the report.
        silent = replace(self.robot, report=Report())
        for name, node in entries(self.document.get("scenarios")).items():
            opened = _opened(
                self.source, node.get("scenario"), "scenario", "study-name", self.report
            )
            if opened is None:
                continue
            parts[opened.name] = compile_scenario(
                opened, lambda part: silent, self.robot_source.path
            )
            yield name, opened.path

    # -- variables ------------------------------------------------------------------

    def _variables(self) -> Iterator[Variable]:
        text = self._robot_text()
        document = self.robot_source.document
        assert document is not None
        aliases = shared_spans(document)
        for name, node in entries(self.document.get("variables")).items():
            paths = [path for path in items(node.get("paths")) if isinstance(path.value, str)]
            are_valid = [self._check_path(document, path, aliases) for path in paths]
            variable = self._variable(name, node, tuple(str(path.value) for path in paths))
            if variable is not None and paths and all(are_valid):
                self._try_values(variable, node, text)
                yield variable

    def _variable(self, name: str, node: Node, paths: tuple[str, ...]) -> Variable | None:
        least, most, choices = (node.get(key) for key in ("min", "max", "values"))
        has_range = least is not None and most is not None
        if (choices is not None) == (least is not None or most is not None) or not (
            has_range or choices is not None
        ):
            self.report.add(
                "study-value",
                f"the variable `{name}` needs either `min` and `max`, or `values`",
                node.where,
            )
            return None
        if least is not None and most is not None:
            limits = str(least.value), str(most.value)
            limit = _read_range(name, *limits, node.where, self.report)
            if limit is None:
                return None
            return Variable(name, paths, (), *limit, node.where)
        values = tuple(item.value for item in items(choices) if item.value is not None)
        return Variable(name, paths, values, 0.0, 0.0, "", False, node.where) if values else None

    def _check_path(self, document: Node, path: Node, aliases: set[Any]) -> bool:
        """Checks that a path leads to a scalar of the robot file, or to a parameter that the file
        does not set."""
        text = str(path.value)
        try:
            node, missing = find_value(document, text)
        except PathError as error:
            self.report.add("study-path", str(error), path.span)
            return False
        if missing:
            return self._check_parameter(node, text, missing, path)
        if isinstance(node.value, dict | tuple):
            kind = "a mapping" if isinstance(node.value, dict) else "a list"
            self.report.add(
                "study-path",
                f"`{text}` is {kind}; a variable replaces a single value",
                path.span,
                hint=f"name a value in it, such as `{text}.{next(_keys(node), '0')}`",
            )
            return False
        if node.span in aliases:
            self.report.add(
                "study-path",
                f"the value of `{text}` has a YAML alias, so that it stands for several values",
                path.span,
                hint="write the value in each place, and name each place in `paths`",
            )
            return False
        return True

    def _check_parameter(
        self, mapping: Node, path: str, missing: tuple[str, ...], node: Node
    ) -> bool:
        """Checks a path whose last keys the robot file lacks.

        The default of a parameter of a module can be replaced, also if the file does not set it.
        """
        keys = path.split(".")
        known = list(_keys(mapping))
        parents = keys[: len(keys) - len(missing)]
        if len(keys) == 4 and keys[0] == "modules" and keys[2] == "params" and len(parents) >= 2:
            known = self._parameters(keys[1])
            if keys[3] in known:
                return True
            parents = keys[:3]
            missing = (keys[3],)
        place = ".".join(parents) or "the robot file"
        rest = keys[len(parents) + 1 :]
        near = did_you_mean(
            path, [".".join([*parents, key, *rest]) for key in known], f"it has {', '.join(known)}"
        )
        self.report.add("study-path", f"`{place}` has no `{missing[0]}`", node.span, hint=near)
        return False

    def _parameters(self, module: str) -> list[str]:
        """Returns the names of the parameters of the type of a module."""
        document, ignored = self.robot_source.document, Report()
        assert document is not None
        node, missing = find_value(document, f"modules.{module}.type")
        if missing:
            return []
        folder = self.robot_source.path.parent
        library = Library(library_folders_of(document, folder, (), ignored))
        loaded = library.load(str(node.value), node, ignored)
        return [] if loaded is None else list(loaded.section("params"))

    def _try_values(self, variable: Variable, node: Node, text: str) -> None:
        """Compiles the robot with each value of a variable, and reports the values that no design
        can have."""
        listed = items(node.get("values"))
        for index, value in enumerate(variable.tested_values()):
            place = listed[index].span if listed else node.where
            try:
                changed = with_replaced_values(text, ((path, value) for path in variable.paths))
            except PathError as error:
                self.report.add("study-path", str(error), place)
                return
            path = self.robot_source.path
            with unsaved_texts({os.path.realpath(path): changed.encode()}):
                tried = self.compile_robot(
                    SourceFile(path, self.robot_source.name, self.robot_source.folder)
                )
            self.tried_files.update(tried.files)
            self.choice_inputs.append(
                (variable.name, definition.value_key(value), tried.source_sha256)
            )
            for diagnostic in tried.report.errors:
                number, name = diagnostic.code.number, diagnostic.code.name
                if number.startswith("TV2") or name in _WRONG_WITH_ALL_DESIGNS:
                    message = f"`{value}` is no value of `{variable.name}`: {diagnostic.message}"
                    hint = diagnostic.hint if listed else None
                    if isinstance(hint, Proposal):  # without its span in the robot file
                        hint = Proposal(str(hint), *hint.replacements, is_example=hint.is_example)
                    self.report.add("study-value", message, place, hint=hint)
                    break

    def _robot_text(self) -> str:
        data = read_bytes(
            self.robot_source.path, self.robot_source.name, self.report, limit=MAX_BYTES
        )
        return (data or b"").decode("utf-8", "replace")

    # -- constraints and objectives -----------------------------------------------------

    def _constraints(self) -> Iterator[definition.Constraint]:
        for name, node in entries(self.document.get("constraints")).items():
            fact = self._fact(node.get("fact"))
            quantity = fact_quantity(fact).kind if fact else ""
            least, most = (self._bound(node.get(key), quantity) for key in ("at_least", "at_most"))
            if node.get("at_least") is None and node.get("at_most") is None:
                self.report.add(
                    "study-value",
                    f"the constraint `{name}` needs `at_least` or `at_most`",
                    node.where,
                )
            elif least is not None and most is not None and least > most:
                self.report.add(
                    "study-value", f"no number is within the bounds of `{name}`", node.where
                )
            if fact:
                yield definition.Constraint(name, fact, least, most)

    def _bound(self, node: Node | None, quantity: str) -> float | None:
        """Returns a bound in SI units.

        ``quantity``: kind of quantity of the fact, or empty if the fact is unknown.
        """
        if node is None or node.value is None:
            return None
        text = str(node.value)
        if quantity == si.MONEY.kind:
            return self._money(text, node)
        if isinstance(node.value, int | float):
            return float(node.value)
        try:
            return parse_quantity(text, quantity) if quantity else parse_any(text)
        except UnitError as error:
            self.report.add(error.code, error.message, node.span, hint=error.hint)
            return None

    def _money(self, text: str, node: Node) -> float | None:
        """Returns a bound for a price in the currency of the robot."""
        try:
            money = parse_money(text)
        except MoneyError as error:
            self.report.add("price-invalid", str(error), node.span, hint=error.hint)
            return None
        if money.currency != self.currency:
            message = (
                f"the bound is in {money.currency}, and the robot has prices in {self.currency}"
            )
            hint = f"write the bound in {self.currency}; no currency is converted"
            self.report.add("price-invalid", message, node.span, hint=hint)
        return money.amount

    def _objectives(self) -> Iterator[definition.Objective]:
        scenarios = entries(self.document.get("scenarios"))
        for name, node in entries(self.document.get("objectives")).items():
            fact, metric, goal = (node.get(key) for key in ("fact", "metric", "goal"))
            if (fact is None) == (metric is None):
                message = f"the objective `{name}` needs either `fact` or `metric`"
                self.report.add("study-value", message, node.where)
                continue
            known = [
                f"{scenario}.{metric_name}"
                for scenario in scenarios
                for metric_name in metric_units()
            ]
            if metric is not None and metric.value not in known:
                self.report.add(
                    "study-name",
                    f"the study has no metric `{metric.value}`",
                    metric.span,
                    hint=did_you_mean(
                        str(metric.value), known, "write it as SCENARIO.METRIC; it has no scenarios"
                    ),
                )
                continue
            path = self._fact(fact) if fact is not None else ""
            maximise = goal is not None and goal.value == "maximise"
            yield definition.Objective(
                name, path, "" if metric is None else str(metric.value), maximise
            )

    def _fact(self, node: Node | None) -> str:
        """Returns the path of a fact, or an empty text and reports an unknown fact."""
        if node is None or node.value is None:
            return ""
        path = str(node.value)
        if path in self.facts:
            return path
        message = f"the robot has no fact `{path}` that is a number"
        parent, inner = path.rpartition(".")[0], [f for f in self.facts if f.startswith(f"{path}.")]
        if parent in self.facts:
            hint: str | None = Proposal(f"did you mean `{parent}`?", parent)
        elif inner:
            hint = Proposal(f"it has {', '.join(inner[:6])}", *inner[:6], is_example=True)
        else:
            hint = did_you_mean(path, self.facts, "`thorvaldc info --json` shows the facts")
        if _is_null(self.facts_document, path):
            message = f"the fact `{path}` of the robot has no value"
            hint = "the robot of the study needs one; `thorvaldc info` says what is missing"
            purchase = self.facts_document["purchase"]
            reasons = {"purchase.price": "no_price", "purchase.lead_time": "no_lead_time"}
            if path in reasons:
                message += f": {purchase[reasons[path]]}"
                hint = "the section `purchase` of the robot file or of a module file states it"
        self.report.add("study-name", message, node.span, hint=hint)
        return ""

    def _check_size(self, study: Study) -> None:
        """Checks the number of designs."""
        method, number = study.samples.method, study.samples.number
        size, most = number, MAX_DESIGNS
        if method == "grid":
            size = math.prod(len(variable.choices) or number for variable in study.variables)
        elif method == "saltelli":
            size = number * (len(study.variables) + 2)
        elif method == "search":
            most = MAX_SEARCHED
        node = (self.document.get("samples") or self.document).get("number") or self.document
        if size > most:
            message = f"the study has {size} designs; with `{method}` it may have {most}"
            self.report.add("out-of-range", message, node.where)
        elif method == "saltelli" and number & (number - 1):
            above = 1 << number.bit_length()
            self.report.add(
                "out-of-range",
                f"`saltelli` needs a power of two, not {number}",
                node.where,
                hint=Proposal(f"write `{above}`", f"{above}"),
            )


def _is_null(document: Any, path: str) -> bool:
    """Returns whether a path leads to a fact without a value."""
    for key in path.split("."):
        if isinstance(document, list) and key.isdecimal() and int(key) < len(document):
            document = document[int(key)]
        elif isinstance(document, dict) and key in document:
            document = document[key]
        else:
            return False
    return document is None


def _keys(node: Node) -> Iterator[str]:
    if isinstance(node.value, dict):
        yield from node.value
    elif isinstance(node.value, tuple):
        yield from map(str, range(len(node.value)))
