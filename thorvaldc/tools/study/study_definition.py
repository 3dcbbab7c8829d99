"""The content of a study file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.node import Value
from thorvaldc.diagnostics import Span

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

    def rank(self, value: float) -> float:
        """Returns a number that is smaller for a better value."""
        return -value if self.maximise else value


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
