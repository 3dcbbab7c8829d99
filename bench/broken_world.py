"""Is the covariance of the odometry right if the world breaks: walls, ice, mud, a pull?

Robots of twelve families drive in MuJoCo.  At a random time their world breaks in one of the ways
of ``world_breaks``.  An estimate may be inaccurate then, but not wrong and sure: at most 1 % of the
trials of each family and class may lie outside of the 99.9 % bound of the covariance.

The physics runs once.  ``record`` keeps what a driver sees and the truth, and ``evaluate`` judges
an estimator with it, with and without a gyro:

    python -m bench.broken_world record FOLDER [TEXT ...]    families whose name contains a text
    python -m bench.broken_world evaluate FOLDER [TEXT ...]  files whose name contains each text

Some trials cannot be judged by wheels: all of them spin as commanded on a body that is held.  In
such a tick, no wheel deviates from its command and none disagrees with the others.  An oracle
knows the true twist in all other ticks, and takes that of the wheels in these.  A trial in which
the oracle is outside of the bound is counted as ``hidden``, and not as ``outside``.

A trial ends when the robot tips over, such as one that climbs a wall: the pose is then not one in
the plane, and a yaw rate about the vertical is none that a gyro measures.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import broken_sensors, world_robots
from bench.figure import Figure
from bench.healthy_readings import HealthyFit, healthy_fit
from bench.recorded_trials import Array, Recording, logarithm
from bench.world_breaks import AT_REST, CASES, CLASSES, GOOD_GROUND, Case, World, body_of
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise, TwistEstimate
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2, Twist
from thorvaldc.simulation.physics.sim_base import WheelErrors

GROUP = "long"

TRIALS, SAMPLE = 400, 40
"""Trials of the figures, and of ``record``."""
SECONDS = 3.6
BREAKS = (0.9, 1.7)
"""Earliest and latest time (s) of the break."""
_LEAST, _MOST = 0.2, 1.3
"""Least and largest torque of the drives, relative to that with which a wheel spins if the
coefficient of friction is 1."""
_LEAST_SKIDDING = 0.8
"""Least torque with which wheels that skid in turns can turn."""
CASE_FAMILY = "4 steered, wide"
_WARM_UP = 20
"""Ticks before the break in which the evaluated odometry runs."""
_TIPPING = math.cos(math.radians(5.0))
"""Cosine of the tilt from which a robot tips over."""
_BOUND = 16.266
"""99.9 % quantile of the chi-square distribution with 3 degrees of freedom."""


class Share(NamedTuple):
    """Shares in percent after the break, and the mean of NEES/3 of the ticks.

    - ``trials``, ``hidden``: trials outside of the bound of the pose that the readings show, and
      those that they do not show.
    - ``ticks``, ``hidden_ticks``: the same for ticks and the bound of the twist.
    - ``silent``: ticks outside in which no wheel is left out, doubted or said to slide.
    """

    trials: float
    hidden: float
    ticks: float
    hidden_ticks: float
    silent: float
    nees: float


# -- recording ----------------------------------------------------------------------------------


def record(world: World, name: str, trials: int) -> Recording:
    """Returns recorded trials of a class or case."""
    rows = [_trial(world, name, number) for number in range(trials)]
    joints = np.array([row.joints for row in rows])
    poses = np.array([row.poses for row in rows])
    poses[:, :, 2] = np.unwrap(poses[:, :, 2], axis=1)
    return Recording(
        times=np.arange(poses.shape[1]) / world.robot.driver.rate,
        speeds=joints[:, :, 0],
        angles=joints[:, :, 1],
        rates=joints[:, :, 2],
        positions=joints[:, :, 3],
        commanded=joints[:, :, 4],
        torques=joints[:, :, 5],
        poses=poses,
        yaw_rates=np.array([row.yaw_rates for row in rows]),
        breaks=np.array([row.broken_at for row in rows]),
        ends=np.array([row.end for row in rows]),
        changes=np.array([row.change for row in rows]),
    )


class _Trial(NamedTuple):
    """The lists have one entry for each tick; ``joints``: six lists of values of all wheels."""

    joints: list[list[Sequence[float]]]
    poses: list[Pose2]
    yaw_rates: list[float]
    broken_at: int
    end: int
    change: str


def _trial(world: World, name: str, number: int) -> _Trial:
    robot = world.robot
    rng = random.Random(f"{robot.name} {name} {number}")
    case = CASES.get(name)
    grip = np.mean([wheel.load * wheel.radius for wheel in robot.wheels if wheel.driven])
    skids = FixedWheels(BaseGeometry.from_robot(robot).wheels).skids
    least = _LEAST_SKIDDING if skids else _LEAST
    torque = case.torque if case else rng.uniform(least, _MOST) * float(grip)
    base = world.restart(torque, _wheel_errors(rng, robot))
    driver = BaseDriver(robot, base)
    dt = 1.0 / robot.driver.rate
    broken_at = round(rng.uniform(*BREAKS) / dt)
    change, slippery_at = None, math.inf
    twists = _twists(driver, rng, name, case, broken_at * dt)
    rows: list[list[Sequence[float]]] = []
    poses, yaw_rates, upright = [], [], []
    for k in range(round((case.seconds if case else SECONDS) / dt) + 1):
        now = k * dt
        if k == broken_at:
            pose, twist = base.true_pose(), base.true_twist()
            direction = pose.yaw + math.atan2(twist.vy, twist.vx)
            if twist.speed < 0.05:
                direction = rng.uniform(-math.pi, math.pi)
            draw = case.draw if case else CLASSES[name]
            change = draw(rng, body_of(robot, torque, direction))
            world.begin(change, direction)
            slippery_at = now + change.slippery_after
        if change is not None:
            if now >= slippery_at:
                world.make_slippery(change)
                slippery_at = math.inf
            if change.pull:
                world.pull(change)
        joints = base.read(now)
        commanded = driver.calculator.commanded_speeds or [0.0] * len(robot.wheels)
        rows.append(
            [
                [*joints.speeds],
                [*joints.angles],
                [*joints.angle_rates],
                [*(joints.positions or ())],
                [*commanded],
                world.torques(torque),
            ]
        )
        poses.append(base.true_pose())
        yaw_rates.append(base.true_twist().wz)
        upright.append(base.uprightness() > _TIPPING)
        driver.command(twists[0] if now < twists[1] else twists[2], now)
        driver.tick(now, joints)
    end = max([*upright, False].index(False) - 1, broken_at + 1)
    return _Trial(rows, poses, yaw_rates, broken_at, end, str(change))


def _wheel_errors(rng: random.Random, robot: Robot) -> WheelErrors:
    """Returns wrong radii and steering zeros, half as large as the noise model states."""
    noise = Noise(**dict(robot.driver.noise))
    return WheelErrors(
        tuple(1.0 + rng.gauss(0.0, noise.speed_ratio / 2.0) for _ in robot.wheels),
        tuple(rng.gauss(0.0, noise.angle / 2.0) for _ in robot.wheels),
    )


def _twists(
    driver: BaseDriver, rng: random.Random, name: str, case: Case | None, broken_at: float
) -> tuple[Twist, float, Twist]:
    """Returns a commanded twist, a time (s), and the twist from that time on."""
    if case is not None:
        return Twist(*case.twist), math.inf, ZERO_TWIST
    if name in AT_REST:
        return ZERO_TWIST, math.inf, ZERO_TWIST
    first = _random_twist(driver, rng)
    if rng.random() < 0.5:
        return first, math.inf, first
    second = ZERO_TWIST if rng.random() < 0.4 else _random_twist(driver, rng)
    return first, rng.uniform(broken_at, SECONDS - 0.5), second


def _random_twist(driver: BaseDriver, rng: random.Random) -> Twist:
    """Returns a twist that the robot can drive, with at least 0.15 m/s at its wheels."""
    settings, calculator = driver.settings, driver.calculator
    while True:
        speed = settings.max_linear_velocity * rng.uniform(0.0, 0.9)
        angle = 0.0 if rng.random() < 0.3 else rng.uniform(-math.pi, math.pi)
        turn = 0.0 if rng.random() < 0.3 else rng.uniform(-0.6, 0.6)
        wished = Twist(speed * math.cos(angle), speed * math.sin(angle), turn)
        twist = driver.limited(wished)
        if twist.speed + calculator.geometry.length * abs(twist.wz) > 0.15:
            return twist


# -- evaluation ---------------------------------------------------------------------------------


class _Replay(General):
    """A calculator whose last commands are those of a recording."""

    commanded: list[float] | None = None

    @property
    def commanded_speeds(self) -> Sequence[float] | None:
        return self.commanded or [0.0] * len(self.geometry.wheels)


class _Oracle(_Replay):
    """A calculator whose estimates are known."""

    estimate = TwistEstimate(ZERO_TWIST, ((0.0,) * 3,) * 3, 3)

    def odometry(self, states: JointStates) -> TwistEstimate:
        return self.estimate


def evaluate(robot: Robot, recording: Recording, *, gyro: bool) -> Share:
    """Returns the shares of a recording with the estimator of this robot."""
    geometry, noise = BaseGeometry.from_robot(robot), Noise(**dict(robot.driver.noise))
    trials, n = recording.yaw_rates.shape
    measured = None
    if gyro:
        errors = np.random.default_rng(5).standard_normal((trials, n))
        measured = recording.yaw_rates + noise.gyro * errors
    fit = healthy_fit(geometry, noise, recording, measured)
    true = recording.true_twists()
    counts, tick_counts, squares = np.zeros(2), np.zeros(3), []
    for trial in range(trials):
        first, end = int(recording.breaks[trial]), int(recording.ends[trial])
        states = recording.joint_states(trial, None if measured is None else measured[trial])
        odometry = Odometry(_Replay(geometry, None, noise), robot.driver.top_speeds)
        estimates = _replayed(odometry, states, recording.commanded[trial], first)
        healthy = fit.is_healthy[trial, first:end]
        errors = true[trial, first:end] - np.array([e.twist for e in estimates])
        covariances = np.array([e.covariance for e in estimates])
        solved = np.linalg.solve(covariances, errors[:, :, np.newaxis])[:, :, 0]
        square = (errors * solved).sum(1)
        squares.append(square)
        wrong = square > _BOUND
        unnamed = np.array([not (e.dropped or e.suspects or e.sliding) for e in estimates])
        tick_counts += np.array(
            [(wrong & ~healthy).sum(), (wrong & healthy).sum(), (wrong & unnamed).sum()]
        )
        if _is_outside(odometry, recording, trial):
            oracle = _oracle(geometry, noise, robot, fit, true, trial, states, first)
            counts[int(_is_outside(oracle, recording, trial))] += 1
    all_squares = np.concatenate(squares)
    outside, hidden = (100.0 * counts / trials).tolist()
    ticks, hidden_ticks, silent = (100.0 * tick_counts / len(all_squares)).tolist()
    nees = float(all_squares.mean()) / 3.0
    return Share(outside, hidden, ticks, hidden_ticks, silent, nees)


def _replayed(
    odometry: Odometry, states: Sequence[JointStates], commanded: Array, first: int
) -> list[TwistEstimate]:
    """Runs the odometry, whose pose starts at the tick ``first``, and returns the estimates
    after that."""
    calculator = odometry.calculator
    estimates = []
    for k in range(max(first - _WARM_UP, 0), len(states)):
        if isinstance(calculator, _Replay):
            calculator.commanded = commanded[k].tolist()
        odometry.update(states[k], states[k].time)
        if k == first:
            odometry.reset()
        elif k > first:
            estimates.append(odometry.estimate)
    return estimates


def _oracle(
    geometry: BaseGeometry,
    noise: Noise,
    robot: Robot,
    fit: HealthyFit,
    true: Array,
    trial: int,
    states: Sequence[JointStates],
    first: int,
) -> Odometry:
    """Returns the odometry that has the true twist unless the readings are those of a healthy
    drive."""
    calculator = _Oracle(geometry, None, noise)
    odometry = Odometry(calculator, robot.driver.top_speeds)
    for k in range(first, len(states)):
        if k > first:
            twist = (fit.twists if fit.is_healthy[trial, k - 1] else true)[trial, k - 1]
            (a, b, c), (d, e, f), (g, h, i) = fit.covariances[trial, k - 1].tolist()
            calculator.estimate = TwistEstimate(
                Twist(*twist.tolist()), ((a, b, c), (d, e, f), (g, h, i)), 3
            )
        odometry.update(states[k], states[k].time)
        if k == first:
            odometry.reset()
    return odometry


def _is_outside(odometry: Odometry, recording: Recording, trial: int) -> bool:
    """Returns whether the pose at the end lies outside of its 99.9 % bound."""
    start = Pose2(*recording.poses[trial, recording.breaks[trial]].tolist())
    end = Pose2(*recording.poses[trial, recording.ends[trial]].tolist()).relative_to(start)
    error = logarithm(np.array(end.relative_to(odometry.pose)))
    return bool(error @ np.linalg.solve(np.array(odometry.covariance), error) > _BOUND)


# -- figures, and the two steps -----------------------------------------------------------------


def classes_of(family: str) -> tuple[str, ...]:
    """Returns the names of the classes and cases of a family."""
    return (*CLASSES, *(CASES if family == CASE_FAMILY else ()))


def figures() -> Iterator[Figure]:
    worlds = {name: World(*world_robots.robot(name)) for name in world_robots.NAMES}
    for name in (*CLASSES, *CASES):
        families = (CASE_FAMILY,) if name in CASES else world_robots.NAMES
        recordings = {family: record(worlds[family], name, TRIALS) for family in families}
        broken = (name, *broken_sensors.CLASSES) if name == GOOD_GROUND else (name,)
        for kind in broken:
            for gyro in (False, True):
                yield _worst(worlds, recordings, kind, gyro)


def _worst(
    worlds: dict[str, World], recordings: dict[str, Recording], name: str, gyro: bool
) -> Figure:
    """Returns the figure of a class for the worst of these families."""
    shares = {}
    for family, recording in recordings.items():
        robot = worlds[family].robot
        shares[family] = evaluate(robot, with_sensors(robot, recording, name), gyro=gyro)
    worst = max(share.trials for share in shares.values())
    each = "; ".join(
        f"{family}: {share.trials:.1f}, hidden {share.hidden:.1f}, ticks {share.ticks:.1f}"
        for family, share in shares.items()
    )
    how = f"% of {TRIALS} trials of the worst family outside of the 99.9 % bound; {each}"
    title = f"{name}{', gyro' * gyro}: outside"
    return Figure(title, worst, "%", 1.0, "lower", how)


def with_sensors(robot: Robot, recording: Recording, name: str) -> Recording:
    """Returns a recording, with broken sensors if these are the class ``name``."""
    if name not in broken_sensors.CLASSES:
        return recording
    return broken_sensors.broken(recording, BaseGeometry.from_robot(robot), name)


def main(step: str, folder: str, *texts: str) -> None:
    if step == "record":
        for family in world_robots.NAMES:
            if not texts or any(text in family for text in texts):
                world = World(*world_robots.robot(family))
                for name in classes_of(family):
                    record(world, name, SAMPLE).save(Path(folder, f"{family}; {name}.npz"))
        return
    print(f"{'trials':>54}{'hidden':>8}{'ticks':>8}{'hidden':>8}{'silent':>8}{'NEES/3':>10}")
    for path in sorted(Path(folder).glob("*.npz")):
        family, name = path.stem.split("; ")
        broken = (name, *broken_sensors.CLASSES) if name == GOOD_GROUND else (name,)
        chosen = [kind for kind in broken if all(t in f"{family}; {kind}" for t in texts)]
        if not chosen:
            continue
        robot, recording = world_robots.robot(family)[0], Recording.load(path)
        for kind in chosen:
            for gyro in (False, True):
                share = evaluate(robot, with_sensors(robot, recording, kind), gyro=gyro)
                numbers = "".join(f"{value:8.1f}" for value in share[:5])
                title = f"{family}; {kind}{', gyro' * gyro}"
                print(f"{title:<46}{numbers}{share.nees:10.3g}", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in ("record", "evaluate"):
        sys.exit(__doc__)
    main(*sys.argv[1:])
