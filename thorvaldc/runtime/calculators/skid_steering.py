"""Wheel speeds of a robot that turns by skidding because its fixed wheels are not in line."""

from __future__ import annotations

from thorvaldc.model.float_sum import float_sum
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.se2 import Twist


class SkidSteering:
    """Compensation of the yaw rate that a robot loses by skidding.

    With Coulomb friction and equal loads, the yaw rate is the least-squares fit of a twist to the
    surface velocities of the wheels.  Wheel i has the position a_i across the wheels and l_i along
    the wheels, both relative to the mean position.  Yaw rate wz of a skidding robot whose wheels i
    roll at the speeds v_i:

        wz = -sum a_i v_i / (sum a_i^2 + sum l_i^2)

    Without skidding, a robot with the wheel speeds v_i = -a_i wz' would turn at the yaw rate wz'.
    With the same wheel speeds, a skidding robot turns only at the yaw rate g wz', where g = sum
    a_i^2 / (sum a_i^2 + sum l_i^2).  For four wheels at (+-a, +-b), the factor is g = b^2 / (a^2 +
    b^2).  To turn a skidding robot at the yaw rate wz, the compensation computes the wheel speeds
    for the yaw rate wz / g.
    """

    def __init__(self, inverse_gain: float, middle: float, normal: tuple[float, float]) -> None:
        self._inverse_gain = inverse_gain
        self._middle = middle
        self._normal = normal

    @staticmethod
    def from_geometry(geometry: BaseGeometry, fixed: FixedWheels) -> SkidSteering | None:
        """Returns the skid compensation, or ``None`` if the robot turns without skidding."""
        if geometry.steering_groups or not fixed.skids or len(fixed.rows) != 1:
            return None
        wheels = [w for w in geometry.wheels if w.fixed]
        driven = [w for w in wheels if w.driven]
        # The normal of the fixed wheels is (t1, t2), so their rolling direction is (t2, -t1).
        t1, t2, _ = fixed.rows[0]
        across = [t1 * w.x + t2 * w.y for w in driven]
        middle = float_sum(across) / len(across)
        turning = float_sum((a - middle) ** 2 for a in across)
        along = [t2 * w.x - t1 * w.y for w in wheels]
        mean = float_sum(along) / len(wheels)
        resisting = float_sum((a - mean) ** 2 for a in along)
        if turning < 1e-6:
            return None
        return SkidSteering((turning + resisting) / turning, middle, (t1, t2))

    def compensate(self, twist: Twist) -> Twist:
        """Returns the twist whose wheel speeds make the skidding robot move with ``twist``.

        The compensation adds a rotation about the middle of the driven wheels, so the mean speed of
        the driven wheels does not change.
        """
        t1, t2 = self._normal
        added_turn = (self._inverse_gain - 1.0) * twist.wz
        along = added_turn * self._middle
        return Twist(twist.vx + t2 * along, twist.vy - t1 * along, twist.wz + added_turn)
