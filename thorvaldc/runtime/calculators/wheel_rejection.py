"""Rejects faulty wheels by a search over hypotheses about which wheels are faulty.

A wheel that slips, stalls or has a wrong steering angle disagrees with the other wheels.  The
chi-square D of a faulty wheel therefore exceeds a threshold, the gate (see
``twist_fit.chi_squares``).  A faulty wheel also changes the fitted twist, so the chi-squares of
healthy wheels can exceed their gates.  On a robot with few wheels, a healthy wheel can even have
the largest chi-square.  The search therefore fits the twist without each wheel in turn
(leave-one-out).  If no single wheel explains the misfit, the search also leaves out pairs of
wheels.  Cost of the hypothesis that the wheels of a set F are faulty:

    cost = misfit of the used measurements + sum over the k-th wheel of F of k * price

Up to a constant, the cost of a hypothesis is -2 log of its likelihood.  ``price`` is the chi-square
that a healthy wheel exceeds with the permitted rate of false rejections.  Because of the factor k,
the search assumes that two faulty wheels are less likely than one.  Hypotheses of nearly equal cost
are averaged with the weights exp(-cost / 2).

Two pairs of wheels of a robot with four wheels can each be consistent: two dead encoders show a
robot that stands, and the other two encoders show a robot that drives.  The search treats such
pairs in two ways:

*   Consistent pairs are equally likely.  A smaller misfit is no evidence, because two dead encoders
    have no noise and therefore the misfit 0.
*   A wheel that was commanded to turn, but does not turn, is suspect.  A hypothesis that trusts the
    speed of a suspect wheel has a higher cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from thorvaldc.model.float_sum import float_sum
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
"""The fit still uses one of the two measurements of a faulty wheel up to this chi-square.

The number is the 1 % quantile of the chi-square distribution with 1 degree of freedom.
"""
_NEGLIGIBLE = 9.2
"""A hypothesis has a weight below 1 % if its cost exceeds the smallest cost by this difference."""
_SUSPECT_PRICE = 6.0
"""Cost of a hypothesis that trusts the speed of a suspect wheel: odds of 1 to 20."""
_SUSPECT_SPEED = 0.05
"""Commanded speed (m/s) from which a wheel that does not turn is suspect."""
_SUSPECT_SHARE = 0.2
"""A wheel does not turn if its speed is below this share of the commanded speed."""
_MIN_PROBABILITY = 0.6
"""Least probability at which a single faulty wheel is named: it exceeds all others clearly."""
_MIN_PAIR_PROBABILITY = 0.97
"""Least probability at which two faulty wheels are named."""
_PAIR_SEEDS = 3
"""Number of the most likely single faulty wheels that the search extends to pairs of wheels."""


class Hypothesis(NamedTuple):
    """The assumption that certain wheels are faulty, and the fit of the twist without these wheels.

    - ``rejected``: indices of the measurements of the faulty wheels.
    - ``measurements``: all measurements.  The fit uses at most one measurement of a rejected wheel,
      which must agree with the other wheels.
    - ``fit``: fitted twist without the rejected measurements.
    - ``cost``: cost of the hypothesis, by the formula in the documentation of the module
      ``wheel_rejection``.
    - ``misfit``: part of the cost that the used measurements cause.
    - ``worst_ratio``: largest quotient of chi-square and gate of the wheels that are not rejected.
      A wheel whose chi-square is larger than its gate disagrees with the other wheels.
    """

    rejected: tuple[int, ...]
    measurements: list[Measurement]
    fit: Fit
    cost: float
    misfit: float
    worst_ratio: float


class HypothesisSearch:
    """Searches for the faulty wheels of a robot.

    - ``gates``: for each measured wheel, the chi-square above which the wheel disagrees.
    - ``price``: cost of a rejected wheel, as explained in the documentation of the module
      ``wheel_rejection``.
    - ``max_rejected``: largest number of faulty wheels, 0 to 2.
    - ``suspects``: indices of the measured wheels that do not turn although commanded.
    - ``fit_anew``: function that fits the twist, with weights from the unweighted fit of the same
      measurements.  With ``fit_anew``, the weights of the healthy wheels are independent of the
      faulty wheels.
    - ``refit``: function that fits the twist with weights from a previous fit.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        max_rejected: int,
        suspects: Sequence[int],
        fit_anew: Callable[[list[Measurement]], Fit],
        refit: Callable[[list[Measurement], Fit], Fit],
    ) -> None:
        self._gates = gates
        self._price = price
        self._max_rejected = max_rejected
        self._suspects = suspects
        self._fit_anew = fit_anew
        self._refit = refit

    def likely_hypotheses(self, measurements: list[Measurement], fit: Fit) -> list[Hypothesis]:
        """Returns all likely hypotheses about faulty wheels, the most likely hypothesis first.

        ``fit`` is the fitted twist with all measurements.  The returned list includes the
        hypothesis that all wheels are healthy.  Returns an empty list if no combination of faulty
        wheels explains the misfit.
        """
        all_healthy = self._hypothesis((), measurements, fit)
        singles = self._reject_one_more(all_healthy)
        singles.sort(key=_cost)
        hypotheses = [all_healthy, *singles]
        if singles and self._max_rejected > 1 and min(hypotheses, key=_cost).worst_ratio > 1.0:
            pairs: list[Hypothesis] = []
            for rank, single in enumerate(singles[:_PAIR_SEEDS]):
                # The list already contains all pairs of wheels with a more likely faulty wheel.
                visited = [s.rejected[0] for s in singles[:rank]]
                pairs += self._reject_one_more(single, visited)
            hypotheses += _equally_likely(pairs)
        hypotheses.sort(key=_cost)
        best = hypotheses[0]
        if best.worst_ratio > 2.0:  # twice the gate has about the square of the gate's probability
            return []
        return [
            h._replace(fit=self._refit(h.measurements, h.fit)) if h.rejected else h
            for h in hypotheses
            if h.cost - best.cost < _NEGLIGIBLE
        ]

    def _reject_one_more(
        self, hypothesis: Hypothesis, visited: Sequence[int] = ()
    ) -> list[Hypothesis]:
        """Returns all hypotheses with one more faulty wheel than ``hypothesis``.

        ``visited`` contains the indices of wheels that are skipped, because the search has already
        rejected them.  A wheel can be rejected only if the other wheels determine the twist without
        it.
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
        """Computes the cost of a hypothesis, and keeps the correct measurement of a faulty wheel.

        A slipping wheel still measures its direction correctly.  A wheel with a wrong steering
        angle still measures its speed correctly.
        """
        worst_ratio = 0.0
        for k, d in enumerate(chi_squares(fit)):
            if k not in rejected:
                worst_ratio = max(worst_ratio, d / self._gates[k])
        disagreement = misfit(fit)
        cost = _SUSPECT_PRICE * sum(1 for k in self._suspects if k not in rejected)
        measurements, current = [*measurements], fit
        for order, k in enumerate(rejected, 1):
            cost += order * self._price
            if not measurements[k][0] & TEST_ROLL:
                continue
            comparison = compare_with_others(current, current.measurements[k])
            smaller = min(comparison.roll, comparison.side)
            if smaller >= _CREDIBLE:
                cost += _CREDIBLE
            else:
                disagreement += smaller
                row = USE_ROLL if comparison.roll == smaller else USE_SIDE
                measurements[k] = _with_use(measurements[k], row)
                if order < len(rejected):
                    current = self._refit(measurements, current)
        cost += disagreement
        return Hypothesis(rejected, measurements, fit, cost, disagreement, worst_ratio)


def _equally_likely(pairs: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Gives all pairs whose remaining wheels agree the smallest misfit of any pair."""
    least = min((h.misfit for h in pairs), default=0.0)
    return [
        h._replace(cost=h.cost - h.misfit + least) if h.worst_ratio <= 1.0 else h for h in pairs
    ]


def suspect_wheels(
    measurements: Sequence[Measurement], commanded: Sequence[float]
) -> tuple[int, ...]:
    """Returns the indices of the measured wheels that were commanded to turn, but do not turn.

    ``commanded``: commanded speed of each measured wheel, m/s.
    """
    return tuple(
        k
        for k, (m, speed) in enumerate(zip(measurements, commanded, strict=True))
        if m[0] & TEST_ROLL
        and abs(speed) > _SUSPECT_SPEED
        and abs(m[5]) < _SUSPECT_SHARE * abs(speed)
    )


def faulty_wheels(hypotheses: Sequence[Hypothesis], probability: float) -> tuple[int, ...]:
    """Returns the indices of the measurements of wheels that are clearly faulty.

    ``probability``: probability of the first hypothesis.  The result is empty if another hypothesis
    is too likely.
    """
    rejected = hypotheses[0].rejected
    least = _MIN_PAIR_PROBABILITY if len(rejected) > 1 else _MIN_PROBABILITY
    return rejected if probability > least else ()


def mixture(hypotheses: Sequence[Hypothesis]) -> tuple[Fit, float]:
    """Returns the mean fit of all hypotheses, and the probability of the first hypothesis.

    The fits of the hypotheses are averaged as a mixture of normal distributions.  With the
    probabilities p_i, means xi_i and covariances P_i of the hypotheses, the mixture has the mean xi
    = sum p_i xi_i and the covariance P = sum p_i (P_i + (xi_i - xi) (xi_i - xi)').
    """
    best = hypotheses[0]
    if len(hypotheses) == 1:
        return best.fit, 1.0
    weights = [math.exp((best.cost - h.cost) / 2.0) for h in hypotheses]
    total = float_sum(weights)
    probabilities = [weight / total for weight in weights]
    fits = [h.fit for h in hypotheses]
    vx = float_sum(p * f.vx for p, f in zip(probabilities, fits, strict=True))
    vy = float_sum(p * f.vy for p, f in zip(probabilities, fits, strict=True))
    wz = float_sum(p * f.wz for p, f in zip(probabilities, fits, strict=True))
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
    """Returns a copy of a measurement with different flags for its use by the fit.

    ``use`` is ``USE_ROLL``, ``USE_SIDE``, or 0 if the fit must not use the measurement.
    """
    return (measurement[0] & ~(USE_ROLL | USE_SIDE) | use, *measurement[1:])
