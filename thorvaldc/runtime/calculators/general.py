"""The calculator for any arrangement of driven, steered, fixed and free wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.runtime.base import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand
from thorvaldc.runtime.calculators.geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear import solve3
from thorvaldc.runtime.calculators.steering import Steering
from thorvaldc.runtime.se2 import Twist

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
    the wheels within their speeds, so that the centre of rotation stays.
    """

    name = "general"
    summary = "any arrangement of driven, steered, fixed and free wheels"
    Options = GeneralOptions

    def __init__(self, geometry: BaseGeometry, options: GeneralOptions | None = None) -> None:
        super().__init__(geometry, options)
        wheels = geometry.wheels
        self._fixed = FixedWheels(wheels)
        self._steering = [
            Steering(
                wheels[group[0]],
                group,
                min(wheels[i].max_acceleration * wheels[i].radius for i in group),
                self.options.hysteresis,
            )
            for group in geometry.steering_groups
        ]
        self._skid = self._skid_gain()
        self._length2 = geometry.length**2
        self._fixed_rows = tuple(
            (i, *w.rows(0.0)) for i, w in enumerate(wheels) if w.fixed and w.driven
        )

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

    def allowed(self, twist: Twist) -> Twist:
        return self._fixed.allowed(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        wheels = self.geometry.wheels
        target = self._fixed.allowed(twist)
        vx, vy, wz = target
        infeasible = Twist(twist.vx - vx, twist.vy - vy, twist.wz - wz)
        unreachable: tuple[int, ...] = ()
        for steering in self._steering:
            i = steering.wheels[0]
            wheel = steering.wheel
            angle = states.angles[i] if states else steering.angle
            speed = states.speeds[i] * wheel.radius if states else 0.0
            steering.choose(vx - wz * wheel.y, vy + wz * wheel.x, wz, angle, speed)
            if steering.unreachable:
                unreachable += steering.wheels
        self._move_steering(dt)

        scale = self._saturation(target)
        target = target.scaled(scale) if scale < 1.0 else target
        # Direction of rolling of each steered wheel, where it is or else where it is asked to be.
        cosines, sines = [0.0] * len(wheels), [0.0] * len(wheels)
        for steering in self._steering:
            wheel = steering.wheel
            angle = states.angles[steering.wheels[0]] if states else steering.angle
            direction = wheel.heading + wheel.sign * angle
            c, s = math.cos(direction), math.sin(direction)
            for i in steering.wheels:
                cosines[i], sines[i] = c, s
        now = self._coordinated(target, states, cosines, sines) if states else target
        speeds = [0.0] * len(wheels)
        angles = [0.0] * len(wheels)
        excess = 1.0
        vx, vy, wz = self._through_skid(now) if self._skid else now
        for i, row, _ in self._fixed_rows:
            wheel = wheels[i]
            speed = (row[0] * vx + row[1] * vy + row[2] * wz) / wheel.radius
            speeds[i] = speed
            excess = max(excess, abs(speed) / wheel.max_speed)
        for steering in self._steering:
            for i in steering.wheels:
                wheel = wheels[i]
                angles[i] = steering.angle
                if not wheel.driven or steering.unreachable:
                    continue
                # At the centre of rotation a contact beside the axis still rolls.
                v = -wheel.lateral * (wz + wheel.sign * steering.rate) if wheel.lateral else 0.0
                if not steering.held:
                    v += cosines[i] * (vx - wz * wheel.y) + sines[i] * (vy + wz * wheel.x)
                speed = v / wheel.radius
                speeds[i] = speed
                excess = max(excess, abs(speed) / wheel.max_speed)
        if excess > 1.0:
            speeds = [v / excess for v in speeds]
            now = now.scaled(1.0 / excess)
        for group in self.geometry.spin_groups:
            mean = sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return BaseCommand(
            JointCommands(speeds, angles), target, now, infeasible, scale, unreachable
        )

    # -- steering -----------------------------------------------------------------

    def _move_steering(self, dt: float | None) -> None:
        if dt is None:
            for steering in self._steering:
                steering.jump()
            return
        slowest = 0.0
        if self.options.arrive_together:
            slowest = max((s.time_to_target() for s in self._steering), default=0.0)
        # A wheel that follows within a tick or two need not wait for the others.
        together = slowest > 2.0 * dt and slowest < math.inf
        for steering in self._steering:
            share = steering.time_to_target() / slowest if together else 1.0
            if steering.wheel.max_rate == math.inf:
                steering.jump()
            else:
                steering.advance(dt, share)

    # -- speeds -------------------------------------------------------------------

    def _saturation(self, target: Twist) -> float:
        """The factor (at most 1) that keeps every wheel within its speed at its target."""
        vx, vy, wz = self._through_skid(target) if self._skid else target
        scale = 1.0
        wheels = self.geometry.wheels
        for i, row, _ in self._fixed_rows:
            v = abs(row[0] * vx + row[1] * vy + row[2] * wz)
            top = wheels[i].max_speed * wheels[i].radius
            if v > top:
                scale = min(scale, top / v)
        for steering in self._steering:
            if steering.held:
                continue
            for i in steering.wheels:
                wheel = wheels[i]
                if wheel.driven:
                    v = abs(steering.rolling - wz * wheel.lateral)
                    top = wheel.max_speed * wheel.radius
                    if v > top:
                        scale = min(scale, top / v)
        return scale

    def _coordinated(
        self, target: Twist, states: JointStates, cosines: list[float], sines: list[float]
    ) -> Twist:
        """The twist that scrubs least with the wheels at the angles they have now.

        argmin of the squared side slips plus a little of the squared distance
        from ``target``: the target itself once the wheels are at their angles.
        """
        vx, vy, wz = target
        wheels = self.geometry.wheels
        if all(
            not s.unreachable and (s.held or abs(states.angles[s.wheels[0]] - s.target) <= _ALIGNED)
            for s in self._steering
        ):
            return target
        k = self._length2
        a11 = a22 = _FOLLOW
        a33 = _FOLLOW * k
        a12 = a13 = a23 = 0.0
        # Solved for the difference from the target, which makes the aligned case exact.
        b1 = b2 = b3 = 0.0
        for steering in self._steering:
            if steering.held and not steering.unreachable:
                continue
            for i in steering.wheels:
                wheel = wheels[i]
                c, s = cosines[i], sines[i]
                t3 = c * wheel.x + s * wheel.y + wheel.trail
                slip = c * vy - s * vx + t3 * wz
                if wheel.trail:
                    slip += wheel.trail * wheel.sign * steering.rate
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
        return Twist(vx + dx, vy + dy, wz + dw)

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
