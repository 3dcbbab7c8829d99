"""Stopping distances: the formula, the derived watchdog times, and simulated stops."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import pytest

from tests.model.stops import stop_bound
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import compiled
from thorvaldc.model import ParameterSet, Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.stopping import (
    DRIVER_DEAD,
    KINDS,
    STOP_LOCK,
    motor_nodes,
    reachable_speed,
    shortest_watchdog,
    stop_bounds,
)
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

SLOW_TURNS = "max_linear_velocity: 0.8 m/s, max_angular_velocity: 0.1 rad/s"
_CIA402 = ", params: {controller: controller/cia402_propulsion_steering}"


def robot(driver: str = "", controller: str = "") -> Robot:
    return compiled(f"""
thorvaldc: 1
name: two_drives
driver: {{{driver}}}
modules:
  frame: {{type: frame/tube_rectangular,
    params: {{length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left{controller}, can: 1}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right{controller}, can: 2}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
""")


def cia402(driver: str = "") -> Robot:
    return robot(driver, _CIA402)


def consumer_times(model: Robot) -> list[float | None]:
    return [node.heartbeat_consumer_time for node in model.buses[0].nodes]


def heartbeat_period(model: Robot) -> float:
    frame = next(f for f in model.buses[0].frames if f.name == "master_heartbeat")
    assert frame.period is not None
    return frame.period


# -- the formula -------------------------------------------------------------------------------


def test_the_distance_is_that_of_the_reaction_and_the_ramp() -> None:
    model = robot(SLOW_TURNS)
    a = model.driver.max_linear_acceleration
    bounds = {bound.kind: bound for bound in stop_bounds(model)}
    assert tuple(bounds) == KINDS
    for bound in bounds.values():
        assert bound.distance == pytest.approx(0.8 * bound.reaction + 0.8**2 / (2.0 * a))
    assert 0.54 < bounds["command_timeout"].reaction < 0.56
    assert 0.52 < bounds["driver_dead"].reaction < 0.54
    assert 0.12 < bounds["drive_dead"].reaction < 0.16
    assert shortest_watchdog(model) == 0.5


def test_the_longest_times_of_all_parameter_sets() -> None:
    slow = robot("command_timeout: 1 s")
    quick = ParameterSet("quick", None, replace(slow.driver, command_timeout=0.2), slow.span)
    both = replace(slow, parameter_sets=(quick,))
    assert stop_bounds(both) == stop_bounds(slow)


def test_a_slow_turn_lengthens_the_ramp() -> None:
    """The ramp changes both velocities in the same share, so that the slower one determines it."""
    fast = robot("max_linear_velocity: 0.8 m/s")
    slow = robot("max_linear_velocity: 0.8 m/s, max_angular_acceleration: 0.2 rad/s^2")
    assert stop_bound(slow, "stop_lock").distance > 2.0 * stop_bound(fast, "stop_lock").distance
    assert stop_bound(slow, DRIVER_DEAD) == stop_bound(fast, DRIVER_DEAD)


def test_a_drive_without_watchdog_never_stops() -> None:
    model = robot()
    bus = model.buses[0]
    nodes = tuple(replace(node, command_watchdog=None) for node in bus.nodes)
    model = replace(model, buses=(replace(bus, nodes=nodes),))
    assert math.isinf(stop_bound(model, DRIVER_DEAD).distance)
    assert shortest_watchdog(model) is None


def test_reachable_speed() -> None:
    for reaction in (0.0, 0.1, 0.5):
        speed = reachable_speed(0.6, reaction, 1.5)
        assert speed * reaction + speed**2 / 3.0 == pytest.approx(0.6)
    assert reachable_speed(0.6, math.inf, 1.5) == 0.0


# -- derived times -----------------------------------------------------------------------------


def test_without_a_distance_nothing_changes() -> None:
    model = cia402()
    assert model.driver.stopping_distance is None
    assert model.driver.command_timeout == 0.5
    assert consumer_times(model) == [0.5, 0.5]
    assert heartbeat_period(model) == 0.1


@pytest.mark.parametrize("distance", [0.35, 0.4, 0.5, 0.6, 1.0])
def test_derived_times_keep_the_distance(distance: float) -> None:
    model = cia402(f"{SLOW_TURNS}, stopping_distance: {distance} m")
    assert max(bound.distance for bound in stop_bounds(model)) <= distance
    (consumer_time,) = set(consumer_times(model))
    assert consumer_time is not None
    longest_response = max(f.response_time or 0.0 for f in model.buses[0].frames)
    assert consumer_time >= 2.0 * heartbeat_period(model) + longest_response
    objects = {entry.name: entry.value for entry in model.buses[0].nodes[0].objects}
    watched = objects["heartbeat_consumer_time"]
    assert watched is not None
    assert watched & 0xFFFF == round(1000.0 * consumer_time)
    assert model.driver.command_timeout <= 0.5
    if distance < 0.6:
        assert model.driver.command_timeout < 0.45
        assert consumer_time < 0.45


def test_sources_get_the_derived_time_out() -> None:
    model = cia402("max_linear_velocity: 0.8 m/s, stopping_distance: 0.5 m")
    assert {s.timeout for s in model.twist_sources} == {model.driver.command_timeout}


# -- simulated stops ---------------------------------------------------------------------------


def positions(rig: Rig) -> list[float]:
    """Returns the true way (m) of each driven wheel at the ground."""
    return [
        rig.simulated.motors[actuator.name].read(rig.now).position * wheel.radius
        for wheel in rig.robot.wheels
        if (actuator := rig.robot.actuator_of(wheel.spin_joint)) is not None
    ]


def way(before: list[float], after: list[float]) -> float:
    """Returns the mean way (m) of the wheels."""
    return sum(abs(b - a) for a, b in zip(before, after, strict=True)) / len(before)


def travelled(rig: Rig) -> float:
    """Returns the mean true distance (m) of the driven wheels; runs until they stand."""
    before = positions(rig)
    limit = rig.now + 5.0
    while rig.speed() > 0.0 and rig.now < limit:
        rig.simulated.run(0.01)
    assert rig.speed() == 0.0
    return way(before, positions(rig))


@pytest.mark.parametrize("make", [robot, cia402], ids=["Thorvald script", "CiA 402"])
def test_a_dead_driver(make: Callable[[str], Robot]) -> None:
    """The bound is kept, and it is not more than a tenth too long."""
    model = make(SLOW_TURNS)
    rig = Rig(model)
    rig.drive(Twist(0.8, 0.0, 0.0), 3.0)
    bound = stop_bound(model, DRIVER_DEAD)
    distance = travelled(rig)
    assert 0.8 * bound.distance < distance <= bound.distance


def test_a_dead_driver_with_a_stated_distance() -> None:
    model = cia402(f"{SLOW_TURNS}, stopping_distance: 0.4 m")
    rig = Rig(model)
    rig.drive(Twist(0.8, 0.0, 0.0), 3.0)
    assert travelled(rig) <= 0.4


@pytest.mark.parametrize("make", [robot, cia402], ids=["Thorvald script", "CiA 402"])
def test_commands_that_stop(make: Callable[[str], Robot]) -> None:
    model = make("max_linear_velocity: 0.8 m/s, stopping_distance: 0.7 m")
    rig = Rig(model)
    rig.drive(Twist(0.8, 0.0, 0.0), 3.0)
    rig.twist = None
    start = rig.driven.driver.state.pose.x
    rig.until(lambda: rig.state is BaseState.READY and rig.speed() == 0.0, 5.0)
    assert rig.driven.driver.state.pose.x - start <= 0.7


GRID = list(combinations(range(0, 40, 6), 2))
"""Control cycles of a stop after which two gaps begin."""


@pytest.mark.parametrize(
    ("make", "grid"),
    [
        (robot, [(5, 8)]),
        (cia402, [(5, 8)]),
        pytest.param(robot, GRID, marks=pytest.mark.slow),
        pytest.param(cia402, GRID, marks=pytest.mark.exhaustive),
    ],
    ids=["Thorvald script", "CiA 402", "Thorvald script, all", "CiA 402, all"],
)
def test_a_stop_with_two_gaps_keeps_its_bound(
    make: Callable[[str], Robot], grid: list[tuple[int, int]]
) -> None:
    """The reports are too old in the cycle after a gap, and show the late wheels in the next."""
    model, gap = make(""), 0.22
    bound = stop_bound(model, STOP_LOCK)
    for pair in grid:
        rig = Rig(model)
        rig.drive(Twist(1.4, 0.0, 0.0), 3.0)
        rig.driven.lock(model.twist_locks[0].name)
        commands: list[float] = []
        start, before = rig.now, positions(rig)
        for cycles in (pair[0], pair[1] - pair[0]):
            rig.driven.run(rig.now + cycles * rig.driven.period, watch=fastest(commands))
            rig.stall(gap)
        rig.driven.run(
            rig.now + 3.0, watch=fastest(commands), stop=lambda rig=rig: rig.speed() == 0.0
        )
        assert commands == sorted(commands, reverse=True), pair
        assert rig.now - start <= bound.time + 2.0 * gap, pair
        assert way(before, positions(rig)) <= bound.distance + 1.4 * 2.0 * gap, pair


@pytest.mark.parametrize("make", [robot, cia402], ids=["Thorvald script", "CiA 402"])
def test_a_stop_with_frozen_reports_keeps_its_bound(make: Callable[[str], Robot]) -> None:
    """All drives report the speed at which the stop began, and obey."""
    model = make("")
    bound = stop_bound(model, STOP_LOCK)
    rig = Rig(model)
    rig.drive(Twist(1.4, 0.0, 0.0), 3.0)
    injector = FaultInjector(rig.simulated, BusFaults(()))
    for bus, node in motor_nodes(model):
        injector.inject(BusFault("frozen_reports", bus.name, node.name, 0.0, None, SPAN))
    rig.run(0.1)
    rig.driven.disarm()
    start, before = rig.now, positions(rig)
    commands: list[float] = []
    rig.driven.run(rig.now + 3.0, watch=fastest(commands), stop=lambda: rig.speed() == 0.0)
    assert commands == sorted(commands, reverse=True)
    assert rig.now - start <= bound.time
    assert way(before, positions(rig)) <= bound.distance


def fastest(commands: list[float]) -> Callable[[object, DriverState], None]:
    """Returns a function that notes the fastest commanded wheel of each control cycle."""

    def note(_: object, state: DriverState) -> None:
        assert state.command is not None
        commands.append(max(map(abs, state.command.joints.speeds)))

    return note


def test_derived_watchdogs_cause_no_fault() -> None:
    model = cia402(f"{SLOW_TURNS}, stopping_distance: 0.35 m")
    rig = Rig(model)
    rig.drive(Twist(0.8, 0.0, 0.0), 20.0)
    assert rig.state is BaseState.ACTIVE
