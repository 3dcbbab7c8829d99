"""Odometry by random pairs of wheels, from the Thorvald II paper, as a baseline for comparisons.

It is also the example of a base calculator in a package of its own: this module, and the entry
point in ``pyproject.toml``.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Self

from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.calculators.twist_estimator import Noise, TwistEstimate
from thorvaldc.runtime.se2 import ZERO_TWIST, Cov3, Twist

COVARIANCE: Cov3 = ((0.001, 0.0, 0.0), (0.0, 0.001, 0.0), (0.0, 0.0, 0.03))
"""Constant covariance that the original Thorvald II software publishes with every twist."""
_PARALLEL = 1e-9
"""Two axle lines count as parallel if the sine of the angle between them is smaller."""
_AT_CENTRE = 0.05
"""The speed of a wheel is not used if the wheel is closer (m) to the centre of rotation."""


_AxleLine = tuple[float, float, float, float, float | None]
"""Position of the contact (x, y), rolling direction (c, s), and rolling speed of a wheel.

The speed is ``None`` for a wheel without encoder.
"""


@dataclass(frozen=True, slots=True)
class RandomPairsOptions(GeneralOptions):
    """Options of the calculator ``random_pairs``, in addition to the options of ``general``.

    - ``seed``: seed of the random number generator that draws pairs of wheels.
    - ``pairs_per_wheel``: number of pairs that are drawn per wheel in each tick.
    - ``special_cases``: if ``True``, the odometry handles parallel wheels and wheels at the centre
      of rotation.  If most pairs of wheels are parallel, the estimated yaw rate is 0. The speed of
      a wheel at the centre of rotation is not used.  If ``special_cases`` is ``False``, only pairs
      of exactly parallel axle lines are left out.
    - ``parallel``: two wheels count as parallel if their directions differ by less than this angle
      (rad).  The angle is used only if ``special_cases`` is ``True``.
    """

    seed: int = 1
    pairs_per_wheel: int = 10
    special_cases: bool = True
    parallel: float = 0.02

    def __post_init__(self) -> None:
        # slots=True creates a new class, for which super() without arguments fails.
        GeneralOptions.__post_init__(self)
        if not 1 <= self.pairs_per_wheel <= 1000:
            raise ValueError(f"pairs_per_wheel is {self.pairs_per_wheel}; it must be 1 to 1000")
        if not 0.0 < self.parallel < 1.0:
            raise ValueError(f"parallel is {self.parallel:g} rad; it must be between 0 and 1 rad")


class RandomPairs(General):
    """Odometry that averages the intersections of the axle lines of random pairs of wheels.

    Source: Grimstad and From, "Software Components of the Thorvald II Modular Robot" (2018),
    section 3.3.1.  The calculator ``random_pairs`` computes the same joint commands as the
    calculator ``general``.  The covariance of the estimated twist is constant.  The odometry of
    random pairs is only a baseline for comparisons.  With measurement noise, two almost parallel
    axle lines can intersect anywhere, which makes the mean intersection useless.
    """

    name = "random_pairs"
    summary = "the paper's odometry: intersections of random pairs of axle lines (a baseline)"
    Options = RandomPairsOptions

    def __init__(
        self,
        geometry: BaseGeometry,
        options: RandomPairsOptions | None = None,
        noise: Noise | None = None,
    ) -> None:
        self._pairs = options or RandomPairsOptions()
        self._random = random.Random()
        # Index and geometry of each wheel whose direction is known.
        self._guiding = tuple((i, w) for i, w in enumerate(geometry.wheels) if not w.swivel)
        super().__init__(geometry, self._pairs, noise)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        if sum(1 for w in geometry.wheels if not w.swivel) < 2:
            return "it has fewer than two wheels whose direction is known, so no pair"
        return super().unsuited_reason(geometry)

    def reset(self, states: JointStates | None = None) -> None:
        super().reset(states)
        self._random.seed(self._pairs.seed)

    def resume(self, previous: Self) -> None:
        super().resume(previous)
        self._random = previous._random

    def odometry(self, states: JointStates) -> TwistEstimate:
        self.estimator.check(states)
        lines: list[_AxleLine] = []
        for i, w in self._guiding:
            turning = w.sign * states.angle_rates[i]
            direction = w.heading + w.sign * states.angles[i]
            c, s = math.cos(direction), math.sin(direction)
            speed = w.radius * states.speeds[i] + w.lateral * turning if w.encoder else None
            x = w.x + c * w.trail - s * w.lateral
            y = w.y + s * w.trail + c * w.lateral
            lines.append((x, y, c, s, speed))
        if not any(speed for *_, speed in lines):
            return TwistEstimate(ZERO_TWIST, COVARIANCE, 3)
        centre = self._centre_of_rotation(lines)
        twist = _translation(lines) if centre is None else self._turning_about(lines, *centre)
        return TwistEstimate(twist, COVARIANCE, 3)

    def _centre_of_rotation(self, lines: list[_AxleLine]) -> tuple[float, float] | None:
        """Returns the mean intersection (m) of the axle lines of random pairs of wheels.

        Returns ``None`` if too few pairs of axle lines intersect, because the robot does not turn.
        """
        options = self._pairs
        draw, n = self._random.randrange, len(lines)
        pairs = options.pairs_per_wheel * n
        tolerance = math.sin(options.parallel) if options.special_cases else _PARALLEL
        count, x, y = 0, 0.0, 0.0
        for _ in range(pairs):
            i = draw(n)
            j = draw(n - 1)
            xi, yi, ci, si, _ = lines[i]
            xj, yj, cj, sj, _ = lines[j if j < i else j + 1]
            # A point p lies on the axle line of a wheel with the direction (c, s) if (c, s) . (p -
            # contact) = 0.
            det = ci * sj - si * cj
            if abs(det) < tolerance:
                continue
            bi, bj = ci * xi + si * yi, cj * xj + sj * yj
            x += (bi * sj - bj * si) / det
            y += (ci * bj - cj * bi) / det
            count += 1
        if count == 0 or (options.special_cases and count < pairs - count):
            return None
        return x / count, y / count

    def _turning_about(self, lines: list[_AxleLine], xc: float, yc: float) -> Twist:
        """Returns the twist of a rotation about (xc, yc), with the mean yaw rate of the wheels."""
        min_distance = _AT_CENTRE if self._pairs.special_cases else 1e-9
        count, total = 0, 0.0
        for x, y, c, s, speed in lines:
            dx, dy = x - xc, y - yc
            distance = math.hypot(dx, dy)
            if speed is None or distance < min_distance:
                continue
            total += math.copysign(speed / distance, speed * (dx * s - dy * c))
            count += 1
        wz = total / count if count else 0.0
        return Twist(wz * yc, -wz * xc, wz)


def _translation(lines: list[_AxleLine]) -> Twist:
    """Returns the mean velocity of the wheels as a twist without rotation."""
    moving = [(c * v, s * v) for _, _, c, s, v in lines if v is not None]
    n = len(moving)
    return Twist(float_sum(u for u, _ in moving) / n, float_sum(u for _, u in moving) / n, 0.0)
