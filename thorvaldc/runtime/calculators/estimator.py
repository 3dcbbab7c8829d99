"""The robot's twist from its joints: weighted least squares over what wheels say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from thorvaldc.model.spatial import symmetric_eigenvalues
from thorvaldc.runtime.base import JointStates
from thorvaldc.runtime.calculators.geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear import solve3
from thorvaldc.runtime.faults import NotFiniteError
from thorvaldc.runtime.se2 import Cov3, Twist

_RANK_TOLERANCE = 1e-8
"""Smallest eigenvalue of the scaled information over the mean one that counts."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is taken of the wheels' errors.

    ``speed_ratio``: of a wheel's speed, relative; ``angle``: of its direction,
    rad; ``speed_floor`` and ``slip_floor``: m/s along and across the wheel at
    rest; ``skid_ratio``: of the speed, for wheels that must scrub in turns.
    """

    speed_ratio: float = 0.01
    angle: float = math.radians(0.5)
    speed_floor: float = 0.002
    slip_floor: float = 0.002
    skid_ratio: float = 0.1


@dataclass(frozen=True, slots=True)
class TwistEstimate:
    """A twist, its covariance (of vx, vy, wz, in SI) and what it rests on.

    ``rank`` is how many directions of the twist the wheels determine, 0 to 3.
    Below 3 the rest comes from the prior that the robot stands still within
    its top speed, and the covariance says so.
    """

    twist: Twist
    covariance: Cov3
    rank: int


class TwistEstimator:
    """Least squares of rolling and no-side-slip rows, weighted by predicted speeds.

    A first solution with equal weights predicts each wheel's speed; the weights
    follow from the prediction, not from the measured speed, so that a stalled
    encoder is not taken for a certain one.  Side slip is measured as 0 on every
    wheel that cannot swivel; rolling on those with an encoder.  Steering with
    the contact beside or behind its axis moves the contact, which is counted.
    """

    def __init__(self, geometry: BaseGeometry, noise: Noise | None = None) -> None:
        self._noise = noise or Noise()
        self._n = len(geometry.wheels)
        self._wheels = geometry.wheels
        self._centre = geometry.centre
        skids = FixedWheels(geometry.wheels).skids
        self._skidding = len(skids)
        xm, ym = geometry.centre
        # (index, direction at angle 0, sign, x', y', trail, lateral, radius or 0, turns, skids)
        self._rows = tuple(
            (
                i,
                w.heading,
                w.sign,
                w.x - xm,
                w.y - ym,
                w.trail,
                w.lateral,
                w.radius if w.encoder else 0.0,
                w.steered,
                i in skids,
            )
            for i, w in enumerate(geometry.wheels)
            if not w.swivel
        )
        self._fixed = {
            i: (math.cos(h), math.sin(h))
            for i, h, _, _, _, _, _, _, turns, _ in self._rows
            if not turns
        }
        top = geometry.fastest
        self._length2 = geometry.length**2
        # Prior information on (vx, vy, wz): at rest within the top speed.
        self._prior = (1.0 / top**2, self._length2 / top**2)

    def check(self, states: JointStates) -> None:
        """Raise ``NotFiniteError`` or ``ValueError`` where the joints cannot be used."""
        if not len(states.speeds) == len(states.angles) == len(states.angle_rates) == self._n:
            raise ValueError(f"joint states of {len(states.speeds)} wheels for {self._n}")
        positions = states.positions if states.positions is not None else states.speeds
        if len(positions) != self._n:
            raise ValueError(f"joint states of {len(positions)} wheels for {self._n}")
        total = sum(states.speeds) + sum(states.angles) + sum(states.angle_rates) + sum(positions)
        if math.isfinite(total):
            return
        for values, what in (
            (positions, "position"),
            (states.speeds, "speed"),
            (states.angles, "steering angle"),
            (states.angle_rates, "steering rate"),
        ):
            for wheel, value in zip(self._wheels, values, strict=True):
                if not math.isfinite(value):
                    raise NotFiniteError(f"the {what} of wheel {wheel.name} is {value}")
        raise NotFiniteError("the joint states are out of all bounds")

    def estimate(self, states: JointStates) -> TwistEstimate:
        """The twist that agrees best with the joints, with its covariance and rank.

        Raises ``NotFiniteError`` where a joint state is not a finite number.
        """
        self.check(states)
        speeds: Sequence[float] = states.speeds
        angles: Sequence[float] = states.angles
        rates: Sequence[float] = states.angle_rates
        fixed = self._fixed
        # All about the centre, where linear and angular motion come apart:
        # L = (c, s, l3) measures z_l where it rolls with an encoder, T = (-s, c, t3) z_t.
        rows: list[tuple[float, float, float, float, bool, float, float, bool]] = []
        a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
        for i, heading, sign, x, y, trail, lateral, radius, turns, skids in self._rows:
            if turns:
                direction = heading + sign * angles[i]
                c, s = math.cos(direction), math.sin(direction)
                turning = sign * rates[i]
                z_t = -trail * turning
                z_l = radius * speeds[i] + lateral * turning
            else:
                c, s = fixed[i]
                z_t = 0.0
                z_l = radius * speeds[i]
            l3 = s * x - c * y - lateral
            t3 = c * x + s * y + trail
            rolls = radius > 0.0
            rows.append((c, s, l3, z_l, rolls, t3, z_t, skids))
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            if z_t:
                b1 -= s * z_t
                b2 += c * z_t
                b3 += t3 * z_t
            if rolls:
                a11 += c * c
                a12 += c * s
                a13 += c * l3
                a22 += s * s
                a23 += s * l3
                a33 += l3 * l3
                b1 += c * z_l
                b2 += s * z_l
                b3 += l3 * z_l
        k = self._length2
        c11 = a22 * a33 - a23 * a23
        det = a11 * c11 - a12 * (a12 * a33 - a13 * a23) + a13 * (a12 * a23 - a13 * a22)
        mean = (a11 + a22 + a33 / k) / 3.0
        rank = 3
        p_v = p_w = 0.0
        if det <= _RANK_TOLERANCE * k * mean * mean * mean:
            rank = self._count_rank(a11, a12, a13, a22, a23, a33)
            p_v, p_w = self._prior
            # The first pass is in units of one, the prior in those of a top speed.
            weak = 1e-6 * max(mean, 1.0)
            a11, a22, a33 = a11 + weak, a22 + weak, a33 + weak * k
        vx, vy, wz = solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)

        n = self._noise
        ratio2, angle2, skid2 = n.speed_ratio**2, n.angle**2, n.skid_ratio**2
        speed_floor2, slip_floor2 = n.speed_floor**2, n.slip_floor**2
        a11, a22, a33 = p_v, p_v, p_w
        a12 = a13 = a23 = b1 = b2 = b3 = 0.0
        w_skid = 0.0
        if self._skidding:
            # Friction does not ask how fast a wheel scrubs: they all weigh the same.
            a2 = sum((c * vx + s * vy + l3 * wz) ** 2 for c, s, l3, _, _, _, _, k in rows if k)
            w_skid = 1.0 / (skid2 * a2 / self._skidding + speed_floor2)
        for c, s, l3, z_l, rolls, t3, z_t, skids in rows:
            roll = c * vx + s * vy + l3 * wz
            slip = c * vy - s * vx + t3 * wz
            a2 = roll * roll + slip * slip
            if skids:
                w_l = w_t = w_skid
            else:
                w_l = 1.0 / (ratio2 * a2 + speed_floor2)
                w_t = 1.0 / (angle2 * a2 + slip_floor2)
            sw, cw, tw = s * w_t, c * w_t, t3 * w_t
            a11 += s * sw
            a12 -= s * cw
            a13 -= s * tw
            a22 += c * cw
            a23 += c * tw
            a33 += t3 * tw
            if z_t:
                b1 -= sw * z_t
                b2 += cw * z_t
                b3 += tw * z_t
            if rolls:
                sw, cw, lw = s * w_l, c * w_l, l3 * w_l
                a11 += c * cw
                a12 += c * sw
                a13 += c * lw
                a22 += s * sw
                a23 += s * lw
                a33 += l3 * lw
                b1 += cw * z_l
                b2 += sw * z_l
                b3 += lw * z_l
        c11 = a22 * a33 - a23 * a23
        c12 = a13 * a23 - a12 * a33
        c13 = a12 * a23 - a13 * a22
        inverse = 1.0 / (a11 * c11 + a12 * c12 + a13 * c13)
        p11, p12, p13 = c11 * inverse, c12 * inverse, c13 * inverse
        p22 = (a11 * a33 - a13 * a13) * inverse
        p23 = (a12 * a13 - a11 * a23) * inverse
        p33 = (a11 * a22 - a12 * a12) * inverse
        vx = p11 * b1 + p12 * b2 + p13 * b3
        vy = p12 * b1 + p22 * b2 + p23 * b3
        wz = p13 * b1 + p23 * b2 + p33 * b3
        xm, ym = self._centre
        if xm or ym:  # from the centre back to base_link
            vx, vy = vx + ym * wz, vy - xm * wz
            p11, p12, p22 = (
                p11 + 2.0 * ym * p13 + ym * ym * p33,
                p12 + ym * p23 - xm * p13 - xm * ym * p33,
                p22 - 2.0 * xm * p23 + xm * xm * p33,
            )
            p13, p23 = p13 + ym * p33, p23 - xm * p33
        covariance = ((p11, p12, p13), (p12, p22, p23), (p13, p23, p33))
        return TwistEstimate(Twist(vx, vy, wz), covariance, rank)

    def _count_rank(
        self, a11: float, a12: float, a13: float, a22: float, a23: float, a33: float
    ) -> int:
        k = math.sqrt(self._length2)
        values = symmetric_eigenvalues(
            ((a11, a12, a13 / k), (a12, a22, a23 / k), (a13 / k, a23 / k, a33 / k / k))
        )
        largest = max(values)
        return sum(1 for v in values if v > 1e-7 * largest) if largest > 1e-12 else 0
