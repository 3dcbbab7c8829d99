"""Selects the designs of a study: the values of its variables."""

from __future__ import annotations

import hashlib
import itertools
import random
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from thorvaldc.compiler.source.node import Value
from thorvaldc.tools.study.study_definition import Study, Variable

Design = tuple[Value, ...]
"""The value of each variable of a study, in the order of the study file."""


class MissingPackageError(Exception):
    """Raised if a package of the extra ``study`` is not installed.  ``str()`` names the extra."""

    def __init__(self, package: str) -> None:
        super().__init__(
            f"this study needs {package}, which is not installed: pip install 'thorvaldc[study]'"
        )


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
    sequence = load_qmc().Sobol(2 * count, rng=study.samples.seed)
    for row in sequence.random_base2((number - 1).bit_length())[:number].tolist():
        a, b = row[:count], row[count:]
        yield a
        yield b
        for index in range(count):
            yield [*a[:index], b[index], *a[index + 1 :]]


def load_qmc() -> Any:
    """Returns the module ``scipy.stats.qmc``.

    Raises ``MissingPackageError`` if scipy is not installed.
    """
    try:
        from scipy.stats import qmc
    except ImportError:
        raise MissingPackageError("scipy") from None
    return qmc


def _scipy_rows(study: Study) -> list[list[float]]:
    qmc = load_qmc()
    samples, count = study.samples, len(study.variables)
    if samples.method == "sobol":
        # The sequence is balanced for powers of two; the first numbers of a longer one are equal.
        exponent = (samples.number - 1).bit_length()
        points = qmc.Sobol(count, rng=samples.seed).random_base2(exponent)[: samples.number]
    else:
        points = qmc.LatinHypercube(count, rng=samples.seed).random(samples.number)
    rows: list[list[float]] = points.tolist()
    return rows
