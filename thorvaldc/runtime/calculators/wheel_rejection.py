"""Rejects faulty wheels by a search over hypotheses about which wheels are faulty.

A wheel that slips, stalls or has a wrong steering angle disagrees with the other wheels.  The
chi-square D of a faulty wheel therefore exceeds a threshold, the gate (see
``twist_fit.chi_squares``).  A faulty wheel also changes the fitted twist, so the chi-squares of
healthy wheels can exceed their gates.  On a robot with few wheels, a healthy wheel can even have
the largest chi-square.  The search therefore fits the twist without each wheel in turn
(leave-one-out).  If no single wheel explains the misfit, the search also leaves out pairs of
wheels.  Cost of the hypothesis that the wheels of a set F are faulty:

    cost = misfit of the used measurements + price of F

Up to a constant, the cost of a hypothesis is -2 log of its likelihood.  Hypotheses of nearly equal
cost are averaged with the weights exp(-cost / 2).

A vote of the wheels alone is wrong if more than half of them are faulty: two dead encoders of three
agree that the robot stands.  Only the commands can tell.  With the commanded speed c and the
measured speed z of an encoder, the wheel

*   follows its command if |z - c| is at most the error e(c) of ``following_error``;
*   is suspect if z / c < 0.2, as of a dead or reversed encoder or a stalled motor;
*   deviates otherwise, as of a stuck encoder, a delay, or a motor at its limit.

The price of F has these parts (``q`` is the chi-square that a healthy wheel exceeds with the
permitted rate of false rejections):

*   k q for the k-th wheel of F that follows its command.  Because of the factor k, two faulty
    wheels are less likely than one.
*   6 for each suspect wheel outside of F.  A suspect wheel in F costs nothing: the command explains
    it.
*   5 for each deviating wheel if F contains all of them: encoders get stuck one by one. If F leaves
    a deviating wheel, 5 once, and those in F count as wheels that follow. So they do if most wheels
    deviate by nearly the same share: a load, or the delay of a bus in a ramp, slows down all wheels
    at once, which says nothing against one of them.

The search adds the sets F of all suspect wheels, and of all suspect and deviating wheels, of any
size.  The wheels of such a set F keep their directions.  A small error of a single trusted encoder
that nothing else confirms (its leverage L P L' / sigma_L^2 is near 1), or of encoders that are not
the majority, cannot be seen, nor whether a lag or faults let most wheels deviate.  Then the
covariance also includes the hypothesis that all encoders are wrong and the wheels follow their
commands.

In the covariance, each likely hypothesis has at least the weight w = 0.1.  If a hypothesis at the
distance d from the mean is true, the squared error d' (w d d' + ...)^-1 d is at most 1 / w = 10,
below the 99.9 % quantile 16.3 of the chi-square distribution with 3 degrees of freedom.

Without redundancy no wheel disagrees: two wheels on an axle, or encoders that are all dead.  If
a wheel is suspect, or deviates and no other wheel confirms it, the twist stays as measured, and its
covariance gets the square of the distance to the twist of the commands (``doubted_wheels``).
Wheels without a command are never suspect: robots are pushed and roll out.

Without commands (``commanded`` is empty), consistent pairs of wheels are equally likely.  A smaller
misfit is no evidence, because two dead encoders have no noise and therefore the misfit 0.  If at
least half of the wheels stand, they may all be dead.

A wrong radius agrees with its command.  One of few measurements that is wrong by a few standard
deviations changes the twist more than the chi-squares, and stays unnoticed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.calculators.twist_fit import (
    TEST_ROLL,
    USE_ROLL,
    USE_SIDE,
    Fit,
    Measurement,
    NoiseSquares,
    NormalEquations,
    add_rolling_speed,
    chi_squares,
    compare_with_others,
    fit_twist,
    misfit,
    rolling_leverage,
    unweighted_normal_equations,
)
from thorvaldc.runtime.se2 import Row3

_FOLLOWING: Final = 0.03
"""Error of a wheel that follows its command, relative to the commanded speed."""
FOLLOWING_FLOOR: Final = 0.015
"""Error (m/s) of a wheel that follows its command, in addition to the relative error.

A wheel that accelerates by 0.75 m/s^2 is so much slower than its command of the last tick.
"""


class HypothesisFits(NamedTuple):
    """Fits the twist to the measurements of a tick, under hypotheses about faulty wheels.

    - ``solve``: solves the unweighted normal equations.
    - ``squares``: variances from ``Noise.squares``.
    - ``prior``: prior information for measurements of trusted wheels.
    - ``weak_prior``: prior information if the trusted wheels may not determine the twist.
    - ``yaw_rate``: yaw rate (rad/s) that a gyro measures, or ``None`` without a gyro.
    - ``steps``: number of Gauss-Newton steps of ``refit``.
    - ``commanded``: commanded rolling speed (m/s) of the contact of each measured wheel, or empty
      if the commands are unknown.
    """

    solve: Callable[[NormalEquations, float | None], tuple[Row3, int]]
    squares: NoiseSquares
    prior: tuple[float, float]
    weak_prior: tuple[float, float]
    yaw_rate: float | None
    steps: int
    commanded: Sequence[float]

    def refit(self, measurements: list[Measurement], previous: Fit) -> Fit:
        """Fits with weights from a previous fit."""
        for _ in range(self.steps):
            vx, vy, wz = previous[:3]
            previous = fit_twist(measurements, vx, vy, wz, self.squares, self.prior, self.yaw_rate)
        return previous

    def anew(self, measurements: list[Measurement]) -> Fit:
        """Fits with weights from the unweighted fit of the same measurements.

        The weights of the healthy wheels are then independent of the faulty wheels.
        """
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(measurements), self.yaw_rate)
        first = fit_twist(measurements, vx, vy, wz, self.squares, self.prior, self.yaw_rate)
        return self.refit(measurements, first)

    def with_commands(self, measurements: list[Measurement], faulty: Sequence[int]) -> Fit:
        """Fits where the encoders of the wheels ``faulty`` are wrong.

        The commands, if known, measure the speeds of these wheels, with the errors of
        ``following_error``.  Speeds that nothing measures are 0 with the top speed as the standard
        deviation.
        """
        expected = measurements
        if self.commanded:
            # The weights need a twist that the faulty encoders do not influence.
            expected = [
                (m[0] | USE_ROLL, *m[1:5], self.commanded[k], *m[6:]) if k in faulty else m
                for k, m in enumerate(measurements)
            ]
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(expected), self.yaw_rate)
        fit = fit_twist(measurements, vx, vy, wz, self.squares, self.weak_prior, self.yaw_rate)
        if self.commanded:
            for k in faulty:
                speed = self.commanded[k]
                fit = add_rolling_speed(fit, k, speed, following_error(speed) ** 2)
        return fit

    def without_encoders(self, measurements: list[Measurement]) -> Fit:
        """Fits where all encoders are wrong."""
        encoders = [k for k, m in enumerate(measurements) if m[0] & USE_ROLL]
        return self.with_commands([(m[0] & ~USE_ROLL, *m[1:]) for m in measurements], encoders)


def following_error(speed: float) -> float:
    """Returns the largest error (m/s) of a wheel that follows its commanded speed (m/s)."""
    return FOLLOWING_FLOOR + _FOLLOWING * abs(speed)


_CREDIBLE: Final = 6.63
"""The fit still uses one of the two measurements of a faulty wheel up to this chi-square.

The number is the 1 % quantile of the chi-square distribution with 1 degree of freedom.
"""
_NEGLIGIBLE: Final = 9.2
"""A hypothesis has a weight below 1 % if its cost exceeds the smallest cost by this difference."""
_SUSPECT_PRICE: Final = 6.0
"""Cost of a hypothesis that trusts the speed of a suspect wheel: odds of 1 to 20."""
_DEVIATION_PRICE: Final = 5.0
"""Cost of a deviating wheel that is rejected, and of a hypothesis that trusts deviating wheels.

Encoders get stuck one by one, but a load delays all wheels at once.
"""
COMMANDED_SPEED: Final = 0.05
"""Commanded speed (m/s) from which a wheel can contradict its command."""
_SUSPECT_SHARE: Final = 0.2
"""A wheel stands or turns backwards if its speed is below this share of the commanded speed."""
_COMMON_LAG: Final = 0.25
"""Largest difference of the shares of their commands that wheels with a common lag reach."""
_STANDING: Final = 0.005
"""Speed (m/s) below which a wheel stands."""
_UNCONFIRMED: Final = 0.75
"""Share of a measured speed in its own estimate from which no other wheel confirms it."""
_LEAST_WEIGHT: Final = 0.1
"""Least weight of a likely hypothesis in the covariance: the truth is within 3.2 sigma."""
_MIN_PROBABILITY: Final = 0.6
"""Least probability at which a single faulty wheel is named: it exceeds all others clearly."""
_MIN_PAIR_PROBABILITY: Final = 0.97
"""Least probability at which two faulty wheels are named."""
_PAIR_SEEDS: Final = 3
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
    by_commands: bool = False


class Suspicion(NamedTuple):
    """Measured wheels whose speeds contradict the commands.

    - ``known``: ``True`` if the commands are known.
    - ``lags``: ``True`` if most commanded wheels deviate by nearly the same share.
    - ``suspects``: indices of the wheels that stand or turn backwards although commanded.
    - ``deviating``: indices of the wheels that turn in the commanded direction at a wrong speed.
    """

    known: bool
    lags: bool
    suspects: tuple[int, ...]
    deviating: tuple[int, ...]


class HypothesisSearch:
    """Searches for the faulty wheels of a robot.

    - ``gates``: for each measured wheel, the chi-square above which the wheel disagrees.
    - ``price``: cost of a rejected wheel, as explained in the documentation of the module
      ``wheel_rejection``.
    - ``max_rejected``: largest number of faulty wheels that the search rejects against their
      commands, 0 to 2.
    - ``suspicion``: wheels that contradict their commands.
    - ``fits``: fits of the twist under a hypothesis.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        max_rejected: int,
        suspicion: Suspicion,
        fits: HypothesisFits,
    ) -> None:
        self._gates = gates
        self._price = price
        self._max_rejected = max_rejected
        self._suspicion = suspicion
        self._fits = fits

    def likely_hypotheses(self, measurements: list[Measurement], fit: Fit) -> list[Hypothesis]:
        """Returns all likely hypotheses about faulty wheels, the most likely hypothesis first.

        ``fit`` is the fitted twist with all measurements.  The returned list includes the
        hypothesis that all wheels are healthy.  Returns an empty list if no combination of faulty
        wheels explains the misfit.
        """
        all_healthy = self._hypothesis((), measurements, fit)
        singles = self._reject_one_more(all_healthy)
        singles.sort(key=_cost)
        hypotheses = [all_healthy, *singles, *self._by_commands(measurements)]
        hypotheses += self._without_commands(measurements)
        if singles and self._max_rejected > 1 and min(hypotheses, key=_cost).worst_ratio > 1.0:
            pairs: list[Hypothesis] = []
            for rank, single in enumerate(singles[:_PAIR_SEEDS]):
                # The list already contains all pairs of wheels with a more likely faulty wheel.
                visited = [s.rejected[0] for s in singles[:rank]]
                pairs += self._reject_one_more(single, visited)
            hypotheses += _equally_likely(pairs)
        hypotheses = _distinct(hypotheses)
        best = hypotheses[0]
        if best.worst_ratio > 2.0:  # twice the gate has about the square of the gate's probability
            return []
        likely = [
            h._replace(fit=self._fits.refit(h.measurements, h.fit))
            if h.rejected and not h.by_commands
            else h
            for h in hypotheses
            if h.cost - best.cost < _NEGLIGIBLE
        ]
        encoders = len(_encoders(measurements))
        suspicious = self._suspicion.suspects or self._suspicion.deviating
        if self._suspicion.lags or (
            suspicious and any(2 * len(h.rejected) >= encoders or _unconfirmed(h) for h in likely)
        ):
            last = self._encoders_faulty(_encoders(measurements), measurements)
            likely.append(last._replace(cost=max(last.cost, best.cost + _NEGLIGIBLE)))
        return likely

    def _by_commands(self, measurements: list[Measurement]) -> list[Hypothesis]:
        """Returns the hypotheses that all wheels with wrong speeds have faulty encoders.

        The number of these wheels is not limited.  If the other wheels still disagree, one of them
        is faulty too, or all encoders are.
        """
        suspects, deviating = self._suspicion.suspects, self._suspicion.deviating
        hypotheses: list[Hypothesis] = []
        if not (suspects or deviating):
            return hypotheses
        encoders = _encoders(measurements)
        for rejected in sorted({suspects, tuple(sorted((*suspects, *deviating)))} - {()}):
            first = self._encoders_faulty(rejected, measurements)
            hypotheses.append(first)
            if first.worst_ratio > 1.0:
                hypotheses += [
                    self._encoders_faulty((*rejected, k), measurements)
                    for k in encoders
                    if k not in rejected
                ]
        return [*hypotheses, self._encoders_faulty(encoders, measurements)]

    def _without_commands(self, measurements: list[Measurement]) -> list[Hypothesis]:
        """Returns two equally likely hypotheses if at least half of the wheels stand.

        Either the robot stands, and the other wheels spin, or the encoders of the standing wheels
        are dead.  The agreement of wheels that stand is no evidence.
        """
        encoders = _encoders(measurements)
        standing = tuple(k for k in encoders if abs(measurements[k][5]) < _STANDING)
        moving = tuple(k for k in encoders if k not in standing)
        if self._suspicion.known or not moving or len(standing) < len(moving):
            return []
        return [
            self._encoders_faulty(rejected, measurements)._replace(cost=self._price)
            for rejected in (standing, moving)
        ]

    def _encoders_faulty(
        self, rejected: tuple[int, ...], measurements: list[Measurement]
    ) -> Hypothesis:
        """Returns the hypothesis that wheels measure their directions, but not their speeds."""
        remaining = [
            _with_use(m, m[0] & USE_SIDE) if k in rejected else m
            for k, m in enumerate(measurements)
        ]
        fit = self._fits.with_commands(remaining, rejected)
        worst_ratio = 0.0
        for k, (d, gate) in enumerate(zip(chi_squares(fit), self._gates, strict=True)):
            if k in rejected:
                d, gate = compare_with_others(fit, fit.measurements[k]).side, self._price
            worst_ratio = max(worst_ratio, d / gate)
        disagreement = misfit(fit)
        cost = disagreement + self._price_of(rejected)
        return Hypothesis(rejected, remaining, fit, cost, disagreement, worst_ratio, True)

    def _price_of(self, rejected: Sequence[int]) -> float:
        """Returns the cost of the assumption that the wheels ``rejected`` alone are faulty."""
        suspects, deviating = self._suspicion.suspects, self._suspicion.deviating
        cost = _SUSPECT_PRICE * len(set(suspects).difference(rejected))
        trusts = not set(deviating).issubset(rejected)
        if trusts:
            cost += _DEVIATION_PRICE
        order = 0
        for k in rejected:
            if k in deviating and not trusts and not self._suspicion.lags:
                cost += _DEVIATION_PRICE
            elif k not in suspects:
                order += 1
                cost += order * self._price
        return cost

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
            extended.append(self._hypothesis(rejected, remaining, self._fits.anew(remaining)))
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
        cost = self._price_of(rejected)
        measurements, current = [*measurements], fit
        for order, k in enumerate(rejected, 1):
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
                    current = self._fits.refit(measurements, current)
        cost += disagreement
        return Hypothesis(rejected, measurements, fit, cost, disagreement, worst_ratio)


def _encoders(measurements: Sequence[Measurement]) -> tuple[int, ...]:
    return tuple(k for k, m in enumerate(measurements) if m[0] & USE_ROLL)


def _distinct(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Returns the hypotheses, the most likely first, with each set of faulty wheels once."""
    distinct: dict[frozenset[int], Hypothesis] = {}
    for h in sorted(hypotheses, key=_cost):
        distinct.setdefault(frozenset(h.rejected), h)
    return list(distinct.values())


def _unconfirmed(hypothesis: Hypothesis) -> bool:
    """Returns ``True`` if no other wheel confirms the speed of a trusted encoder."""
    fit = hypothesis.fit
    return any(
        m[0] & USE_ROLL and rolling_leverage(fit, k) > _UNCONFIRMED
        for k, m in enumerate(hypothesis.measurements)
    )


def _equally_likely(pairs: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Gives all pairs whose remaining wheels agree the smallest misfit of any pair."""
    least = min((h.misfit for h in pairs), default=0.0)
    return [
        h._replace(cost=h.cost - h.misfit + least) if h.worst_ratio <= 1.0 else h for h in pairs
    ]


def suspicion(speeds: Sequence[tuple[float, float]]) -> Suspicion:
    """Returns the wheels whose speeds contradict the commands.

    ``speeds``: measured and commanded speed (m/s) of each wheel; 0 for a wheel without encoder.
    """
    suspects, deviating, shares = [], [], []
    for k, (measured, speed) in enumerate(speeds):
        if abs(speed) <= COMMANDED_SPEED:
            continue
        shares.append(measured / speed)
        if measured / speed < _SUSPECT_SHARE:
            suspects.append(k)
        elif abs(measured - speed) > following_error(speed):
            deviating.append(k)
    most = 2 * len(deviating) > len(shares)
    lags = most and max(shares) - min(shares) <= _COMMON_LAG
    return Suspicion(True, lags, tuple(suspects), tuple(deviating))


def doubted_wheels(fit: Fit, doubts: Suspicion) -> tuple[int, ...]:
    """Returns the wheels that may be faulty although all wheels agree.

    Wheels that all stand or turn backwards agree.  A deviating wheel is doubted only if no other
    wheel confirms its speed; a load or a delay lets all wheels deviate by the same share.
    """
    unconfirmed = (k for k in doubts.deviating if rolling_leverage(fit, k) > _UNCONFIRMED)
    return (*doubts.suspects, *unconfirmed)


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
    mean = best.fit._replace(vx=vx, vy=vy, wz=wz)
    return covering(mean, [max(p, _LEAST_WEIGHT) for p in probabilities], fits), probabilities[0]


def covering(mean: Fit, weights: Sequence[float], fits: Sequence[Fit]) -> Fit:
    """Returns ``mean`` with the covariance sum w_i (P_i + (xi_i - xi) (xi_i - xi)').

    With weights of sum 1 this is the covariance of a mixture.
    """
    vx, vy, wz = mean[:3]
    p11 = p12 = p13 = p22 = p23 = p33 = 0.0
    for p, f in zip(weights, fits, strict=True):
        dx, dy, dw = f.vx - vx, f.vy - vy, f.wz - wz
        p11 += p * (f.p11 + dx * dx)
        p12 += p * (f.p12 + dx * dy)
        p13 += p * (f.p13 + dx * dw)
        p22 += p * (f.p22 + dy * dy)
        p23 += p * (f.p23 + dy * dw)
        p33 += p * (f.p33 + dw * dw)
    return Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, mean.measurements)


def _cost(hypothesis: Hypothesis) -> float:
    return hypothesis.cost


def _with_use(measurement: Measurement, use: int) -> Measurement:
    """Returns a copy of a measurement with different flags for its use by the fit.

    ``use`` is ``USE_ROLL``, ``USE_SIDE``, or 0 if the fit must not use the measurement.
    """
    return (measurement[0] & ~(USE_ROLL | USE_SIDE) | use, *measurement[1:])
