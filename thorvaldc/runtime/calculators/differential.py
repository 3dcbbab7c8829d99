"""Base calculator for differential drives: two or more driven wheels on one axle, without steering.

The unit vector e points along the wheels, and the unit vector n points across the wheels.  The
position of a wheel along n is a, and the position of the axle along e is d.  Kinematics of a robot
with the velocity v and the yaw rate wz:

    rolling speed of the wheel:  e . v - a wz        no side slip of the axle:  n . v = -d wz

The odometry fits the linear function "rolling speed = along - a wz" of the wheel position a to the
measured wheel speeds by weighted least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

from thorvaldc.model.float_sum import float_sum
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, NoOptions
from thorvaldc.runtime.calculators.base_calculator import finite_result
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.motor_limits import DriveMotors
from thorvaldc.runtime.calculators.twist_estimator import Noise, TwistEstimate
from thorvaldc.runtime.se2 import Twist


class Differential(BaseCalculator):
    """Inverse kinematics and odometry of a differential drive in closed form.

    The equations are in the documentation of the module ``differential``.
    """

    name = "differential"
    summary = "driven wheels on one axle, steered by the difference of their speeds"

    def __init__(
        self, geometry: BaseGeometry, options: NoOptions | None = None, noise: Noise | None = None
    ) -> None:
        super().__init__(geometry, options, noise)
        self._fixed = FixedWheels(geometry.wheels)
        # The constraint of the axle is n . v + d wz = 0 with the coefficients n = (nx, ny) and d.
        nx, ny, self._d = self._fixed.rows[0]
        self._nx, self._ny = nx, ny
        # (index, sign: -1 if the wheel is mounted the other way round, row L, radius, speed limit)
        self._wheels = tuple(
            (
                i,
                math.copysign(1.0, ny * math.cos(w.heading) - nx * math.sin(w.heading)),
                w.rows(0.0)[0],
                w.radius,
                w.max_speed,
            )
            for i, w in enumerate(geometry.wheels)
            if w.driven and not w.swivel
        )
        self._motors = DriveMotors(geometry)
        self._across = tuple((i, s, -s * row[2], r) for i, s, row, r, _ in self._wheels)
        self._axle_positions = tuple(nx * w.x + ny * w.y for w in geometry.wheels if w.fixed)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        steered = [w.name for w in geometry.wheels if w.steered]
        if steered:
            return f"it has steered wheels ({', '.join(steered)})"
        driven = [w for w in geometry.driven if not w.swivel]
        if len(driven) < 2:
            return f"it has {len(driven)} driven wheels; two or more are needed"
        fixed = FixedWheels(geometry.wheels)
        if len(fixed.rows) > 1:
            return "its fixed wheels point in different directions"
        if fixed.skids:
            names = ", ".join(geometry.wheels[i].name for i in fixed.skids)
            return f"its fixed wheels ({names}) are not on one axle, so that it turns by skidding"
        nx, ny, _ = fixed.rows[0]
        positions = [nx * w.x + ny * w.y for w in driven]
        if max(positions) - min(positions) < 1e-3:
            return "its driven wheels are at the same position along the axle"
        return None

    def reset(self, states: JointStates | None = None) -> None:
        if states is None:
            self._motors.reset()
        else:
            self._motors.reset(states, self.odometry(states).twist)

    def resume(self, previous: Self) -> None:
        self._motors.resume(previous._motors)

    @property
    def commanded_speeds(self) -> Sequence[float]:
        return self._motors.commanded_speeds

    def feasible(self, twist: Twist) -> Twist:
        return self._fixed.feasible(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        feasible = self._fixed.feasible(twist)
        vx, vy, wz = feasible
        n = len(self.geometry.wheels)
        speeds = [0.0] * n
        excess = 1.0
        for i, _, row, radius, limit in self._wheels:
            speeds[i] = (row[0] * vx + row[1] * vy + row[2] * wz) / radius
            excess = max(excess, abs(speeds[i]) / limit)
        scale = 1.0 / excess
        if excess > 1.0:
            speeds = [v * scale for v in speeds]
        target = feasible.scaled(scale) if excess > 1.0 else feasible
        speeds = self._motors.average_shared(speeds)
        current, limited_speeds = self._motors.limit_accelerations(target, speeds, dt)
        infeasible = Twist(twist.vx - vx, twist.vy - vy, twist.wz - wz)
        zeros = (0.0,) * n
        joints = JointCommands(limited_speeds, zeros)
        return BaseCommand(joints, target, current, infeasible, scale, (), zeros)

    @finite_result
    def odometry(self, states: JointStates) -> TwistEstimate:
        self.estimator.check(states)
        if len(self._wheels) > 2 or self.estimator.may_deviate(
            states.speeds, self.commanded_speeds
        ):  # the estimator can reject a faulty wheel, and compares wheels with their commands
            return super().odometry(states)
        noise = self.noise
        speeds = states.speeds
        # The weights of the fit depend on the wheel speeds.  An unweighted fit predicts the wheel
        # speeds.
        along, turn = self._fit_line([(a, s * r * speeds[i], 1.0) for i, s, a, r in self._across])[
            :2
        ]
        ratio2, floor2 = noise.rolling**2, noise.speed_floor**2
        weighted = [
            (a, s * r * speeds[i], 1.0 / (ratio2 * (along - a * turn) ** 2 + floor2))
            for i, s, a, r in self._across
        ]
        along, turn, p11, p13, p33 = self._fit_line(weighted)
        angle2, slip2 = noise.direction**2, noise.slip_floor**2
        p22 = 1.0 / float_sum(
            1.0 / (angle2 * (along - a * turn) ** 2 + slip2) for a in self._axle_positions
        )
        # Converts the speed along the wheels to the velocity v of base_link: v = e along - n d wz.
        d, nx, ny = self._d, self._nx, self._ny
        ex, ey = ny, -nx
        vx, vy = ex * along - nx * d * turn, ey * along - ny * d * turn
        nn, en, nt = p22 + d * d * p33, -d * p13, -d * p33
        covariance = (
            (
                ex * ex * p11 + 2 * ex * nx * en + nx * nx * nn,
                ex * ey * p11 + (ex * ny + ey * nx) * en + nx * ny * nn,
                ex * p13 + nx * nt,
            ),
            (
                ex * ey * p11 + (ex * ny + ey * nx) * en + nx * ny * nn,
                ey * ey * p11 + 2 * ey * ny * en + ny * ny * nn,
                ey * p13 + ny * nt,
            ),
            (ex * p13 + nx * nt, ey * p13 + ny * nt, p33),
        )
        return TwistEstimate(Twist(vx, vy, turn), covariance, 3)

    @staticmethod
    def _fit_line(
        points: list[tuple[float, float, float]],
    ) -> tuple[float, float, float, float, float]:
        """Fits the linear function ``speed = along - a turn`` to points (a, speed, weight).

        Returns the fitted parameters ``along`` and ``turn`` and the upper half of their covariance
        matrix.
        """
        s0 = s1 = s2 = t0 = t1 = 0.0
        for a, v, w in points:
            s0 += w
            s1 += w * a
            s2 += w * a * a
            t0 += w * v
            t1 += w * a * v
        det = s0 * s2 - s1 * s1
        return (s2 * t0 - s1 * t1) / det, (s1 * t0 - s0 * t1) / det, s2 / det, s1 / det, s0 / det
