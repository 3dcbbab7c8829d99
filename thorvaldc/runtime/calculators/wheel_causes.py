"""Causes that make wheels disagree, and the mixture of the twists that follow from the causes.

Each wheel has a cause.  The cause says which row of ``twist_fit`` measures its rolling speed:

===============  ===========================================  ======================================
cause            examples                                     rolling speed of the contact
===============  ===========================================  ======================================
healthy          rolls, is pushed, or is stalled on ground    the reading z
wrong encoder    dead, reversed, stuck, wrong scale           the command c
spinning         ice, mud, a wheel in the air                 between 0 and z: z/2 with the standard
                                                              deviation of half of the top reading
wrong wheel      slips, or has a wrong steering angle         the one of z and the direction that
                                                              agrees with the other wheels, if any
===============  ===========================================  ======================================

A hypothesis gives each wheel a cause.  Up to a constant, its cost is -2 log of its likelihood:

    cost = misfit of the used measurements + price of the causes

Hypotheses of a robot whose wheels disagree:

1.  All wheels are healthy.  Price 0.
2.  One or two wheels are wrong wheels, whichever leave the smallest cost.  Price k q for the k-th
    of them, where ``q`` is the chi-square that a healthy wheel exceeds with the permitted rate of
    false alarms.
3.  The encoders of all wheels N that contradict their commands are wrong, and the robot moves as
    the other wheels say.  Price ``_ONE_ENCODER``, or ``_ENCODERS`` for more wheels, which then
    share a cause such as a cable.  Wheels whose readings are different shares of their commands
    share no cause: ``_OTHER_CAUSE`` for each further share.
4.  The encoders of N are right, and all other wheels spin.  The robot is held, or moves as the
    wheels N say.  Price ``_SPINNING``.

A motor that turns as commanded says nothing about the ground: if three wheels of four turn as
commanded and one stands, hypotheses 3 and 4 explain the readings equally well, and neither the
vote of the three wheels nor their commands decide.  A gyro decides if the hypotheses differ in the
yaw rate.  Wheels that contradict their commands and agree with each other do decide: a robot that
is pushed needs no accident to turn its wheels, but several stuck encoders do.

Without commands, the wheels that stand are N.

Means and covariances of all likely hypotheses are combined as a mixture of normal distributions.
In the covariance each likely hypothesis has at least the weight w = ``_LEAST_WEIGHT``.  If a
hypothesis at the distance d from the mean is true, the squared error d' (w d d' + ...)^-1 d is at
most 1 / w, far below the 99.9 % quantile 16.3 of the chi-square distribution with 3 degrees of
freedom.

Wheels that agree may still contradict their commands.  Hypotheses 3 and 4 are then added if a wheel
turns at less than 0.6 or more than 1.4 of its command (``_DOUBTFUL_SHARE``), or if no other wheel
confirms a wheel that deviates.  A load or a delay that makes all wheels slower changes nothing, and
nor does a push without a command.

All wheels that spin as commanded on a robot that is held, and a wrong radius, cannot be seen by
the wheels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
_COMMANDED_SPEED: Final = 0.05
"""Commanded speed (m/s) from which wheels that agree can contradict their commands."""
_DOUBTFUL_SHARE: Final = 0.4
"""Deviation from the command, relative to the command, that no load or delay explains."""
_COMMON_LAG: Final = 0.2
"""Largest difference of the shares of their commands that wheels with a common lag reach."""
_STANDING: Final = 0.005
"""Speed (m/s) below which a wheel stands."""
_UNCONFIRMED: Final = 0.75
"""Share of a measured speed in its own estimate from which no other wheel confirms it."""
_EQUAL_SHARES: Final = 0.1
"""Largest difference between the shares of their commands that encoders with one cause read."""

_EQUAL_VALUES: Final = 0.005
"""Largest difference (m/s) between the readings of encoders with one cause."""

_ONE_ENCODER: Final = 5.0
_ENCODERS: Final = 9.0
_OTHER_CAUSE: Final = 5.0
_SPINNING: Final = 9.0
_CREDIBLE: Final = 6.63
"""The fit still uses one of the two measurements of a wrong wheel up to this chi-square.

The number is the 1 % quantile of the chi-square distribution with 1 degree of freedom.
"""
_DRAGGED: Final = 2.0
_NEGLIGIBLE: Final = 9.2
"""A hypothesis has a weight below 1 % if its cost exceeds the smallest cost by this difference."""
_LEAST_WEIGHT: Final = 0.25
"""Least weight of a likely hypothesis in the covariance: the truth is within 2 sigma."""
_MIN_PROBABILITY: Final = 0.6
"""Least probability at which a single wrong wheel is named: it exceeds all others clearly."""
_MIN_PAIR_PROBABILITY: Final = 0.97
"""Least probability at which several wrong wheels are named."""
_PAIR_SEEDS: Final = 3
"""Number of the most likely single wrong wheels that the search extends to pairs of wheels."""


def following_error(speed: float) -> float:
    """Returns the largest error (m/s) of a wheel that follows its commanded speed (m/s)."""
    return FOLLOWING_FLOOR + _FOLLOWING * abs(speed)


class Fits(NamedTuple):
    """Fits the twist to the measurements of a tick, for given causes of the wheels.

    - ``solve``: solves the unweighted normal equations.
    - ``squares``: variances from ``Noise.squares``.
    - ``prior``: prior information for measurements of trusted wheels.
    - ``weak_prior``: prior information if the trusted wheels may not determine the twist.
    - ``yaw_rate``: yaw rate (rad/s) that a gyro measures, or ``None`` without a gyro.
    - ``steps``: number of Gauss-Newton steps of ``refit``.
    """

    solve: Callable[[NormalEquations, float | None], tuple[Row3, int]]
    squares: NoiseSquares
    prior: tuple[float, float]
    weak_prior: tuple[float, float]
    yaw_rate: float | None
    steps: int

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

    def replaced(
        self,
        measurements: list[Measurement],
        speeds: Mapping[int, tuple[float, float]],
        unknown: Sequence[int] = (),
    ) -> tuple[list[Measurement], Fit, float]:
        """Fits with other rolling speeds than those of the encoders.

        - ``speeds``: rolling speed (m/s) of the contact and its variance, for some wheels.
        - ``unknown``: wheels whose rolling speed is unknown.

        Returns the measurements without the replaced encoders, the fit, and its misfit.
        """
        expected: list[Measurement] = []
        remaining: list[Measurement] = []
        for k, m in enumerate(measurements):
            without = m
            if k in speeds or k in unknown:
                without = with_use(m, m[0] & USE_SIDE)
                m = (m[0], *m[1:5], speeds[k][0], *m[6:]) if k in speeds else without
            expected.append(m)
            remaining.append(without)
        # The weights need a twist that the replaced encoders do not influence.
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(expected), self.yaw_rate)
        fit = fit_twist(remaining, vx, vy, wz, self.squares, self.weak_prior, self.yaw_rate)
        for k, (value, variance) in speeds.items():
            fit = add_rolling_speed(fit, k, value, variance)
        disagreement = self.misfit(fit)
        for k, (value, variance) in speeds.items():
            _, c, s, x, y = fit.measurements[k][:5]
            rolls = c * (fit.vx - y * fit.wz) + s * (fit.vy + x * fit.wz)
            disagreement += (value - rolls) ** 2 / variance
        return remaining, fit, disagreement

    def misfit(self, fit: Fit) -> float:
        """Returns the misfit of the wheels and of the gyro."""
        return misfit(fit) + self.gyro_misfit(fit)

    def gyro_misfit(self, fit: Fit) -> float:
        """Returns the misfit of the gyro, 0 without a gyro."""
        if self.yaw_rate is None:
            return 0.0
        return (self.yaw_rate - fit.wz) ** 2 / self.squares[5]


class Hypothesis(NamedTuple):
    """Causes of the wheels, and the fit of the twist that follows from the causes.

    - ``wrong``: indices of the measurements of wrong wheels and of wheels with wrong encoders.
    - ``spinning``: indices of the measurements of spinning wheels.
    - ``measurements``: all measurements with the uses that the fit makes of them.
    - ``others``: fit without all measurements of the wrong wheels.
    - ``fit``: fit with the measurements of the wrong wheels that agree.
    - ``cost``: cost, by the formula in the documentation of the module ``wheel_causes``.
    - ``worst_ratio``: largest quotient of chi-square and gate of the healthy wheels.  A wheel whose
      chi-square is larger than its gate disagrees with the other wheels.
    """

    wrong: tuple[int, ...]
    spinning: tuple[int, ...]
    measurements: list[Measurement]
    others: Fit
    fit: Fit
    cost: float
    worst_ratio: float


class Contradiction(NamedTuple):
    """Wheels that contradict their commands.

    - ``wheels``: indices of the measurements of these wheels, N.
    - ``commands``: commanded rolling speed (m/s) of the contact of each measured wheel, or empty if
      the commands are unknown.
    - ``causes``: least number of causes that wrong encoders of N have.
    - ``doubtful``: ``True`` if no load or delay explains the deviation of a wheel, or no other
      wheel confirms it.
    """

    wheels: tuple[int, ...]
    commands: Sequence[float]
    causes: int
    doubtful: bool


def contradiction(fit: Fit, measurements: Sequence[Measurement], turning: Sequence[tuple[float, float]]) -> Contradiction:
    """Returns the wheels that contradict their commands; without commands, those that stand.

    - ``fit``: fitted twist with all measurements.
    - ``turning``: measured and commanded speed (m/s) of each measured wheel, or empty if the
      commands are unknown.
    """
    wheels: list[int] = []
    if not turning:
        wheels = [k for k in encoders(measurements) if abs(measurements[k][5]) < _STANDING]
        return Contradiction(tuple(wheels), (), 1, False)
    doubtful = False
    causes = 0
    highest, lowest = -math.inf, math.inf
    shares: list[float] = []
    values: list[float] = []
    for k in encoders(measurements):
        measured, command = turning[k]
        deviation = abs(measured - command)
        share = measured / command if abs(command) > _COMMANDED_SPEED else 1.0
        if deviation <= following_error(command):
            highest, lowest = max(highest, 1.0), min(lowest, 1.0)
            continue
        wheels.append(k)
        confirmed = rolling_leverage(fit, k) <= _UNCONFIRMED
        if abs(command) > _COMMANDED_SPEED:
            highest, lowest = max(highest, share), min(lowest, share)
            doubtful = doubtful or not confirmed or abs(share - 1.0) > _DOUBTFUL_SHARE
            if confirmed:
                _add_distinct(shares, share, _EQUAL_SHARES)
                _add_distinct(values, measured, _EQUAL_VALUES)
        elif confirmed:
            causes += 1
    doubtful = doubtful or highest - lowest > _COMMON_LAG
    causes = max(causes + min(len(shares), len(values)), 1)
    commands = [
        # The contact of a wheel beside its steering axis also moves with the steering joint.
        m[5] + command - measured
        for m, (measured, command) in zip(measurements, turning, strict=True)
    ]
    return Contradiction(tuple(wheels), commands, causes, doubtful)


def _add_distinct(values: list[float], value: float, tolerance: float) -> None:
    if all(abs(value - other) > tolerance for other in values):
        values.append(value)


class CauseSearch:
    """Finds the likely causes of wheels that disagree.

    - ``gates``: for each measured wheel, the chi-square above which the wheel disagrees.
    - ``price``: cost q of a wrong wheel.
    - ``max_wrong``: largest number of wrong wheels, 0 to 2.
    - ``against``: wheels that contradict their commands.
    - ``fits``: fits of the twist for given causes.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        max_wrong: int,
        length2: float,
        against: Contradiction,
        fits: Fits,
    ) -> None:
        self._gates = gates
        self._price = price
        self._max_wrong = max_wrong
        self._length2 = length2
        self._against = against
        self._fits = fits

    def likely_hypotheses(
        self, measurements: list[Measurement], fit: Fit, disagree: bool
    ) -> list[Hypothesis]:
        """Returns all likely hypotheses, the most likely first.

        ``fit`` is the fitted twist with all measurements.  ``disagree``: whether a wheel exceeds
        its gate.  Returns an empty list if no hypothesis explains the misfit.
        """
        healthy = self._wrong_wheels((), measurements, fit)
        whole = self._wrong_encoders(measurements)
        sliding = self._sliding(measurements) if self._against.wheels or self._against.commands else None
        found = [healthy, *whole]
        if sliding is not None:
            found.append(sliding)
        if disagree:
            known = [{*h.wrong} for h in whole if h.wrong]
            singles = self._one_more_wrong(healthy, known)
            singles.sort(key=_cost)
            found += singles
            if singles and self._max_wrong > 1 and min(found, key=_cost).worst_ratio > 1.0:
                for rank, single in enumerate(singles[:_PAIR_SEEDS]):
                    # The list already contains all pairs of wheels with a more likely wrong wheel.
                    visited = [s.wrong[0] for s in singles[:rank]]
                    found += self._one_more_wrong(single, known, visited)
        else:
            return found  # the agreement of wheels that contradict their commands proves nothing
        found.sort(key=_cost)
        best = found[0]
        if best.worst_ratio > 2.0:  # twice the gate has about the square of the gate's probability
            return []
        likely = [h for h in found if h.cost - best.cost < _NEGLIGIBLE]
        if self._against.commands and any(2 * len(h.wrong) >= len(self._against.commands) for h in likely):
            every = encoders(measurements)
            used, fit, _ = self.encoders_wrong(every, measurements)
            likely.append(self._priced(every, (), used, fit, 0.0, best.cost + _NEGLIGIBLE))
        return likely

    def encoders_wrong(
        self, wheels: Sequence[int], measurements: list[Measurement]
    ) -> tuple[list[Measurement], Fit, float]:
        """Fits where the encoders of the wheels are wrong, and the wheels follow their commands."""
        commands = self._against.commands
        if not commands:
            return self._fits.replaced(measurements, {}, wheels)
        speeds = {k: (commands[k], following_error(commands[k]) ** 2) for k in wheels}
        return self._fits.replaced(measurements, speeds)

    def _wrong_encoders(self, measurements: list[Measurement]) -> list[Hypothesis]:
        """Returns the hypothesis 3: the encoders of N are wrong, and perhaps one more."""
        wheels = self._against.wheels
        others = tuple(k for k in encoders(measurements) if k not in wheels)
        if not wheels or not (others or self._against.commands):
            return []
        used, fit, disagreement = self.encoders_wrong(wheels, measurements)
        price = _ONE_ENCODER if len(wheels) == 1 else _ENCODERS
        price += _OTHER_CAUSE * (self._against.causes - 1)
        found = [self._priced(wheels, (), used, fit, disagreement, price)]
        if found[0].worst_ratio > 1.0:
            for k in others:
                more = (*wheels, k)
                used, fit, disagreement = self.encoders_wrong(more, measurements)
                found.append(
                    self._priced(more, (), used, fit, disagreement, price + self._price)
                )
        return found

    def _sliding(self, measurements: list[Measurement]) -> Hypothesis | None:
        """Returns the hypothesis 4: the robot is held or pulled, and the wheels slide.

        Returns ``None`` if no wheel and no gyro contradicts the commands.
        """
        against, yaw_rate = self._against, self._fits.yaw_rate
        every = encoders(measurements)
        others = tuple(k for k in every if k not in against.wheels)
        used, fit, _ = self.encoders_wrong(every, measurements)
        vx, vy, wz = fit[:3]
        length = math.sqrt(self._length2)
        fastest = max((abs(measurements[k][5]) for k in every), default=0.0)
        share, deviation = 0.0, fastest
        if against.commands:
            share, deviation = 1.0, 0.0
            for k in against.wheels:
                measured, command = measurements[k][5], against.commands[k]
                if abs(measured - command) > deviation:
                    deviation = abs(measured - command)
                    share = measured / command if abs(command) > _COMMANDED_SPEED else 1.0
                    if abs(command) <= _COMMANDED_SPEED:
                        deviation *= _DRAGGED
            fastest = max(fastest, *(abs(against.commands[k]) for k in every))
            if yaw_rate is not None:
                turning = length * abs(yaw_rate - wz)
                noise = 3.0 * length * math.sqrt(self._fits.squares[5])
                if turning > following_error(length * wz) + noise:
                    deviation = max(fastest, _DRAGGED * turning)
                    if length * abs(wz) > _COMMANDED_SPEED:
                        share = yaw_rate / wz
        if not deviation:
            return None
        share = min(max(share, -1.0), 2.0)
        variance = (deviation * 0.5) ** 2
        angular = variance / self._length2
        vx, vy, wz = share * vx, share * vy, share * wz
        price = _SPINNING
        if yaw_rate is not None:
            noise = self._fits.squares[5]
            total = angular + noise
            price += min(
                (yaw_rate - wz) ** 2 / total + math.log(total / noise),
                yaw_rate * yaw_rate / (noise + 0.0004),
            )
            wz += angular / total * (yaw_rate - wz)
            angular *= noise / total
        fit = Fit(vx, vy, wz, variance, 0.0, 0.0, variance, 0.0, angular, fit.measurements)
        return Hypothesis((), others or every, used, fit, fit, price, 0.0)

    def _priced(
        self,
        wrong: tuple[int, ...],
        spinning: tuple[int, ...],
        used: list[Measurement],
        fit: Fit,
        disagreement: float,
        price: float,
    ) -> Hypothesis:
        """Returns a hypothesis about the whole robot.

        If the healthy wheels agree, a smaller misfit is no evidence, because wheels that stand and
        dead encoders have no noise.
        """
        ratio = self._worst_ratio(fit, (*wrong, *spinning))
        if ratio <= 1.0:
            disagreement = self._fits.gyro_misfit(fit)
        return Hypothesis(wrong, spinning, used, fit, fit, disagreement + price, ratio)

    def _one_more_wrong(
        self, hypothesis: Hypothesis, known: Sequence[set[int]], visited: Sequence[int] = ()
    ) -> list[Hypothesis]:
        """Returns all hypotheses with one more wrong wheel than ``hypothesis``.

        ``known``: sets of wheels that other hypotheses already leave out.  ``visited`` contains the indices of wheels that are skipped, because the search has already
        taken them as wrong.  A wheel can be wrong only if the other wheels determine the twist
        without it.
        """
        extended: list[Hypothesis] = []
        if len(hypothesis.wrong) >= self._max_wrong:
            return extended
        for k, measurement in enumerate(hypothesis.others.measurements):
            if k in hypothesis.wrong or k in visited:
                continue
            if not compare_with_others(hypothesis.others, measurement).redundant:
                continue
            wrong = (*hypothesis.wrong, k)
            if set(wrong) in known:
                continue
            remaining = [
                with_use(m, 0) if j in wrong else m for j, m in enumerate(hypothesis.measurements)
            ]
            extended.append(self._wrong_wheels(wrong, remaining, self._fits.anew(remaining)))
        return extended

    def _wrong_wheels(
        self, wrong: tuple[int, ...], measurements: list[Measurement], fit: Fit
    ) -> Hypothesis:
        """Computes the cost of wrong wheels, and keeps the correct measurement of each.

        A slipping wheel still measures its direction correctly.  A wheel with a wrong steering
        angle still measures its speed correctly.
        """
        ratio = self._worst_ratio(fit, wrong)
        cost = self._fits.misfit(fit)
        measurements, current = [*measurements], fit
        for order, k in enumerate(wrong, 1):
            cost += order * self._price
            if not measurements[k][0] & TEST_ROLL:
                continue
            comparison = compare_with_others(current, current.measurements[k])
            smaller = min(comparison.roll, comparison.side)
            if smaller >= _CREDIBLE:
                cost += _CREDIBLE
            else:
                cost += smaller
                row = USE_ROLL if comparison.roll == smaller else USE_SIDE
                measurements[k] = with_use(measurements[k], row)
                current = self._fits.refit(measurements, current)
        return Hypothesis(wrong, (), measurements, fit, current, cost, ratio)

    def _worst_ratio(self, fit: Fit, others: Sequence[int]) -> float:
        ratios = [0.0]
        for k, (d, gate) in enumerate(zip(chi_squares(fit), self._gates, strict=True)):
            if k not in others:
                ratios.append(d / gate)
        return max(ratios)


def encoders(measurements: Sequence[Measurement]) -> tuple[int, ...]:
    """Returns the indices of the measurements with an encoder that the fit may use."""
    return tuple(k for k, m in enumerate(measurements) if m[0] & USE_ROLL)


class Mixture(NamedTuple):
    """Mixture of the likely hypotheses.

    - ``fit``: mean twist and covariance.
    - ``left_out``: indices of the measurements of wheels that are clearly wrong or spinning.
    - ``suspects``: indices of the measurements of wheels that may be wrong.
    - ``spinning``: indices of the measurements of wheels that may spin.
    """

    fit: Fit
    left_out: tuple[int, ...]
    suspects: tuple[int, ...]
    spinning: tuple[int, ...]


def mixture(hypotheses: Sequence[Hypothesis]) -> Mixture:
    """Returns the mixture of the hypotheses, of which the first is the most likely.

    With the probabilities p_i, means xi_i and covariances P_i of the hypotheses, the mixture has
    the mean xi = sum p_i xi_i and the covariance P = sum p_i (P_i + (xi_i - xi) (xi_i - xi)').
    """
    best = hypotheses[0]
    left_out = best.wrong
    if len(hypotheses) == 1:
        return Mixture(best.fit, left_out, (), best.spinning)
    weights = [math.exp((best.cost - h.cost) / 2.0) for h in hypotheses]
    total = float_sum(weights)
    probabilities = [weight / total for weight in weights]
    fits = [h.fit for h in hypotheses]
    vx = float_sum(p * f.vx for p, f in zip(probabilities, fits, strict=True))
    vy = float_sum(p * f.vy for p, f in zip(probabilities, fits, strict=True))
    wz = float_sum(p * f.wz for p, f in zip(probabilities, fits, strict=True))
    mean = best.fit._replace(vx=vx, vy=vy, wz=wz)
    mean = covering(mean, [max(p, _LEAST_WEIGHT) for p in probabilities], fits)
    # Nothing is left out on the word of a motor that turns as commanded.
    undecided = any(h.spinning for h in hypotheses)
    least = _MIN_PAIR_PROBABILITY if len(left_out) > 1 or undecided else _MIN_PROBABILITY
    if probabilities[0] > least and not best.spinning:
        return Mixture(mean, left_out, (), ())
    suspects = {k for h in hypotheses for k in h.wrong}
    spinning = {k for h in hypotheses for k in h.spinning}
    return Mixture(mean, (), tuple(suspects), tuple(spinning - suspects))


def covering(mean: Fit, weights: Sequence[float], fits: Sequence[Fit]) -> Fit:
    """Returns ``mean`` with the covariance sum P_i + w_i (xi_i - xi) (xi_i - xi)'.

    A mixture weights the covariances P_i too.  They count in full, because the true hypothesis may
    be one of small weight.
    """
    vx, vy, wz = mean[:3]
    p11 = p12 = p13 = p22 = p23 = p33 = 0.0
    for p, f in zip(weights, fits, strict=True):
        dx, dy, dw = f.vx - vx, f.vy - vy, f.wz - wz
        p11 += f.p11 + p * dx * dx
        p12 += f.p12 + p * dx * dy
        p13 += f.p13 + p * dx * dw
        p22 += f.p22 + p * dy * dy
        p23 += f.p23 + p * dy * dw
        p33 += f.p33 + p * dw * dw
    return Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, mean.measurements)


def with_covariance(fit: Fit, factor: float) -> Fit:
    """Returns ``fit`` with its covariance multiplied by ``factor``."""
    vx, vy, wz, *covariance, measurements = fit
    return Fit(vx, vy, wz, *(factor * p for p in covariance), measurements)


def _cost(hypothesis: Hypothesis) -> float:
    return hypothesis.cost


def with_use(measurement: Measurement, use: int) -> Measurement:
    """Returns a copy of a measurement with different flags for its use by the fit.

    ``use`` is ``USE_ROLL``, ``USE_SIDE``, or 0 if the fit must not use the measurement.
    """
    return (measurement[0] & ~(USE_ROLL | USE_SIDE) | use, *measurement[1:])
