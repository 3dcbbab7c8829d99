"""Base calculator for tricycles: a driven and steered wheel, and a fixed axle of passive wheels.

The fixed axle has the normal n = (nx, ny) and the offset d.  The axle allows no side slip: n . v +
d wz = 0 for the velocity v and the yaw rate wz.  The driven wheel at p = (px, py) moves with the
velocity u = v + wz (-py, px).  Solution for the twist, with n . u = n . v + wz (ny px - nx py):

    wz = n . u / (ny px - nx py - d),   v = u - wz (-py, px)

The odometry computes the twist from the measured rolling speed and steering angle of the driven
wheel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

from thorvaldc.model.float_sum import float_sum
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand
from thorvaldc.runtime.calculators.base_calculator import finite_result
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.general import SteeringOptions
from thorvaldc.runtime.calculators.motor_limits import DriveMotors
from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists
from thorvaldc.runtime.calculators.steering_branch import SteeringJoint
from thorvaldc.runtime.calculators.twist_estimator import Noise, TwistEstimate
from thorvaldc.runtime.se2 import Twist


class OneWheel(BaseCalculator):
    """Calculator for tricycles.

    The equations are in the documentation of the module ``one_wheel``.

    The robot can move without scrub at any steering angle of the driven wheel.  A tricycle
    therefore does not stop while the driven wheel turns to its target angle.  While the driven
    wheel turns, its rolling speed is the component of the commanded velocity along the present
    wheel direction.
    """

    name = "one_wheel"
    summary = "one driven and steered wheel, with a fixed axle of passive wheels"
    Options = SteeringOptions

    def __init__(
        self,
        geometry: BaseGeometry,
        options: SteeringOptions | None = None,
        noise: Noise | None = None,
    ) -> None:
        super().__init__(geometry, options, noise)
        self._fixed = FixedWheels(geometry.wheels)
        self._reachable = ReachableTwists(geometry, self._fixed)
        self._nx, self._ny, self._d = self._fixed.rows[0]
        nx, ny = self._nx, self._ny
        self._axle_positions = tuple(nx * w.x + ny * w.y for w in geometry.wheels if w.fixed)
        self._index, self._wheel = next((i, w) for i, w in enumerate(geometry.wheels) if w.steered)
        self._motors = DriveMotors(geometry)
        self._steering = SteeringJoint(geometry.wheels, (self._index,), self.options.hysteresis)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        drives = [w for w in geometry.wheels if w.driven]
        steered = [w for w in geometry.wheels if w.steered]
        if len(drives) != 1 or len(steered) != 1 or drives[0] is not steered[0]:
            return (
                f"it has {len(drives)} driven and {len(steered)} steered wheels; "
                "exactly one that is both is needed"
            )
        fixed = FixedWheels(geometry.wheels)
        if fixed.unconstrained:
            return "it has no fixed passive wheel, without which nothing holds its heading"
        if len(fixed.rows) > 1 or fixed.skids:
            return "its fixed wheels are not on one axle"
        nx, ny, d = fixed.rows[0]
        wheel = drives[0]
        reach = math.hypot(wheel.trail, wheel.lateral)
        if abs(ny * wheel.x - nx * wheel.y - d) < reach + 1e-3:
            return "its driven wheel is, or can be steered, in line with the fixed axle"
        return None

    def reset(self, states: JointStates | None = None) -> None:
        self._reachable.reset()
        self._steering.reset(states.angles[self._index] if states else 0.0)
        self._motors.reset(states)

    def resume(self, previous: Self) -> None:
        self._reachable.resume(previous._reachable)
        self._steering.resume(previous._steering)
        self._motors.resume(previous._motors)

    def feasible(self, twist: Twist) -> Twist:
        return self._reachable.feasible(twist)

    def limiting_wheels(self, twist: Twist) -> tuple[int, ...]:
        return self._reachable.project(twist).limiting

    @property
    def commanded_speeds(self) -> Sequence[float]:
        return self._motors.commanded_speeds

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        i, wheel, steering = self._index, self._wheel, self._steering
        feasible, unreachable = self._reachable.project(twist)
        self._reachable.keep(feasible)
        vx, vy, wz = feasible
        angle = states.angles[i] if states else steering.angle
        speed = states.speeds[i] * wheel.radius if states else 0.0
        steering.choose(vx - wz * wheel.y, vy + wz * wheel.x, wz, angle, speed)
        n = len(self.geometry.wheels)
        speeds, angles, rates = [0.0] * n, [0.0] * n, [0.0] * n
        if dt is not None:
            rates[i] = (steering.target - steering.angle) / dt
        if dt is None or wheel.max_rate == math.inf:
            steering.jump()
        else:
            steering.advance(dt, 1.0)
        angles[i] = steering.angle
        angle = states.angles[i] if states else steering.angle
        rolling, _ = wheel.rows(angle)
        v = 0.0
        if steering.holding:
            v = -wz * wheel.lateral if not steering.unreachable else 0.0
        else:
            v = rolling[0] * vx + rolling[1] * vy + rolling[2] * wz
        # The speed limit of the wheel at its target angle determines the scale of the twist.
        rolling, _ = wheel.rows(steering.target)
        limit = wheel.max_speed * wheel.radius
        target_speed = abs(rolling[0] * vx + rolling[1] * vy + rolling[2] * wz)
        scale = limit / target_speed if target_speed > limit else 1.0
        turning = wheel.sign * steering.rate
        v = min(max(v * scale - wheel.lateral * turning, -limit), limit)
        speeds[i] = v / wheel.radius
        _, limited_speeds = self._motors.limit_accelerations(feasible, speeds, dt)
        v = limited_speeds[i] * wheel.radius
        current = self._motion(angle, v + wheel.lateral * turning, -wheel.trail * turning)
        infeasible = Twist(twist.vx - vx, twist.vy - vy, twist.wz - wz)
        target = feasible.scaled(scale) if scale < 1.0 else feasible
        joints = JointCommands(limited_speeds, angles)
        return BaseCommand(joints, target, current, infeasible, scale, unreachable, rates)

    @finite_result
    def odometry(self, states: JointStates) -> TwistEstimate:
        self.estimator.check(states)
        if self.estimator.may_deviate(states.speeds, self.commanded_speeds):
            return super().odometry(states)
        i, wheel, noise = self._index, self._wheel, self.noise
        turning = wheel.sign * states.angle_rates[i]
        rolls = wheel.radius * states.speeds[i] + wheel.lateral * turning
        slips = -wheel.trail * turning
        angle = states.angles[i]
        twist = self._motion(angle, rolls, slips)
        # The twist is a linear function of three speeds with independent errors: the rolling speed
        # and the side slip of the driven wheel, and the side slip of the axle.  The covariance of
        # the twist is therefore sum sigma_k^2 J_k J_k', where J_k is the twist per unit of speed k,
        # and sigma_k is the standard deviation of speed k.
        a2 = rolls * rolls + slips * slips
        angle2, slip2 = noise.direction**2, noise.slip_floor**2
        along = self._ny * twist.vx - self._nx * twist.vy
        axle_information = float_sum(
            1.0 / (angle2 * (along - a * twist.wz) ** 2 + slip2) for a in self._axle_positions
        )
        columns = (
            (self._motion(angle, 1.0, 0.0), noise.rolling**2 * a2 + noise.speed_floor**2),
            (self._motion(angle, 0.0, 1.0), angle2 * a2 + slip2),
            (self._motion(angle, 0.0, 0.0, 1.0), 1.0 / axle_information),
        )

        def entry(j: int, k: int) -> float:
            return float_sum(column[j] * column[k] * variance for column, variance in columns)

        xy, xw, yw = entry(0, 1), entry(0, 2), entry(1, 2)
        covariance = (
            (entry(0, 0), xy, xw),
            (xy, entry(1, 1), yw),
            (xw, yw, entry(2, 2)),
        )
        return TwistEstimate(twist, covariance, 3)

    def _motion(self, angle: float, rolls: float, slips: float, drift: float = 0.0) -> Twist:
        """Returns the twist for given speeds (m/s) of the driven wheel and the axle.

        - ``rolls``: rolling speed of the driven wheel.
        - ``slips``: side slip of the driven wheel, positive to the left.
        - ``drift``: side slip of the fixed axle.
        """
        wheel = self._wheel
        direction = wheel.heading + wheel.sign * angle
        c, s = math.cos(direction), math.sin(direction)
        px = wheel.x + c * wheel.trail - s * wheel.lateral
        py = wheel.y + s * wheel.trail + c * wheel.lateral
        ux, uy = c * rolls - s * slips, s * rolls + c * slips
        nx, ny, d = self._nx, self._ny, self._d
        # Solves n . u = n . v + wz (ny px - nx py) and n . v + d wz = drift for v and wz.
        arm = ny * px - nx * py - d
        wz = (nx * ux + ny * uy - drift) / arm
        return Twist(ux + wz * py, uy - wz * px, wz)
