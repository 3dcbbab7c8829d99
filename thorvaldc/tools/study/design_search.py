"""Searches the best designs of a study: proposes designs from the results of earlier ones."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

from thorvaldc.compiler.source.node import Value
from thorvaldc.tools.study.sample_points import Design, MissingPackageError
from thorvaldc.tools.study.study_definition import Study, Variable
from thorvaldc.tools.study.study_table import objective_value

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
        try:
            import optuna
        except ImportError:
            raise MissingPackageError("optuna") from None
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
            values = [objective_value(objective, result) for objective in self._study.objectives]
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
