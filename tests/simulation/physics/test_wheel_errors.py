"""Simulated robots with wheel errors that their drivers do not know, and calibrated robots."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.physics.sim_base import RollingBase, SimBase, WheelErrors
from thorvaldc.simulation.simulation_run import Simulation

ROBOT = make_robot(FOUR_STEERED)
NAMES = [wheel.name for wheel in ROBOT.wheels]
MANOEUVRE = [
    Segment(0.0, Twist(0.8, 0.0, 0.0)),
    Segment(3.0, Twist(0.5, 0.3, 0.6)),
    Segment(6.0, Twist(0, 0, 0)),
]
RADII = {"w0": 1.01, "w1": 0.99, "w3": 1.02}
OFFSETS = {"w0": math.radians(2.0), "w2": math.radians(-1.0)}


def with_errors(robot: Robot, radii: dict[str, float], offsets: dict[str, float]) -> Robot:
    """Returns a model that contains these errors."""
    wheels = tuple(replace(w, radius=w.radius * radii.get(w.name, 1.0)) for w in robot.wheels)
    offset_of = {w.steering_joint: offsets.get(w.name, 0.0) for w in robot.wheels}
    actuators = tuple(
        replace(a, encoder_offset=offset_of.get(a.joint, 0.0)) for a in robot.actuators
    )
    return replace(robot, wheels=wheels, actuators=actuators)


def follow(base: BaseHandle, angle: float, speed: float, seconds: float) -> None:
    """Turns all wheels to an angle, then rolls."""
    n = len(NAMES)
    base.read(0.0)
    base.write(JointCommands([0.0] * n, [angle] * n), 0.0)
    for tick in range(1, round((1.0 + seconds) * 50) + 1):
        base.read(tick / 50)
        base.write(JointCommands([speed if tick >= 50 else 0.0] * n, [angle] * n), tick / 50)


def test_ranges_of_wheel_errors() -> None:
    for ratio in (0.5, 2.0):
        assert WheelErrors.by_name(ROBOT, {"w1": ratio}).radius_ratios == (1.0, ratio, 1.0, 1.0)
    for ratio in (0.49, 2.01, math.nan):
        with pytest.raises(DiagnosticError, match=r"radius ratio of `w1` is .* 0.5 to 2"):
            WheelErrors.by_name(ROBOT, {"w1": ratio})
    for offset in (-1.0, 1.0):
        errors = WheelErrors.by_name(ROBOT, None, {"w2": offset})
        assert errors.steering_offsets == (0.0, 0.0, offset, 0.0)
    for offset in (-1.01, 1.01, math.nan):
        with pytest.raises(DiagnosticError, match=r"steering offset of `w2` is .* -1 to 1"):
            WheelErrors.by_name(ROBOT, None, {"w2": offset})


# -- ideal joints on ideal ground -------------------------------------------------------


def test_without_errors_wheels_follow_their_commands() -> None:
    rolling, ideal = RollingBase(ROBOT), SimBase(ROBOT)
    for base in (rolling, ideal):
        follow(base, 0.3, 2.0, 2.0)
    a, b = rolling.read(3.0), ideal.read(3.0)
    assert a.speeds == pytest.approx(b.speeds, abs=1e-9)
    assert a.angles == pytest.approx(b.angles, abs=1e-9)
    assert a.positions == pytest.approx(b.positions, abs=1e-3)
    pose = rolling.true_pose()
    assert math.atan2(pose.y, pose.x) == pytest.approx(0.3, abs=1e-6)


def test_unknown_errors_cause_an_end_error_and_known_ones_do_not() -> None:
    wheel_errors = {ROBOT.name: WheelErrors.by_name(ROBOT, RADII, OFFSETS)}
    unaware = Simulation(ROBOT, wheel_errors=wheel_errors).run(8.0, MANOEUVRE).robots[0]
    assert unaware.end_error > 0.02
    # A driver that knows the errors has nearly no end error.
    known = with_errors(ROBOT, RADII, OFFSETS)
    aware = Simulation(known, open_loop=True).run(8.0, MANOEUVRE).robots[0]
    assert aware.end_error < 1e-3
    assert aware.path_true == pytest.approx(aware.path_odometry, rel=1e-4)


def test_wheels_roll_along_their_direction_of_motion() -> None:
    base = RollingBase(ROBOT, WheelErrors.by_name(ROBOT, RADII, OFFSETS))
    follow(base, 0.2, 3.0, 3.0)
    states, (vx, vy, wz) = base.read(4.0), base.true_twist()
    for i, wheel in enumerate(ROBOT.wheels):
        ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
        radius = wheel.radius * RADII.get(wheel.name, 1.0)
        angle = states.angles[i] + OFFSETS.get(wheel.name, 0.0)
        assert states.speeds[i] * radius == pytest.approx(math.hypot(ux, uy), rel=1e-9)
        assert angle == pytest.approx(math.atan2(uy, ux), abs=1e-9)


# -- MuJoCo -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    pytest.importorskip("mujoco")
    return files_of(Mjcf, ROBOT)


def test_larger_wheels_drive_farther_in_mujoco(files: dict[str, bytes]) -> None:
    wheel_errors = {ROBOT.name: WheelErrors.by_name(ROBOT, dict.fromkeys(NAMES, 1.02))}
    plain = Simulation(ROBOT, files).run(4.0, MANOEUVRE).robots[0]
    larger = Simulation(ROBOT, files, wheel_errors=wheel_errors).run(4.0, MANOEUVRE).robots[0]
    assert larger.path_odometry == pytest.approx(plain.path_odometry, rel=1e-3)
    assert larger.path_true == pytest.approx(1.02 * plain.path_true, rel=1e-3)


def test_steering_offsets_change_the_direction_in_mujoco(files: dict[str, bytes]) -> None:
    offset = math.radians(5.0)
    wheel_errors = {ROBOT.name: WheelErrors.by_name(ROBOT, None, dict.fromkeys(NAMES, offset))}
    simulation = Simulation(ROBOT, files, wheel_errors=wheel_errors)
    run = simulation.run(4.0, Twist(0.8, 0.0, 0.0)).robots[0]
    assert run.pose_odometry.y == pytest.approx(0.0, abs=1e-3)
    assert math.atan2(run.pose_true.y, run.pose_true.x) == pytest.approx(offset, abs=2e-3)


def test_open_loop_drives_give_way_and_closed_loop_drives_do_not(files: dict[str, bytes]) -> None:
    wheel_errors = {ROBOT.name: WheelErrors.by_name(ROBOT, {"w0": 1.02})}

    def speeds(open_loop: bool) -> tuple[float, ...]:
        speeds_of_ticks: list[tuple[float, ...]] = []
        simulation = Simulation(ROBOT, files, wheel_errors=wheel_errors, open_loop=open_loop)
        simulation.run(
            4.0,
            Twist(0.8, 0.0, 0.0),
            on_tick=lambda loop: speeds_of_ticks.append(tuple(loop.driver.state.joints.speeds)),
        )
        return speeds_of_ticks[-1]

    held, free = speeds(open_loop=False), speeds(open_loop=True)
    assert held == pytest.approx([4.0] * 4, rel=1e-3)
    assert free[0] == pytest.approx(free[2] / 1.02, rel=2e-3)
    assert 3.0 < free[2] < 3.99


def test_a_known_offset_changes_nothing(files: dict[str, bytes]) -> None:
    known = with_errors(ROBOT, {}, OFFSETS)
    for scene_files in (None, files):
        plain = Simulation(ROBOT, scene_files).run(4.0, MANOEUVRE).robots[0]
        assert Simulation(known, scene_files).run(4.0, MANOEUVRE).robots[0] == plain


# -- invalid errors -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("radii", "offsets", "message"),
    [
        ({"w9": 1.0}, {}, "no wheel `w9`"),
        ({"w0": math.nan}, {}, "radius ratio"),
        ({"w0": 0.0}, {}, "radius ratio"),
        ({}, {"w0": math.inf}, "steering offset"),
    ],
)
def test_impossible_errors(
    radii: dict[str, float], offsets: dict[str, float], message: str
) -> None:
    with pytest.raises(DiagnosticError, match=message) as caught:
        WheelErrors.by_name(ROBOT, radii, offsets)
    assert caught.value.diagnostic.code.name == "hidden-error"


def test_offset_of_a_wheel_that_is_not_steered() -> None:
    robot = make_robot([(0.5, 0.4, "fixed"), (0.5, -0.4, "fixed"), (-0.5, 0.0, "swivel")])
    with pytest.raises(DiagnosticError, match="not steered"):
        WheelErrors.by_name(robot, None, {"w0": 0.1})
