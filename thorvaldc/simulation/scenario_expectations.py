"""Comparison of the metrics of a scenario run with the expectations of the scenario."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.scenario.scenario_reader import metric_units
from thorvaldc.diagnostics import Span
from thorvaldc.model.scenario import Expectation
from thorvaldc.simulation.run_result import SimulationResult


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one expectation for one robot.

    ``value``, ``minimum`` and ``maximum`` are in SI units.
    """

    robot: str
    metric: str
    value: float
    minimum: float | None
    maximum: float | None
    span: Span

    @property
    def passed(self) -> bool:
        """True if the value is finite and within the bounds."""
        above = self.minimum is None or self.value >= self.minimum
        below = self.maximum is None or self.value <= self.maximum
        return math.isfinite(self.value) and above and below

    @property
    def bounds(self) -> str:
        """Text of the bounds with their unit, such as ``at most 20 deg``."""
        unit = metric_units()[self.metric]
        texts = []
        if self.minimum is not None:
            texts.append(f"at least {_with_unit(self.minimum, unit)}")
        if self.maximum is not None:
            texts.append(f"at most {_with_unit(self.maximum, unit)}")
        return " and ".join(texts)

    @property
    def value_text(self) -> str:
        """Text of the measured value with the unit."""
        return _with_unit(self.value, metric_units()[self.metric])


def _with_unit(value: float, unit: str) -> str:
    if unit == "rad":
        return f"{math.degrees(value):.4g} deg"
    return f"{value:.4g} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class ScenarioResult:
    """Result of a scenario run.

    * ``scenario``: name of the scenario.
    * ``run``: result of the simulation run.
    * ``metrics``: metrics in SI units, by robot name and metric name.
    * ``checks``: result of each expectation for each robot.
    * ``hash``: SHA-256 of every number of every tick.  Two runs with equal numbers to the last bit
      have equal hashes.  Empty if the run was not hashed.
    """

    scenario: str
    run: SimulationResult
    metrics: Mapping[str, Mapping[str, float]]
    checks: tuple[Check, ...]
    hash: str

    @property
    def completed(self) -> bool:
        """True if the simulation did not diverge and no robot fell over."""
        return not self.run.diverged and not any(robot.tipped for robot in self.run.robots)

    @property
    def passed(self) -> bool:
        """True if the run is complete and all expectations are met."""
        return self.completed and all(check.passed for check in self.checks)

    def as_json(self) -> dict[str, Any]:
        """Returns the result of the scenario as JSON values."""
        checks = [
            {
                "robot": check.robot,
                "metric": check.metric,
                "value": check.value,
                "min": check.minimum,
                "max": check.maximum,
                "passed": check.passed,
            }
            for check in self.checks
        ]
        return {
            "scenario": self.scenario,
            "passed": self.passed,
            "completed": self.completed,
            "hash": self.hash,
            "checks": checks,
            "metrics": {name: dict(values) for name, values in self.metrics.items()},
            "run": self.run.as_json(),
        }


def check_expectation(robot: str, values: Mapping[str, float], expectation: Expectation) -> Check:
    """Compares the metric of an expectation with the bounds of the expectation.

    ``values`` are the metrics of the robot ``robot`` by name, in SI units.
    """
    value = values[expectation.metric]
    return Check(
        robot, expectation.metric, value, expectation.least, expectation.most, expectation.span
    )
