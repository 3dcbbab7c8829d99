"""Consistency of the covariances of twist and pose: NEES by the kind of the wheel errors.

NEES is the squared error in units of the covariance, e' P^-1 e.  Its mean over many runs, divided
by the three components, is 1 if the covariance is right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bench.figure import Figure
from bench.odometry import DT, paper_drive
from bench.wheel_noise import ROBOTS, Array, geometry_of, velocity
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import ORIGIN, Pose2, Twist
from thorvaldc.simulation.vectorised.calculator_batch import CalculatorBatch

RUNS = 60
LASTING = 2.0
"""Time constant (s) of lasting errors."""
BIASED = "wrong radii and zeros"
KINDS = {
    "white": Noise(radius_error=0.0, steering_offset_error=0.0),
    "lasting 2 s": Noise(correlation=LASTING, radius_error=0.0, steering_offset_error=0.0),
    BIASED: Noise(radius_error=0.008, steering_offset_error=math.radians(0.4)),
}
"""The errors of a wheel are 1 % and 0.5 deg in every tick.

Of wrong radii and zeros, 0.8 % and 0.4 deg last, and 0.6 % and 0.3 deg are random.
"""
SECONDS = {"2WD": 16.0}
"""Duration of the drive.  Two wheels that are 1 % wrong turn the robot by 80 deg in 77 s."""


def figures() -> Iterator[Figure]:
    for robot in ROBOTS:
        geometry = geometry_of(robot)
        for kind, noise in KINDS.items():
            seconds = SECONDS.get(robot, 77.0)
            ticks = round(seconds / DT)
            twist, pose, distance, sigma = _nees(geometry, kind, noise, ticks)
            how = (
                f"{RUNS} runs of {seconds:g} s, 1 % and 0.5 deg; end error {distance:.2f} m,"
                f" standard deviation {sigma:.2f} m"
            )
            for name, value in (("twist", twist), ("pose", pose)):
                yield Figure(f"{name} NEES/3, {robot}, {kind}", value, "", 1.2, "lower", how)
                yield Figure(
                    f"{name} NEES/3 at least, {robot}, {kind}", value, "", 0.8, "higher", how
                )


def _nees(
    geometry: BaseGeometry, kind: str, noise: Noise, ticks: int
) -> tuple[float, float, float, float]:
    """Returns NEES/3 of twist and pose, and the root mean squares of error and deviation (m)."""
    rng = np.random.default_rng(7)
    fixed = FixedWheels(geometry.wheels)
    twists = np.array([fixed.feasible(Twist(*t)) for t in paper_drive()[:, :ticks].T.tolist()]).T
    totals = np.zeros(4)
    for _ in range(RUNS):
        true, speeds, angles = _run(geometry, fixed, twists, kind, rng)
        totals[0] += _twist_nees(geometry, noise, true, speeds, angles)
        odometry = Odometry(General(geometry, None, noise), (1.5, 1.0))
        still = [0.0] * len(geometry.wheels)
        joints = zip(speeds.T.tolist(), angles.T.tolist(), strict=True)
        for k, (wheel_speeds, steering) in enumerate(joints):
            odometry.update(JointStates(k * DT, wheel_speeds, steering, still), k * DT)
        error = np.array(_end(true).relative_to(odometry.pose))
        covariance = np.array(odometry.covariance)
        totals[1] += float(error @ np.linalg.solve(covariance, error)) / 3.0
        totals[2] += error[0] ** 2 + error[1] ** 2
        totals[3] += covariance[0, 0] + covariance[1, 1]
    twist, pose, square, variance = totals / RUNS
    return twist, pose, math.sqrt(square), math.sqrt(variance)


def _run(
    geometry: BaseGeometry, fixed: FixedWheels, twists: Array, kind: str, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Returns true twists, wheel speeds and steering angles of a drive with errors of a kind."""
    wheels, n = geometry.wheels, twists.shape[1]
    noise = Noise()
    if fixed.rows and kind != BIASED:  # all fixed wheels slip sideways together
        slip = _errors(kind, 1, n, rng)[0]
        information = np.zeros(n)
        for w in wheels:
            if w.fixed:
                moving = np.hypot(*velocity(w.x, w.y, twists))
                information += 1.0 / ((noise.angle * moving) ** 2 + noise.slip_floor**2)
        twists = twists.copy()
        twists[:2] += np.outer(fixed.rows[0][:2], slip / np.sqrt(information))
    rolling, direction = _errors(kind, len(wheels), n, rng), _errors(kind, len(wheels), n, rng)
    speeds, angles = np.zeros((2, len(wheels), n))
    for i, w in enumerate(wheels):
        if w.swivel:
            continue
        ux, uy = velocity(w.x, w.y, twists)
        rolls = math.cos(w.heading) * ux + math.sin(w.heading) * uy
        if w.steered:
            rolls = np.hypot(ux, uy)
            angles[i] = w.sign * (np.unwrap(np.arctan2(uy, ux)) - w.heading)
            angles[i] += direction[i] * noise.angle
        if w.encoder:
            speeds[i] = rolls * (1.0 + noise.speed_ratio * rolling[i]) / w.radius
    return twists, speeds, angles


def _errors(kind: str, wheels: int, n: int, rng: np.random.Generator) -> Array:
    """Returns errors (wheels, n) with the standard deviation 1."""
    errors = rng.standard_normal((wheels, n))
    if kind == BIASED:
        return 0.8 * rng.standard_normal((wheels, 1)) + 0.6 * errors
    if kind != "white":
        left = math.exp(-DT / LASTING)
        errors[:, 1:] *= math.sqrt(1.0 - left * left)
        for k in range(1, n):
            errors[:, k] += left * errors[:, k - 1]
    return errors


def _twist_nees(
    geometry: BaseGeometry, noise: Noise, true: Array, speeds: Array, angles: Array
) -> float:
    twists, upper = np.empty_like(true), np.empty((6, true.shape[1]))
    CalculatorBatch(General(geometry, None, noise)).estimate(speeds, angles, twists, upper)
    moving = np.hypot(true[0], true[1]) > 0.2
    covariances = upper[[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)[moving]
    errors = (true - twists).T[moving]
    solved = np.linalg.solve(covariances, errors[:, :, np.newaxis])[:, :, 0]
    return float(np.einsum("ni,ni->n", errors, solved).mean()) / 3.0


def _end(twists: Array) -> Pose2:
    """Returns the end of a drive whose twist changes linearly between two ticks."""
    pose = ORIGIN
    means = (twists[:, 1:] + twists[:, :-1]) / 2.0
    for vx, vy, wz in means.T.tolist():
        pose = pose.moved(se2.exp(Twist(vx, vy, wz), DT))
    return pose
