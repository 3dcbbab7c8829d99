"""From twists to joints, over arrays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.calculators.base_geometry import WheelGeometry
from thorvaldc.runtime.calculators.general import SteeringOptions
from thorvaldc.runtime.calculators.steering_branch import RESUME_ABOVE, Steering
from thorvaldc.runtime.se2 import Twist

Array = NDArray[np.float64]

_SMALL = 1e-3
"""Twists (m/s, rad/s) at which no limit is reached, to read a linear map off."""
_SCAN = 720
"""Directions in which the choice of an angle is looked at, before it is bisected."""


class Choice(NamedTuple):
    """Which angle a steering joint at rest at 0 takes, as a step function of the direction.

    ``first``: half turns to add for directions from -pi on, ``None`` where no angle can be
    reached; ``steps``: (direction in rad beyond which, half turns to add from there on).
    """

    first: int | None
    steps: tuple[tuple[float, int | None], ...]


def tabulated(wheel: WheelGeometry, hysteresis: float) -> Choice:
    """The scalar choice, read off it and bisected to the last bit."""

    def half_turns(direction: float) -> int | None:
        steering = Steering(wheel, (0,), math.inf, hysteresis)
        steering.choose(math.cos(direction), math.sin(direction), 0.0, steering.angle, 0.0)
        if steering.unreachable:
            return None
        return round((steering.target - wheel.sign * (direction - wheel.heading)) / math.pi)

    steps: list[tuple[float, int | None]] = []
    at = -math.pi
    first = now = half_turns(at)
    for k in range(1, _SCAN + 1):
        end = math.pi * (2.0 * k / _SCAN - 1.0)
        while half_turns(end) != now:
            low, high = at, end
            while low < (middle := (low + high) / 2.0) < high:
                if half_turns(middle) == now:
                    low = middle
                else:
                    high = middle
            at, now = high, half_turns(high)
            steps.append((low, now))
        at = end
    return Choice(first, tuple(steps))


class _Joint(NamedTuple):
    """A steering joint: its wheels as (index, share of its rolling, wheel), its rest and choice."""

    wheel: WheelGeometry
    wheels: tuple[tuple[int, float, WheelGeometry], ...]
    lower: float
    upper: float
    rest: float
    choice: Choice


class Inverse:
    """The pure inverse of a calculator that has just been reset, for each twist on its own."""

    def __init__(self, calculator: BaseCalculator) -> None:
        """Raises ``ValueError`` where an angle depends on more than the wheel's direction."""
        geometry = calculator.geometry
        bent = [w.name for w in geometry.wheels if w.steered and w.trail]
        if bent:
            raise ValueError(
                f"wheels with their contact ahead of or behind their axis ({', '.join(bent)}) "
                "have no inverse over arrays"
            )
        fresh = type(calculator)(geometry, calculator.options)
        hysteresis = 0.0
        if isinstance(calculator.options, SteeringOptions):
            hysteresis = calculator.options.hysteresis
        units = [Twist(*(_SMALL * (i == j) for j in range(3))) for i in range(3)]
        columns = [fresh.feasible(unit) for unit in units]
        self._allowed = np.array(columns).T / _SMALL
        self._free = bool((self._allowed == np.eye(3)).all())
        along, across, turning = (fresh.command(unit).joints.speeds for unit in units)
        # (index, rad/s per unit of the twist, limit)
        self._straight = tuple(
            (i, along[i] / _SMALL, across[i] / _SMALL, turning[i] / _SMALL, w.max_speed)
            for i, w in enumerate(geometry.wheels)
            if w.fixed and w.driven
        )
        wheels = geometry.wheels
        self._joints = tuple(
            _Joint(
                first := wheels[group[0]],
                tuple((i, math.cos(wheels[i].heading - first.heading), wheels[i]) for i in group),
                low := -math.inf if first.lower is None else first.lower,
                high := math.inf if first.upper is None else first.upper,
                min(max(0.0, low), high),
                tabulated(first, hysteresis),
            )
            for group in geometry.steering_groups
        )
        self._rest = tuple(
            i for i, w in enumerate(wheels) if not (w.steered or (w.fixed and w.driven))
        )
        self._still = tuple(i for i, w in enumerate(wheels) if not w.steered)
        self._shared = geometry.spin_groups

    def solve(self, twists: Array, speeds: Array, angles: Array) -> None:
        """Speeds (rad/s) and steering angles (rad) of a piece of twists."""
        vx, vy, wz = twists if self._free else self._allowed @ twists
        speeds[self._rest, :] = 0.0
        angles[self._still, :] = 0.0
        excess = np.ones_like(wz)
        for joint in self._joints:
            self._turn(joint, vx, vy, wz, speeds, angles, excess)
        for i, l1, l2, l3, top in self._straight:
            speed = speeds[i]
            np.multiply(twists[0], l1, out=speed)
            speed += twists[1] * l2
            speed += twists[2] * l3
            np.maximum(excess, np.abs(speed) / top, out=excess)
        if excess.max() > 1.0:
            speeds /= excess
        for group in self._shared:
            speeds[group, :] = speeds[group, :].mean(axis=0)

    @staticmethod
    def _turn(
        joint: _Joint,
        vx: Array,
        vy: Array,
        wz: Array,
        speeds: Array,
        angles: Array,
        excess: Array,
    ) -> None:
        wheel = joint.wheel
        ux, uy = wz * -wheel.y, wz * wheel.x
        ux += vx
        uy += vy
        angle = angles[joint.wheels[0][0]]
        np.arctan2(uy, ux, out=angle)
        ux *= ux
        uy *= uy
        ux += uy
        v = np.sqrt(ux, out=ux)
        turns, flips, lost = _taken(joint.choice, angle)
        if wheel.heading:
            angle -= wheel.heading
        if wheel.sign != 1.0:
            angle *= wheel.sign
        angle += turns
        past = None
        if angle.min() < joint.lower or angle.max() > joint.upper:
            past = angle.copy()
            np.clip(angle, joint.lower, joint.upper, out=angle)
            past -= angle
        still = lost
        if v.min() < RESUME_ABOVE:
            still = v < RESUME_ABOVE
            if lost is not None:
                lost &= ~still
                still |= lost
        if past is not None:
            v *= np.cos(past)
        v *= flips
        if still is not None:
            v[still] = 0.0
            angle[still] = joint.rest
        for i, share, w in joint.wheels:
            if i != joint.wheels[0][0]:
                angles[i] = angle
            if not w.driven:
                speeds[i] = 0.0
                continue
            speed = speeds[i]
            np.multiply(v, share / w.radius, out=speed)
            if w.lateral:
                beside = wz * (w.lateral / w.radius)
                if lost is not None:
                    beside[lost] = 0.0
                speed -= beside
            rate = np.abs(speed)
            rate *= 1.0 / w.max_speed
            np.maximum(excess, rate, out=excess)


def _taken(choice: Choice, direction: Array) -> tuple[Array, Array, NDArray[np.bool_] | None]:
    """Per direction: the angle to add (rad), 1 or -1 for rolling backwards, where there is none."""
    now = choice.first
    turns = np.full_like(direction, (now or 0) * math.pi)
    flips = np.full_like(direction, -1.0 if (now or 0) % 2 else 1.0)
    lost = np.full(direction.shape, True) if now is None else None
    for beyond, after in choice.steps:
        mask = direction > beyond
        if now is None or after is None:
            lost = mask.copy() if lost is None else lost ^ mask
        change = (after or 0) - (now or 0)
        now = after
        if change:
            turns += mask * (change * math.pi)
        if change % 2:
            flips *= 1.0 - 2.0 * mask
    return turns, flips, lost
