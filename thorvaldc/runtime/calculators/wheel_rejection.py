"""Rejection of faulty wheels by a search over hypotheses.

A wheel that slips, stalls or has a wrong steering angle disagrees with the others: its D exceeds
its gate (see ``twist_fit.chi_squares``).  But one faulty wheel also pulls the fit and makes
healthy wheels look wrong, and with few wheels the largest D need not be that of the faulty one.
So the search refits the twist without each wheel in turn (leave-one-out), and without pairs
where no single wheel explains the misfit.  Each hypothesis "the wheels F are faulty" has a cost

    cost = misfit of the rows in use + sum over the k-th wheel of F of k * price

which is -2 log of its likelihood up to a constant.  ``price`` is the chi-square that one wheel
exceeds with the permitted rate of false rejections, and the k makes a second fault beside the
first as much rarer again.  Hypotheses of nearly equal cost are averaged with the weights
exp(-cost / 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from thorvaldc.runtime.calculators.twist_fit import (
    TEST_ROLL,
    USE_ROLL,
    USE_SIDE,
    Fit,
    Measurement,
    chi_squares,
    compare_with_others,
    misfit,
)

_CREDIBLE = 6.63
"""Chi-square (1 degree of freedom, 1 %) up to which one row of a faulty wheel is still used."""
_NEGLIGIBLE = 9.2
"""Difference of costs from which a hypothesis is ignored: its weight is below 1 %."""
_PAIR_SEEDS = 3
"""Number of the most likely single wheels that the search extends to pairs."""


class Hypothesis(NamedTuple):
    """The assumption that some wheels are faulty, and the fit without them.

    ``rejected``: indices of the faulty wheels among the measurements.  ``measurements``: those of
    the rejected wheels are not used, except a row that still agrees.  ``cost``: see the module.
    ``worst_ratio``: the largest D / gate of the other wheels; above 1 one of them is suspect.
    """

    rejected: tuple[int, ...]
    measurements: list[Measurement]
    fit: Fit
    cost: float
    worst_ratio: float


class HypothesisSearch:
    """Search for at most ``max_rejected`` (0 to 2) faulty wheels.

    ``gates``: per measurement, the D beyond which it is suspect.  ``price``: see the module.
    ``fit_anew`` fits measurements from the unweighted solution, so that faulty wheels leave no
    trace in the weights of the others; ``refit`` fits them from the twist of a previous fit.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        max_rejected: int,
        fit_anew: Callable[[list[Measurement]], Fit],
        refit: Callable[[list[Measurement], Fit], Fit],
    ) -> None:
        self._gates = gates
        self._price = price
        self._max_rejected = max_rejected
        self._fit_anew = fit_anew
        self._refit = refit

    def likely_hypotheses(self, measurements: list[Measurement], fit: Fit) -> list[Hypothesis]:
        """Returns all hypotheses that are not negligible, most likely first.

        ``fit`` is the fit of all measurements; that all are healthy is one of the hypotheses.
        Returns an empty list if no hypothesis explains the misfit.
        """
        all_healthy = self._hypothesis((), measurements, fit)
        singles = self._reject_one_more(all_healthy)
        singles.sort(key=_cost)
        hypotheses = [all_healthy, *singles]
        if singles and self._max_rejected > 1 and min(hypotheses, key=_cost).worst_ratio > 1.0:
            for rank, single in enumerate(singles[:_PAIR_SEEDS]):
                # Pairs with a more likely wheel are in the list already.
                visited = [s.rejected[0] for s in singles[:rank]]
                hypotheses += self._reject_one_more(single, visited)
        hypotheses.sort(key=_cost)
        best = hypotheses[0]
        if best.worst_ratio > 2.0:  # twice the gate: about the square of its probability
            return []
        return [
            h._replace(fit=self._refit(h.measurements, h.fit)) if h.rejected else h
            for h in hypotheses
            if h.cost - best.cost < _NEGLIGIBLE
        ]

    def _reject_one_more(
        self, hypothesis: Hypothesis, visited: Sequence[int] = ()
    ) -> list[Hypothesis]:
        """Returns the hypotheses with one more rejected wheel, except the ``visited`` ones.

        Only wheels without which the others still determine the twist can be rejected.
        """
        extended: list[Hypothesis] = []
        if len(hypothesis.rejected) >= self._max_rejected:
            return extended
        for k, measurement in enumerate(hypothesis.fit.measurements):
            if k in hypothesis.rejected or k in visited:
                continue
            if not compare_with_others(hypothesis.fit, measurement).redundant:
                continue
            rejected = (*hypothesis.rejected, k)
            remaining = [
                _with_use(m, 0) if j in rejected else m
                for j, m in enumerate(hypothesis.measurements)
            ]
            extended.append(self._hypothesis(rejected, remaining, self._fit_anew(remaining)))
        return extended

    def _hypothesis(
        self, rejected: tuple[int, ...], measurements: list[Measurement], fit: Fit
    ) -> Hypothesis:
        """Computes the cost, and takes back one row of each rejected wheel if it agrees.

        A slipping wheel still measures its direction, a wrong angle still has the right speed.
        """
        worst_ratio = 0.0
        for k, d in enumerate(chi_squares(fit)):
            if k not in rejected:
                worst_ratio = max(worst_ratio, d / self._gates[k])
        cost = misfit(fit)
        measurements, current = [*measurements], fit
        for order, k in enumerate(rejected, 1):
            cost += order * self._price
            if not measurements[k][0] & TEST_ROLL:
                continue
            comparison = compare_with_others(current, current.measurements[k])
            smaller = min(comparison.roll, comparison.side)
            cost += min(smaller, _CREDIBLE)
            if smaller < _CREDIBLE:
                row = USE_ROLL if comparison.roll == smaller else USE_SIDE
                measurements[k] = _with_use(measurements[k], row)
                if order < len(rejected):
                    current = self._refit(measurements, current)
        return Hypothesis(rejected, measurements, fit, cost, worst_ratio)


def mixture(hypotheses: Sequence[Hypothesis]) -> tuple[Fit, float]:
    """Returns mean and covariance over the hypotheses, and the probability of the first one.

    With probabilities p_i, means xi_i and covariances P_i:
    xi = sum p_i xi_i and P = sum p_i (P_i + (xi_i - xi) (xi_i - xi)').
    """
    best = hypotheses[0]
    if len(hypotheses) == 1:
        return best.fit, 1.0
    weights = [math.exp((best.cost - h.cost) / 2.0) for h in hypotheses]
    total = sum(weights)
    probabilities = [weight / total for weight in weights]
    fits = [h.fit for h in hypotheses]
    vx = sum(p * f.vx for p, f in zip(probabilities, fits, strict=True))
    vy = sum(p * f.vy for p, f in zip(probabilities, fits, strict=True))
    wz = sum(p * f.wz for p, f in zip(probabilities, fits, strict=True))
    p11 = p12 = p13 = p22 = p23 = p33 = 0.0
    for p, f in zip(probabilities, fits, strict=True):
        dx, dy, dw = f.vx - vx, f.vy - vy, f.wz - wz
        p11 += p * (f.p11 + dx * dx)
        p12 += p * (f.p12 + dx * dy)
        p13 += p * (f.p13 + dx * dw)
        p22 += p * (f.p22 + dy * dy)
        p23 += p * (f.p23 + dy * dw)
        p33 += p * (f.p33 + dw * dw)
    mean = Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, best.fit.measurements)
    return mean, probabilities[0]


def _cost(hypothesis: Hypothesis) -> float:
    return hypothesis.cost


def _with_use(measurement: Measurement, use: int) -> Measurement:
    """Returns the measurement of which the fit uses only these rows (USE_ROLL, USE_SIDE, 0)."""
    return (measurement[0] & ~(USE_ROLL | USE_SIDE) | use, *measurement[1:])
