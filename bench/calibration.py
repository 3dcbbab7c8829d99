"""Accuracy of self-calibration for wheel errors of 1 % and 1 deg, in simulation.

The run is as long as that of the paper (77 s, about 80 m, with forward, sideways and turning
motions), with the six-wheeled robot that has no two equal rows.
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

GROUP = "long"

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
    """True radius ratios and offsets (rad) by wheel; half of them are too large."""

    radii: dict[str, float]
    offsets: dict[str, float]

    @staticmethod
    def of(robot: Robot, seed: int) -> Errors:
        rng = random.Random(seed)
        names = [wheel.name for wheel in robot.wheels]
        signs = [1.0 if i % 2 else -1.0 for i in range(len(names))]
        rng.shuffle(signs)
        radii = {name: 1.0 + RADIUS * s for name, s in zip(names, signs, strict=True)}
        rng.shuffle(signs)
        return Errors(radii, {name: OFFSET * s for name, s in zip(names, signs, strict=True)})


def figures() -> Iterator[Figure]:
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Robot

    robot = compile_file(ROOT / "examples" / "6wd6ws_asymmetric" / "robot.yaml").model
    if not isinstance(robot, Robot):
        raise RuntimeError("the example has errors")
    files = emit(robot, ["mjcf"], Report())
    yield from _rolling(robot)
    yield from _physics(robot, files)


def _rolling(robot: Robot) -> Iterator[Figure]:
    """Ideal ground: the wheels roll freely, so the log shows their true radii."""
    radius = offset = before = after = taken = 0.0
    squares: list[float] = []
    for seed in SEEDS:
        errors = Errors.of(robot, seed)
        log, true = _drive(robot, errors=errors, open_loop=True)
        log = _noisy(log, seed)
        start = time.process_time()
        result = _calibrated(robot, log)
        taken = max(taken, time.process_time() - start)
        r, o, z = _errors_of(result, errors)
        radius, offset = max(radius, r), max(offset, o)
        squares += z
        before = max(before, _end_error(robot, log, true))
        after = max(after, _end_error(_applied(robot, result), log, true))
    how = "ideal ground, 1 % and 0.5 deg of white noise at 50 Hz, worst wheel of three runs"
    yield Figure("calibration, radius 1 %", 100 * radius, "%", 0.05, "lower", how)
    yield Figure("calibration, offset 1 deg", math.degrees(offset), "deg", 0.05, "lower", how)
    size = sum(squares) / len(squares)
    ratio = "mean of (error / standard error)^2; 1 is exact"
    yield Figure("calibration, errors", size, "", 2.0, "lower", ratio)
    yield Figure(
        "end error before",
        before,
        "m",
        None,
        "lower",
        "odometry with the radii and offsets of the file; ideal ground, worst run",
    )
    yield Figure(
        "end error after", after, "m", 1.0, "lower", "odometry with the calibration; the same runs"
    )
    yield Figure(
        "calibration, time", taken, "s", 5.0, "lower", "of a log of 77 s at 50 Hz", timed=True
    )


def _physics(robot: Robot, files: Mapping[str, bytes]) -> Iterator[Figure]:
    """The same run in MuJoCo."""
    errors = Errors.of(robot, SEEDS[0])
    # The driver knows the true wheels; the calibration does not.
    radii = {w.name: w.radius * errors.radii[w.name] for w in robot.wheels}
    known, rolling = _with(robot, radii, errors.offsets), Errors(errors.radii, {})
    log, true = _drive(known, errors=rolling, files=files, open_loop=True)
    result = _calibrated(robot, log)
    radius, offset, _ = _errors_of(result, errors)
    how = "MuJoCo, a driver with calibrated encoders"
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
        radius = max(radius, _errors_of(result, errors)[0])
        claims += sum(w.offset is not None and w.offset.determined for w in result.wheels)
    how = "MuJoCo, open-loop drives, steering held against the ground, uncalibrated; worst run"
    yield Figure("blind physics, radius 1 %", 100 * radius, "%", 0.1, "lower", how)
    how = "offsets reported as determined there, although no log can determine them"
    yield Figure("blind physics, claims", claims, "", 0, "lower", how)

    log, _ = _drive(robot, errors=errors, files=files, open_loop=False)
    result = _calibrated(robot, log)
    claims = sum(
        estimate is not None and estimate.determined
        for wheel in result.wheels
        for estimate in (wheel.offset, wheel.ratio)
    )
    how = "values reported as determined with speed-controlled drives"
    yield Figure("speed control, claims", claims, "", 0, "lower", how)


# -- driving ------------------------------------------------------------------------------


def _drive(
    robot: Robot,
    *,
    open_loop: bool,
    errors: Errors | None = None,
    files: Mapping[str, bytes] | None = None,
) -> tuple[JointLog, Pose2]:
    """Returns the log of the run and the true end pose."""
    from thorvaldc.diagnostics import Report
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.control_loop import Segment
    from thorvaldc.simulation.physics.sim_base import WheelErrors
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
    """Adds white noise of 1 % to speeds and 0.5 deg to angles, and removes the commands."""
    rng = random.Random(seed)
    positions = {}
    for joint, values in log.positions.items():
        noisy = [values[0]]
        for i in range(1, len(values)):
            step = values[i] - values[i - 1]
            noisy.append(noisy[-1] + step * (1.0 + rng.gauss(0.0, 0.01)))
        positions[joint] = noisy
    angles = {
        joint: [value + rng.gauss(0.0, math.radians(0.5)) for value in values]
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


def _errors_of(result: CalibrationResult, errors: Errors) -> tuple[float, float, list[float]]:
    """Returns the largest errors of ratios and offsets (rad), and (error / standard error)^2."""
    scale = math.exp(sum(math.log(r) for r in errors.radii.values()) / len(errors.radii))
    radius = offset = 0.0
    squares: list[float] = []
    for wheel in result.wheels:
        if wheel.ratio is not None:
            error = wheel.ratio.value - errors.radii[wheel.name] / scale
            radius = max(radius, abs(error))
            squares.append((error / wheel.ratio.error) ** 2)
        if wheel.offset is not None:
            error = wheel.offset.value - errors.offsets[wheel.name]
            offset = max(offset, abs(error))
            squares.append((error / wheel.offset.error) ** 2)
    return radius, offset, squares


def _with(robot: Robot, radii: Mapping[str, float], offsets: Mapping[str, float]) -> Robot:
    """Returns the robot with these radii (m) and offsets (rad) by wheel."""
    offset_of_joint = {w.steering_joint: offsets.get(w.name, 0.0) for w in robot.wheels}
    return replace(
        robot,
        wheels=tuple(replace(w, radius=radii.get(w.name, w.radius)) for w in robot.wheels),
        actuators=tuple(
            replace(a, encoder_offset=offset_of_joint.get(a.joint, 0.0)) for a in robot.actuators
        ),
    )


def _applied(robot: Robot, result: CalibrationResult) -> Robot:
    radii = {w.name: w.radius for w in result.wheels if w.radius is not None}
    offsets = {w.name: w.offset.value for w in result.wheels if w.offset is not None}
    return _with(robot, radii, offsets)


def _end_error(robot: Robot, log: JointLog, true: Pose2) -> float:
    """Returns the distance (m) between the end pose of the odometry and the true one."""
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
