"""The calculator for any arrangement of driven, steered, fixed and free wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.runtime.base import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, Noise
from thorvaldc.runtime.calculators.geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear import solve3
from thorvaldc.runtime.calculators.steering import Steering
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_FOLLOW = 0.02
"""Weight of following the command against not scrubbing while wheels turn."""
_ALIGNED = 1e-9
"""Misalignment (rad) below which wheels count as at their angles."""


@dataclass(frozen=True, slots=True)
class GeneralOptions:
    """Options of ``general``.

    ``hysteresis`` (s): by how much sooner the other branch (the wheel turned
    by half a turn, rolling backwards) must be there to be taken.
    ``arrive_together``: wheels that turn to new angles do so in the same time.
    """

    hysteresis: float = 0.02
    arrive_together: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.hysteresis <= 10.0:
            raise ValueError(f"hysteresis is {self.hysteresis:g} s; it must be 0 to 10 s")


class General(BaseCalculator):
    """Each wheel follows the velocity field of the twist at its place.

    The twist is first brought to what fixed wheels allow, then each steering
    joint takes the best of all its angles, then one factor for all keeps
    the wheels within their speeds and accelerations, so that the centre of rotation stays.
    """

    name = "general"
    summary = "any arrangement of driven, steered, fixed and free wheels"
    Options = GeneralOptions

    def __init__(
        self,
        geometry: BaseGeometry,
        options: GeneralOptions | None = None,
        noise: Noise | None = None,
    ) -> None:
        super().__init__(geometry, options, noise)
        wheels = geometry.wheels
        self._fixed = FixedWheels(wheels)
        self._steering = tuple(
            Steering(
                wheels[group[0]],
                group,
                min(wheels[i].max_acceleration * wheels[i].radius for i in group),
                self.options.hysteresis,
            )
            for group in geometry.steering_groups
        )
        self._skid = self._skid_gain()
        self._length2 = geometry.length**2
        # What the loops of a tick need of each wheel, as plain numbers.
        self._joints = tuple(
            (s, s.wheels[0], s.wheel.x, s.wheel.y, s.wheel.radius) for s in self._steering
        )
        self._turning = tuple(
            (i, s, s.wheel.heading, s.wheel.sign, w.x, w.y, w.trail, w.lateral, w.radius, w.driven)
            for s in self._steering
            for i in s.wheels
            for w in (wheels[i],)
        )
        self._rolling = tuple(
            (s, w.lateral, w.max_speed * w.radius)
            for s in self._steering
            for w in (wheels[i] for i in s.wheels)
            if w.driven
        )
        self._straight = tuple(
            (i, *w.rows(0.0)[0], w.radius, w.max_speed * w.radius)
            for i, w in enumerate(wheels)
            if w.fixed and w.driven
        )
        self._top = tuple(
            (i, w.max_speed, w.max_acceleration)
            for i, w in enumerate(wheels)
            if w.driven and not w.swivel
        )
        self._standing = (0.0,) * len(wheels)
        self.reset()

    @classmethod
    def unsuited(cls, geometry: BaseGeometry) -> str | None:
        if not geometry.wheels:
            return "it has no wheels"
        if not any(w.driven and not w.swivel for w in geometry.wheels):
            return "no wheel with a motor holds its direction"
        return None

    def reset(self, states: JointStates | None = None) -> None:
        for steering in self._steering:
            steering.reset(states.angles[steering.wheels[0]] if states else 0.0)
        self._speeds = list(states.speeds if states else self._standing)
        self._angles = list(self._standing)
        for i, steering, *_ in self._turning:
            self._angles[i] = steering.angle
        self._now = ZERO_TWIST if states is None else self.estimator.estimate(states).twist

    def allowed(self, twist: Twist) -> Twist:
        return self._fixed.allowed(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        target, infeasible = twist, ZERO_TWIST
        if not self._fixed.free:
            target = self._fixed.allowed(twist)
            infeasible = Twist(twist.vx - target.vx, twist.vy - target.vy, twist.wz - target.wz)
        vx, vy, wz = target
        angles, speeds = (
            (states.angles, states.speeds) if states else (self._angles, self._standing)
        )
        unreachable: tuple[int, ...] = ()
        aligned = True
        for steering, i, x, y, radius in self._joints:
            angle = angles[i]
            steering.choose(vx - wz * y, vy + wz * x, wz, angle, speeds[i] * radius)
            if steering.unreachable:
                unreachable += steering.wheels
                aligned = False
            elif not -_ALIGNED < angle - steering.target < _ALIGNED:
                aligned = aligned and steering.held
        rates = self._move_steering(dt)
        scale = self._saturation(target)
        if scale < 1.0:
            target = target.scaled(scale)
        now, asked = self._speeds_now(target, states, aligned)
        now, asked = self._within_limits(now, asked, dt)
        self._now, self._speeds = now, asked
        commanded = self._angles = list(self._standing)
        for i, steering, *_ in self._turning:
            commanded[i] = steering.angle
        joints = JointCommands(asked, commanded)
        return BaseCommand(joints, target, now, infeasible, scale, unreachable, rates)

    # -- steering -----------------------------------------------------------------

    def _move_steering(self, dt: float | None) -> list[float]:
        """Move every steering joint; the rates that would bring each to its angle at once."""
        rates = list(self._standing)
        if dt is None:
            for steering in self._steering:
                steering.jump()
            return rates
        slowest = 0.0
        for steering in self._steering:
            error = steering.target - steering.angle
            if error:
                for i in steering.wheels:
                    rates[i] = error / dt
                time = abs(error) * steering.seconds_per_rad
                if time > slowest:
                    slowest = time
        # A wheel that follows within a tick or two need not wait for the others.
        together = self.options.arrive_together and slowest > 2.0 * dt
        for steering in self._steering:
            share = steering.time_to_target() / slowest if together else 1.0
            steering.advance(dt, share)
        return rates

    # -- speeds -------------------------------------------------------------------

    def _saturation(self, target: Twist) -> float:
        """The factor (at most 1) that keeps every wheel within its speed at its target."""
        scale = 1.0
        wz = target.wz
        for steering, lateral, top in self._rolling:
            v = abs(steering.rolling - wz * lateral)
            if v * scale > top:
                scale = top / v
        if self._straight:
            vx, vy, wz = self._through_skid(target) if self._skid else target
            for _, l1, l2, l3, _, top in self._straight:
                v = abs(l1 * vx + l2 * vy + l3 * wz)
                if v * scale > top:
                    scale = top / v
        return scale

    def _speeds_now(
        self, target: Twist, states: JointStates | None, aligned: bool
    ) -> tuple[Twist, list[float]]:
        """The twist for the angles that the wheels have now, and the speeds that make it.

        While wheels still turn it is the one that scrubs least: argmin of the
        squared side slips plus a little of the squared distance from ``target``,
        which it is once the wheels are at their angles.
        """
        vx, vy, wz = target
        angles = states.angles if states else None
        coordinate = angles is not None and not aligned
        directions = []
        # Solved for the difference from the target, which makes the aligned case exact.
        a12 = a13 = a23 = b1 = b2 = b3 = 0.0
        a11 = a22 = _FOLLOW
        a33 = _FOLLOW * self._length2
        for i, steering, heading, sign, x, y, trail, _, _, _ in self._turning:
            direction = heading + sign * (angles[i] if angles is not None else steering.angle)
            c, s = math.cos(direction), math.sin(direction)
            directions.append((c, s))
            if not coordinate or (steering.held and not steering.unreachable):
                continue
            t3 = c * x + s * y
            slip = c * vy - s * vx + t3 * wz
            if trail:
                t3 += trail
                slip += trail * (wz + sign * steering.rate)
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            b1 += s * slip
            b2 -= c * slip
            b3 -= t3 * slip
        now = target
        if coordinate:
            for t1, t2, t3 in self._fixed.rows:
                a11 += t1 * t1
                a12 += t1 * t2
                a13 += t1 * t3
                a22 += t2 * t2
                a23 += t2 * t3
                a33 += t3 * t3
            dx, dy, dw = solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
            now = Twist(vx + dx, vy + dy, wz + dw)
        speeds = list(self._standing)
        vx, vy, wz = self._through_skid(now) if self._skid else now
        for i, l1, l2, l3, radius, _ in self._straight:
            speeds[i] = (l1 * vx + l2 * vy + l3 * wz) / radius
        for (i, steering, _, sign, x, y, _, lateral, radius, driven), (c, s) in zip(
            self._turning, directions, strict=True
        ):
            if not driven or steering.unreachable:
                continue
            # At the centre of rotation a contact beside the axis still rolls.
            v = -lateral * (wz + sign * steering.rate) if lateral else 0.0
            if not steering.held:
                v += c * (vx - wz * y) + s * (vy + wz * x)
            speeds[i] = v / radius
        for group in self.geometry.spin_groups:
            mean = sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return now, speeds

    def _within_limits(
        self, now: Twist, speeds: list[float], dt: float | None
    ) -> tuple[Twist, list[float]]:
        """Speeds that the wheels can have, all slowed by one factor, and their twist.

        Then, where a wheel would have to change its speed faster than it can, all
        go the same part of the way from what was commanded before.
        """
        slow = 1.0
        for i, top, _ in self._top:
            v = abs(speeds[i])
            if v * slow > top:
                slow = top / v
        if slow < 1.0:
            speeds = [v * slow for v in speeds]
            now = now.scaled(slow)
        if dt is None:
            return now, speeds
        before = self._speeds
        share = 1.0
        for i, _, acceleration in self._top:
            change = abs(speeds[i] - before[i])
            if change * share > acceleration * dt:
                share = acceleration * dt / change
        if share < 1.0:
            speeds = [b + share * (v - b) for v, b in zip(speeds, before, strict=True)]
            (vx, vy, wz), (bx, by, bw) = now, self._now
            now = Twist(bx + share * (vx - bx), by + share * (vy - by), bw + share * (wz - bw))
        return now, speeds

    # -- skidding -----------------------------------------------------------------

    def _skid_gain(self) -> tuple[float, float] | None:
        """Turning gain of a robot that steers by skidding, and the middle across of its motors.

        Under Coulomb friction with like loads the robot turns as the least
        squares fit of its wheels' surface velocities says; for wheels at
        (+-a, +-b) that is b^2 / (a^2 + b^2) of what the two sides' speeds
        say.  The wheels are driven faster by the inverse of it.
        """
        if self._steering or not self._fixed.skids or len(self._fixed.rows) != 1:
            return None
        fixed = [w for w in self.geometry.wheels if w.fixed]
        driven = [w for w in fixed if w.driven]
        n = len(fixed)
        t1, t2, _ = self._fixed.rows[0]
        # Along the wheels is (t2, -t1); their places across it drive the turn.
        across = [t1 * w.x + t2 * w.y for w in driven]
        middle = sum(across) / len(across)
        turning = sum((a - middle) ** 2 for a in across)
        along = [t2 * w.x - t1 * w.y for w in fixed]
        mean = sum(along) / n
        resisting = sum((a - mean) ** 2 for a in along)
        if turning < 1e-6:
            return None
        return ((turning + resisting) / turning, middle)

    def _through_skid(self, twist: Twist) -> Twist:
        """The twist whose rolling speeds make a skidding robot move by ``twist``."""
        if self._skid is None:
            return twist
        gain, middle = self._skid
        t1, t2, _ = self._fixed.rows[0]
        more = (gain - 1.0) * twist.wz
        # Turn more about the middle of the driven wheels: their mean speed stays.
        along = more * middle
        return Twist(twist.vx + t2 * along, twist.vy - t1 * along, twist.wz + more)
