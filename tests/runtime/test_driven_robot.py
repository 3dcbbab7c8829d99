"""Who may move a robot: arming, locks, silent sources, homing, gaps and parameters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.model.stops import stop_bound
from tests.robots import FOUR_STEERED, make_robot
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_exhaustive
from thorvaldc.model import Robot
from thorvaldc.model.stopping import COMMAND_TIMEOUT
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOT = make_robot(FOUR_STEERED)
both = pytest.mark.parametrize("kind", mostly_exhaustive(ROBOTS))


def with_driver(robot: Robot, **changes: Any) -> Robot:
    return replace(robot, driver=replace(robot.driver, **changes))


class Operators:
    """A robot on ideal joints with the twists that programs hold; ``None`` is silence."""

    def __init__(self, robot: Robot = ROBOT, base: SimBase | None = None) -> None:
        self.robot = DrivenRobot(robot, base or SimBase(robot), factor=0.0)
        self.held: dict[str, Twist | None] = {}

    def run(self, seconds: float) -> float:
        """Returns the highest speed (m/s) of the robot."""
        fastest, robot = 0.0, self.robot
        for _ in range(round(seconds / robot.period)):
            for source, twist in self.held.items():
                if twist is not None:
                    robot.multiplexer.publish(source, twist, robot.input_time, source)
            robot.step()
            fastest = max(fastest, abs(robot.driver.state.odometry.twist.vx))
        return fastest

    def drive(self, source: str = "auto_nav") -> None:
        """Arms the robot and drives with a source that has commanded zero."""
        self.held[source] = ZERO_TWIST
        self.run(0.1)
        self.robot.arm()
        self.held[source] = FORWARD
        assert self.run(1.0) > 0.4


# -- arming -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["safety_stop", "auto_nav_pause"])
def test_a_stick_that_is_held_behind_a_lock_never_arms_the_robot(name: str) -> None:
    """The twist behind a lock is zero, but the stick is not."""
    operators = Operators(with_driver(ROBOT, arming="automatic"))
    operators.robot.lock(name)
    operators.held["auto_nav"] = FORWARD
    operators.run(2.0)
    operators.robot.lock(name, False)
    assert operators.run(3.0) == 0.0
    operators.held["auto_nav"] = ZERO_TWIST
    operators.run(0.1)
    operators.held["auto_nav"] = FORWARD
    assert operators.run(1.0) > 0.4


def test_a_stop_lock_disarms_as_the_safety_stop_does() -> None:
    operators = Operators()
    operators.drive()
    operators.robot.lock("safety_stop")
    operators.run(10.0)
    assert not operators.robot.armed
    operators.robot.lock("safety_stop", False)
    assert operators.run(3.0) == 0.0
    assert operators.robot.driver.state.hold_reason == (
        "disarmed: the stop lock `safety_stop` is active"
    )
    with pytest.raises(RequestRefused, match="`auto_nav` commands a motion"):
        operators.robot.arm()


def test_a_source_below_one_that_falls_silent_does_not_start_the_robot() -> None:
    operators = Operators()
    operators.drive()
    operators.held["teleop_joy"] = ZERO_TWIST
    operators.run(2.0)
    operators.held["teleop_joy"] = None
    operators.run(0.1)
    assert operators.run(3.0) == 0.0


def test_a_client_that_comes_back_with_its_stick_held_does_not_start_the_robot() -> None:
    operators = Operators()
    operators.drive()
    operators.held["auto_nav"] = None
    operators.run(5.0)
    operators.held["auto_nav"] = FORWARD
    assert operators.run(3.0) == 0.0
    assert operators.robot.driver.state.hold_reason.endswith("command zero first")


def test_arming_ends_some_time_after_the_last_source_was_heard() -> None:
    operators = Operators(with_driver(ROBOT, arming_timeout=20.0))
    operators.drive()
    operators.held["auto_nav"] = None
    operators.run(19.0)
    assert operators.robot.armed
    operators.run(3.0)
    assert not operators.robot.armed
    operators.held["teleop_joy"] = ZERO_TWIST
    operators.run(0.2)
    operators.held["teleop_joy"] = FORWARD
    assert operators.run(1.0) == 0.0
    assert operators.robot.driver.state.hold_reason == "disarmed: no source was heard for 20 s"


# -- parameters ---------------------------------------------------------------------------------


def test_no_parameter_makes_a_stop_longer() -> None:
    operators = Operators()
    operators.drive()
    for limits in (
        {"max_linear_acceleration": 1e-6},
        {"max_linear_velocity": 5.0},
        {"max_angular_acceleration": 99.0},
    ):
        with pytest.raises(RequestRefused, match="it must be at"):
            operators.robot.set_drive_parameters(limits=limits)
    with pytest.raises(RequestRefused, match="only at rest"):
        operators.robot.set_drive_parameters(radii={"w0": 0.19})
    with pytest.raises(RequestRefused, match=r"it must be at least 0\.133"):
        operators.robot.set_drive_parameters(radii={"w0": 0.02})
    # The smallest acceleration that is accepted slows no stop.
    operators.robot.set_drive_parameters(limits={"max_linear_acceleration": 0.015})
    operators.held["auto_nav"] = None
    operators.run(0.5 + 0.5 / ROBOT.driver.max_linear_deceleration + 0.1)
    assert operators.run(0.1) == 0.0


def test_a_setting_of_a_script_makes_no_stop_longer() -> None:
    rig = Rig(ROBOTS["Thorvald script"]())
    rig.ready()
    node = rig.base.state_machine.controllers[0].node.name
    with pytest.raises(RequestRefused, match="max_propulsion_acceleration is 100; it must be at l"):
        rig.base.nodes.setup_motor_controller(node, "max_propulsion_acceleration", 100)
    with pytest.raises(RequestRefused, match="max_propulsion_speed is 9000; it must be at most"):
        rig.base.nodes.setup_motor_controller(node, "max_propulsion_speed", 9000)


# -- gaps in time -------------------------------------------------------------------------------


@both
@pytest.mark.parametrize(
    ("stall", "cycles"), [(0.22, 2), (0.22, 1), (0.12, 3), (0.17, 2), (0.24, 40)]
)
def test_stalls_again_and_again_void_no_promise(kind: str, stall: float, cycles: int) -> None:
    """The client ends; from then on the process of the driver stalls after every few cycles."""
    robot = ROBOTS[kind]()
    rig = Rig(robot)
    rig.drive(Twist(0.8, 0.0, 0.0), 2.0)
    promise = stop_bound(robot, COMMAND_TIMEOUT)
    rig.twist = None
    start, way = rig.now, 0.0
    while rig.speed() > 0.0 and rig.now - start < 20.0:
        before = rig.now
        rig.run(cycles * rig.base.period)
        speeds = [rig.speed(), *rig.stall(stall)]
        way += (rig.now - before) * max(speeds)
    # The drives hold their speed during a stall, so that each may come on top of the promise once.
    assert rig.now - start <= promise.time + 2.0 * stall + cycles * rig.base.period
    assert way <= promise.distance + 2.0 * stall * 0.8


# -- homing -------------------------------------------------------------------------------------


def unhomed(kind: str, **changes: Any) -> tuple[Rig, Callable[[], float]]:
    """Returns a robot that nobody homes, and a function for the travel (rad) of its steering."""
    rig = Rig(with_driver(ROBOTS[kind](), **changes))
    rig.homes = False
    motors = [
        rig.simulated.motors[actuator.name]
        for actuator in rig.robot.actuators
        if actuator.role == "steering"
    ]
    start = [motor.read(0.0).position for motor in motors]

    def travel() -> float:
        now = rig.now
        return max(abs(m.read(now).position - at) for m, at in zip(motors, start, strict=True))

    return rig, travel


@both
def test_no_steering_joint_turns_before_somebody_arms(kind: str) -> None:
    rig, travel = unhomed(kind)
    rig.run(20.0)
    assert rig.state is BaseState.STANDBY
    assert rig.driven.driver.state.hold_reason == "not homed; arming homes the steering"
    assert travel() == 0.0
    assert "armed when it has ended" in rig.driven.arm()
    rig.until(lambda: rig.driven.armed)
    states = [change.state for change in rig.base.changes]
    assert states[-3:] == [BaseState.STANDBY, BaseState.HOMING, BaseState.READY]


@both
def test_a_stop_lock_refuses_a_homing_and_ends_one(kind: str) -> None:
    rig, travel = unhomed(kind)
    rig.until(lambda: rig.state is BaseState.STANDBY)
    rig.driven.lock("safety_stop")
    with pytest.raises(RequestRefused, match="the stop lock `safety_stop` is active"):
        rig.driven.home_steering()
    with pytest.raises(RequestRefused, match="the stop lock `safety_stop` is active"):
        rig.driven.arm()
    rig.driven.lock("safety_stop", False)
    rig.driven.home_steering()
    rig.run(0.5)
    rig.driven.lock("safety_stop")
    rig.run(0.5)
    assert rig.state is BaseState.STANDBY
    stopped = travel()
    rig.run(2.0)
    assert travel() == pytest.approx(stopped, abs=1e-6)


def test_a_program_that_ends_during_the_homing_leaves_the_robot_disarmed() -> None:
    rig, _ = unhomed("CiA 402")
    rig.until(lambda: rig.state is BaseState.STANDBY)
    rig.driven.arm("connection 1")
    rig.run(0.5)
    rig.driven.end_program("connection 1")
    rig.until(lambda: rig.state is BaseState.READY)
    rig.run(0.5)
    assert not rig.driven.armed


@both
def test_a_homing_at_the_start_is_a_choice_of_the_robot_file(kind: str) -> None:
    rig, _ = unhomed(kind, homing="at_start")
    rig.until(lambda: rig.state is BaseState.READY)
    assert not rig.driven.armed


def test_automatic_arming_homes_when_a_source_has_commanded_zero() -> None:
    rig, travel = unhomed("CiA 402", arming="automatic")
    rig.driven.feed = None
    rig.run(10.0)
    assert travel() == 0.0  # nobody is there
    for twist, turns in ((FORWARD, False), (ZERO_TWIST, True)):
        for _ in range(20):
            rig.driven.multiplexer.publish("teleop_joy", twist, rig.now)
            rig.run(rig.base.period)
        assert (rig.state is BaseState.HOMING) is turns


def test_after_an_encoder_fault_a_reset_turns_nothing() -> None:
    rig, travel = unhomed("CiA 402")
    rig.homes = True
    rig.drive()
    rig.homes = False
    rig.twist = ZERO_TWIST
    controller = rig.base.state_machine.controllers[0]
    for axis in controller.axes:
        axis.jump = math.radians(30.0) if axis.steering else 0.0
    rig.until(lambda: rig.state is BaseState.FAULT)
    rig.run(2.0)
    turned = travel()
    rig.driven.reset()
    rig.until(lambda: rig.state is BaseState.STANDBY)
    rig.run(5.0)
    assert travel() == pytest.approx(turned, abs=1e-6)
