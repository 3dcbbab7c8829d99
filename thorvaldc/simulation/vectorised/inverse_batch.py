"""Computes the inverse kinematics of many twists: wheel speeds and steering angles."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.calculators.base_geometry import FixedWheels, WheelGeometry
from thorvaldc.runtime.calculators.general import SteeringOptions
from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists
from thorvaldc.runtime.calculators.steering_branch import RESUME_ABOVE, SteeringJoint
from thorvaldc.runtime.se2 import Twist

Array = NDArray[np.float64]

_SMALL = 1e-3
"""Size (m/s, rad/s) of the test twists that determine the linear map from twists to wheel speeds.

A test twist is so small that no wheel reaches its speed limit.
"""
_SCAN = 720
"""Number of directions of motion at which the chosen steering angle is sampled."""


class BranchTable(NamedTuple):
    """Half turns that a steering joint adds to the direction of motion, as a step function.

    The table applies to a steering joint at rest at the angle 0. The number of half turns is a step
    function of the direction of motion.

    - ``first``: number of half turns from the direction -pi rad to the first step, or ``None`` if
      no steering angle is reachable.
    - ``steps``: for each step, the direction of motion (rad) and the number of half turns beyond
      this direction.
    """

    first: int | None
    steps: tuple[tuple[float, int | None], ...]


def tabulate_branch(wheel: WheelGeometry, hysteresis: float) -> BranchTable:
    """Returns the branch table of a steering joint.

    The function samples the steering angles that ``SteeringJoint`` chooses, and finds each step by
    bisection to the last bit.
    """

    def half_turns(direction: float) -> int | None:
        joint = SteeringJoint((wheel,), (0,), hysteresis)
        joint.choose(math.cos(direction), math.sin(direction), 0.0, joint.angle, 0.0)
        if joint.unreachable:
            return None
        return round((joint.target - wheel.sign * (direction - wheel.heading)) / math.pi)

    steps: list[tuple[float, int | None]] = []
    start = -math.pi
    first = current = half_turns(start)
    for k in range(1, _SCAN + 1):
        end = math.pi * (2.0 * k / _SCAN - 1.0)
        while half_turns(end) != current:
            low, high = start, end
            while low < (middle := (low + high) / 2.0) < high:
                if half_turns(middle) == current:
                    low = middle
                else:
                    high = middle
            start, current = high, half_turns(high)
            steps.append((low, current))
        start = end
    return BranchTable(first, tuple(steps))


class _Joint(NamedTuple):
    """A steering joint and its wheels.

    - ``wheel``: geometry of the first wheel on the steering joint.
    - ``wheels``: for each wheel on the joint, its index, its share of the rolling speed, and its
      geometry.
    - ``lower``, ``upper``: limits of the steering angle, rad.
    - ``rest``: steering angle after a reset, rad.
    - ``branches``: table of the half turns for each direction of motion.
    """

    wheel: WheelGeometry
    wheels: tuple[tuple[int, float, WheelGeometry], ...]
    lower: float
    upper: float
    rest: float
    branches: BranchTable


class InverseBatch:
    """Computes the inverse kinematics of a base calculator for arrays of independent twists."""

    def __init__(self, calculator: BaseCalculator) -> None:
        """Determines the tables and constants of the inverse kinematics of ``calculator``.

        Raises ``ValueError`` if a steered wheel has a trail, because its steering angle also
        depends on wz.
        """
        geometry = calculator.geometry
        trailing = [w.name for w in geometry.wheels if w.steered and w.trail]
        if trailing:
            raise ValueError(
                f"wheels with their contact ahead of or behind their axis ({', '.join(trailing)}) "
                "have no inverse over arrays"
            )
        # Without steering limits, joint speeds are a linear function of small twists.
        unlimited = replace(
            geometry, wheels=tuple(replace(w, lower=None, upper=None) for w in geometry.wheels)
        )
        reset_calculator = type(calculator)(unlimited, calculator.options)
        self._reachable = ReachableTwists(geometry, FixedWheels(geometry.wheels))
        hysteresis = 0.0
        if isinstance(calculator.options, SteeringOptions):
            hysteresis = calculator.options.hysteresis
        units = [Twist(*(_SMALL * (i == j) for j in range(3))) for i in range(3)]
        columns = [reset_calculator.feasible(unit) for unit in units]
        self._feasible = np.array(columns).T / _SMALL
        self._unconstrained = bool((self._feasible == np.eye(3)).all())
        along, across, turning = (reset_calculator.command(unit).joints.speeds for unit in units)
        # Fields: wheel index, wheel speed (rad/s) per m/s forward, per m/s to the left and per
        # rad/s of yaw rate, speed limit (rad/s).
        self._driven_fixed = tuple(
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
                tabulate_branch(first, hysteresis),
            )
            for group in geometry.steering_groups
        )
        self._without_drive = tuple(
            i for i, w in enumerate(wheels) if not (w.steered or (w.fixed and w.driven))
        )
        self._not_steered = tuple(i for i, w in enumerate(wheels) if not w.steered)
        self._shared = geometry.spin_groups

    def solve(self, twists: Array, speeds: Array, angles: Array) -> None:
        """Writes the wheel speeds (rad/s) and steering angles (rad) for ``twists`` (3, n)."""
        feasible = twists if self._unconstrained else self._feasible @ twists
        if not self._reachable.unlimited:
            feasible = self._reachable_twists(feasible)
        vx, vy, wz = feasible
        speeds[self._without_drive, :] = 0.0
        angles[self._not_steered, :] = 0.0
        excess = np.ones_like(wz)
        for joint in self._joints:
            self._solve_joint(joint, vx, vy, wz, speeds, angles, excess)
        for i, l1, l2, l3, limit in self._driven_fixed:
            speed = speeds[i]
            np.multiply(vx, l1, out=speed)
            speed += vy * l2
            speed += wz * l3
            np.maximum(excess, np.abs(speed) / limit, out=excess)
        if excess.max() > 1.0:
            speeds /= excess
        for group in self._shared:
            speeds[group, :] = speeds[group, :].mean(axis=0)

    def _reachable_twists(self, twists: Array) -> Array:
        """Returns the reachable twists for twists that the fixed wheels allow.

        The scalar method ``ReachableTwists.project`` computes the columns in which a wheel is at or
        beyond a steering limit.
        """
        beyond = np.zeros(twists.shape[1], bool)
        for lower, upper in self._reachable.limit_rows:
            beyond |= (np.array(lower) @ twists) * (np.array(upper) @ twists) > -1e-18
        reachable = twists.copy()
        for k in np.flatnonzero(beyond):
            reachable[:, k] = self._reachable.project(Twist(*twists[:, k].tolist())).twist
        return reachable

    @staticmethod
    def _solve_joint(
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
        turns, signs, unreachable = _branches(joint.branches, angle)
        if wheel.heading:
            angle -= wheel.heading
        if wheel.sign != 1.0:
            angle *= wheel.sign
        angle += turns
        np.clip(angle, joint.lower, joint.upper, out=angle)
        standing = unreachable
        if v.min() < RESUME_ABOVE:
            standing = v < RESUME_ABOVE
            if unreachable is not None:
                unreachable &= ~standing
                standing |= unreachable
        v *= signs
        if standing is not None:
            v[standing] = 0.0
            angle[standing] = joint.rest
        for i, share, w in joint.wheels:
            if i != joint.wheels[0][0]:
                angles[i] = angle
            if not w.driven:
                speeds[i] = 0.0
                continue
            speed = speeds[i]
            np.multiply(v, share / w.radius, out=speed)
            if w.lateral:
                lateral_speed = wz * (w.lateral / w.radius)
                if unreachable is not None:
                    lateral_speed[unreachable] = 0.0
                speed -= lateral_speed
            rate = np.abs(speed)
            rate *= 1.0 / w.max_speed
            np.maximum(excess, rate, out=excess)


def _branches(
    table: BranchTable, direction: Array
) -> tuple[Array, Array, NDArray[np.bool_] | None]:
    """Looks up the half turns in a branch table for an array of directions of motion (rad).

    Returns the angle (rad) to add to the direction of motion, the sign of the rolling speed, and a
    mask.  The mask is ``True`` for directions of motion without a reachable steering angle.  The
    mask is ``None`` if all directions of motion have a reachable steering angle.
    """
    current = table.first
    turns = np.full_like(direction, (current or 0) * math.pi)
    signs = np.full_like(direction, -1.0 if (current or 0) % 2 else 1.0)
    unreachable = np.full(direction.shape, True) if current is None else None
    for step, following in table.steps:
        mask = direction > step
        if current is None or following is None:
            unreachable = mask.copy() if unreachable is None else unreachable ^ mask
        change = (following or 0) - (current or 0)
        current = following
        if change:
            turns += mask * (change * math.pi)
        if change % 2:
            signs *= 1.0 - 2.0 * mask
    return turns, signs, unreachable
