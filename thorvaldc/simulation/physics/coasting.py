"""How an ideal joint rolls out while its motor has no power.

An ideal joint has no mass and no ground, so its deceleration is computed from the model: a driven
wheel rolls with its share of the robot's mass against the friction of its motor, gear and tyre
(``model.statics.unpowered``).  A steering joint turns the tyre on the spot; its friction is as
strong as the motor that is made to overcome it, so the joint comes to rest with the largest
acceleration of the motor.  Time from the loss of power, with the closing time t_c of the brake:

    speed  \\__                    slope: deceleration
              \\__ t_c
                 \\                slope: braked (the same without a brake)
            ______\\____
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.model import Actuator, Robot
from thorvaldc.model.statics.unpowered import coasting_deceleration


class Coasting(NamedTuple):
    """The decelerations of a joint without power in rad/s^2.

    - ``deceleration``: before the brake has closed.
    - ``braked``: with a closed brake; the same value for a motor without a brake.
    - ``closing_time``: time in s from the loss of power until the brake is closed.
    """

    deceleration: float
    braked: float
    closing_time: float = 0.0

    def roll(self, speed: float, off_for: float, dt: float) -> tuple[float, float]:
        """Returns the speed (rad/s) after ``dt`` s, and the angle (rad) of the motion until then.

        At the begin of ``dt``, the motor has been without power for ``off_for`` s.
        """
        free = min(max(self.closing_time - off_for, 0.0), dt)
        speed, angle = _roll(speed, self.deceleration, free)
        speed, more = _roll(speed, self.braked, dt - free)
        return speed, angle + more


def _roll(speed: float, deceleration: float, dt: float) -> tuple[float, float]:
    if abs(speed) <= deceleration * dt:
        return 0.0, 0.5 * speed * abs(speed) / deceleration if speed else 0.0
    end = speed - math.copysign(deceleration * dt, speed)
    return end, 0.5 * (speed + end) * dt


def coasting_of(robot: Robot, motor: Actuator) -> Coasting:
    """Returns how the joint of a motor rolls out without power."""
    wheel = next((w for w in robot.wheels if w.spin_joint == motor.joint), None)
    if wheel is None:
        return Coasting(motor.max_acceleration, motor.max_acceleration)
    axle = robot.joint(motor.joint)
    free, braked = (
        coasting_deceleration(wheel, axle, motor, braked=closed) / wheel.radius
        for closed in (False, True)
    )
    return Coasting(free, braked, motor.brake.closing_time if motor.brake is not None else 0.0)
