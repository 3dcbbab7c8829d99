"""Simulation runs: results, diagnostics, default manoeuvres and the demo table."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model.model_json import to_json
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Pose2, Twist, parse_twist
from thorvaldc.simulation.control_loop import (
    Segment,
    default_manoeuvre,
    fleet_manoeuvres,
    twist_at,
)
from thorvaldc.simulation.simulation_result import result_table
from thorvaldc.simulation.simulation_run import Simulation, drive_build

pytest.importorskip("mujoco")
ROBOT = make_robot(FOUR_STEERED)


def codes(report: Report) -> list[str]:
    return [diagnostic.code.name for diagnostic in report]


def messages(report: Report) -> list[str]:
    return [diagnostic.message for diagnostic in report]


def write_build(folder: Path, robot: Robot) -> Path:
    for name, data in files_of(Mjcf, robot).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    (folder / "model.json").write_text(to_json(robot), encoding="utf-8")
    return folder


def test_a_run_on_ideal_joints_and_one_in_mujoco_agree() -> None:
    twist = Twist(0.5, 0.1, 0.2)
    ideal = Simulation(ROBOT).run(4.0, twist)
    real = Simulation(ROBOT, files_of(Mjcf, ROBOT)).run(4.0, twist)
    assert (ideal.physics, real.physics) == ("ideal", "mujoco")
    assert ideal.robots[0].end_error == 0.0
    assert real.robots[0].pose_true == pytest.approx(ideal.robots[0].pose_true, abs=0.05)


def test_same_run_gives_the_same_numbers() -> None:
    sim = Simulation(ROBOT, files_of(Mjcf, ROBOT))
    assert sim.run(2.0, Twist(0.5, 0.0, 0.3)).robots == sim.run(2.0, Twist(0.5, 0.0, 0.3)).robots


def test_result_as_json() -> None:
    result = Simulation(ROBOT).run(1.0, Twist(0.5, 0.0, 0.0))
    value = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert value["robots"][0]["wheels"] == 4
    assert value["robots"][0]["pose_odometry"]["x"] == result.robots[0].pose_odometry.x
    assert value["robots"][0]["infeasible"] == {"vx": 0.0, "vy": 0.0, "wz": 0.0}


@pytest.mark.parametrize("twist", [Twist(math.nan, 0.0, 0.0), Twist(0.0, math.inf, 0.0)])
def test_a_twist_that_is_not_finite_is_an_error(twist: Twist) -> None:
    with pytest.raises(DiagnosticError) as caught:
        Simulation(ROBOT).run(1.0, twist)
    assert caught.value.diagnostic.code.name == "twist-invalid"


@pytest.mark.parametrize("duration", [0.0, -1.0, math.inf, math.nan])
def test_a_duration_must_be_positive(duration: float) -> None:
    with pytest.raises(DiagnosticError):
        Simulation(ROBOT).run(duration, ZERO_TWIST)


def test_twists_as_text() -> None:
    assert parse_twist("1,0,0.3") == Twist(1.0, 0.0, 0.3)
    for text in ("", "1,0", "1,0,0,0", "a,b,c", "1,0,nan", "inf,0,0", "1;0;0"):
        with pytest.raises(ValueError, match="is not a twist of three finite numbers"):
            parse_twist(text)


def test_tip_over_ends_the_run_and_is_reported() -> None:
    """A tall, narrow robot turns fast."""
    narrow = [(0.5, 0.12, "steered"), (0.5, -0.12, "steered"), (-0.5, 0.12, "steered")]
    narrow.append((-0.5, -0.12, "steered"))
    robot = make_robot(narrow, body_height=1.5, body_mass=300.0)
    settings = replace(robot.driver, max_linear_acceleration=5.0, max_angular_acceleration=20.0)
    robot = replace(robot, driver=settings)
    report = Report()
    result = Simulation(robot, files_of(Mjcf, robot)).run(8.0, Twist(1.5, 0.0, 1.5), report)
    assert codes(report) == ["simulation-tipped"]
    assert result.robots[0].tipped
    assert result.simulated < 8.0
    upright = Report()
    Simulation(robot, files_of(Mjcf, robot)).run(4.0, Twist(0.3, 0.0, 0.0), upright)
    assert codes(upright) == []


def test_divergence_ends_the_run_and_is_reported() -> None:
    sim = Simulation(ROBOT, files_of(Mjcf, ROBOT))
    assert sim.scene is not None
    sim.scene.model.body_mass[2] = 1e-12
    sim.scene.model.body_inertia[2] = 1e-15
    sim.scene.model.opt.gravity[2] = -1e14
    report = Report()
    result = sim.run(2.0, Twist(0.5, 0.0, 0.0), report)
    assert result.diverged
    assert codes(report) == ["simulation-diverged"]


def test_unreachable_steering_is_reported() -> None:
    joints = tuple(
        replace(j, lower=-0.6, upper=0.6) if j.role == "steering" else j for j in ROBOT.joints
    )
    robot = replace(ROBOT, joints=joints)
    report = Report()
    result = Simulation(robot).run(2.0, Twist(0.0, 0.5, 0.0), report)
    assert codes(report) == ["steering-unreachable"]
    assert set(result.robots[0].unreachable) == {"w0", "w1", "w2", "w3"}
    assert messages(report)[0].endswith("within the joint limits; it stands")
    nearest = Report()
    Simulation(robot).run(2.0, Twist(0.5, 0.4, 0.0), nearest)
    assert "; it moves with (" in messages(nearest)[0]
    reachable = Report()
    Simulation(robot).run(2.0, Twist(0.5, 0.1, 0.0), reachable)
    assert codes(reachable) == []


def test_infeasible_twists_are_reported_but_not_the_swing_of_a_turn() -> None:
    robot = make_robot([(-0.3, 0.4, "fixed"), (-0.3, -0.4, "fixed"), (0.5, 0.0, "swivel")])
    report = Report()
    result = Simulation(robot).run(2.0, Twist(0.2, 0.5, 0.0), report)
    assert codes(report) == ["twist-infeasible"]
    assert result.robots[0].infeasible == pytest.approx((0.0, 0.5, 0.0))
    turn = Report()
    Simulation(robot).run(2.0, Twist(0.5, 0.0, 0.5), turn)
    assert codes(turn) == []


def test_demo_reads_only_the_build_folder(tmp_path: Path) -> None:
    report = Report()
    result = drive_build(write_build(tmp_path, ROBOT), report)
    assert codes(report) == []
    assert result is not None
    (robot,) = result.robots
    assert robot.path_true == pytest.approx(robot.path_commanded, rel=0.02)
    assert robot.end_error < 0.1
    table = result_table([result])
    assert "test_robot" in table
    assert "4: 4/4" in table
    assert len({line.index("true") for line in table.splitlines() if "true" in line}) == 1


def test_the_table_of_a_turn_on_the_spot_has_angles() -> None:
    result = Simulation(ROBOT).run(4.0, Twist(0.0, 0.0, 0.25), Report())
    cells = re.findall(r"(\d+\.\d) deg", result_table([result]))
    assert [float(cell) for cell in cells] == pytest.approx([50.0] * 3, abs=8.0)


def test_a_limited_twist_has_other_numbers() -> None:
    limit, report = ROBOT.driver.max_linear_velocity, Report()
    Simulation(ROBOT).run(1.0, Twist(1.002 * limit, 0.0, 0.0), report)
    (diagnostic,) = report
    commanded, limited = re.findall(r"\(.*? m/s", diagnostic.message)
    assert commanded != limited


def test_demo_reports_missing_and_broken_files(tmp_path: Path) -> None:
    report = Report()
    assert drive_build(tmp_path, report) is None
    assert codes(report) == ["model-unreadable"]
    for text in (b"{}", b"[]", b"not json", b"\xff\xfe", to_json(ROBOT)[:-40].encode()):
        (tmp_path / "model.json").write_bytes(text)
        report = Report()
        assert drive_build(tmp_path, report) is None
        assert codes(report) == ["model-unreadable"]
    (tmp_path / "model.json").write_text(to_json(ROBOT), encoding="utf-8")
    report = Report()
    assert drive_build(tmp_path, report) is None
    assert codes(report) == ["simulation-scene"]


def test_default_manoeuvre_suits_the_robot() -> None:
    def twists(robot: Robot) -> list[Twist]:
        return [twist for _, twist in default_manoeuvre(robot)[0]]

    assert any(t.vy for t in twists(ROBOT))
    axle = make_robot([(-0.3, 0.4, "fixed"), (-0.3, -0.4, "fixed"), (0.5, 0.0, "swivel")])
    assert not any(t.vy for t in twists(axle))
    assert any(t.wz and not t.vx for t in twists(axle))
    joints = tuple(
        replace(j, lower=-0.6, upper=0.6) if j.role == "steering" else j for j in ROBOT.joints
    )
    narrow = twists(replace(ROBOT, joints=joints))
    assert not any(t.vy for t in narrow)
    assert not any(t.wz and not t.vx for t in narrow)


def test_robots_of_a_fleet_keep_apart() -> None:
    """A robot drives sideways, unless another robot stands there that cannot."""
    axle = make_robot([(-0.3, 0.4, "fixed"), (-0.3, -0.4, "fixed"), (0.5, 0.0, "swivel")])

    # After the arc of 2 rad, the second robot stands to the left of the first.
    def sideways(distance: float) -> bool:
        second = Pose2(-0.91 * distance, -0.42 * distance, 0.0)
        robots = [("a", ROBOT, ORIGIN), ("b", axle, second)]
        plans, duration = fleet_manoeuvres(robots)
        assert duration == max(start for start, _ in plans["a"]) + 2.0
        assert [start for start, _ in plans["a"]] == [start for start, _ in plans["b"]]
        return any(twist.vy for _, twist in plans["a"])

    assert sideways(20.0)
    assert not sideways(2.5)
    assert fleet_manoeuvres([]) == ({}, 2.0)


def test_twist_at() -> None:
    plan = [Segment(1.0, Twist(1.0, 0.0, 0.0)), Segment(2.0, ZERO_TWIST)]
    assert twist_at(plan, 0.5) == ZERO_TWIST
    assert twist_at(plan, 1.0).vx == 1.0
    assert twist_at(plan, 2.0) == ZERO_TWIST
