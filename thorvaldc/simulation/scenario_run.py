"""Simulates a scenario with faults and noise, checks its expectations, reports the result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.compiler.scenario.scenario_compilation import metric_units
from thorvaldc.diagnostics import DiagnosticError, Report, Span
from thorvaldc.diagnostics.text_layout import preformatted
from thorvaldc.model.scenario import Expectation, Scenario
from thorvaldc.simulation import control_loop
from thorvaldc.simulation.records.recorder import Recorder, RunHash, record_ticks
from thorvaldc.simulation.simulation_result import SimulationResult, result_table
from thorvaldc.simulation.simulation_run import Simulation

if TYPE_CHECKING:
    from thorvaldc.simulation.scenario_metrics import ScenarioMetrics


# -- expectations and result -----------------------------------------------------------------------


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

    def _repr_html_(self) -> str:
        """Returns the table of the run and its expectations, which a notebook shows."""
        return preformatted(scenario_text(self))

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


_TICKS_PER_CHECK = 25
"""Number of ticks between two checks whether a run can still meet its expectations."""


class ScenarioSimulation(Simulation):
    """A simulation of the robots and the world of a scenario."""

    def __init__(
        self,
        scenario: Scenario,
        files: Path | str | Mapping[str, bytes],
        parameters: str | None = None,
    ) -> None:
        """Loads the MuJoCo scene of the scenario.

        ``files`` are the outputs of the ``mjcf`` backend for ``scenario.fleet``.  ``parameters``
        is the name of the parameter set that the drivers use at the start.  Raises
        ``DiagnosticError`` if the scene cannot be read, or if a robot does not have the parameter
        set ``parameters``.
        """
        super().__init__(scenario, files, parameters)
        self.scenario = scenario

    def play(
        self,
        report: Report,
        recorders: Sequence[Recorder] = (),
        on_tick: control_loop.TickCallback | None = None,
        *,
        hashed: bool = True,
        ends_early: bool = False,
    ) -> ScenarioResult:
        """Runs the scenario and returns the result.

        Problems and failed expectations are added to ``report``.  Each recorder in ``recorders``
        receives every tick of every robot.  The caller closes the recorders.  If ``hashed`` is
        false, the result has no hash, and the run takes less time.

        Raises ``DiagnosticError`` if the run cannot start, and, if ``ends_early`` is true,
        within ``_TICKS_PER_CHECK`` ticks after the run can no longer meet an expectation because
        the metric never falls.
        """
        if self.scene is None:
            raise DiagnosticError("simulation-scene", "a scenario needs a scene")
        # The module imports numpy, which the help of a command does not need.
        from thorvaldc.simulation.scenario_metrics import ScenarioMetrics

        run_hash = RunHash()
        all_recorders = (run_hash, *recorders) if hashed else tuple(recorders)
        record = record_ticks(all_recorders)
        self.episode.record_sensors(recorders)
        metrics: dict[str, ScenarioMetrics] = {}
        limited = [e for e in self.scenario.expectations if ends_early and e.most is not None]

        def measure(loop: control_loop.ControlLoop) -> None:
            robot_metrics = metrics.get(loop.name)
            if robot_metrics is None:
                robot_metrics = metrics[loop.name] = ScenarioMetrics(loop)
            robot_metrics.update()
            if limited and loop.ticks % _TICKS_PER_CHECK == 0:
                _check_least_values(loop, robot_metrics, limited)
            if all_recorders:
                record(loop)
            if on_tick is not None:
                on_tick(loop)

        self.episode.begin()
        run = self._finish(self.scenario.duration, report, measure)
        values = {robot.name: metrics[robot.name].values(robot) for robot in run.robots}
        checks = tuple(
            check_expectation(robot, robot_values, expectation)
            for expectation in self.scenario.expectations
            for robot, robot_values in values.items()
        )
        for check in checks:
            if not check.passed:
                report.add(
                    "expectation-failed",
                    f"`{check.metric}` of {check.robot} is {check.value_text}; "
                    f"{check.bounds} is expected",
                    check.span,
                )
        return ScenarioResult(
            self.scenario.name, run, values, checks, run_hash.hexdigest() if hashed else ""
        )


def _check_least_values(
    loop: control_loop.ControlLoop, metrics: ScenarioMetrics, limited: Sequence[Expectation]
) -> None:
    """Raises ``DiagnosticError`` if a metric that never falls is above an upper bound."""
    for expectation in limited:
        value = metrics.least_value(expectation.metric)
        if value is not None and expectation.most is not None and value > expectation.most:
            check = check_expectation(loop.name, {expectation.metric: value}, expectation)
            raise DiagnosticError(
                "expectation-failed",
                f"`{check.metric}` of {check.robot} is {check.value_text} after"
                f" {loop.driver.state.time:.2f} s; {check.bounds} is expected",
                span=check.span,
            )


# -- reports ---------------------------------------------------------------------------------------


def scenario_text(result: ScenarioResult, width: int | None = None) -> str:
    """Returns a text with the result table of the robots and one line for each expectation.

    ``width``: number of columns of the terminal, or ``None`` for one line per robot.
    """
    run = result.run
    lines = [result_table([run], width)]
    for check in result.checks:
        verdict = "ok    " if check.passed else "FAILED"
        lines.append(
            f"{verdict}  {check.robot} {check.metric}: {check.value_text} ({check.bounds})"
        )
    passed = sum(1 for check in result.checks if check.passed)
    end = "" if result.completed else f", ended after {run.simulated:.2f} s"
    lines.append(
        f"{result.scenario}: {passed} of {len(result.checks)} expectations met{end}, "
        f"result {result.hash[:16]}"
    )
    return "\n".join(lines)


def junit_report(result: ScenarioResult, errors: Sequence[str]) -> bytes:
    """Returns a JUnit XML report of a scenario run.

    The report has one test case for the completion of the run and one test case for each
    expectation.  ``errors`` are the error messages of a run that did not complete.
    """
    name = result.scenario
    test_count = len(result.checks) + 1
    failed = sum(1 for check in result.checks if not check.passed) + (not result.completed)
    suite = Element(
        "testsuite",
        name=name,
        tests=test_count,
        failures=failed,
        errors=0,
        skipped=0,
        time=round(result.run.simulated, 6),
    )
    suite.add("properties").add("property", name="hash", value=result.hash)
    case = suite.add("testcase", classname=name, name="runs to its end")
    if not result.completed:
        case.add("failure", message="; ".join(errors) or "the run did not complete")
    for check in result.checks:
        case = suite.add("testcase", classname=f"{name}.{check.robot}", name=check.metric)
        if not check.passed:
            case.add("failure", message=f"{check.value_text}; {check.bounds} is expected")
    suites = Element("testsuites", name="thorvaldc", tests=test_count, failures=failed)
    suites.append(suite)
    return to_bytes(suites)
