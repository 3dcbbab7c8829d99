"""Standard errors of the self-calibration under lasting noise, and plans for a better log."""

from __future__ import annotations

import functools
import math
import random
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from tests.recording import record
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.simulation.records.joint_csv import JointLog, read_log
from thorvaldc.tools.calibration.calibration_file import as_json, table
from thorvaldc.tools.calibration.calibration_log import PlannedMotion, plan_text
from thorvaldc.tools.calibration.self_calibration import CalibrationResult, calibrate

FOUR = make_robot(FOUR_STEERED)
CAR = make_robot([*FOUR_STEERED[:2], (-0.55, 0.45, "fixed"), (-0.55, -0.45, "fixed")])
RADII = {"w0": 1.01, "w1": 0.992, "w2": 0.997, "w3": 1.004}
OFFSETS = {"w0": 0.9, "w1": -0.6}
STRAIGHT = (0.0, 0.8, 0.0, 0.0)
MIXED = (
    *(STRAIGHT, (8.0, 1.0, 0.0, 0.3), (16.0, 0.8, 0.6, 0.0), (24.0, 1.0, -0.5, -0.3)),
    *((33.0, 0.2, 1.0, 0.15), (41.0, 1.2, 0.2, -0.25), (50.0, 0.3, -1.0, 0.2)),
)
CURVES = (
    *((0.0, 0.8, 0.0, 0.3), (12.0, 0.8, 0.0, -0.3), (24.0, 0.9, 0.0, 0.0)),
    *((36.0, 0.5, 0.0, 0.4), (48.0, 0.5, 0.0, -0.4)),
)


def drift(rng: random.Random, tau: float, dt: float) -> Iterator[float]:
    """Yields an error of variance 1 that lasts for about ``tau`` s (autoregressive, order 1)."""
    kept = math.exp(-dt / tau) if tau else 0.0
    value = rng.gauss(0.0, 1.0)
    while True:
        yield value
        value = kept * value + math.sqrt(1.0 - kept * kept) * rng.gauss(0.0, 1.0)


@functools.cache
def exact_log(robot: Robot, motion: Sequence[Sequence[float]], seconds: float) -> JointLog:
    """Log of wheels that roll without slip, at 25 Hz."""
    radii = {wheel.name: RADII[wheel.name] for wheel in robot.wheels}
    offsets = {w.name: OFFSETS.get(w.name, 0.0) for w in robot.wheels if w.steering_joint}
    text = record(robot, twists=motion, seconds=seconds, radii=radii, offsets=offsets)
    head, *lines = text.splitlines()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "joints.csv")
        path.write_text("\n".join([head, *lines[::2]]) + "\n", encoding="utf-8")
        log = read_log(path, path.name, robot, Report())
    assert log is not None
    return log


def noisy(log: JointLog, seed: int, tau: float) -> JointLog:
    """Adds errors of 1 % of the speed and 0.5 deg to each wheel."""
    rng = random.Random(seed)
    dt = log.times[1] - log.times[0]
    positions, angles = {}, {}
    for joint, values in log.positions.items():
        error = drift(rng, tau, dt)
        positions[joint] = [values[0]]
        for a, b in pairwise(values):
            positions[joint].append(positions[joint][-1] + (b - a) * (1.0 + 0.01 * next(error)))
    for joint, values in log.angles.items():
        error = drift(rng, tau, dt)
        angles[joint] = [value + math.radians(0.5) * next(error) for value in values]
    return replace(log, positions=positions, angles=angles, commands={})


def calibrated(robot: Robot, log: JointLog) -> tuple[CalibrationResult, str]:
    report = Report()
    result = calibrate(robot, log, report)
    assert result is not None, [d.message for d in report]
    return result, " ".join(f"{d.message} {d.hint}" for d in report)


@pytest.mark.parametrize(
    ("robot", "motion", "tau"),
    [
        (FOUR, MIXED, 0.1),
        pytest.param(CAR, CURVES, 1.0, marks=pytest.mark.slow),
        pytest.param(FOUR, MIXED, 0.0, marks=pytest.mark.slow),
        pytest.param(FOUR, MIXED, 1.0, marks=pytest.mark.exhaustive),
        pytest.param(CAR, CURVES, 0.0, marks=pytest.mark.exhaustive),
        pytest.param(CAR, CURVES, 0.1, marks=pytest.mark.exhaustive),
    ],
)
def test_standard_errors_fit_the_errors(
    robot: Robot, motion: Sequence[Sequence[float]], tau: float
) -> None:
    scale = math.prod(RADII.values()) ** 0.25
    offsets, ratios = [], []
    for seed in range(5):
        result, _ = calibrated(robot, noisy(exact_log(robot, motion, 60.0), seed, tau))
        for wheel in result.wheels:
            if wheel.offset is not None:
                error = wheel.offset.value - math.radians(OFFSETS.get(wheel.name, 0.0))
                offsets.append(error / wheel.offset.error)
            assert wheel.ratio is not None
            error = wheel.ratio.value - RADII[wheel.name] / scale
            ratios.append(error / wheel.ratio.error)
            assert wheel.ratio.settled or wheel.ratio.coarse
    for scores in (offsets, ratios):
        root_mean_square = math.sqrt(sum(z * z for z in scores) / len(scores))
        assert 0.45 < root_mean_square < 1.5


def test_longer_noise_gives_larger_random_errors() -> None:
    errors = []
    for tau in (0.0, 0.1, 0.3, 1.0):
        result, _ = calibrated(FOUR, noisy(exact_log(FOUR, MIXED, 60.0), 2, tau))
        offset = result.wheels[0].offset
        assert offset is not None
        errors.append(offset.random)
        assert offset.systematic < 0.5 * offset.random
    assert errors == sorted(errors)
    # Errors that last 0.1 s are as good as a fifth of the independent errors at 25 Hz.
    assert errors[1] / errors[0] == pytest.approx(math.sqrt(0.2 / 0.04), rel=0.3)


def test_plan_settles_the_values_that_a_straight_drive_leaves_open() -> None:
    before, text = calibrated(FOUR, noisy(exact_log(FOUR, (STRAIGHT,), 20.0), 1, 0.1))
    assert not any(w.offset.settled for w in before.wheels if w.offset)
    plan = before.offset_plan
    assert plan
    assert [motion.description for motion in plan] == ["on the spot, in both directions"]
    assert f"a log with a further {plan[0].seconds:g} s on the spot" in text
    half = plan[0].seconds / 2.0
    turns = (STRAIGHT, (20.0, 0.0, 0.0, 0.7), (20.0 + half, 0.0, 0.0, -0.7))
    after, _ = calibrated(FOUR, noisy(exact_log(FOUR, turns, 20.0 + 2.0 * half), 1, 0.1))
    assert all(w.offset.settled for w in after.wheels if w.offset)
    assert after.offset_plan == after.ratio_plan == ()


def test_no_plan_where_no_motion_of_the_robot_settles_the_radii() -> None:
    robot = make_robot([(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed"), (-0.5, 0.0, "swivel")])
    motion = (STRAIGHT, (5.0, 0.5, 0.0, 0.5))
    log = replace(exact_log(robot, motion, 20.0), commands={})
    result, text = calibrated(robot, log)
    assert result.ratio_plan is None
    assert "no motions of this robot settle it" in text
    assert as_json(result)["radius_ratio_plan"] is None


def test_coarse_value_replaces_only_a_present_value_that_it_contradicts() -> None:
    """At +-0.3 deg, an offset of 0.9 deg is better than 0, and one of 0 is not."""
    log = noisy(exact_log(FOUR, MIXED, 60.0), 4, 1.0)
    result, text = calibrated(FOUR, log)
    coarse = [w.offset for w in result.wheels if w.offset is not None and w.offset.coarse]
    assert coarse
    for offset in coarse:
        assert offset.determined == (abs(offset.value) > 2.0 * offset.error)
    assert "to +-0." in text
    kept = [line for line in table(result).splitlines() if "as before" in line]
    assert len(kept) == sum(not offset.determined for offset in coarse)


def test_motions_are_listed_as_a_person_says_them() -> None:
    motions = [PlannedMotion(text, 10.0 * n) for n, text in enumerate(("on", "back", "round"), 1)]
    assert plan_text(motions[:1]) == "10 s on"
    assert plan_text(motions[:2]) == "10 s on and 20 s back"
    assert plan_text(motions) == "10 s on, 20 s back and 30 s round"
