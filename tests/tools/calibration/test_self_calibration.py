"""Self-calibration: accuracy on simulated logs, standard errors, undetermined values."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

from tests.backend_files import files_of
from tests.recording import TURNS, record
from tests.robots import FOUR_STEERED, make_robot
from tests.slow import one_quick_of
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.compiler.robot_settings.wheel_calibration import Calibration, Measured
from thorvaldc.diagnostics import Report
from thorvaldc.model import ParameterSet, Robot
from thorvaldc.simulation.records.joint_csv import JointLog, read_log
from thorvaldc.tools.calibration.calibration_file import as_json, overlay, table
from thorvaldc.tools.calibration.self_calibration import (
    CalibrationResult,
    WheelCalibration,
    calibrate,
)

ROBOT = make_robot(FOUR_STEERED)
SIX = make_robot([*FOUR_STEERED, (0.1, 0.6, "steered"), (-0.2, -0.6, "steered")])
RADII = {"w0": 1.01, "w1": 0.99, "w3": 1.005}
OFFSETS = {"w0": 1.0, "w1": -0.5, "w2": 0.7, "w3": -1.0}

Edit = Callable[[JointLog], JointLog]


def joint_log(folder: Path, robot: Robot, text: str) -> JointLog:
    path, report = folder / "joints.csv", Report()
    path.write_text(text, encoding="utf-8")
    log = read_log(path, path.name, robot, report)
    assert log is not None, [d.message for d in report]
    return log


def calibrated(
    log: JointLog, robot: Robot = ROBOT, distance: float | None = None
) -> tuple[dict[str, WheelCalibration], CalibrationResult, list[str]]:
    report = Report()
    result = calibrate(robot, log, report, distance)
    assert result is not None, [d.message for d in report]
    return {w.name: w for w in result.wheels}, result, [d.code.name for d in report]


def errors(
    wheels: dict[str, WheelCalibration], radii: dict[str, float], offsets: dict[str, float]
) -> tuple[float, float]:
    """Largest errors of the ratios (relative, but for their common scale) and offsets (deg)."""
    ratios = {w.name: w.ratio.value for w in wheels.values() if w.ratio is not None}
    scale = math.exp(sum(math.log(radii.get(n, 1.0)) for n in ratios) / len(ratios))
    degrees = {
        w.name: math.degrees(w.offset.value) for w in wheels.values() if w.offset is not None
    }
    return (
        max(abs(r * scale / radii.get(n, 1.0) - 1.0) for n, r in ratios.items()),
        max((abs(d - offsets.get(n, 0.0)) for n, d in degrees.items()), default=0.0),
    )


def noisy(log: JointLog, seed: int = 1, speed: float = 0.01, angle: float = 0.5) -> JointLog:
    """Adds white noise to the speeds (relative) and the angles (deg)."""
    rng = random.Random(seed)
    positions = {}
    for joint, values in log.positions.items():
        noisy_values = [values[0]]
        for a, b in pairwise(values):
            noisy_values.append(noisy_values[-1] + (b - a) * (1.0 + rng.gauss(0.0, speed)))
        positions[joint] = noisy_values
    angles = {
        joint: [a + math.radians(rng.gauss(0.0, angle)) for a in values]
        for joint, values in log.angles.items()
    }
    return replace(log, positions=positions, angles=angles, commands={})


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> JointLog:
    text = record(ROBOT, radii=RADII, offsets=OFFSETS)
    return joint_log(tmp_path_factory.mktemp("log"), ROBOT, text)


def test_exact_log_gives_exact_errors(log: JointLog) -> None:
    wheels, result, codes = calibrated(log)
    ratio, offset = errors(wheels, RADII, OFFSETS)
    assert ratio < 1e-6
    assert offset < 1e-4
    assert codes == []
    assert all(w.offset and w.offset.determined for w in result.wheels)
    assert all(w.ratio and w.ratio.determined for w in result.wheels)
    # The common scale stays: the ratios' geometric mean is 1.
    assert math.prod(w.ratio.value for w in result.wheels if w.ratio) == pytest.approx(1.0)


def test_errors_agree_with_the_standard_errors(log: JointLog) -> None:
    squares: list[float] = []
    scale = math.prod(RADII.get(w.name, 1.0) for w in ROBOT.wheels) ** 0.25
    for seed in range(6):
        wheels, _, _ = calibrated(noisy(log, seed))
        for wheel in wheels.values():
            assert wheel.offset is not None
            assert wheel.ratio is not None
            error = wheel.offset.value - math.radians(OFFSETS[wheel.name])
            squares.append((error / wheel.offset.error) ** 2)
            truth = RADII.get(wheel.name, 1.0) / scale
            squares.append(((wheel.ratio.value - truth) / wheel.ratio.error) ** 2)
            assert wheel.offset.error < math.radians(0.2)
            assert wheel.ratio.error < 1e-3
    assert 0.3 < sum(squares) / len(squares) < 2.0


def test_large_offsets(tmp_path: Path) -> None:
    offsets = {"w0": 9.0, "w2": -7.0}
    wheels, _, _ = calibrated(joint_log(tmp_path, ROBOT, record(ROBOT, offsets=offsets)))
    assert errors(wheels, {}, offsets)[1] < 0.01


def test_offsets_do_not_depend_on_the_robot_file(log: JointLog) -> None:
    present = tuple(
        replace(a, encoder_offset=0.3 if a.role == "steering" else 0.0) for a in ROBOT.actuators
    )
    wheels, _, _ = calibrated(log, replace(ROBOT, actuators=present))
    assert errors(wheels, RADII, OFFSETS)[1] < 0.01


def test_log_with_velocities_instead_of_positions(log: JointLog) -> None:
    velocities = {}
    for joint, values in log.positions.items():
        steps = zip(log.times, log.times[1:], values, values[1:], strict=False)
        mean = [(b - a) / (t - s) for s, t, a, b in steps]
        velocities[joint] = [mean[0], *mean]
    wheels, _, _ = calibrated(replace(log, positions={}, velocities=velocities))
    ratio, offset = errors(wheels, RADII, OFFSETS)
    assert ratio < 1e-3
    assert offset < 0.1


def test_robot_with_fixed_wheels(tmp_path: Path) -> None:
    robot = make_robot(
        [*FOUR_STEERED[:2], (-0.55, 0.45, "fixed"), (-0.55, -0.45, "fixed"), (0.8, 0.0, "swivel")]
    )
    twists = [(0.0, 0.8, 0.0, 0.3), (6.0, 0.6, 0.0, -0.5), (12.0, 0.8, 0.0, 0.0)]
    radii, offsets = {"w0": 1.01, "w2": 0.995}, {"w0": 0.5, "w1": -0.8}
    text = record(robot, twists=twists, radii=radii, offsets=offsets)
    wheels, result, _ = calibrated(joint_log(tmp_path, robot, text), robot)
    ratio, offset = errors(wheels, radii, offsets)
    assert ratio < 1e-4
    assert offset < 0.01
    assert [w.name for w in result.wheels if w.offset is None] == ["w2", "w3", "w4"]
    assert wheels["w4"].ratio is None
    assert wheels["w4"].radius is None


def test_contacts_beside_their_steering_axes(tmp_path: Path) -> None:
    sides = (0.1, -0.1, 0.15, 0.05)
    wheels = zip(ROBOT.wheels, sides, strict=True)
    robot = replace(ROBOT, wheels=tuple(replace(w, lateral_offset=s) for w, s in wheels))
    # The wheels steer all the time, which rail_robot them.
    twists = [
        (2.0 * k, 0.6 * math.cos(k), 0.6 * math.sin(k), 0.4 * math.sin(2.3 * k)) for k in range(10)
    ]
    text = record(robot, twists=twists, radii=RADII, offsets=OFFSETS)
    calibrations, _, _ = calibrated(joint_log(tmp_path, robot, text), robot)
    ratio, offset = errors(calibrations, RADII, OFFSETS)
    assert ratio < 2e-3
    assert offset < 0.01


def test_wheels_on_one_joint_have_one_offset(tmp_path: Path) -> None:
    robot = make_robot([*FOUR_STEERED, (0.55, 0.45, "steered")])
    first = robot.wheels[0].steering_joint
    double = replace(robot.wheels[4], steering_joint=first, y=0.55, lateral_offset=0.1)
    robot = replace(robot, wheels=(*robot.wheels[:4], replace(double, y=0.45)))
    text = record(robot, offsets={"w0": 0.8, "w4": 0.8, "w2": -0.4})
    wheels, _, _ = calibrated(joint_log(tmp_path, robot, text), robot)
    assert wheels["w0"].offset == wheels["w4"].offset
    assert errors(wheels, {}, {"w0": 0.8, "w4": 0.8, "w2": -0.4})[1] < 0.05


# -- faulty parts of a log ----------------------------------------------------------------------


def test_temporary_slip_of_a_wheel(log: JointLog) -> None:
    values, slip = [log.positions["w0_axle"][0]], 1.3
    for time, a, b in zip(
        log.times[1:], log.positions["w0_axle"], log.positions["w0_axle"][1:], strict=False
    ):
        values.append(values[-1] + (b - a) * (slip if 5.0 < time < 8.0 else 1.0))
    wheels, _, _ = calibrated(
        replace(log, positions=log.positions | {"w0_axle": values}, commands={})
    )
    ratio, offset = errors(wheels, RADII, OFFSETS)
    assert ratio < 5e-4
    assert offset < 0.05


def test_standstill_and_gaps_are_left_out(log: JointLog) -> None:
    stop = next(i for i, t in enumerate(log.times) if t >= 9.0)
    times = [t if i < stop else t + 100.0 for i, t in enumerate(log.times)]
    wheels, result, _ = calibrated(replace(log, times=times, commands={}))
    assert errors(wheels, RADII, OFFSETS)[0] < 1e-4
    assert result.moving < 20.0


# -- undetermined values ----------------------------------------------------------------


def test_straight_drive_does_not_determine_offsets(tmp_path: Path) -> None:
    text = record(ROBOT, twists=[(0.0, 0.8, 0.0, 0.0)], radii=RADII, offsets=OFFSETS)
    _, result, codes = calibrated(joint_log(tmp_path, ROBOT, text))
    assert not any(w.offset.determined for w in result.wheels if w.offset)
    assert "calibration-undetermined" in codes


def test_two_wheels_on_one_axle_do_not_determine_radii(tmp_path: Path) -> None:
    robot = make_robot([(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed"), (-0.5, 0.0, "swivel")])
    text = record(robot, twists=[(0.0, 0.8, 0.0, 0.0), (5.0, 0.5, 0.0, 0.5)], radii={"w0": 1.02})
    log = replace(joint_log(tmp_path, robot, text), commands={})
    wheels, result, codes = calibrated(log, robot)
    assert codes == ["calibration-undetermined"]
    assert not result.determines_anything
    assert wheels["w0"].radius == robot.wheels[0].radius


def test_consistent_steering_angles_keep_the_offsets(tmp_path: Path) -> None:
    _, result, codes = calibrated(joint_log(tmp_path, ROBOT, record(ROBOT, radii=RADII)))
    assert result.offsets_kept
    assert codes == ["calibration-steering"]
    assert not any(w.offset.determined for w in result.wheels if w.offset)
    assert all(w.ratio.determined for w in result.wheels if w.ratio)


def test_speed_controlled_drives_determine_no_radii(tmp_path: Path) -> None:
    _, result, codes = calibrated(joint_log(tmp_path, ROBOT, record(ROBOT, open_loop=False)))
    assert codes == ["calibration-steering", "calibration-forced"]
    assert not result.determines_anything


# -- physics ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    pytest.importorskip("mujoco")
    return files_of(Mjcf, SIX)


def test_radii_from_physics(files: dict[str, bytes], tmp_path: Path) -> None:
    text = record(SIX, radii=RADII, offsets={"w0": 0.3, "w5": -0.3}, files=files)
    wheels, _, _ = calibrated(joint_log(tmp_path, SIX, text), SIX)
    assert errors(wheels, RADII, {})[0] < 5e-4
    scale = math.prod(RADII.get(w.name, 1.0) for w in SIX.wheels) ** (1 / 6)
    for name, wheel in wheels.items():
        assert wheel.ratio is not None
        # The standard error includes lasting slip.
        assert abs(wheel.ratio.value - RADII.get(name, 1.0) / scale) < 4.0 * wheel.ratio.error


def test_no_offsets_where_motors_hold_the_wheels(files: dict[str, bytes], tmp_path: Path) -> None:
    """The motors hold the wheels at wrong angles, so the angles in the log look consistent."""
    text = record(SIX, radii=RADII, offsets=OFFSETS, files=files)
    wheels, result, codes = calibrated(joint_log(tmp_path, SIX, text), SIX)
    for wheel in wheels.values():
        assert wheel.offset is not None
        truth = math.radians(OFFSETS.get(wheel.name, 0.0))
        assert not wheel.offset.determined or abs(wheel.offset.value - truth) < 0.005
    assert codes == ["calibration-steering"]
    assert result.slip > math.radians(0.1)
    assert errors(wheels, RADII, {})[0] < 1e-3


def test_offsets_of_a_driver_with_calibrated_encoders(
    files: dict[str, bytes], tmp_path: Path
) -> None:
    turned = {f"{name}_steering_axis": math.radians(d) for name, d in OFFSETS.items()}
    calibrated_robot = replace(
        SIX,
        actuators=tuple(replace(a, encoder_offset=turned.get(a.joint, 0.0)) for a in SIX.actuators),
    )
    text = record(calibrated_robot, files=files)
    wheels, _, _ = calibrated(joint_log(tmp_path, SIX, text), SIX)
    assert errors(wheels, {}, OFFSETS)[1] < 0.1
    assert errors(wheels, {}, OFFSETS)[0] < 5e-4


# -- random logs --------------------------------------------------------------


@pytest.mark.parametrize("size", one_quick_of(4, [1e-300, 1.0, 1e6, 1e150, 1e300]))
def test_random_numbers_give_a_result_or_an_error(size: float) -> None:
    for seed in range(4):
        rng = random.Random(seed)

        def column(n: int = 400, rng: random.Random = rng) -> list[float]:
            return [rng.uniform(-size, size) for _ in range(n)]

        times = [1.7e9 + 0.02 * k + (1e9 if k > 200 and seed % 2 else 0.0) for k in range(400)]
        log = JointLog(
            times,
            {wheel.spin_joint: column() for wheel in ROBOT.wheels},
            {},
            {wheel.spin_joint: column() for wheel in ROBOT.wheels},
            {wheel.steering_joint or "": column() for wheel in ROBOT.wheels},
        )
        for distance in (None, 10.0):
            report = Report()
            result = calibrate(ROBOT, log, report, distance)
            assert result is not None or report.has_errors
            if result is not None:
                json.dumps(as_json(result), allow_nan=False)


# -- the common scale -----------------------------------------------------------------------


def test_distance_determines_the_scale(tmp_path: Path) -> None:
    radii = {w.name: 1.02 * RADII.get(w.name, 1.0) for w in ROBOT.wheels}
    twists = [(0.0, 0.8, 0.0, 0.0), (12.0, 0.8, 0.1, 0.1), (16.0, 0.0, 0.0, 0.0)]
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.control_loop import Segment
    from thorvaldc.simulation.physics.sim_base import WheelErrors
    from thorvaldc.simulation.simulation_run import Simulation

    wheel_errors = {ROBOT.name: WheelErrors.by_name(ROBOT, radii)}
    plan = [Segment(t, Twist(*v)) for t, *v in twists]
    true = (
        Simulation(ROBOT, wheel_errors=wheel_errors, open_loop=True)
        .run(18.0, plan)
        .robots[0]
        .pose_true
    )
    log = joint_log(tmp_path, ROBOT, record(ROBOT, twists=twists, seconds=18.0, radii=radii))
    wheels, result, _ = calibrated(log, distance=math.hypot(true.x, true.y))
    for wheel in ROBOT.wheels:
        assert wheels[wheel.name].radius == pytest.approx(
            wheel.radius * radii[wheel.name], rel=5e-4
        )
    assert result.scale is not None


def test_distance_of_a_turning_path_is_refused(log: JointLog) -> None:
    report = Report()
    assert calibrate(ROBOT, log, report, 5.0) is None
    assert [d.code.name for d in report] == ["calibration-distance"]


# -- the result -----------------------------------------------------------------------------


def test_table_and_json(log: JointLog) -> None:
    _, result, _ = calibrated(log)
    lines = table(result).splitlines()
    errors = ["+-", "random", "+-", "systematic"]
    assert lines[0].split() == [
        *("wheel", "steering", "offset", *errors, "radius", "ratio", *errors, "radius")
    ]
    assert "+1.000 +- 0.0" in lines[1]
    # Numbers end below the ends of their headings.
    end = lines[0].index("systematic") + len("systematic")
    wheels = lines[1 : 1 + len(result.wheels)]
    assert all(line[:end].endswith(" deg") and line[end] == " " for line in wheels)
    assert len({len(line) for line in wheels}) == 1
    value = json.loads(json.dumps(as_json(result), allow_nan=False))
    assert value["wheels"][1]["steering_offset"]["value"] == pytest.approx(math.radians(-0.5))


def test_overlay_keeps_undetermined_values(tmp_path: Path) -> None:
    _, result, _ = calibrated(joint_log(tmp_path, ROBOT, record(ROBOT, radii=RADII)))
    previous = Calibration(
        radii={"w1": Measured(0.3, ROBOT.span), "gone": Measured(0.1, ROBOT.span)},
        named_radii={"w1": {"rail": Measured(0.15, ROBOT.span)}},
        steering_offsets={"w1": Measured(0.1, ROBOT.span)},
    )
    wheels = yaml.safe_load(overlay(result, previous))["wheels"]
    assert list(wheels) == ["w0", "w1", "w2", "w3"]
    assert wheels["w1"]["steering_offset"] == "5.72958 deg"
    assert wheels["w1"]["radii"] == {"rail": "150.0000 mm"}
    assert wheels["w1"]["radius"].startswith("197.")
    assert "steering_offset" not in wheels["w0"]


def test_overlay_without_determined_values_is_empty(tmp_path: Path) -> None:
    text = record(ROBOT, open_loop=False)
    _, result, _ = calibrated(joint_log(tmp_path, ROBOT, text))
    assert yaml.safe_load(overlay(result))["wheels"] == {}


def test_radii_of_a_parameter_set(tmp_path: Path) -> None:
    rail = tuple(replace(w, radii=(("rail", 0.15),)) for w in ROBOT.wheels[:3])
    sets = (ParameterSet("rails", "rail", ROBOT.driver, ROBOT.span),)
    robot = replace(ROBOT, wheels=(*rail, ROBOT.wheels[3]), parameter_sets=sets)
    rail_robot = replace(robot, wheels=(*(replace(w, radius=0.15) for w in rail), ROBOT.wheels[3]))
    log = joint_log(tmp_path, robot, record(rail_robot, radii=RADII, offsets=OFFSETS))
    result = calibrate(robot, log, Report(), parameters="rails")
    assert result is not None
    previous = Calibration(radii={"w0": Measured(0.2, ROBOT.span)})
    wheels = yaml.safe_load(overlay(result, previous))["wheels"]
    scale = math.prod(RADII.get(w.name, 1.0) for w in ROBOT.wheels) ** 0.25
    assert list(wheels["w0"]["radii"]) == ["rail"]
    assert wheels["w0"]["radius"] == "200.0000 mm"
    assert float(wheels["w0"]["radii"]["rail"].split()[0]) == pytest.approx(151.5 / scale, abs=0.01)
    assert "radii" not in wheels["w3"]
    assert float(wheels["w3"]["radius"].split()[0]) == pytest.approx(201.0 / scale, abs=0.01)


def test_long_logs_are_thinned(log: JointLog, monkeypatch: pytest.MonkeyPatch) -> None:
    from thorvaldc.tools.calibration import calibration_log

    monkeypatch.setattr(calibration_log, "MAX_TICKS", 200)
    wheels, _, _ = calibrated(log)
    assert errors(wheels, RADII, OFFSETS)[1] < 1e-3


def test_order_of_the_wheels_does_not_matter(tmp_path: Path) -> None:
    order: Sequence[int] = (2, 0, 3, 1)
    turned = replace(ROBOT, wheels=tuple(ROBOT.wheels[i] for i in order))
    text = record(ROBOT, radii=RADII, offsets=OFFSETS, twists=TURNS)
    a, _, _ = calibrated(joint_log(tmp_path, ROBOT, text))
    b, _, _ = calibrated(joint_log(tmp_path, turned, text), turned)
    for name, wheel in a.items():
        assert wheel.offset is not None
        other = b[name].offset
        assert other is not None
        assert other.value == pytest.approx(wheel.offset.value, abs=1e-7)
