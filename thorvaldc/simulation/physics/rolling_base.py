"""A simulated base on ideal ground, on which all wheels roll without slip.

The commanded joint motions of several wheels rarely fit to one motion of the robot, for example
if the wheel radii in the model are wrong.  In each step, the true twist (vx, vy, wz) of the robot
is the least-squares solution of the rolling and no-slip conditions of all wheels.  The base then
sets each joint to the motion that the true twist requires.  The encoder readings thus agree with
the true motion and with the true wheels, as a calibration assumes.  The agreement is exact while
the wheels roll.  A steered wheel gives way only while it rolls (``RELAXATION_LENGTH``), so that
wheels that turn on the spot scrub as on a real floor.
"""

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

RELAXATION_LENGTH = 0.15
"""Distance (m) on which a rolling wheel gives way by 1 rad.

A wheel that turns on the spot keeps the commanded angle, although the robot moves a little.
"""
_WITHOUT_POWER = 1e-2
"""Weight of a wheel without power in the fit of the twist; that of the other wheels is 1."""
_LEAST_SPEED = 1e-3
"""Ground speed (m/s) of a wheel below which the direction of motion of the wheel is undefined."""


class RollingBase(SimBase, GroundTruthBase):
    """A simulated base whose wheels roll without slip.

    The twist of the robot is the best fit to the commanded joints, and all joints follow the twist.
    Real drive motors without speed control follow the motion of the robot in the same way.  Real
    steering motors hold the steering angle instead.
    """

    def __init__(
        self,
        robot: Robot,
        wheel_errors: WheelErrors | None = None,
        radii: Sequence[float] | None = None,
        start: float = 0.0,
    ) -> None:
        """Creates the base at rest, at the time ``start`` (s).

        ``radii`` are the wheel radii (m) without wheel errors.  By default, ``radii`` has the wheel
        radii of the model.
        """
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
        # The encoder readings are the positions (rad) and speeds (rad/s) of the drives, and the
        # angles (rad) and rates (rad/s) of the steering joints.
        self._encoder_positions = [0.0] * n
        self._encoder_speeds = [0.0] * n
        self._encoder_angles = [0.0] * n
        self._encoder_rates = [0.0] * n
        # Angle (rad) by which each wheel gives way: true angle minus commanded true angle.
        self._corrections = [0.0] * n

    def read(self, now: float) -> JointStates:
        ideal = super().read(now)
        return JointStates(
            ideal.time,
            tuple(self._encoder_speeds),
            tuple(self._encoder_angles),
            tuple(self._encoder_rates),
            tuple(self._encoder_positions),
        )

    def true_pose(self) -> Pose2:
        return self._pose

    def true_twist(self) -> Twist:
        return self._twist

    def _advance(self, dt: float) -> None:
        super()._advance(dt)
        last_twist, self._twist = self._twist, self._fitted_twist()
        mean = Twist(*((a + b) / 2.0 for a, b in zip(last_twist, self._twist, strict=True)))
        self._pose = self._pose.moved(se2.exp(mean, dt))
        vx, vy, wz = self._twist
        for i, wheel in enumerate(self._true):
            angle = self._encoder_angles[i]
            if wheel.steered:
                correction = self._angle_without_slip(i) - self._angles[i] - self._offsets[i]
                # A wheel gives way while it rolls, at most as fast as its steering motor turns.
                ground_speed = math.hypot(vx - wz * wheel.y, vy + wz * wheel.x)
                step = min(wheel.max_rate, ground_speed / RELAXATION_LENGTH) * dt
                change = min(max(correction - self._corrections[i], -step), step)
                self._corrections[i] += change
                angle = self._angles[i] + self._corrections[i]
            self._encoder_rates[i] = (angle - self._encoder_angles[i]) / dt
            self._encoder_angles[i] = angle
            if wheel.encoder:
                (l1, l2, l3), _ = wheel.rows(angle + self._offsets[i])
                rolled = l1 * vx + l2 * vy + l3 * wz
                rolled -= wheel.lateral * wheel.sign * self._encoder_rates[i]
                speed = rolled / wheel.radius
                self._encoder_positions[i] += (self._encoder_speeds[i] + speed) / 2.0 * dt
                self._encoder_speeds[i] = speed
                if (i, False) in self._off_since:
                    self._speeds[i] = speed

    def _angle_without_slip(self, i: int) -> float:
        """Returns the true steering angle (rad) at which a wheel rolls without side slip.

        With the velocity u of the steering axis, its direction a, the trail c and the direction p
        of the wheel, the contact point has no velocity across the wheel if

            |u| sin(a - p) + c (wz + p') = 0

        The rate p' is the commanded steering rate.  Of the two solutions, one per sense of rolling,
        the nearer one counts.  A wheel without a solution, such as a wheel that turns on the spot,
        keeps its angle relative to the command.
        """
        wheel, (vx, vy, wz) = self._true[i], self._twist
        commanded = self._angles[i] + self._offsets[i]
        ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
        speed = math.hypot(ux, uy)
        across = wheel.trail * (wz + wheel.sign * self._rates[i])
        if speed <= _LEAST_SPEED or abs(across) >= speed:
            return commanded + self._corrections[i]
        direction = wheel.heading + wheel.sign * commanded
        motion, side = math.atan2(uy, ux), math.asin(across / speed)
        forwards = math.remainder(motion + side - direction, math.tau)
        backwards = math.remainder(motion + math.pi - side - direction, math.tau)
        return commanded + wheel.sign * min(forwards, backwards, key=abs)

    def _fitted_twist(self) -> Twist:
        """Returns the least-squares fit of the twist to the commanded joints.

        Each wheel that is not a caster gives one or two linear equations for the twist of the
        robot.  The speed of the wheel contact point across the wheel is zero.  For a driven wheel,
        the ground speed along the wheel (m/s) is the wheel speed (rad/s) times the true wheel
        radius (m).  The equations contain a correction for a wheel contact point that is not on the
        steering axis.  A robot may have fewer equations than unknowns, so that a small multiple of
        the identity matrix is added to the normal equations of the least-squares fit.
        """
        a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
        for i, wheel in enumerate(self._true):
            if wheel.swivel:
                continue
            rolling, across = wheel.rows(self._angles[i] + self._offsets[i])
            rate = wheel.sign * self._rates[i] if wheel.steered else 0.0
            rows = [(across, -wheel.trail * rate)]
            if wheel.driven:
                speed = self._speeds[i] * wheel.radius + wheel.lateral * rate
                # A wheel without power follows the others; alone, it rolls on with the robot.
                scale = _WITHOUT_POWER if (i, False) in self._off_since else 1.0
                rows.append(
                    ((scale * rolling[0], scale * rolling[1], scale * rolling[2]), scale * speed)
                )
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
        weight = 1e-9
        a11, a22, a33 = a11 + weight, a22 + weight, a33 + weight * self._length2
        return self._fixed.feasible(Twist(*solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)))
