"""Consistency of a filter that fuses the published odometry, with the equations of
robot_localization.

The filter is the EKF of the package robot_localization (``Ekf::predict`` and ``Ekf::correct`` of
the version 3.6) in ``two_d_mode``: 15 states, of which height, roll, pitch, their velocities and
the vertical acceleration are measured as 0 in each message.  At roll = pitch = 0 their rows of the
transfer function have no entries for the other states, so that x, y, yaw, their velocities and the
accelerations along x and y are a filter of their own.  NEES/3 is that of x, y and yaw after 60 s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bench.consistency import KINDS, LASTING, NOISE, SHARES, noisy_runs
from bench.figure import ROOT, Figure
from bench.wheel_noise import ROBOTS, Array, estimate_all
from thorvaldc.backends.ros2_parameters import process_noise
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.model.settings import FOR_FILTERS, MEASURED
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import CheckedJointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.filter_covariance import filter_covariance
from thorvaldc.runtime.se2 import ORIGIN, Twist

GROUP = "long"

SECONDS, RUNS = 60.0, 200
SPEED = 0.4
"""Speed (m/s) of the drives.

An EKF is linear in the yaw error.  Radii that are 1 % wrong turn the robot by 0.005 rad per metre:
after 60 m, the error of x by the cosine of the yaw error is larger than the linear one.  The drive
``FAST`` shows it.
"""
_THIRD = math.sqrt(1.0 / 3.0)
MIXED, DRIVE = "mixed", "drive"
CASES: dict[str, tuple[tuple[float, float, float], Noise]] = {
    **{kind: (SHARES[kind], noise) for kind, noise in KINDS.items()},
    DRIVE: ((0.0, 0.0, 1.0), Noise(correlation=0.0)),
    MIXED: (
        (_THIRD, _THIRD, _THIRD),
        Noise(
            correlation=LASTING / 2.0,
            radius_error=_THIRD * NOISE.speed_ratio,
            steering_offset_error=_THIRD * NOISE.angle,
        ),
    ),
}
"""Shares of the errors, and the settings that describe them, by the kind of the errors.

A third of the mixed variance lasts for ``LASTING`` s: the sum of the autocorrelation of what does
not last for the drive, two thirds, is that of half of this time.
"""
SIX = (*ROBOTS, "1WD1WS")
CALIBRATED = {"2WD": 0.1, "1WD1WS": 0.2}
"""Errors of the robots whose odometry turns by more than 0.1 rad in a drive with errors of 1 % and
0.5 deg, as a share of these: an EKF is linear in the yaw error, see ``FAST``."""
EULER = {("4WD2WS", "curves"), ("1WD1WS", "curves"), ("9WD9WS", "circles")}
"""Drives in which white errors are smaller than those of the filter's steps, whose yaw is late by
half a period in turns: 5 mm to 3 cm."""
SHORT = 20.0
"""Duration (s) of a short drive."""
BOUNDED, FAST = ("straight", "circles", "curves"), "straight, 1 m/s"
DRIVES: dict[str, Callable[[float], tuple[float, float, float]]] = {
    "straight": lambda t: (SPEED, 0.0, 0.0),
    FAST: lambda t: (1.0, 0.0, 0.0),
    "circles": lambda t: (SPEED, 0.0, SPEED / 2.0),
    "curves": lambda t: (SPEED, 0.1 * math.cos(0.7 * t), 0.3 * math.sin(0.4 * t)),
}
"""Twist at a time (s); circles have a radius of 2 m."""
DEFAULT_PROCESS_NOISE = [
    *(0.05, 0.05, 0.06, 0.03, 0.03, 0.06, 0.025, 0.025, 0.04, 0.01, 0.01, 0.02),
    *(0.01, 0.01, 0.015),
]
"""Process noise of robot_localization if the parameter is missing: diagonal of 15 states."""
_KEPT = [0, 1, 5, 6, 7, 11, 12, 13]
"""Indices of the states of the planar filter among the 15 states."""
YAW, YAW_RATE = 2, 5
"""Indices of the yaw and its rate among the planar states."""


class PlanarEkf:
    """The planar states of the EKF of robot_localization, for many runs at once.

    - ``state``: (runs, 8): x, y, yaw, vx, vy, yaw rate, ax, ay.
    - ``covariance``: (runs, 8, 8).
    - ``process_noise``: growth of the variances of the 15 states per second.
    """

    def __init__(self, runs: int, process_noise: list[float]) -> None:
        self.state = np.zeros((runs, 8))
        self.covariance = np.tile(1e-9 * np.eye(8), (runs, 1, 1))
        self._process_noise = np.diag([process_noise[k] for k in _KEPT])
        self._started = False

    def measure(self, twists: Array, covariances: Array, dt: float) -> None:
        """Fuses twists (runs, 3) with covariances (1, 3, 3), ``dt`` s after the last ones."""
        if not self._started:  # the first measurement is the state
            self._started = True
            self.state[:, 3:6] = twists
            self.covariance[:, 3:6, 3:6] = covariances
            return
        self.predict(dt)
        self.correct([3, 4, 5], twists, covariances)

    def correct(self, states: list[int], values: Array, covariances: Array) -> None:
        """Fuses values (runs, n) of some states with covariances (runs or 1, n, n)."""
        p = self.covariance
        gain = p[:, :, states] @ np.linalg.inv(p[:, states][:, :, states] + covariances)
        differences = values - self.state[:, states]
        if YAW in states:
            differences[:, states.index(YAW)] = wrapped(differences[:, states.index(YAW)])
        self.state += (gain @ differences[:, :, np.newaxis])[:, :, 0]
        rest = np.tile(np.eye(8), (len(p), 1, 1))
        rest[:, :, states] -= gain
        self.covariance = _of(rest, p) + _of(gain, covariances)

    def nees(self, poses: Array) -> Array:
        """Returns NEES/3 (runs) for true poses (runs, 3)."""
        errors = poses - self.state[:, :3]
        errors[:, 2] = wrapped(errors[:, 2])
        solved = np.linalg.solve(self.covariance[:, :3, :3], errors[:, :, np.newaxis])[:, :, 0]
        result: Array = np.einsum("ni,ni->n", errors, solved) / 3.0
        return result

    def predict(self, dt: float) -> None:
        _, _, yaw, vx, vy, _, ax, ay = self.state.T
        c, s = np.cos(yaw), np.sin(yaw)
        f = np.tile(np.eye(8), (len(yaw), 1, 1))
        f[:, 0, 3], f[:, 0, 4] = c * dt, -s * dt
        f[:, 1, 3], f[:, 1, 4] = s * dt, c * dt
        f[:, :2, 6:8] = 0.5 * dt * f[:, :2, 3:5]
        f[:, 2, 5] = f[:, 3, 6] = f[:, 4, 7] = dt
        jacobian = f.copy()
        dx, dy = vx * dt + 0.5 * ax * dt * dt, vy * dt + 0.5 * ay * dt * dt
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -s * dx - c * dy, c * dx - s * dy
        self.state = (f @ self.state[:, :, np.newaxis])[:, :, 0]
        self.covariance = _of(jacobian, self.covariance) + dt * self._process_noise


def wrapped(angles: Array) -> Array:
    """Returns angles (rad) in -pi..pi."""
    return (angles + math.pi) % (2.0 * math.pi) - math.pi


def _of(matrices: Array, covariances: Array) -> Array:
    product: Array = matrices @ covariances @ matrices.swapaxes(1, 2)
    return product


class Result(NamedTuple):
    """NEES/3 of x, y and yaw at the end, and root mean squares of the end error and of its standard
    deviation by the filter, m.

    ``default``: NEES/3 with the default settings of the noise.
    """

    nees: float
    distance: float
    sigma: float
    default: float


def commanded(drive: str, seconds: float, rate: float) -> Array:
    """Returns the twists (n, 3) of a drive, which starts and ends at rest."""
    times = np.arange(round(seconds * rate) + 1) / rate
    ramp = np.clip(np.minimum(times, seconds - 1.0 - times), 0.0, 1.0)
    return ramp[:, np.newaxis] * np.array([DRIVES[drive](t) for t in times.tolist()])


def study(
    robot: Robot,
    drive: str,
    kind: str,
    covariance: str = FOR_FILTERS,
    growth: list[float] | None = None,
    rate: float | None = None,
    runs: int = RUNS,
    seconds: float = SECONDS,
    share: float = 1.0,
) -> Result:
    """Returns the result of a filter after drives with errors of a kind.

    All runs have the covariances of the first one, which depend little on the errors.

    - ``covariance``: parameter `twist_covariance` of the node.
    - ``growth``: process noise of the 15 states; by default that of the generated files.
    - ``rate``: twists per second; by default the rate of the driver.
    - ``seconds``: duration of the drive.
    - ``share``: share of all errors and settings.
    """
    shares, noise = CASES[kind]
    settings = [scaled(noise, share), scaled(Noise(), share)]
    rate = rate or robot.driver.rate
    geometry, dt = BaseGeometry.from_robot(robot), 1.0 / rate
    rng = np.random.default_rng(1)
    nominal = commanded(drive, seconds, rate)
    true, speeds, angles = noisy_runs(geometry, shares, nominal, dt, runs, rng, settings[0])
    # Both settings have the same errors of one tick, and thus the same twists.
    calculators = [General(geometry, None, noise) for noise in settings]
    growth = process_noise(robot) if growth is None else growth
    ekf, default = (PlanarEkf(runs, growth) for _ in calculators)
    still = [0.0] * len(geometry.wheels)
    for k, twists in enumerate(_estimates(calculators[0], speeds, angles)):
        first = speeds[k, :, 0].tolist(), angles[k, :, 0].tolist()
        joints = CheckedJointStates(k * dt, *first, still)
        estimate = calculators[0].estimator.estimate(joints)
        for calculator, each in zip(calculators, (ekf, default), strict=True):
            published = estimate.covariance
            if covariance == FOR_FILTERS:
                estimator = calculator.estimator
                published = filter_covariance(estimator, joints, estimate, dt, k * dt)
            each.measure(twists, np.array([published]), dt)
    means = ((true[1:] + true[:-1]) / 2.0).transpose(2, 0, 1).tolist()
    ends = np.array([_end(run, dt) for run in means])
    pose = ekf.covariance
    return Result(
        float(ekf.nees(ends).mean()),
        math.sqrt(float(((ends - ekf.state[:, :3])[:, :2] ** 2).sum(1).mean())),
        math.sqrt(float((pose[:, 0, 0] + pose[:, 1, 1]).mean())),
        float(default.nees(ends).mean()),
    )


def _estimates(calculator: General, speeds: Array, angles: Array) -> Array:
    """Returns the estimated twists (n, runs, 3) of joint states (n, wheels, runs)."""
    n, wheels, runs = speeds.shape
    columns = [a.swapaxes(0, 1).reshape(wheels, n * runs) for a in (speeds, angles)]
    twists, _, _ = estimate_all(calculator, *columns)
    return twists.T.reshape(n, runs, 3)


def _end(twists: list[list[float]], dt: float) -> se2.Pose2:
    pose = ORIGIN
    for twist in twists:
        pose = pose.moved(se2.exp(Twist(*twist), dt))
    return pose


def scaled(noise: Noise, share: float) -> Noise:
    """Returns settings that describe a share of the errors."""
    radius, _, offset = noise.lasting_errors
    return replace(
        noise,
        speed_ratio=share * noise.speed_ratio,
        angle=share * noise.angle,
        speed_floor=share * noise.speed_floor,
        slip_floor=share * noise.slip_floor,
        radius_error=share * radius,
        steering_offset_error=share * offset,
    )


def robot_of(name: str) -> Robot:
    """Returns an example."""
    example = ROBOTS.get(name, "1wd1ws_front")
    model = compile_file(ROOT / "examples" / example / "robot.yaml").model
    if not isinstance(model, Robot):
        raise SystemExit(f"the example {example} does not compile to a robot")
    return model


def figures() -> Iterator[Figure]:
    for name in SIX:
        robot = robot_of(name)
        for kind in (DRIVE, "lasting 2 s", MIXED, "white"):
            rate, share = 25.0, CALIBRATED.get(name, 1.0)
            if kind == "white":
                rate, share = robot.driver.rate, 1.0
            for drive in BOUNDED:
                result = study(robot, drive, kind, rate=rate, share=share)
                judged = kind != "white" or (name, drive) not in EULER
                yield from _within(f"{name}, {kind}, {drive}", result, judged)
                if kind == DRIVE:
                    result = study(robot, drive, kind, rate=rate, share=share, seconds=SHORT)
                    yield from _within(f"{name}, {kind}, {drive}, {SHORT:g} s", result)
    robot = robot_of("4WD4WS")
    for kind in ("lasting 2 s", DRIVE):
        result = study(robot, FAST, kind)
        title = f"filter NEES/3, 4WD4WS, {kind}, {FAST}"
        yield Figure(title, result.nees, "", None, "lower", _how(result))
    before = "the twist's own covariance, process noise of robot_localization"
    tuned = "the twist's own covariance, derived process noise"
    for title, growth in ((before, DEFAULT_PROCESS_NOISE), (tuned, None)):
        result = study(robot, "straight", DRIVE, MEASURED, growth)
        yield Figure(f"filter sigma, {title}", result.sigma, "m", None, "lower", _how(result))


def _within(name: str, result: Result, judged: bool = True) -> Iterator[Figure]:
    title, nees, how = f"filter NEES/3, {name}", result.nees, _how(result)
    yield Figure(title, nees, "", 2.0 if judged else None, "lower", how)
    if judged:
        yield Figure(f"{title}, at least", nees, "", 0.5, "higher", how)
    yield Figure(f"{title}, default noise", result.default, "", 2.0, "lower", how)


def _how(result: Result) -> str:
    return (
        f"{RUNS} runs; end error {result.distance:.3f} m, standard deviation by the filter"
        f" {result.sigma:.3f} m"
    )
