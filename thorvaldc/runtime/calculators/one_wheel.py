"""One wheel drives and steers; others on one fixed axle follow (a tricycle)."""

from __future__ import annotations

import math
from typing import Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand
from thorvaldc.runtime.calculators.base_calculator import bounded
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.general import SteeringOptions
from thorvaldc.runtime.calculators.motor_limits import Motors
from thorvaldc.runtime.calculators.steering_branch import Steering
from thorvaldc.runtime.calculators.twist_estimator import Noise, TwistEstimate
from thorvaldc.runtime.se2 import Twist


class OneWheel(BaseCalculator):
    """The drive wheel's velocity and the axle's line give the robot's motion, exactly.

    At any steering angle some motion is free of scrub, so that a wheel that
    still turns need not wait: it only rolls by what its direction has of the
    velocity wanted.
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
        self._nx, self._ny, self._d = self._fixed.rows[0]
        nx, ny = self._nx, self._ny
        self._axle_places = tuple(nx * w.x + ny * w.y for w in geometry.wheels if w.fixed)
        self._index, self._wheel = next(
            (i, w) for i, w in enumerate(geometry.wheels) if w.steered and w.driven
        )
        self._motors = Motors(geometry)
        w = self._wheel
        self._steering = Steering(
            w, (self._index,), w.max_acceleration * w.radius, self.options.hysteresis
        )

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
        if fixed.free:
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
        self._steering.reset(states.angles[self._index] if states else 0.0)
        self._motors.reset(states)

    def resume(self, before: Self) -> None:
        self._steering.resume(before._steering)
        self._motors.resume(before._motors)

    def feasible(self, twist: Twist) -> Twist:
        return self._fixed.feasible(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        i, wheel, steering = self._index, self._wheel, self._steering
        allowed = self._fixed.feasible(twist)
        vx, vy, wz = allowed
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
        if steering.held:
            v = -wz * wheel.lateral if not steering.unreachable else 0.0
        else:
            v = rolling[0] * vx + rolling[1] * vy + rolling[2] * wz
        ideal, _ = wheel.rows(steering.target)
        top = wheel.max_speed * wheel.radius
        fastest = abs(ideal[0] * vx + ideal[1] * vy + ideal[2] * wz)
        scale = top / fastest if fastest > top else 1.0
        turning = wheel.sign * steering.rate
        v = min(max(v * scale - wheel.lateral * turning, -top), top)
        speeds[i] = v / wheel.radius
        _, reached = self._motors.reached(allowed, speeds, dt)
        v = reached[i] * wheel.radius
        now = self._motion(angle, v + wheel.lateral * turning, -wheel.trail * turning)
        infeasible = Twist(twist.vx - vx, twist.vy - vy, twist.wz - wz)
        target = allowed.scaled(scale) if scale < 1.0 else allowed
        unreachable = (i,) if steering.unreachable else ()
        joints = JointCommands(reached, angles)
        return BaseCommand(joints, target, now, infeasible, scale, unreachable, rates)

    @bounded
    def odometry(self, states: JointStates) -> TwistEstimate:
        self.estimator.check(states)
        i, wheel, noise = self._index, self._wheel, self.noise
        turning = wheel.sign * states.angle_rates[i]
        rolls = wheel.radius * states.speeds[i] + wheel.lateral * turning
        slips = -wheel.trail * turning
        angle = states.angles[i]
        twist = self._motion(angle, rolls, slips)
        # The map from (rolling, slip, slip of the axle) is linear: its columns are motions.
        a2 = rolls * rolls + slips * slips
        angle2, slip2 = noise.angle**2, noise.slip_floor**2
        along = self._ny * twist.vx - self._nx * twist.vy
        certainty = sum(
            1.0 / (angle2 * (along - a * twist.wz) ** 2 + slip2) for a in self._axle_places
        )
        parts = (
            (self._motion(angle, 1.0, 0.0), noise.speed_ratio**2 * a2 + noise.speed_floor**2),
            (self._motion(angle, 0.0, 1.0), angle2 * a2 + slip2),
            (self._motion(angle, 0.0, 0.0, 1.0), 1.0 / certainty),
        )

        def entry(j: int, k: int) -> float:
            return sum(column[j] * column[k] * variance for column, variance in parts)

        xy, xw, yw = entry(0, 1), entry(0, 2), entry(1, 2)
        covariance = (
            (entry(0, 0), xy, xw),
            (xy, entry(1, 1), yw),
            (xw, yw, entry(2, 2)),
        )
        return TwistEstimate(twist, covariance, 3)

    def _motion(self, angle: float, rolls: float, slips: float, drift: float = 0.0) -> Twist:
        """The twist for the contact's speeds along and across the wheel, the axle's across."""
        wheel = self._wheel
        direction = wheel.heading + wheel.sign * angle
        c, s = math.cos(direction), math.sin(direction)
        # The wheel's velocity at its axis, but for what its offsets add: w (lateral, -trail).
        px = wheel.x + c * wheel.trail - s * wheel.lateral
        py = wheel.y + s * wheel.trail + c * wheel.lateral
        ux, uy = c * rolls - s * slips, s * rolls + c * slips
        nx, ny, d = self._nx, self._ny, self._d
        # Across: n . u = n . v + wz (ny px - nx py), and n . v + d wz = drift.
        arm = ny * px - nx * py - d
        wz = (nx * ux + ny * uy - drift) / arm
        return Twist(ux + wz * py, uy - wz * px, wz)
