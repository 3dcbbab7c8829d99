"""How well self-calibration finds wheels that are wrong by 1 % and 1 deg.

A run as long as the paper's (77 s, about 80 m, forwards, sideways and turning mixed) of the
six-wheeler that has no two rows alike, in simulation.
"""

from __future__ import annotations

import io
import math
import random
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.figure import ROOT, Figure

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.runtime.se2 import Pose2
    from thorvaldc.simulation.records.joint_csv import JointLog
    from thorvaldc.tools.calibration.self_calibration import CalibrationResult

SECONDS = 77.0
RADIUS, OFFSET = 0.01, math.radians(1.0)
# Start (s), vx, vy (m/s), wz (rad/s).
RUN = (
    (0.0, 1.0, 0.0, 0.0),
    (7.0, 1.1, 0.0, 0.3),
    (16.0, 0.8, 0.6, 0.0),
    (24.0, 1.0, -0.5, -0.3),
    (33.0, 0.2, 1.0, 0.15),
    (41.0, 1.2, 0.2, -0.25),
    (50.0, 0.3, -1.0, 0.2),
    (58.0, 0.9, 0.5, 0.35),
    (66.0, 1.1, -0.3, -0.2),
    (74.0, 0.0, 0.0, 0.0),
)
SEEDS = (1, 2, 3)


@dataclass(frozen=True)
class Errors:
    """Radii over the file's and offsets (rad) by wheel: as many too large as too small."""

    radii: dict[str, float]
    offsets: dict[str, float]

    @staticmethod
    def of(robot: Robot, seed: int) -> Errors:
        chance = random.Random(seed)
        names = [wheel.name for wheel in robot.wheels]
        signs = [1.0 if i % 2 else -1.0 for i in range(len(names))]
        chance.shuffle(signs)
        radii = {name: 1.0 + RADIUS * s for name, s in zip(names, signs, strict=True)}
        chance.shuffle(signs)
        return Errors(radii, {name: OFFSET * s for name, s in zip(names, signs, strict=True)})


def figures() -> Iterator[Figure]:
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Robot

    robot = compile_file(ROOT / "examples" / "6wd6ws_asymmetric" / "robot.yaml").model
    if not isinstance(robot, Robot):
        raise RuntimeError("the example has faults")
    files = emit(robot, ["mjcf"], Report())
    yield from _rolling(robot)
    yield from _physics(robot, files)


def _rolling(robot: Robot) -> Iterator[Figure]:
    """Where wheels give way to the ground: what is measured is what they are."""
    radius = offset = before = after = taken = 0.0
    squares: list[float] = []
    for seed in SEEDS:
        errors = Errors.of(robot, seed)
        log, true = _drive(robot, errors=errors, open_loop=True)
        log = _noisy(log, seed)
        start = time.process_time()
        result = _calibrated(robot, log)
        taken = max(taken, time.process_time() - start)
        r, o, z = _missed(result, errors)
        radius, offset = max(radius, r), max(offset, o)
        squares += z
        before = max(before, _end_error(robot, log, true))
        after = max(after, _end_error(_applied(robot, result), log, true))
    how = "ideal ground, 1 % and 0.5 deg of white noise at 50 Hz, worst wheel of three runs"
    yield Figure("calibration, radius 1 %", 100 * radius, "%", 0.05, "lower", how)
    yield Figure("calibration, offset 1 deg", math.degrees(offset), "deg", 0.05, "lower", how)
    size = sum(squares) / len(squares)
    told = "squares of the errors over their standard errors', mean; 1 is honest"
    yield Figure("calibration, errors", size, "", 2.0, "lower", told)
    yield Figure(
        "end error before", before, "m", None, "lower", "odometry by the file; ideal ground, worst"
    )
    yield Figure(
        "end error after", after, "m", 1.0, "lower", "odometry by what was found; the same runs"
    )
    yield Figure("calibration, time", taken, "s", 5.0, "lower", "of a log of 77 s at 50 Hz")


def _physics(robot: Robot, files: Mapping[str, bytes]) -> Iterator[Figure]:
    """The same in MuJoCo."""
    errors = Errors.of(robot, SEEDS[0])
    # Who drives knows the wheels, who calibrates does not.
    radii = {w.name: w.radius * errors.radii[w.name] for w in robot.wheels}
    known, rolling = _with(robot, radii, errors.offsets), Errors(errors.radii, {})
    log, true = _drive(known, errors=rolling, files=files, open_loop=True)
    result = _calibrated(robot, log)
    radius, offset, _ = _missed(result, errors)
    how = "MuJoCo, wheels that point as their driver, who knows the offsets, wants"
    yield Figure("physics, radius 1 %", 100 * radius, "%", 0.05, "lower", how)
    yield Figure("physics, offset 1 deg", math.degrees(offset), "deg", 0.05, "lower", how)
    yield Figure("physics, end error before", _end_error(robot, log, true), "m", None, "lower", how)
    after = _end_error(_applied(robot, result), log, true)
    yield Figure("physics, end error after", after, "m", 1.0, "lower", how)

    radius, claims = 0.0, 0
    for seed in SEEDS[:2]:
        errors = Errors.of(robot, seed)
        log, _ = _drive(robot, errors=errors, files=files, open_loop=True)
        result = _calibrated(robot, log)
        radius = max(radius, _missed(result, errors)[0])
        claims += sum(w.offset is not None and w.offset.determined for w in result.wheels)
    how = "MuJoCo, drives that give way, steering held against the ground, nobody knows; worst"
    yield Figure("blind physics, radius 1 %", 100 * radius, "%", 0.1, "lower", how)
    how = "offsets claimed to be known there, where no log can tell them"
    yield Figure("blind physics, claims", claims, "", 0, "lower", how)

    log, _ = _drive(robot, errors=errors, files=files, open_loop=False)
    result = _calibrated(robot, log)
    claims = sum(
        estimate is not None and estimate.determined
        for wheel in result.wheels
        for estimate in (wheel.offset, wheel.ratio)
    )
    how = "values claimed to be known from drives that hold their speed"
    yield Figure("speed control, claims", claims, "", 0, "lower", how)


# -- driving ------------------------------------------------------------------------------


def _drive(
    robot: Robot,
    *,
    open_loop: bool,
    errors: Errors | None = None,
    files: Mapping[str, bytes] | None = None,
) -> tuple[JointLog, Pose2]:
    """The log of the run, and where it truly ended."""
    from thorvaldc.diagnostics import Report
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.manoeuvre import Segment
    from thorvaldc.simulation.physics.wheel_errors import WheelErrors
    from thorvaldc.simulation.records.joint_csv import JointLogWriter, read_log
    from thorvaldc.simulation.simulation_run import Simulation

    wheel_errors = {}
    if errors is not None:
        wheel_errors[robot.name] = WheelErrors.by_name(robot, errors.radii, errors.offsets)
    plan = [Segment(start, Twist(*twist)) for start, *twist in RUN]
    stream = io.StringIO()
    simulation = Simulation(robot, files, wheel_errors=wheel_errors, open_loop=open_loop)
    run = simulation.run(SECONDS, plan, None, JointLogWriter(robot, stream).on_tick).robots[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "joints.csv")
        path.write_text(stream.getvalue(), encoding="utf-8")
        log = read_log(path, path.name, robot, Report())
    if log is None:
        raise RuntimeError("the log cannot be read")
    return log, run.pose_true


def _noisy(log: JointLog, seed: int) -> JointLog:
    """White noise of 1 % on speeds and 0.5 deg on angles; what was commanded is left out."""
    chance = random.Random(seed)
    positions = {}
    for joint, values in log.positions.items():
        made = [values[0]]
        for i in range(1, len(values)):
            step = values[i] - values[i - 1]
            made.append(made[-1] + step * (1.0 + chance.gauss(0.0, 0.01)))
        positions[joint] = made
    angles = {
        joint: [value + chance.gauss(0.0, math.radians(0.5)) for value in values]
        for joint, values in log.angles.items()
    }
    return replace(log, positions=positions, angles=angles, commands={})


# -- comparing ----------------------------------------------------------------------------


def _calibrated(robot: Robot, log: JointLog) -> CalibrationResult:
    from thorvaldc.diagnostics import Report
    from thorvaldc.tools.calibration.self_calibration import calibrate

    report = Report()
    result = calibrate(robot, log, report)
    if result is None:
        raise RuntimeError("; ".join(d.message for d in report))
    return result


def _missed(result: CalibrationResult, errors: Errors) -> tuple[float, float, list[float]]:
    """Largest errors of the ratios and of the offsets (rad); squares over the standard errors'."""
    scale = math.exp(sum(math.log(r) for r in errors.radii.values()) / len(errors.radii))
    radius = offset = 0.0
    squares: list[float] = []
    for wheel in result.wheels:
        if wheel.ratio is not None:
            off = wheel.ratio.value - errors.radii[wheel.name] / scale
            radius = max(radius, abs(off))
            squares.append((off / wheel.ratio.error) ** 2)
        if wheel.offset is not None:
            off = wheel.offset.value - errors.offsets[wheel.name]
            offset = max(offset, abs(off))
            squares.append((off / wheel.offset.error) ** 2)
    return radius, offset, squares


def _with(robot: Robot, radii: Mapping[str, float], offsets: Mapping[str, float]) -> Robot:
    """The robot with these radii (m) and offsets (rad) by wheel."""
    turned = {w.steering_joint: offsets.get(w.name, 0.0) for w in robot.wheels}
    return replace(
        robot,
        wheels=tuple(replace(w, radius=radii.get(w.name, w.radius)) for w in robot.wheels),
        actuators=tuple(
            replace(a, encoder_offset=turned.get(a.joint, 0.0)) for a in robot.actuators
        ),
    )


def _applied(robot: Robot, result: CalibrationResult) -> Robot:
    radii = {w.name: w.radius for w in result.wheels if w.radius is not None}
    offsets = {w.name: w.offset.value for w in result.wheels if w.offset is not None}
    return _with(robot, radii, offsets)


def _end_error(robot: Robot, log: JointLog, true: Pose2) -> float:
    """How far the end of the log by the robot's odometry is from the true one, m."""
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators import for_robot
    from thorvaldc.runtime.odometry import Odometry

    odometry = Odometry(for_robot(robot), (2.0, 2.0))
    offsets = {a.joint: a.encoder_offset for a in robot.actuators}
    zeros = [0.0] * len(robot.wheels)
    for k, now in enumerate(log.times):
        positions = [log.positions[w.spin_joint][k] for w in robot.wheels]
        angles = [
            log.angles[w.steering_joint][k] + offsets[w.steering_joint]
            for w in robot.wheels
            if w.steering_joint is not None
        ]
        odometry.update(JointStates(now, zeros, angles, zeros, positions), now)
    return math.hypot(odometry.pose.x - true.x, odometry.pose.y - true.y)
