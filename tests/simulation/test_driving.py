"""Robots that the base driver controls in MuJoCo follow their commands."""

from __future__ import annotations

import math
from functools import cache

import pytest

from tests.backend_files import files_of
from tests.backends.plans import ROBOTS
from tests.examples import SAMPLED_ROBOTS, example_fleet, example_robot, sampled
from tests.robots import FOUR_STEERED, make_robot
from tests.workshop import Workshop
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.diagnostics import Report
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment
from thorvaldc.simulation.simulation_result import RobotResult
from thorvaldc.simulation.simulation_run import Simulation

pytest.importorskip("mujoco")

S, F, P = "steered", "fixed", "passive"
SQUARE = ((0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45))
ROBOTS_OF_TESTS = {
    "four steered": make_robot(FOUR_STEERED),
    "six steered, suspended": make_robot(
        [(x, y, S) for x, y in (*SQUARE, (0.1, 0.6), (-0.1, -0.6))], suspended=True
    ),
    "two steered, two fixed": make_robot([(x, y, S if x > 0 else F) for x, y in SQUARE]),
    "one drives in front": make_robot([(0.6, 0.0, S), (-0.5, 0.45, P), (-0.5, -0.45, P)]),
    "one drives behind": make_robot([(-0.6, 0.0, S), (0.5, 0.45, P), (0.5, -0.45, P)]),
    "five": make_robot([*((x, y, S) for x, y in SQUARE), (0.0, 0.0, P)]),
    "seven, two sizes of track": make_robot(
        [*((x, y, S) for x, y in SQUARE), (1.2, 0.3, S), (1.2, -0.3, S), (-1.1, 0.0, S)]
    ),
}
SAMPLE = (
    *sampled(ROBOTS_OF_TESTS, ["two steered, two fixed", "one drives behind"]),
    *SAMPLED_ROBOTS,
)


@cache
def simulation(name: str) -> Simulation:
    if name in ROBOTS_OF_TESTS:
        return Simulation(ROBOTS_OF_TESTS[name], files_of(Mjcf, ROBOTS_OF_TESTS[name]))
    return Simulation(example_robot(name), files_of(Mjcf, example_robot(name)))


def drive(name: str, twist: Twist, seconds: float) -> RobotResult:
    """Drives a twist and stops; the driver turns the wheels before it drives."""
    sim = simulation(name)
    plan = [Segment(0.0, twist), Segment(seconds, ZERO_TWIST)]
    return sim.run(seconds + 1.5, plan).robots[0]


def fast(name: str) -> float:
    (robot,) = simulation(name).robots.values()
    return min(1.0, 0.8 * robot.driver.max_linear_velocity)


@pytest.mark.parametrize("name", SAMPLE)
def test_straight_distance_agrees_with_the_wheels(name: str) -> None:
    run = drive(name, Twist(fast(name), 0.0, 0.0), 4.0)
    assert run.path_odometry > 2.0
    # One wheel that drives the whole robot has a stiff servo, integrated implicitly.
    tolerance = 1e-3 if run.driven == 1 else 1e-4
    assert run.path_true == pytest.approx(run.path_odometry, rel=tolerance)
    assert run.path_commanded == pytest.approx(run.path_odometry, rel=1e-2)
    assert abs(run.pose_true.yaw) < 5e-3


@pytest.mark.parametrize("name", SAMPLE)
@pytest.mark.parametrize("twist", [Twist(0.5, 0.0, 0.3), Twist(0.0, 0.0, -0.4)])
def test_turning_agrees_with_the_wheels(name: str, twist: Twist) -> None:
    if name == "car":  # a circle of 2.5 m instead of the two that its steering limits exclude
        twist = Twist(math.copysign(0.8, twist.wz), 0.0, 0.32)
    run = drive(name, twist, 8.0)
    assert abs(run.pose_odometry.yaw) > 2.0
    assert run.pose_true.yaw == pytest.approx(run.pose_odometry.yaw, rel=1e-2)
    assert run.end_error < 0.01 * max(run.path_odometry, 2.0)


@pytest.mark.parametrize(
    ("middle", "bound"),
    # Coulomb friction does not depend on the slip speed, but the least-squares fit of the
    # odometry assumes that it does.
    [((), 0.02), (((0.0, 0.45), (0.0, -0.45)), 0.08)],
)
def test_skid_steering_follows_the_commanded_yaw_rate(
    middle: tuple[tuple[float, float], ...], bound: float
) -> None:
    robot = make_robot([(x, y, F) for x, y in (*SQUARE, *middle)])
    sim = Simulation(robot, files_of(Mjcf, robot))
    for twist in (Twist(0.0, 0.0, 0.4), Twist(0.5, 0.0, 0.3)):
        run = sim.run(9.5, [Segment(0.0, twist), Segment(8.0, ZERO_TWIST)]).robots[0]
        assert run.pose_true.yaw == pytest.approx(twist.wz * 8.0, rel=bound)
        assert run.pose_odometry.yaw == pytest.approx(run.pose_true.yaw, rel=bound)


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_every_example_drives_its_default_manoeuvre(name: str) -> None:
    sim = simulation(name)
    result = sim.demonstrate()
    (run,) = result.robots
    assert not run.tipped
    assert run.unreachable == ()
    assert run.largest_tilt < math.radians(5)
    assert run.path_true == pytest.approx(run.path_commanded, rel=0.02)
    assert run.end_error < 0.01 * run.path_true


def test_the_fleet_drives_without_collisions() -> None:
    fleet = example_fleet("fleet_of_four")
    result = Simulation(fleet, files_of(Mjcf, fleet)).demonstrate()
    assert len(result.robots) == 4
    for run in result.robots:
        assert run.path_true > 5.0
        assert run.end_error < 0.01 * run.path_true


def test_robot_stops_while_a_wheel_turns_around() -> None:
    """Two curves: in the second one a wheel would pass its limit of 176 deg."""
    sim = simulation("6wd6ws_asymmetric")
    plan = [Segment(0.0, Twist(-0.92, 0.52, 0.24)), Segment(4.0, Twist(0.96, 0.23, -0.18))]
    slips: list[float] = [0.0]
    stops: list[bool] = []

    def on_tick(loop: ControlLoop) -> None:
        sample, state = loop.sample(), loop.driver.state
        if state.command is not None and state.joints is not None:
            stops.append(state.command.must_stop)
            for wheel, angle in zip(loop.robot.wheels, state.joints.angles, strict=True):
                vx, vy, wz = sample.true
                c, s = math.cos(wheel.heading + angle), math.sin(wheel.heading + angle)
                slips.append(abs(c * (vy + wz * wheel.x) - s * (vx - wz * wheel.y)))

    run = sim.run(12.0, plan, None, on_tick).robots[0]
    assert any(stops[200:400])
    assert not any(stops[400:])
    # Without the stop a wheel slides sideways at 0.5 m/s, repeatedly.
    assert max(slips) < 0.06
    assert run.end_error < 0.02


@pytest.mark.parametrize("twist", [Twist(0.0, 0.0, 0.5), Twist(0.5, 0.0, 0.3)])
def test_cambered_wheels_turn_the_robot_by_the_angle_of_their_encoders(twist: Twist) -> None:
    """Wheels tilted by 6 and 9 deg; torsional friction causes the remaining error."""
    robot = ROBOTS["cambered"]
    plan = [Segment(0.0, twist), Segment(8.0, ZERO_TWIST)]
    run = Simulation(robot, files_of(Mjcf, robot)).run(10.0, plan).robots[0]
    assert abs(run.pose_odometry.yaw) > 2.0
    assert run.pose_true.yaw == pytest.approx(run.pose_odometry.yaw, rel=1e-3)


def test_robot_with_trail_crosses_the_circle_of_a_contact_point(workshop: Workshop) -> None:
    """The robot stayed at (0.193, -0.255, 0.553): its wheels never turned to the second twist."""
    places = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4), (0.0, 0.35)]
    legs = "".join(
        f"w{i}: {{type: t/leg, mount: {{parent: body, xyz: [{x}, {y}, 0]}}, params: "
        f"{{turns: steers, limit: 90 deg, trail: {-0.05 if x else -0.09}}}}}\n"
        for i, (x, y) in enumerate(places)
    )
    robot = workshop.robot(f"body: {{type: t/plate}}\n{legs}")
    start = Twist(0.17970416274532544, -0.1908631455250737, 0.5528395293112488)
    goal = Twist(0.23816973155003257, -0.31440430568275246, 0.5528395293112488)
    true: list[Twist] = []
    report = Report()
    Simulation(robot, files_of(Mjcf, robot)).run(
        12.0,
        [Segment(0.0, start), Segment(6.0, goal)],
        report,
        on_tick=lambda loop: true.append(loop.sample().true),
    )
    last = true[-50:]
    mean = [sum(component) / len(last) for component in zip(*last, strict=True)]
    assert mean == pytest.approx(goal, abs=0.01)
    assert not [d.message for d in report]
