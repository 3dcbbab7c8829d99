"""Causes that make wheels disagree, and the mixture of the twists that follow from the causes.

A wheel that disagrees with the other wheels or with its command has one of these causes:

================  =========================================  =======================================
cause             examples                                   rolling speed of the contact
================  =========================================  =======================================
healthy           rolls, lags, is pushed, stalls             reading z
wrong encoder     dead, reversed, stuck, wrong scale         command c
sliding           ice, mud, held by a wall, pulled           anything up to the speed of the wheels
wrong wheel       wrong steering angle, slips alone          what agrees with the other wheels
wrong radius      worn, without air                          reading z, a little wrong
================  =========================================  =======================================

A hypothesis gives each wheel a cause, and has its own fit of the twist.  Up to a constant, its cost
is -2 log of its likelihood:

    cost = misfit of the used measurements + price of the causes

N are the wheels that contradict their commands: |z - c| exceeds the error e(c) of
``following_error``.  Hypotheses:

1.  All wheels are healthy.  Price 0.
2.  One or two wheels are wrong wheels, whichever fit best.  Price k q for the k-th of them, where
    ``q`` is the chi-square that a healthy wheel exceeds with the permitted rate of false alarms.
3.  The encoders of N are wrong, the robot moves as the other wheels say, and N follow their
    commands.  Price ``_ONE_ENCODER`` for one wheel, if no load explains its deviation, and
    ``_ENCODERS`` for more.  Encoders that read different shares of their commands share no cause:
    ``_PUSHED`` more for each further share, and for each further wheel that should stand.  If the
    other wheels disagree, one more is wrong.  Most wheels may deviate by a load or a delay instead.
4.  The readings are right, and the wheels slide: the robot is held or pulled.  Price ``_SLIDING``.
    Its twist is the fit of all wheels with a standard deviation that follows from the wheel that
    deviates most, by d = |1 - z / c|: d v / 2 if all wheels deviate, where v is the speed of the
    fastest wheel, and sqrt(d) v / 2 if the wheels disagree.  A held robot and one that moves as
    commanded then lie within two standard deviations if a wheel stands, and within four if one is
    slower by a quarter: the ground says more than that wheel.  A reading above ``_IMPOSSIBLE``
    times the top speed is wrong here too.
5.  The radii are wrong.  Price ``_RADII``.  Its twist is the fit of all wheels, with the errors of
    rolling speeds that the misfit shows, and with a common error of all speeds as large as the
    largest that a wheel or a gyro shows: most wheels may be wrong by the same share.

A motor that turns as commanded says nothing about the ground.  If three wheels of four turn as
commanded and one stands, its encoder is dead (3), or the robot stands and three wheels spin (4).
Neither the vote of the three wheels nor their commands decide.  A gyro decides if the hypotheses
differ in the yaw rate.  If it contradicts wheels that follow their commands, hypothesis 4 remains
likely at any cost, because a wrong wheel explains by accident that few wheels and a gyro disagree.
Wheels that contradict their commands and agree with each other decide too:
a push turns all of them at once, but several stuck encoders agree by accident only.  Without
commands, N are the wheels that stand while others turn.

The likely hypotheses are combined as a mixture of normal distributions.  In the covariance, each
has at least the weight w = ``_LEAST_WEIGHT``, or ``_LEAST_WEIGHT_WRONG`` for hypothesis 2.  If a
hypothesis at the distance d from the mean is true, the squared error d' (w d d' + ...)^-1 d is at
most 1 / w, below the 99.9 % quantile 16.3 of the chi-square distribution with 3 degrees of freedom.

Wheels that agree may still contradict their commands: all of them, or wheels that no other wheel
confirms.  Hypotheses 3 and 4 are then added to the covariance, unless a load or a delay may explain
the deviation: all wheels read nearly the same share of their commands, between 1 - ``DOUBTFUL``
and 1 + ``DOUBTFUL``; wheels that no other wheel confirms, or that skid, must read more nearly the
same.  Nothing confirms a single wheel.  A push is no contradiction if all wheels turn, or if the
wheels that stand would fail a test.

Wheels do not see that all of them spin as commanded on a robot that is held, nor that all radii are
wrong by the same share, nor an error that stays below the gates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

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
    rolling_speed,
    unweighted_normal_equations,
)
from thorvaldc.runtime.calculators.wheel_contradictions import (
    COMMANDED_SPEED,
    DOUBTFUL,
    Contradiction,
    encoders,
    following_error,
)
from thorvaldc.runtime.calculators.wheel_mixture import Hypothesis, covering, with_covariance
from thorvaldc.runtime.se2 import Row3

_OVERSHOOT: Final = 0.1
"""Share of its command by which a motor exceeds it, or turns backwards."""
_DRAGGED: Final = 0.1
"""Standard deviation (m/s) of the speed of a robot that is dragged on wheels that should stand.

It is added to half of the wheels' speed.
"""
_SLIDING_SHARE: Final = 0.6
"""Standard deviation of the speed of a robot that slides for certain, relative to its wheels."""
_PULLED: Final = 0.3
"""Least standard deviation (m/s) of that speed: a pull may be faster than the wheels."""
_IMPOSSIBLE: Final = 2.0
"""Multiple of the top speed above which a reading is wrong: sliding does not explain it."""
_HELD_YAW_RATE: Final = 0.02
"""Standard deviation (rad/s) of the yaw rate of a robot that is held."""

_ONE_ENCODER: Final = 5.0
"""Price of one wrong encoder, the most frequent of the causes here."""
_ENCODERS: Final = 10.0
"""Price of several wrong encoders, and of one whose deviation a load may explain."""
_PUSHED: Final = 5.0
"""Price of each further share that wrong encoders read, or wheel that turns although it should
stand."""
_SLIDING: Final = 9.0
"""Price of wheels that slide: as likely as encoders that are wrong together."""
_RADII: Final = 16.0
"""Price of wrong radii."""
_RADIUS_ERROR: Final = 0.1
"""Largest error of a radius, relative to it: that of a tyre without air."""
_AGAINST_MOTOR: Final = 5.0
"""Further price of wheels that the ground turns backwards or faster than their motors should."""
_CREDIBLE: Final = 6.63
"""The fit still uses one of the two measurements of a wrong wheel up to this chi-square.

The number is the 1 % quantile of the chi-square distribution with 1 degree of freedom.
"""
_NEGLIGIBLE: Final = 9.2
"""A hypothesis has a weight below 1 % if its cost exceeds the smallest cost by this difference."""
_LEAST_WEIGHT: Final = 0.25
"""Least weight of a likely hypothesis in the covariance: the truth is within 2 sigma."""
_LEAST_WEIGHT_WRONG: Final = 0.1
"""The same for wrong wheels, within 3.2 sigma: healthy wheels exceed their gates by chance."""
_PAIR_SEEDS: Final = 3
"""Number of the most likely single wrong wheels that the search extends to pairs of wheels."""


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

    def anew(self, measurements: list[Measurement]) -> Fit | None:
        """Fits with weights from the unweighted fit of the same measurements.

        The weights of the healthy wheels are then independent of the faulty wheels.  Returns
        ``None`` if the measurements and the prior do not determine the twist.
        """
        (vx, vy, wz), rank = self.solve(unweighted_normal_equations(measurements), self.yaw_rate)
        if rank < 3 and not self.prior[0]:
            return None
        first = fit_twist(measurements, vx, vy, wz, self.squares, self.prior, self.yaw_rate)
        return self.refit(measurements, first)

    def with_speeds(
        self, measurements: list[Measurement], wheels: Sequence[int], speeds: Sequence[float]
    ) -> tuple[Fit, float]:
        """Fits without the encoders of some wheels, and returns the fit and its misfit.

        ``speeds``: rolling speed (m/s) of the contact of each measured wheel, with the errors of
        ``following_error``, in place of the encoders of ``wheels``; empty if nothing is known.
        """
        expected = [*measurements]
        remaining = [*measurements]
        for k in wheels:
            m = measurements[k]
            remaining[k] = with_use(m, m[0] & USE_SIDE)
            expected[k] = (m[0], *m[1:5], speeds[k], *m[6:]) if speeds else remaining[k]
        # The weights need a twist that the replaced encoders do not influence.
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(expected), self.yaw_rate)
        fit = fit_twist(remaining, vx, vy, wz, self.squares, self.weak_prior, self.yaw_rate)
        if not speeds:
            return fit, self.misfit(fit)
        for k in wheels:
            # The contact slips too, in particular that of a wheel that skids.
            variance = following_error(speeds[k]) ** 2 + fit.measurements[k][7]
            fit = add_rolling_speed(fit, k, speeds[k], variance)
        disagreement = self.misfit(fit)
        for k in wheels:
            variance = following_error(speeds[k]) ** 2 + fit.measurements[k][7]
            disagreement += (speeds[k] - rolling_speed(fit, k)) ** 2 / variance
        return fit, disagreement

    def misfit(self, fit: Fit) -> float:
        """Returns the misfit of the wheels and of the gyro."""
        return misfit(fit) + self.gyro_misfit(fit)

    def gyro_misfit(self, fit: Fit) -> float:
        """Returns the misfit of the gyro, 0 without a gyro."""
        if self.yaw_rate is None:
            return 0.0
        return (self.yaw_rate - fit.wz) ** 2 / self.squares[5]


class CauseSearch:
    """Finds the likely causes of wheels that disagree.

    - ``gates``: for each measured wheel, the chi-square above which the wheel disagrees.
    - ``price``: cost q of a wrong wheel.
    - ``max_wrong``: largest number of wrong wheels of hypothesis 2, 0 to 2.
    - ``length2``: square of the length (m) that relates yaw rates to speeds.
    - ``against``: wheels that contradict their commands.
    - ``fits``: fits of the twist for given causes.
    - ``gyro_slip``: speed (m/s) at the wheels by which a gyro contradicts the readings, or 0.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        max_wrong: int,
        length2: float,
        against: Contradiction,
        fits: Fits,
        gyro_slip: float,
    ) -> None:
        self._gates = gates
        self._price = price
        self._max_wrong = max_wrong
        self._length2 = length2
        self._against = against
        self._fits = fits
        self._gyro_slip = gyro_slip

    def likely_hypotheses(
        self, measurements: list[Measurement], fit: Fit, disagree: bool
    ) -> list[Hypothesis]:
        """Returns all likely hypotheses, the most likely first.

        - ``fit``: fitted twist with all measurements.
        - ``disagree``: ``True`` if a wheel exceeds its gate.

        Returns an empty list if no hypothesis explains the misfit.
        """
        healthy = self._wrong_wheels((), measurements, fit)
        encoders_wrong = self._wrong_encoders(measurements)
        hypotheses = [healthy, *encoders_wrong]
        impossible = self._impossible(measurements)
        may_slide = self._gyro_slip > 0.0 or any(k not in impossible for k in self._against.wheels)
        if not disagree:
            # The agreement of wheels that contradict their commands proves nothing.
            if may_slide:
                hypotheses.append(self._sliding(measurements, fit, disagree=False))
            return hypotheses
        hypotheses += self._wrong_radii(measurements, fit)
        known = [{*h.wrong} for h in encoders_wrong]
        singles = self._one_more_wrong(healthy, known)
        singles.sort(key=_cost)
        hypotheses += singles
        if singles and self._max_wrong > 1 and min(hypotheses, key=_cost).worst_ratio > 1.0:
            for rank, single in enumerate(singles[:_PAIR_SEEDS]):
                # The list already contains all pairs of wheels with a more likely wrong wheel.
                visited = [s.wrong[0] for s in singles[:rank]]
                hypotheses += self._one_more_wrong(single, known, visited)
        if may_slide:
            sliding = self._sliding(measurements, fit)
            best = min(hypotheses, key=_cost)
            wheels = {*self._against.wheels}
            if self._gyro_slip and not (wheels and wheels <= {*best.wrong}):
                # Wrong wheels explain by accident that few wheels and a gyro disagree.
                sliding = sliding._replace(cost=min(sliding.cost, best.cost + _NEGLIGIBLE))
            hypotheses.append(sliding)
        hypotheses.sort(key=_cost)
        best = hypotheses[0]
        if best.worst_ratio > 2.0:  # twice the gate has about the square of the gate's probability
            return []
        return [h for h in hypotheses if h.cost <= best.cost + _NEGLIGIBLE]

    # -- hypothesis 3 -------------------------------------------------------------------

    def _wrong_encoders(self, measurements: list[Measurement]) -> list[Hypothesis]:
        """Returns the hypothesis that the encoders of N are wrong, and perhaps one more."""
        wheels = self._against.wheels
        others = [k for k in encoders(measurements) if k not in wheels]
        commands = self._against.commands
        if not wheels or not (others or commands):
            return []
        if len(wheels) > len(others) and commands:
            # A load or a delay makes most wheels slower, each by its own share in a turn.
            speeds = [(measurements[k][5], commands[k]) for k in wheels]
            if all(abs(z - c) <= DOUBTFUL * abs(c) for z, c in speeds):
                return []
        alone = len(wheels) == 1 and self._against.doubtful
        price = _ONE_ENCODER if alone else _ENCODERS
        price += _PUSHED * (self._against.causes - 1)
        hypotheses = [self._encoders_wrong(wheels, measurements, price)]
        if hypotheses[0].worst_ratio > 1.0:
            price += self._price
            hypotheses += [self._encoders_wrong((*wheels, k), measurements, price) for k in others]
        return hypotheses

    def _encoders_wrong(
        self, wheels: tuple[int, ...], measurements: list[Measurement], price: float
    ) -> Hypothesis:
        fit, disagreement = self._fits.with_speeds(measurements, wheels, self._against.commands)
        ratio = self._worst_ratio(fit, wheels)
        if ratio <= 1.0:
            # Dead encoders and wheels that stand have no noise: a smaller misfit is no evidence.
            disagreement = self._fits.gyro_misfit(fit)
        return Hypothesis(
            wheels, (), fit, disagreement + price, ratio, _LEAST_WEIGHT, fit, measurements
        )

    # -- hypothesis 4 -------------------------------------------------------------------

    def _sliding(
        self,
        measurements: list[Measurement],
        fit: Fit,
        *,
        disagree: bool = True,
        certain: bool = False,
    ) -> Hypothesis:
        """Returns the hypothesis that the wheels slide.

        - ``fit``: fitted twist with all measurements.
        - ``certain``: ``True`` if no other hypothesis explains the readings.
        """
        every, wheels = encoders(measurements), self._against.wheels
        commands = self._against.commands
        disagree = disagree or len(wheels) < len(every)
        if impossible := self._impossible(measurements):
            fit = self._fits.with_speeds(measurements, impossible, commands)[0]
            every = tuple(k for k in every if k not in impossible)
            wheels = tuple(k for k in wheels if k not in impossible)
        fastest = max([*(abs(measurements[k][5]) for k in every), *map(abs, commands)], default=0.0)
        sigma, against_motor = 0.0, False
        for k in wheels:
            measured = measurements[k][5]
            command = commands[k] if commands else fastest
            if abs(command) <= COMMANDED_SPEED:
                sigma = max(sigma, abs(measured - command) / 2.0 + _DRAGGED)
                continue
            share = measured / command
            deviation = min(abs(1.0 - share), 2.0)
            if disagree:
                deviation = max(deviation, math.sqrt(deviation))
            slip = deviation * fastest / 2.0
            if slip > sigma:
                sigma = slip
                against_motor = not -_OVERSHOOT < share < 1.0 + _OVERSHOOT
        share = 1.0
        if certain or self._gyro_slip:
            sigma = max(sigma, _SLIDING_SHARE * fastest, 2.0 * self._gyro_slip, _PULLED)
            share = 0.5
        cost = _SLIDING + _PUSHED * max(self._against.pushed - 1, 0)
        cost += _AGAINST_MOTOR * against_motor
        variance = sigma * sigma
        wz, angular, gyro_misfit = self._with_gyro(share * fit.wz, variance / self._length2)
        vx, vy, rest = share * fit.vx, share * fit.vy, fit.measurements
        slid = Fit(vx, vy, wz, variance, 0.0, 0.0, variance, 0.0, angular, rest)
        others = tuple(k for k in every if k not in wheels)
        return Hypothesis(
            (), others or every, slid, cost + gyro_misfit, 0.0, _LEAST_WEIGHT, slid, measurements
        )

    def _impossible(self, measurements: list[Measurement]) -> list[int]:
        limit = _IMPOSSIBLE / math.sqrt(self._fits.weak_prior[0])
        return [k for k in encoders(measurements) if abs(measurements[k][5]) > limit]

    def _with_gyro(self, wz: float, variance: float) -> tuple[float, float, float]:
        """Returns a yaw rate and its variance after a measurement by the gyro, and the misfit.

        A wide distribution predicts the measurement with a small density, unless the robot stands.
        """
        yaw_rate, noise = self._fits.yaw_rate, self._fits.squares[5]
        if yaw_rate is None or not variance:
            return wz, variance, 0.0
        total = variance + noise
        slides = (yaw_rate - wz) ** 2 / total + math.log(total / noise)
        stands = yaw_rate * yaw_rate / (noise + _HELD_YAW_RATE**2)
        wz += variance / total * (yaw_rate - wz)
        return wz, variance * noise / total, min(slides, stands)

    # -- hypothesis 5, and readings that no hypothesis explains ---------------------------

    def _wrong_radii(self, measurements: list[Measurement], fit: Fit) -> list[Hypothesis]:
        """Returns the hypothesis that the radii are wrong, if their errors are possible."""
        vx, vy, wz = fit[:3]
        every, yaw_rate = encoders(measurements), self._fits.yaw_rate
        fastest = largest = rolling = 0.0
        for k in every:
            _, c, s, _, _, mx, my, v_l, _ = fit.measurements[k]
            rolls = rolling_speed(fit, k)
            residual = abs(c * mx + s * my - rolls)
            fastest, largest = max(fastest, abs(rolls)), max(largest, residual)
            rolling += residual * residual / v_l
        error = largest / fastest if fastest else math.inf
        if self._gyro_slip and yaw_rate is not None:
            error = max(error, abs(yaw_rate - wz) / max(abs(wz), 1e-9))
        if error > _RADIUS_ERROR:
            return []
        scale = 1.0 + error
        scaled = Fit(scale * vx, scale * vy, scale * wz, *(0.0,) * 6, fit.measurements)
        wrong = covering(fit, [1.0, 1.0], [self._with_misfit(fit), scaled])
        cost = _RADII + misfit(fit) - rolling
        return [Hypothesis((), (), wrong, cost, 0.0, _LEAST_WEIGHT, fit, measurements, every)]

    def unexplained(self, measurements: list[Measurement], fit: Fit) -> Fit:
        """Returns ``fit`` with a covariance for readings that no hypothesis explains."""
        every = encoders(measurements)
        fits = [
            self._with_misfit(fit),
            self._fits.with_speeds(measurements, every, self._against.commands)[0],
            self._sliding(measurements, fit, certain=True).fit,
        ]
        return covering(fit, [1.0, 1.0, _LEAST_WEIGHT], fits)

    def _with_misfit(self, fit: Fit) -> Fit:
        """Returns ``fit`` with the errors of rolling speeds that its misfit shows."""
        freedom = sum(1 for m in fit.measurements if m[0] & USE_ROLL) - 1
        growth = max(1.0, self._fits.misfit(fit) / max(freedom, 1))
        return with_covariance(fit, growth)

    # -- hypotheses 1 and 2 -------------------------------------------------------------

    def _one_more_wrong(
        self, hypothesis: Hypothesis, known: Sequence[set[int]], visited: Sequence[int] = ()
    ) -> list[Hypothesis]:
        """Returns all hypotheses with one more wrong wheel than ``hypothesis``.

        - ``known``: sets of wheels that other hypotheses already leave out.
        - ``visited``: indices of wheels that the search has already taken as wrong.

        A wheel can be wrong only if the other wheels determine the twist without it.
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
            fit = self._fits.anew(remaining)
            if fit is not None:
                extended.append(self._wrong_wheels(wrong, remaining, fit))
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
        least = _LEAST_WEIGHT_WRONG if wrong else _LEAST_WEIGHT
        return Hypothesis(wrong, (), current, cost, ratio, least, fit, measurements)

    def _worst_ratio(self, fit: Fit, others: Sequence[int]) -> float:
        ratios = [0.0]
        for k, (d, gate) in enumerate(zip(chi_squares(fit), self._gates, strict=True)):
            if k not in others:
                ratios.append(d / gate)
        return max(ratios)


def _cost(hypothesis: Hypothesis) -> float:
    return hypothesis.cost


def with_use(measurement: Measurement, use: int) -> Measurement:
    """Returns a copy of a measurement with different flags for its use by the fit.

    ``use`` is ``USE_ROLL``, ``USE_SIDE``, or 0 if the fit must not use the measurement.
    """
    return (measurement[0] & ~(USE_ROLL | USE_SIDE) | use, *measurement[1:])
