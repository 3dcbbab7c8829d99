"""Computes how much each variable of a study matters, from designs of the method ``saltelli``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.tools.study.sample_points import MissingPackageError
from thorvaldc.tools.study.study_table import StudyTable

LEAST_SAMPLES = 16
"""Least number of complete base samples for indices."""
CONFIDENCE = 0.95
RESAMPLES = 500
"""Number of bootstrap resamples for the intervals."""

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SobolIndex:
    """Share of the variance of an objective that one variable causes.

    - ``first_order``: share that the variable causes alone.
    - ``total``: share that it causes alone and together with other variables.  A variable with 0
      does not matter.
    - ``first_order_interval``, ``total_interval``: bootstrap intervals of 95 % confidence.
    """

    variable: str
    first_order: float
    first_order_interval: Interval
    total: float
    total_interval: Interval


@dataclass(frozen=True, slots=True)
class ObjectiveSensitivity:
    """Indices of all variables for an objective.

    - ``samples``: number of base samples that were used, a power of two.
    - ``incomplete``: number of base samples of which a design has no value.
    - ``indices``: empty if there are too few samples, or if the objective has the same value in all
      designs.
    - ``is_constant``: whether the objective has the same value in all designs.
    """

    objective: str
    samples: int
    incomplete: int
    indices: tuple[SobolIndex, ...]
    is_constant: bool = False


def sensitivities(table: StudyTable) -> list[ObjectiveSensitivity]:
    """Returns the indices for each objective, or an empty list for another method.

    The indices are those of Saltelli et al., "Variance based sensitivity analysis of model output",
    2010, as implemented by scipy.  They use the first complete base samples, as many as the largest
    power of two.  Equal tables give equal indices.  Raises ``MissingPackageError`` if scipy is not
    installed.
    """
    description = table.description
    if description.get("method") != "saltelli":
        return []
    variables, objectives = description["variables"], list(description["objectives"])
    names = ", ".join(f'"{name}"' for name in objectives)
    _, rows = table.query(f"SELECT sample, status, {names} FROM designs ORDER BY sample")
    size = len(variables) + 2
    result = []
    for column, objective in enumerate(objectives, 2):
        groups: dict[int, list[float]] = {}
        for row in rows:
            group = groups.setdefault((row[0] - 1) // size, [])
            if row[1] == "ok" and row[column] is not None:
                group.append(row[column])
        complete = [values for values in groups.values() if len(values) == size]
        result.append(_sensitivity(objective, variables, complete, len(groups) - len(complete)))
    return result


def _sensitivity(
    objective: str, variables: Sequence[str], groups: Sequence[Sequence[float]], incomplete: int
) -> ObjectiveSensitivity:
    """``groups``: values of A, B and each AB of the complete base samples."""
    count = 1 << len(groups).bit_length() - 1 if groups else 0
    if count < LEAST_SAMPLES:
        return ObjectiveSensitivity(objective, count, incomplete, ())
    values = [list(column) for column in zip(*groups[:count], strict=True)]
    if all(value == values[0][0] for column in values for value in column):
        return ObjectiveSensitivity(objective, count, incomplete, (), is_constant=True)
    first, total, intervals = _indices(values)
    indices = tuple(
        SobolIndex(name, first[i], intervals[0][i], total[i], intervals[1][i])
        for i, name in enumerate(variables)
    )
    return ObjectiveSensitivity(objective, count, incomplete, indices)


def _indices(values: list[list[float]]) -> tuple[list[float], list[float], list[list[Interval]]]:
    """Returns the first-order and total indices, and the intervals of both."""
    try:
        from scipy import stats
    except ImportError:
        raise MissingPackageError("scipy") from None
    import numpy as np

    outputs = np.array(values)
    count = outputs.shape[1]

    def both(chosen: Any) -> Any:
        pair = {"f_A": outputs[:1, chosen], "f_B": outputs[1:2, chosen]}
        with np.errstate(invalid="ignore", divide="ignore"):  # equal values in a resample
            indices = stats.sobol_indices(func={**pair, "f_AB": outputs[2:, None, chosen]}, n=count)
        shape = (2, outputs.shape[0] - 2)
        return np.stack([indices.first_order, indices.total_order]).reshape(shape)

    best = both(np.arange(count))
    random = np.random.default_rng(0)
    resampled = [both(random.integers(0, count, count)) for _ in range(RESAMPLES)]
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.nanquantile(np.array(resampled), [tail, 1.0 - tail], axis=0)
    intervals = [
        list(zip(lows, highs, strict=True))
        for lows, highs in zip(low.tolist(), high.tolist(), strict=True)
    ]
    return best[0].tolist(), best[1].tolist(), intervals


def sensitivity_notes(shares: ObjectiveSensitivity) -> list[str]:
    """Returns what a reader must know about the indices of an objective, as sentences."""
    notes = []
    if shares.is_constant:
        notes.append(f"{shares.objective} has the same value in all designs.")
    elif not shares.indices:
        notes.append(
            f"{shares.objective}: {shares.samples} complete base samples are too few for indices;"
            f" {LEAST_SAMPLES} are needed."
        )
    if shares.incomplete:
        notes.append(
            f"{shares.objective}: {shares.incomplete} base samples are left out, because a design"
            " of them has no value."
        )
    return notes
