"""Stops on a slope, with forces computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import example_robot
from tests.robots import make_robot
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import DIRECTIONS
from thorvaldc.model.statics.slope_stops import SlopeStop, SlopeStops, steepest_stops
from thorvaldc.model.stopping import DRIVE_DEAD, STOP_LOCK

SQUARE = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)]
FRONT = ("fixed", "fixed", "passive", "passive")


def plain(kinds: tuple[str, ...], friction: float, torque: float = 1e4) -> Robot:
    """Returns a robot without rolling resistance, with equal motors."""
    robot = make_robot([(x, y, kind) for (x, y), kind in zip(SQUARE, kinds, strict=True)])
    return replace(
        robot,
        wheels=tuple(replace(w, friction=friction, rolling_resistance=0.0) for w in robot.wheels),
        actuators=tuple(replace(a, max_torque=torque) for a in robot.actuators),
    )


def stop_of(stops: SlopeStops, kind: str = STOP_LOCK) -> SlopeStop:
    return next(stop for stop in stops.stops if stop.kind == kind)


def test_four_braked_wheels_slide_with_mu() -> None:
    """Whatever the loads: a = mu g cos(t) - g sin(t)."""
    robot, angle = plain(("fixed",) * 4, 0.4), math.radians(15.0)
    expected = GRAVITY * (0.4 * math.cos(angle) - math.sin(angle))
    for direction in DIRECTIONS.values():
        stops = SlopeStops(robot, direction)
        assert expected < stop_of(stops).ramp
        found = stops.deceleration(angle, stop_of(stops))
        assert found == pytest.approx(expected, rel=1e-6)


def test_two_braked_wheels_uphill_lose_load() -> None:
    """Backwards downhill the braked front wheels are uphill.  With the lever arm l of the centre of
    mass to the rear axle, its height h and the distance L of the axles:

    N = m (g l cos(t) - h (a + g sin(t))) / L,   mu N = m (a + g sin(t))
    a + g sin(t) = mu g l cos(t) / (L + mu h);  forwards  mu g l cos(t) / (L - mu h).
    """
    robot, mu, angle = plain(FRONT, 0.3), 0.3, math.radians(5.0)
    # The wheels without motors keep turning, and their inertia pushes the robot on.
    robot = replace(robot, links=tuple(replace(link, inertial=None) for link in robot.links))
    x, _, h = robot.inertial.com
    lever = x + 0.5
    for direction, sign in (("backwards", 1.0), ("forwards", -1.0)):
        stops = SlopeStops(robot, DIRECTIONS[direction])
        pull = mu * GRAVITY * lever * math.cos(angle) / (1.0 + sign * mu * h)
        expected = pull - GRAVITY * math.sin(angle)
        found = stops.deceleration(angle, stop_of(stops))
        assert found == pytest.approx(expected, rel=1e-6)


def test_weak_motors_turn_the_inertia_of_their_wheels_too() -> None:
    robot, angle = plain(("fixed",) * 4, 5.0, torque=20.0), math.radians(10.0)
    stops, mass = SlopeStops(robot), robot.inertial.mass
    found = stops.deceleration(angle, stop_of(stops))
    rolling = 4 * (6.0 * 0.2**2 / 2.0 + robot.actuators[0].armature) / 0.2**2
    force = 4 * 20.0 / 0.2 - mass * GRAVITY * math.sin(angle)
    assert found == pytest.approx(force / (mass + rolling), rel=0.01)


def test_a_robot_that_only_gravity_could_stop_does_not_stop() -> None:
    stops = SlopeStops(plain(FRONT, 0.3), DIRECTIONS["backwards"])
    stop = stop_of(stops)
    assert stops.deceleration(math.radians(12.0), stop) == 0.0
    assert stop.distance(0.0) == math.inf


def test_a_stated_distance_needs_less_than_the_ramp() -> None:
    robot = example_robot("1wd1ws_front")
    slopes = steepest_stops(robot)
    assert slopes["backwards"] < math.radians(6.0) < slopes["forwards"]
    long = replace(robot, driver=replace(robot.driver, stopping_distance=5.0))
    angle = steepest_stops(long)["backwards"]
    assert angle > math.radians(6.0)
    stops = SlopeStops(long, DIRECTIONS["backwards"])
    longest = max(stop.distance(stops.deceleration(angle, stop)) for stop in stops.stops)
    assert 2.0 < longest < 5.0  # a part of the forces is a reserve


def test_the_loss_of_a_drive_counts_if_others_are_left() -> None:
    kinds = {stop.kind for stop in SlopeStops(example_robot("1wd1ws_front")).stops}
    assert DRIVE_DEAD not in kinds
    stops = SlopeStops(example_robot("4wd4ws_wide"))
    lost = [stop for stop in stops.stops if stop.kind == DRIVE_DEAD]
    assert [len(stop.dead) for stop in lost] == [1, 1, 1, 1]
    angle = math.radians(30.0)
    assert stops.reserve(angle, 1.0, lost[0].dead) < stops.reserve(angle, 1.0)


def tall_robot() -> Robot:
    robot = plain(("fixed",) * 4, 5.0)
    x, y, h = robot.inertial.com
    return replace(robot, inertial=replace(robot.inertial, com=(x, y, 4.0 * h)))


def test_a_ramp_tips_a_tall_robot_over_though_less_would_do() -> None:
    """On a slope t the deceleration a tips it over at (k a + g sin(t)) / (g cos(t)) = d / h.

    The wheels brake with their ramp, whatever the stopping distance needs; a servo overshoots it by
    exp(-2), and 6 % of d / h are a reserve."""
    robot = tall_robot()
    robot = replace(robot, driver=replace(robot.driver, stopping_distance=50.0))
    stops, slope = SlopeStops(robot), steepest_stops(robot)["forwards"]
    stop = stop_of(stops)
    x, _, h = robot.inertial.com
    level = (0.5 - x) / h
    spin = 4 * (6.0 * 0.2**2 / 2.0) / 0.2 / (robot.inertial.mass * h)
    assert stop.needed < 0.1 * stop.ramp
    pull = (1.0 + math.exp(-2.0)) * (1.0 + spin) * stop.ramp / GRAVITY
    assert (pull + math.sin(slope)) / math.cos(slope) == pytest.approx(0.94 * level, rel=1e-3)
    assert stops.deceleration(slope + math.radians(0.1), stop) == 0.0
    assert stops.deceleration(slope - math.radians(0.1), stop) == stop.ramp


def test_springs_lean_a_robot_downhill() -> None:
    """W d / K moves the centre of mass over the edge, and a step makes the robot swing to twice
    its lean: both lower the slope."""
    rigid = plain(("fixed",) * 4, 5.0)
    x, y, h = rigid.inertial.com
    slopes = []
    for suspended in (False, True):
        robot = make_robot([(x, y, "fixed") for x, y in SQUARE], suspended=suspended)
        robot = replace(
            robot,
            inertial=replace(rigid.inertial, com=(x, y, 2.0 * h)),
            wheels=tuple(replace(wheel, friction=5.0) for wheel in robot.wheels),
            actuators=tuple(replace(motor, max_torque=1e4) for motor in robot.actuators),
        )
        slopes.append(math.tan(steepest_stops(robot)["forwards"]))
    lean = rigid.inertial.mass * GRAVITY * (0.5 - x) / (20000.0 * 4 * 0.5**2)
    assert slopes[0] - slopes[1] > lean + 0.8 * 1.5 / GRAVITY


def test_info_states_the_slopes() -> None:
    robot = example_robot("2wd0ws_greenhouse")
    slopes = robot_facts(robot).slopes
    assert slopes is not None
    stops = {"forwards": slopes.forwards.stops, "backwards": slopes.backwards.stops}
    assert stops == steepest_stops(robot)
    assert 0.0 < slopes.backwards.stops < slopes.forwards.stops
    assert slopes.left is slopes.right is None  # its wheels do not roll sideways


def test_a_robot_that_rolls_sideways_stops_in_four_directions() -> None:
    robot = example_robot("4wd4ws_slim")  # low on its wheels, and its battery is on the left
    slopes = robot_facts(robot).slopes
    assert slopes is not None
    assert slopes.left is not None
    assert slopes.right is not None
    assert slopes.left.stops < slopes.right.stops
