r"""Computes the set-points of a drive for speed ramps and for trapezoidal moves.

A trapezoidal move ends at rest at the target position.  This diagram shows a trapezoidal move with
the top speed v and with equal acceleration and deceleration a:

    speed ^      v ____________
          |       /            \
          |     /                \            braking distance from speed s: s^2 / (2 a)
          |   /                    \
          +--+----------------------+--> time

The speed limit s in a step is the highest speed from which the drive can still stop at the goal.
The speed changes in time steps of dt, so that the braking distance is the sum s dt + (s - a dt) dt
+ ... = s^2 / (2 a) + s dt/2.  The speed limit s makes the braking distance equal to the distance d
to the target position.  Solution of the quadratic equation for the speed limit s:

    s = sqrt((a dt/2)^2 + 2 a d) - a dt/2
"""

from __future__ import annotations

import math


def ramp(speed: float, goal: float, acceleration: float, dt: float) -> float:
    """Returns the speed after a ramp from ``speed`` towards ``goal`` for ``dt`` s."""
    step = acceleration * dt
    return min(max(goal, speed - step), speed + step)


class Move:
    """The set-point of a trapezoidal move that ends at rest and may start at any speed.

    ``position`` is the position of the set-point (rad), and ``speed`` is the speed of the set-point
    (rad/s).
    """

    def __init__(self, position: float, speed: float = 0.0) -> None:
        self.position = position
        self.speed = speed

    def step(
        self, goal: float, velocity: float, acceleration: float, deceleration: float, dt: float
    ) -> bool:
        """Computes the set-point after a time step of ``dt`` s.

        All limits of speed and acceleration must be positive.  Returns true if the set-point has
        reached the target position.
        """
        distance = goal - self.position
        half = deceleration * dt / 2.0
        allowed = math.sqrt(half * half + 2.0 * deceleration * abs(distance)) - half
        speed_goal = math.copysign(min(velocity, allowed), distance)
        braking = abs(speed_goal) < abs(self.speed) or speed_goal * self.speed < 0.0
        self.speed = ramp(self.speed, speed_goal, deceleration if braking else acceleration, dt)
        step = self.speed * dt
        if abs(distance) <= max(abs(step), 1e-9) and abs(self.speed) <= deceleration * dt * 1.01:
            self.position, self.speed = goal, 0.0
            return True
        self.position += step
        return False
