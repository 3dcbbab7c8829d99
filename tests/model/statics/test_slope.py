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
from thorvaldc.model.statics.slope import SlopeStop, SlopeStops, steepest_stops
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
    stops, angle = SlopeStops(plain(("fixed",) * 4, 0.4)), math.radians(15.0)
    expected = GRAVITY * (0.4 * math.cos(angle) - math.sin(angle))
    assert expected < stop_of(stops).ramp
    for backwards in (False, True):
        found = stops.deceleration(angle, stop_of(stops), backwards=backwards)
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
    stops, lever = SlopeStops(robot), x + 0.5
    for backwards, sign in ((True, 1.0), (False, -1.0)):
        pull = mu * GRAVITY * lever * math.cos(angle) / (1.0 + sign * mu * h)
        expected = pull - GRAVITY * math.sin(angle)
        found = stops.deceleration(angle, stop_of(stops), backwards=backwards)
        assert found == pytest.approx(expected, rel=1e-6)


def test_weak_motors_turn_the_inertia_of_their_wheels_too() -> None:
    robot, angle = plain(("fixed",) * 4, 5.0, torque=20.0), math.radians(10.0)
    stops, mass = SlopeStops(robot), robot.inertial.mass
    found = stops.deceleration(angle, stop_of(stops), backwards=False)
    rolling = 4 * (6.0 * 0.2**2 / 2.0 + robot.actuators[0].armature) / 0.2**2
    force = 4 * 20.0 / 0.2 - mass * GRAVITY * math.sin(angle)
    assert found == pytest.approx(force / (mass + rolling), rel=0.01)


def test_a_robot_that_only_gravity_could_stop_does_not_stop() -> None:
    stops = SlopeStops(plain(FRONT, 0.3))
    stop = stop_of(stops)
    assert stops.deceleration(math.radians(12.0), stop, backwards=True) == 0.0
    assert stop.distance(0.0) == math.inf


def test_a_stated_distance_needs_less_than_the_ramp() -> None:
    robot = example_robot("1wd1ws_front")
    front, rear = steepest_stops(robot)
    assert rear < math.radians(6.0) < front
    long = replace(robot, driver=replace(robot.driver, stopping_distance=5.0))
    assert steepest_stops(long)[1] > math.radians(8.0)
    angle = steepest_stops(long)[1]
    stops = SlopeStops(long)
    longest = max(
        stop.distance(stops.deceleration(angle, stop, backwards=True)) for stop in stops.stops
    )
    assert longest == pytest.approx(5.0, rel=1e-3)


def test_the_loss_of_a_drive_counts_if_others_are_left() -> None:
    kinds = {stop.kind for stop in SlopeStops(example_robot("1wd1ws_front")).stops}
    assert DRIVE_DEAD not in kinds
    stops = SlopeStops(example_robot("4wd4ws_wide"))
    lost = [stop for stop in stops.stops if stop.kind == DRIVE_DEAD]
    assert [len(stop.dead) for stop in lost] == [1, 1, 1, 1]
    angle = math.radians(30.0)
    whole = stops.reserve(angle, 1.0, backwards=False)
    assert stops.reserve(angle, 1.0, lost[0].dead, backwards=False) < whole


def test_a_robot_that_would_tip_over_does_not_brake_harder() -> None:
    """On a slope t the deceleration a tips it over at (a + g sin(t)) / (g cos(t)) = d / h."""
    robot = plain(("fixed",) * 4, 5.0)
    x, y, h = robot.inertial.com
    robot = replace(robot, inertial=replace(robot.inertial, com=(x, y, 4.0 * h)))
    margin = (0.5 - x) / (4.0 * h)
    angle = math.atan(margin) - math.radians(3.0)
    stops = SlopeStops(robot)
    found = stops.deceleration(angle, stop_of(stops), backwards=False)
    expected = GRAVITY * (margin * math.cos(angle) - math.sin(angle))
    assert found == pytest.approx(expected, rel=1e-6)


def test_info_states_the_slopes() -> None:
    robot = example_robot("2wd0ws_greenhouse")
    slopes = robot_facts(robot).slopes
    assert slopes is not None
    assert (slopes.forwards.stops, slopes.backwards.stops) == steepest_stops(robot)
    assert 0.0 < slopes.backwards.stops < slopes.forwards.stops
