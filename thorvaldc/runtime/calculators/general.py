"""The calculator for any arrangement of driven, steered, fixed and free wheels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, Noise
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear_algebra import solve3
from thorvaldc.runtime.calculators.motor_limits import Motors
from thorvaldc.runtime.calculators.steering_branch import Steering
from thorvaldc.runtime.calculators.twist_estimator import Estimation, TwistEstimator
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_FOLLOW = 0.01
"""Weight of following the command against not scrubbing while wheels turn."""
_MOVING = 0.05
"""Speed (m/s) from which a wheel scrubs much if it does not point where it moves."""
_FURTHEST = math.pi / 4.0
"""The furthest (rad) that a wheel turns at once while it moves; the robot stops for more."""
_LEAST = 0.1
"""Share of the way to a twist that a wheel can go; below, it is at its end."""
_STANDING = 1e-6
"""Square of the speed (m/s) at which a robot counts as standing."""
_ALIGNED = math.radians(1.0)
"""Misalignment up to which wheels count as at their angles: what servos leave costs no speed."""


@dataclass(frozen=True, slots=True)
class SteeringOptions:
    """Options of calculators that steer.

    ``hysteresis`` (s): by how much sooner the other branch (the wheel turned
    by half a turn, rolling backwards) must be there to be taken.
    ``arrive_together``: wheels that turn to new angles do so in the same time.
    """

    hysteresis: float = 0.02
    arrive_together: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.hysteresis <= 10.0:
            raise ValueError(f"hysteresis is {self.hysteresis:g} s; it must be 0 to 10 s")


@dataclass(frozen=True, slots=True)
class GeneralOptions(SteeringOptions):
    """Options of ``general``, besides those of steering.

    ``faulty_wheels``: how many wheels odometry may leave out at once, 0 to 2.
    ``polish``: further steps of its fit towards maximum likelihood.
    """

    faulty_wheels: int = 2
    polish: int = 0

    def __post_init__(self) -> None:
        # super() without arguments fails in a dataclass with slots, which is made anew.
        SteeringOptions.__post_init__(self)
        if self.faulty_wheels not in (0, 1, 2):
            raise ValueError(f"faulty_wheels is {self.faulty_wheels}; it must be 0, 1 or 2")
        if not 0 <= self.polish <= 10:
            raise ValueError(f"polish is {self.polish}; it must be 0 to 10")


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
        estimation = Estimation(faulty=self.options.faulty_wheels, polish=self.options.polish)
        self.estimator = TwistEstimator(geometry, noise, estimation)
        wheels = geometry.wheels
        self._fixed = FixedWheels(wheels)
        self._free = self._fixed.free
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
        turned = [(i, s, wheels[i]) for s in self._steering for i in s.wheels]
        self._turned = tuple((i, s) for i, s, _ in turned)
        # The third: the speed of a wheel for the rolling (m/s) of its joint's first.
        self._rolling = tuple(
            (
                i,
                s,
                math.cos(w.heading - s.wheel.heading) / w.radius,
                w.lateral / w.radius,
                w.max_speed,
            )
            for i, s, w in turned
            if w.driven
        )
        self._scrubbing = tuple(
            (i, s, w.heading, w.sign, w.x, w.y, w.trail, w.lateral, w.radius, w.driven)
            for i, s, w in turned
        )
        self._straight = tuple(
            (i, *w.rows(0.0)[0], w.radius, w.max_speed)
            for i, w in enumerate(wheels)
            if w.fixed and w.driven
        )
        self._motors = Motors(geometry)
        self._shared = bool(geometry.spin_groups)
        self._standing = (0.0,) * len(wheels)
        self.reset()

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        if not geometry.wheels:
            return "it has no wheels"
        if not any(w.driven and not w.swivel for w in geometry.wheels):
            return "no wheel with a motor holds its direction"
        return None

    def reset(self, states: JointStates | None = None) -> None:
        self._before = ZERO_TWIST
        self._stops = False
        self._follows = True
        for steering in self._steering:
            steering.reset(states.angles[steering.wheels[0]] if states else 0.0)
        angles = list(self._standing)
        for i, steering in self._turned:
            angles[i] = steering.angle
        self._angles = (*angles,)
        if states is None:
            self._motors.reset()
        else:
            self._motors.reset(states, self.estimator.estimate(states).twist)

    def resume(self, before: Self) -> None:
        for steering, its in zip(self._steering, before._steering, strict=True):
            steering.resume(its)
        self._angles = before._angles
        self._before, self._stops, self._follows = before._before, before._stops, before._follows
        self._motors.resume(before._motors)

    def feasible(self, twist: Twist) -> Twist:
        return self._fixed.feasible(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        target, infeasible = twist, ZERO_TWIST
        if not self._free:
            target = self._fixed.feasible(twist)
            infeasible = Twist(twist.vx - target.vx, twist.vy - target.vy, twist.wz - target.wz)
        angles: Sequence[float] = self._angles
        speeds: Sequence[float] = self._standing
        if states is not None:
            angles, speeds = states.angles, states.speeds
        doing = self._motors.twist
        must_stop = self._stops and self._size(doing) > _STANDING
        rates: Sequence[float] = self._standing
        unreachable: tuple[int, ...] = ()
        if not must_stop:
            unreachable = self._choose(target, angles, speeds)
            rates, late, self._follows = self._lateness(dt, self._follows)
            if late > 1.0:
                target, unreachable, must_stop = self._slower(target, late, angles, speeds, dt)
            if not must_stop:
                self._before = target
        self._stops = must_stop
        self._move_steering(dt)
        commanded = self._angles
        asked, scale = self._speeds_at_targets(target)
        if scale < 1.0:
            target = target.scaled(scale)
        now = target
        if states is None:
            angles = commanded
        if dt is not None or states is not None:
            away = self._away(angles)
            if must_stop:
                slower = target if self._size(target) < self._size(doing) else ZERO_TWIST
                now, asked = self._speeds_on_the_way(slower, angles, math.inf)
            elif away > _ALIGNED:
                now, asked = self._speeds_on_the_way(target, angles, away)
        now, reached = self._motors.reached(now, asked, dt)
        joints = JointCommands(reached, commanded)
        return BaseCommand(
            joints,
            target,
            now,
            infeasible,
            scale,
            unreachable,
            rates,
            must_stop,
            self._follows,
        )

    def _size(self, twist: Twist) -> float:
        """Square of the mean speed of wheels, m^2/s^2."""
        vx, vy, wz = twist
        return vx * vx + vy * vy + self._length2 * wz * wz

    # -- steering -----------------------------------------------------------------

    def _choose(
        self, twist: Twist, angles: Sequence[float], speeds: Sequence[float]
    ) -> tuple[int, ...]:
        """Have every joint choose its angle for ``twist``; the wheels that have none."""
        vx, vy, wz = twist
        unreachable: tuple[int, ...] = ()
        for steering, i, x, y, radius in self._joints:
            steering.choose(vx - wz * y, vy + wz * x, wz, angles[i], speeds[i] * radius)
            if steering.unreachable:
                unreachable += steering.wheels
        return unreachable

    def _lateness(self, dt: float | None, followed: bool) -> tuple[Sequence[float], float, bool]:
        """The rates (rad/s) at which each joint would be at its angle in this tick.

        Also the ticks that the slowest of the wheels that move needs for that, infinitely
        many where it would have to turn further than a wheel may that moves, if all have
        ``followed``; and whether no wheel, moving or standing, would have to turn that far.
        """
        if dt is None:
            return self._standing, 0.0, True
        rates = list(self._standing)
        late, aligned = 0.0, True
        vx, vy, wz = self._motors.twist
        for steering, _, x, y, _ in self._joints:
            gap = steering.target - steering.angle
            for i in steering.wheels:
                rates[i] = gap / dt
            if steering.held:
                continue
            far = not -_FURTHEST <= gap <= _FURTHEST
            if far:
                aligned = False
            ux, uy = vx - wz * y, vy + wz * x
            if ux * ux + uy * uy >= _MOVING * _MOVING:
                ticks = math.inf if far else abs(gap) * steering.seconds_per_rad / dt
                if ticks > late:
                    late = ticks
        return rates, late, aligned

    def _slower(
        self,
        target: Twist,
        late: float,
        angles: Sequence[float],
        speeds: Sequence[float],
        dt: float | None,
    ) -> tuple[Twist, tuple[int, ...], bool]:
        """As far from the last twist to ``target`` as all wheels keep up; no further where one
        is behind already.  With it whether a wheel is at an end, and must turn around.
        """
        before, share = self._before, 1.0
        smaller = self._size(target) / max(self._size(before), 1e-12)
        if smaller < 1.0:  # whoever has to wait for wheels slows down all the same
            before = before.scaled(math.sqrt(smaller))
        unreachable = self._choose(before, angles, speeds)
        _, behind, _ = self._lateness(dt, True)
        if behind >= 1.0:
            return before, unreachable, False
        slower = target
        while late > 1.0:
            # Far on the way alone is nothing that moves gradually would not reach.
            share *= 0.5 if late == math.inf else (1.0 - behind) / (late - behind)
            if late == math.inf and share < _LEAST:
                return before, self._choose(before, angles, speeds), True
            slower = Twist(
                before.vx + share * (target.vx - before.vx),
                before.vy + share * (target.vy - before.vy),
                before.wz + share * (target.wz - before.wz),
            )
            unreachable = self._choose(slower, angles, speeds)
            if late < math.inf:
                break
            _, late, _ = self._lateness(dt, True)
        return slower, unreachable, False

    def _move_steering(self, dt: float | None) -> None:
        """Move the joints towards their targets."""
        angles = list(self._standing)
        if dt is None:
            for i, steering in self._turned:
                angles[i] = steering.angle = steering.target
                steering.rate = 0.0
            self._angles = (*angles,)
            return
        slowest = 0.0
        for steering in self._steering:
            time = abs(steering.target - steering.angle) * steering.seconds_per_rad
            if time > slowest:
                slowest = time
        # A wheel that follows within a tick or two need not wait for the others.
        together = slowest > 2.0 * dt and self.options.arrive_together
        for steering in self._steering:
            steering.advance(dt, steering.time_to_target() / slowest if together else 1.0)
        for i, steering in self._turned:
            angles[i] = steering.angle
        self._angles = (*angles,)

    def _away(self, angles: Sequence[float]) -> float:
        """How far (rad) the worst wheel is from the direction that the motion asks of it."""
        worst = 0.0
        for steering, i, _, _, _ in self._joints:
            if steering.held:
                if steering.unreachable:
                    return math.inf
            else:
                away = abs(angles[i] - steering.target)
                if away > worst:
                    worst = away
        return worst

    # -- speeds -------------------------------------------------------------------

    def _speeds_at_targets(self, target: Twist) -> tuple[list[float], float]:
        """The speeds of wheels at their angles, and what slowed them all to their limits."""
        speeds = list(self._standing)
        scale = 1.0
        wz = target.wz
        for i, steering, gain, lateral, top in self._rolling:
            v = steering.rolling * gain
            if lateral and not steering.unreachable:
                # At the centre of rotation a contact beside the axis still rolls.
                v -= lateral * (wz + steering.wheel.sign * steering.rate)
            speeds[i] = v
            if v > top or v < -top:
                scale = min(scale, top / abs(v))
        if self._straight:
            scale = self._straight_speeds(target, speeds, scale)
        if scale < 1.0:
            speeds = [v * scale for v in speeds]
        return self._motors.sharing(speeds) if self._shared else speeds, scale

    def _straight_speeds(self, twist: Twist, speeds: list[float], scale: float) -> float:
        """Put in those of the wheels that do not turn."""
        vx, vy, wz = self._through_skid(twist) if self._skid else twist
        for i, l1, l2, l3, radius, top in self._straight:
            speeds[i] = v = (l1 * vx + l2 * vy + l3 * wz) / radius
            if v * scale > top or v * scale < -top:
                scale = top / abs(v)
        return scale

    def _speeds_on_the_way(
        self, target: Twist, angles: Sequence[float], away: float
    ) -> tuple[Twist, list[float]]:
        """The twist that scrubs least at these angles, and the speeds that make it.

        argmin of the squared side slips plus a little of the squared distance from
        ``target`` (the more, the nearer ``away`` is to what counts as aligned), slowed
        as a whole to the wheels' limits.
        """
        follow = _FOLLOW / (1.0 - (_ALIGNED / away) ** 2)
        vx, vy, wz = target
        directions = []
        # Solved for the difference from the target: nothing is lost near it.
        a12 = a13 = a23 = b1 = b2 = b3 = 0.0
        a11 = a22 = follow
        a33 = follow * self._length2
        for i, steering, heading, sign, x, y, trail, _, _, _ in self._scrubbing:
            direction = heading + sign * angles[i]
            c, s = math.cos(direction), math.sin(direction)
            directions.append((c, s))
            if steering.held and not steering.unreachable:
                continue
            t3 = c * x + s * y + trail
            slip = c * vy - s * vx + t3 * wz
            if trail:
                slip += trail * sign * steering.rate
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            b1 += s * slip
            b2 -= c * slip
            b3 -= t3 * slip
        for t1, t2, t3 in self._fixed.rows:
            a11 += t1 * t1
            a12 += t1 * t2
            a13 += t1 * t3
            a22 += t2 * t2
            a23 += t2 * t3
            a33 += t3 * t3
        dx, dy, dw = solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
        vx, vy, wz = vx + dx, vy + dy, wz + dw
        speeds = list(self._standing)
        for (i, steering, _, sign, x, y, _, lateral, radius, driven), (c, s) in zip(
            self._scrubbing, directions, strict=True
        ):
            if not driven or steering.unreachable:
                continue
            v = -lateral * (wz + sign * steering.rate) if lateral else 0.0
            if not steering.held:
                v += c * (vx - wz * y) + s * (vy + wz * x)
            speeds[i] = v / radius
        now = Twist(vx, vy, wz)
        if self._straight:
            self._straight_speeds(now, speeds, 1.0)
        now, speeds = self._motors.slowed(now, speeds)
        return now, self._motors.sharing(speeds)

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
