"""The designs of a study: selected in advance, or searched for in batches."""

from __future__ import annotations

import hashlib
import itertools
import random
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any

from thorvaldc.cli.exits import OutsideError
from thorvaldc.compiler.source.node import Value
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.tools.study.study_document import Design, StudyPlan, Variable


def required(module: str) -> Any:
    """Imports a module of the extra ``study``.

    Raises ``OutsideError``, which names the extra, if its package is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise OutsideError(
            f"this study needs {package}, which is not installed: {install_command('study')}"
        ) from None


def designs_of(plan: StudyPlan) -> list[Design]:
    """Returns the designs of a study in the order of their numbers.

    With the methods ``random``, ``sobol`` and ``saltelli``, a design does not depend on the number
    of designs.
    """
    if plan.method == "grid":
        return list(itertools.product(*(_grid_values(plan.number, v) for v in plan.variables)))
    return [
        tuple(variable.at(fraction) for variable, fraction in zip(plan.variables, row, strict=True))
        for row in _rows(plan)
    ]


def _grid_values(number: int, variable: Variable) -> list[Value]:
    """Returns the listed values, or equally spaced values with both limits of the range."""
    limits = variable.range
    if limits is None:
        return list(variable.choices)
    step = (limits.most - limits.least) / max(number - 1, 1)
    values = (limits.quantity(limits.least + step * i) for i in range(number))
    return list(dict.fromkeys(values))  # whole numbers can repeat


def _rows(plan: StudyPlan) -> Iterator[Sequence[float]]:
    """Yields the place of each variable between 0 and 1 for each design."""
    count, number, seed = len(plan.variables), plan.number, plan.seed
    if plan.method == "random":
        for index in range(number):
            keys = (f"{seed} {index} {v.name}".encode() for v in plan.variables)
            yield [random.Random(hashlib.sha256(key).digest()).random() for key in keys]
        return
    qmc = required("scipy.stats.qmc")
    if plan.method == "latin_hypercube":
        yield from qmc.LatinHypercube(count, rng=seed).random(number).tolist()
        return
    # A Sobol sequence is balanced for powers of two; the first rows of a longer one are equal.
    size = 2 * count if plan.method == "saltelli" else count
    rows = qmc.Sobol(size, rng=seed).random_base2((number - 1).bit_length())[:number].tolist()
    if plan.method == "sobol":
        yield from rows
        return
    # Each base sample: A, B, and A with one coordinate of B for each variable (Saltelli et al.,
    # "Variance based sensitivity analysis of model output", 2010).
    for row in rows:
        a, b = row[:count], row[count:]
        yield a
        yield b
        for index in range(count):
            yield [*a[:index], b[index], *a[index + 1 :]]


def new_optuna_study(plan: StudyPlan, **options: Any) -> Any:
    """Returns a study of Optuna with the objectives of a study; ``options`` of ``create_study``."""
    optuna = required("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(
        directions=["maximize" if o.maximise else "minimize" for o in plan.objectives],
        load_if_exists=True,
        **options,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Optuna calls names experimental
        study.set_metric_names([objective.name for objective in plan.objectives])
    return study


def distributions_of(plan: StudyPlan) -> dict[str, Any]:
    """Returns the range or the listed values of each variable for Optuna.

    Listed values are their indices, which are numbers of Optuna also if the values are equal.
    """
    kinds = required("optuna").distributions
    distributions = {}
    for v in plan.variables:
        if v.range is None:
            distributions[v.name] = kinds.CategoricalDistribution(range(len(v.choices)))
        elif v.range.whole:
            limits = round(v.range.least), round(v.range.most)
            distributions[v.name] = kinds.IntDistribution(*limits)
        else:
            distributions[v.name] = kinds.FloatDistribution(v.range.least, v.range.most)
    return distributions


_STATES = {"constraint": "PRUNED", "expectation": "PRUNED"}


def trial_of(
    plan: StudyPlan,
    design: Design,
    result: Mapping[str, Any],
    attributes: dict[str, Any] | None = None,
) -> Any:
    """Returns a design and its result as a trial of Optuna."""
    optuna = required("optuna")
    values = [objective.value_of(result) for objective in plan.objectives]
    is_measured = result["status"] == "ok" and None not in values
    state = "COMPLETE" if is_measured else _STATES.get(result["status"], "FAIL")
    parameters: dict[str, Any] = {}
    for v, value in zip(plan.variables, design, strict=True):
        if v.range is None:
            parameters[v.name] = v.choices.index(value)
        else:
            number = value if isinstance(value, int | float) else float(str(value).split()[0])
            parameters[v.name] = min(max(number, v.range.least), v.range.most)
    return optuna.create_trial(
        state=optuna.trial.TrialState[state],
        params=parameters,
        distributions=distributions_of(plan),
        values=values if is_measured else None,
        user_attrs=attributes,
    )


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
    """

    def __init__(self, plan: StudyPlan) -> None:
        optuna = required("optuna")
        with warnings.catch_warnings():
            # Optuna calls options experimental that it has had for years.
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                seed=plan.seed,
                n_startup_trials=RANDOM_DESIGNS,
                constant_liar=True,  # designs of one batch keep a distance from each other
            )
        self._plan = plan
        self._study = new_optuna_study(plan, sampler=sampler)
        self._distributions = distributions_of(plan)
        self._batch: list[Any] = []

    def propose(self, count: int) -> list[Design]:
        """Returns the next batch of designs."""
        self._batch = [self._study.ask(self._distributions) for _ in range(count)]
        return [
            tuple(
                v.choices[parameter] if v.range is None else v.range.quantity(parameter)
                for v, parameter in ((v, trial.params[v.name]) for v in self._plan.variables)
            )
            for trial in self._batch
        ]

    def learn(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Adds the results of the designs that ``propose`` returned last, in their order."""
        for trial, result in zip(self._batch, results, strict=True):
            values = [objective.value_of(result) for objective in self._plan.objectives]
            is_measured = result["status"] == "ok" and None not in values
            # The sampler compares designs that break a constraint by their violation alone.
            trial.set_constraint("violation", 0.0 if is_measured else self._violation(result))
            self._study.tell(trial, [0.0 if value is None else value for value in values])

    def _violation(self, result: Mapping[str, Any]) -> float:
        """Returns by how much a design misses its bounds, as a sum of shares of the bounds."""
        if result["status"] != "constraint":
            return FAILED
        total = 0.0
        for constraint in self._plan.constraints:
            value = result["facts"].get(constraint.fact)
            if value is None:
                return FAILED
            for bound, sign in ((constraint.at_least, 1.0), (constraint.at_most, -1.0)):
                if bound is not None:
                    total += max(sign * (bound - value), 0.0) / (abs(bound) or 1.0)
        return total
