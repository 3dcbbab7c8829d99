"""A base of ideal joints on ideal ground, where no wheel slips."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear_algebra import solve3
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Pose2, Twist
from thorvaldc.simulation.physics.ground_truth_base import GroundTruthBase
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.physics.wheel_errors import WheelErrors

_STANDS = 1e-3
"""Speed (m/s) over ground below which a wheel is not turned by it."""


class RollingBase(SimBase, GroundTruthBase):
    """Joints give way to the ground: the robot moves as its wheels ask for on the whole.

    Then each wheel rolls as that motion wants and points where it wants, so
    that what the joints tell agrees with the true motion and the true wheels,
    by which it can be found what the model does not know.  A real drive
    without speed control gives way like this; a steering motor does not.
    """

    def __init__(
        self,
        robot: Robot,
        wheel_errors: WheelErrors | None = None,
        radii: Sequence[float] | None = None,
        start: float = 0.0,
    ) -> None:
        """``radii`` (m) are those that the wheels roll on but for their errors."""
        super().__init__(robot, start)
        wheel_errors = wheel_errors or WheelErrors.none(robot)
        self._ratios, self._offsets = wheel_errors.radius_ratios, wheel_errors.steering_offsets
        model = BaseGeometry.from_robot(robot)
        radii = radii or [wheel.radius for wheel in model.wheels]
        self._true = tuple(
            dataclasses.replace(wheel, radius=radius * ratio)
            for wheel, radius, ratio in zip(model.wheels, radii, self._ratios, strict=True)
        )
        self._fixed = FixedWheels(model.wheels)
        self._length2 = model.length**2
        n = len(self._true)
        self._pose = ORIGIN
        self._twist = ZERO_TWIST
        # What the ground makes of the joints, as their encoders tell it.
        self._rolled = [0.0] * n
        self._rolling = [0.0] * n
        self._pointed = [0.0] * n
        self._turning = [0.0] * n

    def read(self, now: float) -> JointStates:
        asked = super().read(now)
        return JointStates(
            asked.time,
            tuple(self._rolling),
            tuple(self._pointed),
            tuple(self._turning),
            tuple(self._rolled),
        )

    def true_pose(self) -> Pose2:
        return self._pose

    def true_twist(self) -> Twist:
        return self._twist

    def _advance(self, dt: float) -> None:
        super()._advance(dt)
        before, self._twist = self._twist, self._motion()
        mean = Twist(*((a + b) / 2.0 for a, b in zip(before, self._twist, strict=True)))
        self._pose = self._pose.moved(se2.exp(mean, dt))
        vx, vy, wz = self._twist
        for i, wheel in enumerate(self._true):
            angle = self._pointed[i]
            if wheel.steered:
                ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
                asked = self._angles[i] + self._offsets[i]
                direction = wheel.heading + wheel.sign * asked
                if math.hypot(ux, uy) > _STANDS:
                    # Along the ground's direction, forwards or backwards, whichever is nearer.
                    off = math.remainder(math.atan2(uy, ux) - direction, math.pi)
                    asked += wheel.sign * off
                angle = asked - self._offsets[i]
            self._turning[i] = (angle - self._pointed[i]) / dt
            self._pointed[i] = angle
            if wheel.encoder:
                (l1, l2, l3), _ = wheel.rows(angle + self._offsets[i])
                rolled = l1 * vx + l2 * vy + l3 * wz
                rolled -= wheel.lateral * wheel.sign * self._turning[i]
                speed = rolled / wheel.radius
                self._rolled[i] += (self._rolling[i] + speed) / 2.0 * dt
                self._rolling[i] = speed

    def _motion(self) -> Twist:
        """The twist on which the joints as they are asked for agree best."""
        a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
        for i, wheel in enumerate(self._true):
            if wheel.swivel:
                continue
            rolling, across = wheel.rows(self._angles[i] + self._offsets[i])
            turning = wheel.sign * self._rates[i] if wheel.steered else 0.0
            rows = [(across, -wheel.trail * turning)]
            if wheel.driven:
                speed = self._speeds[i] * wheel.radius + wheel.lateral * turning
                rows.append((rolling, speed))
            for (r1, r2, r3), z in rows:
                a11 += r1 * r1
                a12 += r1 * r2
                a13 += r1 * r3
                a22 += r2 * r2
                a23 += r2 * r3
                a33 += r3 * r3
                b1 += r1 * z
                b2 += r2 * z
                b3 += r3 * z
        weak = 1e-9
        a11, a22, a33 = a11 + weak, a22 + weak, a33 + weak * self._length2
        return self._fixed.feasible(Twist(*solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)))
