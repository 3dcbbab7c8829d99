"""The content of a study file, and the designs that its method selects or searches."""

from __future__ import annotations

import hashlib
import itertools
import json
import random
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from thorvaldc.cli.exits import OutsideError
from thorvaldc.compiler.source.node import Value
from thorvaldc.diagnostics import Span
from thorvaldc.diagnostics.installation import install_command

STATUSES = ("ok", "constraint", "expectation", "tipped", "diverged", "error")
STATUS_COLUMNS = ("sample", "key", "status", "code", "message")
"""Columns of the table of designs that do not depend on the study."""

DEFAULT_BATCH = 16
"""Number of designs that the method ``search`` proposes at once, if the study does not state it."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A value of the robot file that differs between the designs.

    Attributes
    ----------
    paths : dotted paths of the values in the robot file that the variable replaces.
    choices : listed values.  Empty for a range.
    least, most : limits of the range, in ``unit``.
    unit : unit of the limits, as in the study file.
    whole : if true, the values of the range are whole numbers.
    span : span of the variable in the study file.
    """

    name: str
    paths: tuple[str, ...]
    choices: tuple[Value, ...]
    least: float
    most: float
    unit: str
    whole: bool
    span: Span

    def at(self, fraction: float) -> Value:
        """Returns the value at a fraction from 0 to 1 of the range or of the listed values.

        Values of a range have 6 significant digits, because people read them in a robot file.
        """
        if self.choices:
            return self.choices[min(int(fraction * len(self.choices)), len(self.choices) - 1)]
        if self.whole:
            return min(int(self.least + fraction * (self.most - self.least + 1)), int(self.most))
        return self.quantity(self.least + fraction * (self.most - self.least))

    def quantity(self, value: float) -> Value:
        """Returns a value in the unit of the variable as a document contains it."""
        if self.whole:
            return round(value)
        number = float(f"{value:.6g}")
        return f"{number!r} {self.unit}" if self.unit else number

    def tested_values(self) -> tuple[Value, ...]:
        """Returns the listed values, or the limits of the range."""
        return self.choices or (self.quantity(self.least), self.quantity(self.most))


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

    def rank(self, value: float) -> float:
        """Returns a number that is smaller for a better value."""
        return -value if self.maximise else value

    def value_of(self, result: Mapping[str, Any]) -> float | None:
        """Returns the value of the objective from the result of a design, or ``None`` without."""
        if self.fact:
            value = result["facts"].get(self.fact)
        else:
            scenario, _, metric = self.metric.partition(".")
            value = (result["metrics"].get(scenario) or {}).get(metric)
        return None if value is None else float(value)


@dataclass(frozen=True, slots=True)
class Samples:
    """Selection of the designs.

    - ``number``: number of designs, of the values of each range for the method ``grid``, or of the
      base samples for ``saltelli``.
    - ``batch``: number of designs that the method ``search`` proposes at once.
    """

    method: str
    number: int
    seed: int
    batch: int = DEFAULT_BATCH


@dataclass(frozen=True, slots=True)
class Study:
    """The content of a study file.

    Attributes
    ----------
    robot : path of the robot file.
    scenarios : name and path of each scenario file.
    inputs : SHA-256 of the files of the robot and the scenarios.
    currency : currency of the prices of the robot (ISO 4217), or empty.
    choice_inputs : SHA-256 of the files of the robot with one listed value, by the name of the
        variable and the JSON text of the value.  A module type has files of its own.
    """

    name: str
    description: str
    robot: Path
    variables: tuple[Variable, ...]
    constraints: tuple[Constraint, ...]
    scenarios: tuple[tuple[str, Path], ...]
    objectives: tuple[Objective, ...]
    samples: Samples
    inputs: str = ""
    currency: str = ""
    choice_inputs: tuple[tuple[str, str, str], ...] = ()

    def facts(self) -> Iterator[str]:
        """Yields the paths of the facts that the study needs."""
        yield from (constraint.fact for constraint in self.constraints)
        yield from (objective.fact for objective in self.objectives if objective.fact)

    def question(self) -> dict[str, Any]:
        """Returns all that the result of a design depends on, except the files and values."""
        return {
            "paths": {variable.name: list(variable.paths) for variable in self.variables},
            "constraints": {c.name: [c.fact, c.at_least, c.at_most] for c in self.constraints},
            "scenarios": [name for name, _ in self.scenarios],
            "objectives": {o.name: [o.fact, o.metric] for o in self.objectives},
        }


def value_key(value: Value) -> str:
    """Returns a value of a variable as JSON text."""
    return json.dumps(value, ensure_ascii=False)


Design = tuple[Value, ...]
"""The value of each variable of a study, in the order of the study file."""


class MissingPackageError(OutsideError):
    """Raised if a package of the extra ``study`` is not installed.  ``str()`` names the extra."""

    def __init__(self, package: str) -> None:
        super().__init__(
            f"this study needs {package}, which is not installed: {install_command('study')}"
        )


def required(module: str) -> Any:
    """Imports a module of the extra ``study``.

    Raises ``MissingPackageError`` if its package is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackageError(module.partition(".")[0]) from None


def designs_of(study: Study) -> list[Design]:
    """Returns the designs of a study in the order of their numbers.

    With the methods ``random``, ``sobol`` and ``saltelli``, a design does not depend on the number
    of designs.

    Raises ``MissingPackageError`` if the method needs scipy and it is not installed.
    """
    method = study.samples.method
    if method == "grid":
        return list(itertools.product(*(_grid_values(study, v) for v in study.variables)))
    if method == "random":
        rows: Iterable[Sequence[float]] = _random_rows(study)
    else:
        rows = _saltelli_rows(study) if method == "saltelli" else _scipy_rows(study)
    return [
        tuple(
            variable.at(fraction) for variable, fraction in zip(study.variables, row, strict=True)
        )
        for row in rows
    ]


def _grid_values(study: Study, variable: Variable) -> list[Value]:
    """Returns the listed values, or equally spaced values with both limits of the range."""
    if variable.choices:
        return list(variable.choices)
    number = study.samples.number
    steps = max(number - 1, 1)
    width = variable.most - variable.least
    values = (variable.quantity(variable.least + width * i / steps) for i in range(number))
    return list(dict.fromkeys(values))  # whole numbers can repeat


def _random_rows(study: Study) -> Iterator[list[float]]:
    """Yields random numbers that depend only on the seed, the number of the design and the name of
    the variable."""
    samples = study.samples
    for number in range(samples.number):
        row = []
        for variable in study.variables:
            key = f"{samples.seed} {number} {variable.name}"
            row.append(random.Random(hashlib.sha256(key.encode()).digest()).random())
        yield row


def _saltelli_rows(study: Study) -> Iterator[list[float]]:
    """Yields the points of each base sample: A, B, and A with one coordinate of B for each variable
    (Saltelli et al., "Variance based sensitivity analysis of model output", 2010)."""
    count, number = len(study.variables), study.samples.number
    sequence = required("scipy.stats.qmc").Sobol(2 * count, rng=study.samples.seed)
    for row in sequence.random_base2((number - 1).bit_length())[:number].tolist():
        a, b = row[:count], row[count:]
        yield a
        yield b
        for index in range(count):
            yield [*a[:index], b[index], *a[index + 1 :]]


def _scipy_rows(study: Study) -> list[list[float]]:
    qmc = required("scipy.stats.qmc")
    samples, count = study.samples, len(study.variables)
    if samples.method == "sobol":
        # The sequence is balanced for powers of two; the first numbers of a longer one are equal.
        exponent = (samples.number - 1).bit_length()
        points = qmc.Sobol(count, rng=samples.seed).random_base2(exponent)[: samples.number]
    else:
        points = qmc.LatinHypercube(count, rng=samples.seed).random(samples.number)
    rows: list[list[float]] = points.tolist()
    return rows


RANDOM_DESIGNS = 16
"""Number of random designs before the search uses results."""
FAILED = 1.0
"""Constraint violation of a design that failed: as bad as a bound missed by its own value."""


class DesignSearch:
    """A search for the designs with the best values of one or several objectives.

    The search proposes batches of designs.  A batch depends only on the study and on the results
    of the batches before it.  The method is the tree-structured Parzen estimator (Bergstra et al.,
    "Algorithms for Hyper-Parameter Optimization", 2011; for several objectives Ozaki et al.,
    "Multiobjective Tree-Structured Parzen Estimator", 2022), as implemented by Optuna.

    Raises ``MissingPackageError`` if Optuna is not installed.
    """

    def __init__(self, study: Study) -> None:
        optuna = required("optuna")
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._study = study
        self._distributions = {
            variable.name: _distribution(optuna.distributions, variable)
            for variable in study.variables
        }
        with warnings.catch_warnings():
            # Optuna calls options experimental that it has had for years.
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                seed=study.samples.seed,
                n_startup_trials=RANDOM_DESIGNS,
                # Designs of one batch keep a distance from each other.
                constant_liar=True,
            )
        self._optuna_study = optuna.create_study(
            sampler=sampler, directions=["minimize"] * len(study.objectives)
        )
        self._batch: list[Any] = []

    def propose(self, count: int) -> list[Design]:
        """Returns the next batch of designs."""
        self._batch = [self._optuna_study.ask(self._distributions) for _ in range(count)]
        variables = self._study.variables
        return [
            tuple(_value(variable, trial.params[variable.name]) for variable in variables)
            for trial in self._batch
        ]

    def learn(self, results: Sequence[dict[str, Any]]) -> None:
        """Adds the results of the designs that ``propose`` returned last, in their order."""
        for trial, result in zip(self._batch, results, strict=True):
            values = [objective.value_of(result) for objective in self._study.objectives]
            ranks = [
                0.0 if value is None else objective.rank(value)
                for objective, value in zip(self._study.objectives, values, strict=True)
            ]
            is_measured = result["status"] == "ok" and None not in values
            violation = 0.0 if is_measured else self._violation(result)
            # The sampler compares designs that break a constraint by their violation alone.
            trial.set_constraint("violation", violation)
            self._optuna_study.tell(trial, ranks)

    def _violation(self, result: dict[str, Any]) -> float:
        """Returns by how much a design misses its bounds, as a sum of shares of the bounds."""
        if result["status"] != "constraint":
            return FAILED
        total = 0.0
        for constraint in self._study.constraints:
            value = result["facts"].get(constraint.fact)
            if value is None:
                return FAILED
            for bound, excess in (
                (constraint.at_least, (constraint.at_least or 0.0) - value),
                (constraint.at_most, value - (constraint.at_most or 0.0)),
            ):
                if bound is not None and excess > 0.0:
                    total += excess / (abs(bound) or 1.0)
        return total


def _distribution(distributions: Any, variable: Variable) -> Any:
    if variable.choices:
        return distributions.CategoricalDistribution(range(len(variable.choices)))
    if variable.whole:
        return distributions.IntDistribution(round(variable.least), round(variable.most))
    return distributions.FloatDistribution(variable.least, variable.most)


def _value(variable: Variable, parameter: Any) -> Value:
    if variable.choices:
        choice: Value = variable.choices[parameter]
        return choice
    return variable.quantity(parameter)
