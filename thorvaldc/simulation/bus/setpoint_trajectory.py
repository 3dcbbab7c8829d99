"""Set-points of a drive from one moment to the next: speed ramps and moves to a position."""

from __future__ import annotations

import math


def ramp(speed: float, goal: float, acceleration: float, dt: float) -> float:
    """The speed after ``dt`` s on the way to ``goal``."""
    step = acceleration * dt
    return min(max(goal, speed - step), speed + step)


class Move:
    """The set-point of a move that ends at rest: trapezoidal, from any speed.

    ``position`` (rad) and ``speed`` (rad/s) are the set-point's.
    """

    def __init__(self, position: float, speed: float = 0.0) -> None:
        self.position = position
        self.speed = speed

    def step(
        self, goal: float, velocity: float, acceleration: float, deceleration: float, dt: float
    ) -> bool:
        """Move on for ``dt`` s; whether the goal is reached.  All limits are positive."""
        way = goal - self.position
        # The speed from which the deceleration just brings it to rest at the goal; the
        # half step keeps a set-point that moves in steps from running past it.
        half = deceleration * dt / 2.0
        allowed = math.sqrt(half * half + 2.0 * deceleration * abs(way)) - half
        wanted = math.copysign(min(velocity, allowed), way)
        braking = abs(wanted) < abs(self.speed) or wanted * self.speed < 0.0
        self.speed = ramp(self.speed, wanted, deceleration if braking else acceleration, dt)
        step = self.speed * dt
        if abs(way) <= max(abs(step), 1e-9) and abs(self.speed) <= deceleration * dt * 1.01:
            self.position, self.speed = goal, 0.0
            return True
        self.position += step
        return False
