"""Consistency of the covariances of twist and pose: NEES by the kind of the wheel errors.

NEES is the squared error in units of the covariance, e' P^-1 e.  Its mean over many runs, divided
by the three components, is 1 if the covariance is right.  The error of a pose is the logarithm of
the true pose relative to the estimated pose.

Every measurement of a wheel has the errors that the noise model states: a rolling speed and a
direction per wheel, whose standard deviation is 1 % and 0.5 deg of the speed, and a floor.  Fixed
wheels have no steering encoder; the error of their direction moves the robot sideways.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench.figure import Figure
from bench.odometry import DT, paper_drive
from bench.wheel_noise import ROBOTS, Array, estimate_all, geometry_of, velocity
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.base_geometry import FixedWheels, WheelGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import ORIGIN, Pose2, Twist

GROUP = "long"

RUNS = 200
STRIDE = 2
"""The study uses every second tick of the drive: 25 joint states per second."""
LASTING = 2.0
"""Time constant (s) of errors that last some seconds."""
BIASED = "wrong radii and zeros"
KINDS = {
    "white": Noise(correlation=0.0, radius_error=0.0, steering_offset_error=0.0),
    "lasting 2 s": Noise(correlation=LASTING, radius_error=0.0, steering_offset_error=0.0),
    BIASED: Noise(correlation=0.0, radius_error=0.008, steering_offset_error=math.radians(0.4)),
}
"""The settings that describe each kind of errors."""
SHARES = {"white": (1.0, 0.0, 0.0), "lasting 2 s": (0.0, 1.0, 0.0), BIASED: (0.6, 0.0, 0.8)}
"""Shares of the standard deviations, 1 % and 0.5 deg, that are white, last ``LASTING`` s, and last
for the whole drive, by the kind of errors."""
SECONDS = {"2WD": 16.0}
"""Duration of the drive.  Two wheels that are 1 % wrong turn the robot by 80 deg in 77 s."""
NOISE = Noise()
"""Standard deviations of all errors, 1 % and 0.5 deg."""
MOVING = 0.2
"""Speed (m/s) from which the error of a twist counts."""


class Result(NamedTuple):
    """Mean of NEES/3 over all runs with its standard error, for the twist and for the pose.

    ``distance``, ``sigma``: root mean squares of the end error and of its standard deviation, m.
    """

    twist: float
    twist_error: float
    pose: float
    pose_error: float
    distance: float
    sigma: float


def figures() -> Iterator[Figure]:
    for robot in ROBOTS:
        seconds = SECONDS.get(robot, 77.0)
        for kind, noise in KINDS.items():
            matching, default = study(robot, kind, [noise, Noise()], seconds)
            how = f"{RUNS} runs of {seconds:g} s; end error {matching.distance:.2f} m, "
            for name, value, error in (
                ("twist", matching.twist, matching.twist_error),
                ("pose", matching.pose, matching.pose_error),
            ):
                text = f"{how}standard deviation {matching.sigma:.2f} m; +-{error:.2f}"
                yield Figure(f"{name} NEES/3, {robot}, {kind}", value, "", 1.2, "lower", text)
                yield Figure(
                    f"{name} NEES/3 at least, {robot}, {kind}", value, "", 0.8, "higher", text
                )
            text = f"{how}standard deviation {default.sigma:.2f} m; +-{default.pose_error:.2f}"
            yield Figure(
                f"pose NEES/3 by default, {robot}, {kind}", default.pose, "", 1.2, "lower", text
            )


def study(robot: str, kind: str, settings: list[Noise], seconds: float) -> list[Result]:
    """Returns the results of runs with errors of a kind, for each setting of the noise."""
    geometry, dt = geometry_of(robot), DT * STRIDE
    rng = np.random.default_rng(7)
    nominal = paper_drive()[:, : round(seconds / dt) * STRIDE : STRIDE].T
    twists, speeds, angles = noisy_runs(geometry, SHARES[kind], nominal, dt, RUNS, rng)
    means = (twists[1:] + twists[:-1]) / 2.0
    ends = [_end(run, dt) for run in means.transpose(2, 0, 1).tolist()]
    positions = np.zeros_like(speeds)
    positions[1:] = np.cumsum((speeds[1:] + speeds[:-1]) / 2.0 * dt, axis=0)
    still = [0.0] * len(geometry.wheels)
    calculators = [[General(geometry, None, noise) for _ in ends] for noise in settings]
    odometries = [[Odometry(c, (1.5, 1.0)) for c in group] for group in calculators]
    for k, states in enumerate(zip(speeds, angles, positions, strict=True)):
        joints = [
            JointStates(k * dt, speed, angle, still, position)
            for speed, angle, position in zip(*(s.T.tolist() for s in states), strict=True)
        ]
        for group in odometries:
            for odometry, joint_states in zip(group, joints, strict=True):
                odometry.update(joint_states, k * dt)
    results = []
    for noise, group in zip(settings, odometries, strict=True):
        errors = [logarithm(end.relative_to(o.pose)) for end, o in zip(ends, group, strict=True)]
        poses = np.array([_nees(e, o.covariance) for e, o in zip(errors, group, strict=True)])
        squares = [e[0] ** 2 + e[1] ** 2 for e in errors]
        variances = [o.covariance[0][0] + o.covariance[1][1] for o in group]
        per_run = _twist_nees(geometry, noise, twists, speeds, angles)
        results.append(
            Result(
                float(per_run.mean()),
                float(per_run.std()) / math.sqrt(RUNS),
                float(poses.mean()),
                float(poses.std()) / math.sqrt(RUNS),
                math.sqrt(sum(squares) / RUNS),
                math.sqrt(sum(variances) / RUNS),
            )
        )
    return results


def noisy_runs(
    geometry: BaseGeometry,
    shares: tuple[float, float, float],
    nominal: Array,
    dt: float,
    runs: int,
    rng: np.random.Generator,
    noise: Noise = NOISE,
) -> tuple[Array, Array, Array]:
    """Returns true twists (n, 3, runs), and wheel speeds and steering angles (n, wheels, runs).

    - ``shares``: shares of the errors, as in ``SHARES``.
    - ``nominal``: commanded twists (n, 3), one every ``dt`` s.
    - ``noise``: standard deviations of all errors.
    """
    wheels, n = geometry.wheels, len(nominal)
    fixed = FixedWheels(wheels)
    drive = np.array([fixed.feasible(Twist(*twist)) for twist in nominal.tolist()])
    twists = np.repeat(drive[:, :, np.newaxis], runs, axis=2)
    rolling, direction = (_Errors(shares, (n, len(wheels), runs), dt, rng) for _ in range(2))
    if fixed.rows:  # fixed wheels on one axle slip sideways together
        slip, information = np.zeros((2, n, runs))
        for i, w in enumerate(wheels):
            if w.fixed:
                roll = _rolling(w, twists)
                weight = 1.0 / ((noise.angle * roll) ** 2 + noise.slip_floor**2)
                slip += weight * direction.of(i, noise.angle * roll, noise.slip_floor)
                information += weight
        twists[:, :2] += np.multiply.outer(fixed.rows[0][:2], slip / information).swapaxes(0, 1)
    speeds, angles = np.zeros((2, n, len(wheels), runs))
    for i, w in enumerate(wheels):
        if w.swivel:
            continue
        roll = _rolling(w, twists)
        if w.steered:
            ux, uy = velocity(w.x, w.y, twists.swapaxes(0, 1))
            roll = np.hypot(ux, uy)
            angles[:, i] = w.sign * (np.unwrap(np.arctan2(uy, ux), axis=0) - w.heading)
            slip = direction.of(i, noise.angle * roll, noise.slip_floor)
            angles[:, i] += slip / np.maximum(roll, 0.05)
        if w.encoder:
            error = rolling.of(i, noise.speed_ratio * roll, noise.speed_floor)
            speeds[:, i] = (roll + error) / w.radius
    return twists, speeds, angles


def _rolling(wheel: WheelGeometry, twists: Array) -> Array:
    ux, uy = velocity(wheel.x, wheel.y, twists.swapaxes(0, 1))
    rolling: Array = math.cos(wheel.heading) * ux + math.sin(wheel.heading) * uy
    return rolling


class _Errors:
    """Errors of one measurement of all wheels, with the standard deviation 1: (n, wheels, runs)."""

    def __init__(
        self,
        shares: tuple[float, float, float],
        shape: tuple[int, int, int],
        dt: float,
        rng: np.random.Generator,
    ) -> None:
        white, lasting, drive = shares
        self._ratio, self._floor = rng.standard_normal(shape), rng.standard_normal(shape)
        if lasting and not white:  # the floor lasts too
            _make_lasting(self._ratio, dt)
            _make_lasting(self._floor, dt)
            self._ratio *= lasting
        else:
            self._ratio *= white
            if lasting:
                errors = rng.standard_normal(shape)
                _make_lasting(errors, dt)
                self._ratio += lasting * errors
        if drive:
            self._ratio += drive * rng.standard_normal(shape[1:])

    def of(self, wheel: int, ratio: Array, floor: float) -> Array:
        """Returns the errors (m/s) of a wheel, for the standard deviations ratio and floor."""
        errors: Array = ratio * self._ratio[:, wheel] + floor * self._floor[:, wheel]
        return errors


def _make_lasting(errors: Array, dt: float) -> None:
    """Gives white errors (n, ...) the time constant ``LASTING``."""
    left = math.exp(-dt / LASTING)
    errors[1:] *= math.sqrt(1.0 - left * left)
    for k in range(1, len(errors)):
        errors[k] += left * errors[k - 1]


def _twist_nees(
    geometry: BaseGeometry, noise: Noise, true: Array, speeds: Array, angles: Array
) -> Array:
    """Returns the mean of NEES/3 of the twists of each run."""
    n, _, runs = true.shape
    columns = [a.swapaxes(0, 1).reshape(a.shape[1], n * runs) for a in (true, speeds, angles)]
    twists, covariances, _ = estimate_all(General(geometry, None, noise), *columns[1:])
    moving = np.hypot(*columns[0][:2]) > MOVING
    errors = (columns[0] - twists).T[moving]
    solved = np.linalg.solve(covariances[moving], errors[:, :, np.newaxis])[:, :, 0]
    nees = np.einsum("ni,ni->n", errors, solved) / 3.0
    run = np.tile(np.arange(runs), n)[moving]
    means: Array = np.bincount(run, nees, runs) / np.bincount(run, minlength=runs)
    return means


def _nees(error: Array, covariance: se2.Cov3) -> float:
    return float(error @ np.linalg.solve(np.array(covariance), error)) / 3.0


def logarithm(pose: Pose2) -> Array:
    """Returns the twist that moves a robot from the origin to ``pose`` in 1 s."""
    half = pose.yaw / 2.0
    k = half / math.tan(half) if half else 1.0
    return np.array([k * pose.x + half * pose.y, k * pose.y - half * pose.x, pose.yaw])


def _end(twists: list[list[float]], dt: float) -> Pose2:
    pose = ORIGIN
    for twist in twists:
        pose = pose.moved(se2.exp(Twist(*twist), dt))
    return pose
