"""Random motions of robots and their noisy joint states, over arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.figure import ROOT
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseGeometry, Noise
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
"""Least speed (m/s) of every wheel; a standing wheel can neither slip nor stall."""


def geometry_of(name: str) -> BaseGeometry:
    """Returns the wheels of an example."""
    compilation = compile_file(ROOT / "examples" / ROBOTS[name] / "robot.yaml")
    if not isinstance(compilation.model, Robot):
        raise RuntimeError(f"the example {ROBOTS[name]} does not compile to a robot")
    return BaseGeometry.from_robot(compilation.model)


@dataclass(frozen=True)
class Drive:
    """True twists (3, n), and joint states (wheels, n) in rad/s and rad.

    ``information`` (n, 3, 3): Fisher information; its inverse is the Cramer-Rao bound.
    """

    twists: Array
    speeds: Array
    angles: Array
    information: Array

    def efficiency(self, estimates: Array) -> float:
        """Returns sqrt(NEES / 3) relative to the Cramer-Rao bound: 1 is optimal."""
        errors = (estimates - self.twists).T
        nees = np.einsum("ni,nij,nj->n", errors, self.information, errors)
        return math.sqrt(float(nees.mean()) / 3.0)


def estimate_all(
    calculator: BaseCalculator, speeds: Array, angles: Array
) -> tuple[Array, Array, dict[int, tuple[int, ...]]]:
    """Estimates the twists of joint states (wheels, n) in rad/s and rad.

    Returns the twists (3, n), their covariances (n, 3, 3), and the indices of the wheels that were
    left out, for each state with such wheels.
    """
    n = speeds.shape[1]
    still = [0.0] * len(speeds)
    twists, covariances = np.empty((n, 3)), np.empty((n, 3, 3))
    dropped: dict[int, tuple[int, ...]] = {}
    joints = zip(speeds.T.tolist(), angles.T.tolist(), strict=True)
    for k, (speed, angle) in enumerate(joints):
        estimate = calculator.odometry(JointStates(0.0, speed, angle, still))
        twists[k], covariances[k] = estimate.twist, estimate.covariance
        if estimate.dropped:
            dropped[k] = estimate.dropped
    return twists.T, covariances, dropped


def random_twists(geometry: BaseGeometry, n: int, rng: np.random.Generator) -> Array:
    """Returns random feasible twists up to 1 m/s and 1 rad/s.

    Every wheel moves, and no wheel exceeds the speed of its motor.
    """
    fixed = FixedWheels(geometry.wheels)
    feasible = np.array([fixed.feasible(Twist(*unit)) for unit in np.eye(3)]).T
    twists = np.empty((3, 0))
    while twists.shape[1] < n:
        candidates = feasible @ rng.uniform(-1.0, 1.0, (3, 2 * n))
        valid = np.full(candidates.shape[1], True)
        for w in geometry.wheels:
            moving = np.hypot(*velocity(w.x, w.y, candidates))
            valid &= (moving >= SLOWEST) & (moving <= w.max_speed * w.radius)
        twists = np.concatenate([twists, candidates[:, valid]], axis=1)
    return twists[:, :n]


def velocity(x: float, y: float, twists: Array) -> tuple[Array, Array]:
    return twists[0] - twists[2] * y, twists[1] + twists[2] * x


def drive(
    geometry: BaseGeometry,
    twists: Array,
    noise: Noise,
    rng: np.random.Generator,
    errors: Array | None = None,
) -> Drive:
    """Returns joint states for these twists, with errors of ``noise``.

    A steered wheel points along the motion, forward or reversed; its speed and its direction are
    measured with errors.  Fixed wheels slip sideways by the noise of their direction, which
    changes the twists.  ``errors``: standard normal, (2, wheels, n), along and across.
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
    """Returns the information (n, 3, 3) of a row with this variance."""
    full = np.array([np.broadcast_to(v, variance.shape) for v in row])
    information: Array = np.einsum("in,jn,n->nij", full, full, 1.0 / variance)
    return information


def _slipped(
    geometry: BaseGeometry, twists: Array, noise: Noise, rng: np.random.Generator
) -> Array:
    """Adds the common side slip of all fixed wheels to the twists."""
    rows = FixedWheels(geometry.wheels).rows
    if not rows:
        return twists
    axle_information = np.zeros(twists.shape[1])
    for w in geometry.wheels:
        if w.fixed:
            moving = np.hypot(*velocity(w.x, w.y, twists))
            axle_information += 1.0 / ((noise.angle * moving) ** 2 + noise.slip_floor**2)
    slip = rng.standard_normal(twists.shape[1]) / np.sqrt(axle_information)
    slipped = twists.copy()
    slipped[0] += rows[0][0] * slip
    slipped[1] += rows[0][1] * slip
    return slipped
