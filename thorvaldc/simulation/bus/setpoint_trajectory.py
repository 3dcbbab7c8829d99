r"""Set-points of a drive over time: speed ramps, and moves that end at rest.

A trapezoidal move, here with equal acceleration and deceleration a and top speed v:

    speed ^      v ____________
          |       /            \
          |     /                \            braking distance from speed s: s^2 / (2 a)
          |   /                    \
          +--+----------------------+--> time

At each step the drive may have at most the speed s from which it can still stop at the goal.  In
steps of dt the braking distance is s dt + (s - a dt) dt + ... = s^2 / (2 a) + s dt/2, a little
more than the continuous one.  Set equal to the distance d to the goal:

    s = sqrt((a dt/2)^2 + 2 a d) - a dt/2
"""

from __future__ import annotations

import math


def ramp(speed: float, goal: float, acceleration: float, dt: float) -> float:
    """Returns the speed after ``dt`` s of a change towards ``goal``."""
    step = acceleration * dt
    return min(max(goal, speed - step), speed + step)


class Move:
    """The set-point of a trapezoidal move that ends at rest and may start at any speed.

    ``position`` (rad) and ``speed`` (rad/s) are those of the set-point.
    """

    def __init__(self, position: float, speed: float = 0.0) -> None:
        self.position = position
        self.speed = speed

    def step(
        self, goal: float, velocity: float, acceleration: float, deceleration: float, dt: float
    ) -> bool:
        """Advances by ``dt`` s; all limits are positive.  Returns whether the goal is reached."""
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
