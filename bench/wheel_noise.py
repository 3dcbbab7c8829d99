"""Motions of robots and what their joints would tell of them, with errors; over arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.figure import ROOT
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.se2 import Twist

Array = NDArray[np.float64]

ROBOTS = {
    "4WD4WS": "4wd4ws_wide",
    "6WD6WS asymmetric": "6wd6ws_asymmetric",
    "9WD9WS": "9wd9ws",
    "4WD2WS": "4wd2ws_tall",
    "2WD": "2wd0ws_greenhouse",
}
SLOWEST = 0.1
"""Speed (m/s) that every wheel has at least: one that stands neither slips nor stalls."""


def geometry_of(name: str) -> BaseGeometry:
    """The wheels of an example."""
    done = compile_file(ROOT / "examples" / ROBOTS[name] / "robot.yaml")
    if not isinstance(done.model, Robot):
        raise RuntimeError(f"the example {ROBOTS[name]} is no robot without faults")
    return BaseGeometry.from_robot(done.model)


@dataclass(frozen=True)
class Drive:
    """True twists (3, n), and the joints (wheels, n) that tell of them: rad/s and rad.

    ``information`` (n, 3, 3) is Fisher's: its inverse is the Cramer-Rao bound.
    """

    twists: Array
    speeds: Array
    angles: Array
    information: Array

    def efficiency(self, estimates: Array) -> float:
        """sqrt(NEES / 3) against the Cramer-Rao bound: 1 is the best that there is."""
        errors = (estimates - self.twists).T
        nees = np.einsum("ni,nij,nj->n", errors, self.information, errors)
        return math.sqrt(float(nees.mean()) / 3.0)


def random_twists(geometry: BaseGeometry, n: int, rng: np.random.Generator) -> Array:
    """Up to 1 m/s and 1 rad/s in all directions that the robot can drive.

    Every wheel moves, none faster than its motor can.
    """
    fixed = FixedWheels(geometry.wheels)
    allowed = np.array([fixed.feasible(Twist(*unit)) for unit in np.eye(3)]).T
    found = np.empty((3, 0))
    while found.shape[1] < n:
        some = allowed @ rng.uniform(-1.0, 1.0, (3, 2 * n))
        fine = np.full(some.shape[1], True)
        for w in geometry.wheels:
            moving = np.hypot(*velocity(w.x, w.y, some))
            fine &= (moving >= SLOWEST) & (moving <= w.max_speed * w.radius)
        found = np.concatenate([found, some[:, fine]], axis=1)
    return found[:, :n]


def velocity(x: float, y: float, twists: Array) -> tuple[Array, Array]:
    return twists[0] - twists[2] * y, twists[1] + twists[2] * x


def drive(
    geometry: BaseGeometry,
    twists: Array,
    noise: Noise,
    rng: np.random.Generator,
    errors: Array | None = None,
) -> Drive:
    """Joints for these twists, with errors of ``noise``.

    A steered wheel is where the motion asks it to be, forward or reversed; its speed
    and its direction are measured with errors.  A wheel that does not turn slips sideways
    by what the noise says for its direction: the twists are changed by that.
    ``errors``: standard normal, (2, wheels, n), along and across.
    """
    n, wheels = twists.shape[1], geometry.wheels
    if errors is None:
        errors = rng.standard_normal((2, len(wheels), n))
    twists = _slipped(geometry, twists, noise, rng)
    speeds, angles = np.zeros((2, len(wheels), n))
    information = np.zeros((n, 3, 3))
    for i, w in enumerate(wheels):
        if w.swivel:
            continue
        ux, uy = velocity(w.x, w.y, twists)
        moving = np.hypot(ux, uy)
        v_l = (noise.speed_ratio * moving) ** 2 + noise.speed_floor**2
        v_t = (noise.angle * moving) ** 2 + noise.slip_floor**2
        c, s = np.cos(w.heading), np.sin(w.heading)
        rolling = c * ux + s * uy
        if w.steered:
            c, s = ux / moving, uy / moving
            flip = rng.integers(0, 2, n)
            rolling = moving * (1.0 - 2.0 * flip)
            direction = np.arctan2(uy, ux) + math.pi * flip
            direction += errors[1, i] * np.sqrt(v_t) / moving
            angles[i] = w.sign * (direction - w.heading)
        if w.encoder:
            speeds[i] = (rolling + errors[0, i] * np.sign(rolling) * np.sqrt(v_l)) / w.radius
            information += _outer((c, s, s * w.x - c * w.y), v_l)
        information += _outer((-s, c, c * w.x + s * w.y), v_t)
    return Drive(twists, speeds, angles, information)


def _outer(row: tuple[Array | float, ...], variance: Array) -> Array:
    """What a row with an error of this variance tells, (n, 3, 3)."""
    full = np.array([np.broadcast_to(v, variance.shape) for v in row])
    told: Array = np.einsum("in,jn,n->nij", full, full, 1.0 / variance)
    return told


def _slipped(
    geometry: BaseGeometry, twists: Array, noise: Noise, rng: np.random.Generator
) -> Array:
    """What wheels that do not turn say of side slip, all of them together, comes true."""
    rows = FixedWheels(geometry.wheels).rows
    if not rows:
        return twists
    certainty = np.zeros(twists.shape[1])
    for w in geometry.wheels:
        if w.fixed:
            moving = np.hypot(*velocity(w.x, w.y, twists))
            certainty += 1.0 / ((noise.angle * moving) ** 2 + noise.slip_floor**2)
    slip = rng.standard_normal(twists.shape[1]) / np.sqrt(certainty)
    slipped = twists.copy()
    slipped[0] += rows[0][0] * slip
    slipped[1] += rows[0][1] * slip
    return slipped
