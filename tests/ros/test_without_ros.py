"""The parts of the node that need no ROS."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.ros import parameter_table
from tests.simulation.bus.robots import drives
from thorvaldc.ros.parameters import PARAMETERS
from thorvaldc.ros.topic_twists import ClockWatch, TwistInputs
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.run_time_parameters import COMMAND_TIMEOUT, LIMITS
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.sim_base import SimBase

FORWARD = Twist(0.3, 0.0, 0.0)
SOURCE = "auto_nav"
FUTURE = "the stamp of the twist is 0.200 s in the future; max_command_lead is 0.1 s"


def test_defaults_are_in_their_ranges_for_every_example() -> None:
    assert len({p.name for p in PARAMETERS}) == len(PARAMETERS)
    for name in SAMPLED_ROBOTS:
        robot = example_robot(name)
        for parameter in PARAMETERS:
            default = parameter.default_for(robot)
            assert type(default) in (str, bool, float), parameter.name
            if isinstance(default, float):
                lowest, highest = parameter.range_for(robot)
                assert lowest <= default <= highest, parameter.name


def test_the_page_has_every_parameter() -> None:
    page = parameter_table.PAGE.read_text(encoding="utf-8")
    assert parameter_table.text() == page, "make golden writes it"


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_no_limit_can_be_set_outside_of_its_range(name: str) -> None:
    """The range is that of the robot file; the rule is that of the driver, whoever asks."""
    robot = example_robot(name)
    driver = BaseDriver(robot, SimBase(robot))
    for parameter in PARAMETERS:
        if parameter.name not in (*LIMITS, COMMAND_TIMEOUT):
            continue
        lowest, highest = parameter.range_for(robot)
        assert 0.0 < lowest < getattr(robot.driver, parameter.name)
        assert highest >= getattr(robot.driver, parameter.name)
        for value in (0.99 * lowest, 1.01 * highest, 1e6, math.inf, math.nan):
            with pytest.raises(ParameterError, match=parameter.name):
                driver.update(**{parameter.name: value})


def test_without_ros_the_program_says_how_to_get_it() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "thorvaldc.ros.base_driver"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 3
    assert result.stderr.startswith("error: the Python package rclpy of ROS 2 is missing in ")
    assert "setup.bash" in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_real_robot_needs_no_simulation() -> None:
    program = (
        "import sys, thorvaldc.ros.bases, thorvaldc.ros.parameters\n"
        "rooms = ('numpy', 'mujoco', 'thorvaldc.simulation', 'thorvaldc.compiler')\n"
        "print([r for r in rooms if r in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr


def test_a_clock_that_stands_or_jumps_is_noticed() -> None:
    watch = ClockWatch()
    assert watch.update(0.0, -9.0, 0.5) == ""
    assert watch.update(0.0, -0.1, 0.5) == ""
    assert watch.problem == "the clock /clock has not run yet"
    assert watch.update(5.0, 0.0, 0.5) == "the clock /clock jumped by 5.000 s"
    assert not watch.problem
    assert watch.update(5.1, 0.1, 0.5) == ""
    assert watch.update(5.1, 0.6, 0.5) == ""
    assert not watch.problem
    assert watch.update(5.1, 0.61, 0.5) == ""
    assert watch.problem == "the clock /clock stands still at 5.100 s"
    assert watch.update(5.2, 0.7, 0.5) == ""
    assert not watch.problem
    assert watch.update(1.0, 0.8, 0.5) == "the clock /clock jumped back by 4.200 s"
    assert watch.update(2.0, 0.9, 0.5) == ""
    assert watch.update(3.1, 1.0, 0.5) == "the clock /clock jumped by 1.100 s"


def test_the_change_between_the_clocks_is_a_jump() -> None:
    watch = ClockWatch()
    assert watch.update(None, 0.0, 0.5) == ""
    assert watch.update(None, 9.0, 0.5) == ""
    assert watch.update(5.0, 9.1, 0.5) == "use_sim_time has become true"
    assert watch.update(5.0, 9.7, 0.5) == ""
    assert watch.problem == "the clock /clock has not run yet"
    assert watch.update(None, 9.8, 0.5) == "use_sim_time has become false"
    assert not watch.problem
    assert watch.update(None, 9.9, 0.5) == ""


class Machine:
    """A simulated robot with ideal joints and a clock that the test moves."""

    def __init__(self) -> None:
        self.time = 0.0
        self.robot = self.make(lambda: self.time)

    def make(self, clock: Callable[[], float]) -> DrivenRobot:
        robot = example_robot("2wd0ws_greenhouse")
        return DrivenRobot(robot, SimBase(robot), real_time=clock)

    def drive(self, seconds: float = 1.0) -> float:
        """Commands zero, then FORWARD; returns the speed of the robot, m/s."""
        self.run(0.05, ZERO_TWIST)
        return self.run(seconds, FORWARD)

    def run(self, seconds: float, twist: Twist | None = None) -> float:
        """Runs the cycles that are due and returns the speed of the robot, m/s."""
        end = self.time + seconds
        while self.time < end - 1e-9:
            if twist is not None and not self.robot.void_reason():
                robot = self.robot
                robot.multiplexer.publish(SOURCE, twist, robot.input_time, "ROS")
            if self.robot.wait() <= 0.0:
                self.robot.run_due_cycle()
            self.time += 0.01
        return self.robot.driver.state.odometry.twist.vx


class MachineOnBuses(Machine):
    """A robot on simulated buses, whose virtual time follows a clock that the test moves.

    ``factor``: speed of the buses relative to the clock, 0 for as fast as possible.
    """

    def __init__(self, factor: float) -> None:
        self.factor = factor
        super().__init__()

    def make(self, clock: Callable[[], float]) -> DrivenRobot:
        robot = drives()
        simulated = SimulatedRobot(robot)
        simulated.power_on()
        interfaces = {bus.name: simulated.interface(bus.name) for bus in robot.buses}
        base = CanBase(robot, interfaces, threaded=False)
        bus = interfaces[robot.buses[0].name]
        return DrivenRobot(robot, base, bus, factor=self.factor, real_time=clock)


def test_a_simulated_robot_moves_only_after_arming() -> None:
    machine = Machine()
    assert machine.run(1.0, FORWARD) == 0.0
    with pytest.raises(ServiceError, match="`auto_nav` commands a motion"):
        machine.robot.call("arm")
    machine.run(1.0)
    machine.robot.call("arm")
    assert machine.run(1.0, FORWARD) == 0.0  # the source was silent, and begins with a motion
    assert machine.drive() == pytest.approx(0.3)
    machine.robot.call("disarm")
    assert machine.run(1.0, FORWARD) == 0.0


def test_after_a_gap_in_real_time_a_zero_twist_comes_first() -> None:
    machine = Machine()
    machine.run(0.1)
    machine.robot.call("arm")
    machine.drive()
    machine.time += 2.0  # the process was frozen
    assert "commands that waited do not count" in machine.robot.void_reason()
    with pytest.raises(ServiceError, match="no control cycle for "):
        machine.robot.call("reset_odometry", "ROS")
    assert machine.run(1.0, FORWARD) == 0.0
    reason = machine.robot.driver.state.hold_reason
    assert reason.endswith(" ms; command zero first"), reason
    machine.run(0.05, ZERO_TWIST)
    assert machine.run(1.0, FORWARD) == pytest.approx(0.3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_buses_run_faster_or_slower_than_real_time(factor: float) -> None:
    machine = MachineOnBuses(factor)
    machine.run(1.0)
    assert machine.robot.now == pytest.approx(factor, abs=0.05)
    machine.robot.shutdown()


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "stops"), [(1.0, True), (0.0, False)])
def test_a_frozen_process_is_a_gap_of_buses_that_keep_to_real_time(
    factor: float, stops: bool
) -> None:
    """Buses that run as fast as possible have no relation to the real time."""
    machine = MachineOnBuses(factor)
    machine.run(1.0)
    while machine.robot.base.is_homed:
        machine.run(0.5)
    assert "armed when it has ended" in machine.robot.call("arm")
    while not machine.robot.armed:
        machine.run(1.0)
    assert machine.drive() == pytest.approx(0.3, abs=0.05)
    machine.time += 2.0
    assert ("no control cycle for " in machine.robot.void_reason()) == stops
    speed = machine.run(1.5, FORWARD)
    assert abs(speed) < 0.01 if stops else speed == pytest.approx(0.3, abs=0.05)
    reason = machine.robot.driver.state.hold_reason
    assert reason.startswith("no control cycle for 2") == stops
    assert reason.endswith(" ms; command zero first") == stops
    machine.robot.shutdown()


@pytest.mark.parametrize("stamped", [False, True])
@pytest.mark.parametrize(("waited", "counts"), [(0.1, True), (0.9, False), (3600.0, False)])
def test_a_zero_twist_from_a_gap_does_not_count_after_it(
    waited: float, counts: bool, stamped: bool
) -> None:
    """The middleware delivers it late, on a busy computer; an hour is a clock that is wrong."""
    machine = Machine()
    machine.run(0.1)
    machine.robot.call("arm")
    machine.drive()
    machine.time += 2.0  # the process was frozen
    machine.run(0.8)
    values = {"max_command_age": 0.5, "max_command_lead": 0, "base_frame_id": "base_link"}
    inputs = TwistInputs(machine.robot.driver.robot, values)
    zero = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    twist = SimpleNamespace(linear=zero, angular=zero)
    header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
    message = SimpleNamespace(header=header, twist=twist)

    def publish() -> None:
        if stamped:  # with a stamp of zero, which means now
            inputs.publish_stamped(machine.robot, SOURCE, message, "", machine.time, waited)
        else:
            inputs.publish(machine.robot, SOURCE, twist, "", waited=waited)

    publish()
    assert (inputs.refused == {}) == counts
    machine.run(0.05)  # a cycle takes the twist
    assert (machine.run(1.0, FORWARD) > 0.0) == counts
    machine.run(10.0)
    publish()
    machine.run(0.05)
    assert machine.run(1.0, FORWARD) > 0.0


def test_refused_twists_are_counted_with_the_newest_reason() -> None:
    machine = Machine()
    values = {"max_command_age": 0.5, "max_command_lead": 0.1}
    inputs = TwistInputs(machine.robot.driver.robot, values)

    def publish(robot: DrivenRobot | None, vx: float, age: float = 0.0) -> None:
        vector = SimpleNamespace(x=vx, y=0.0, z=0.0)
        message = SimpleNamespace(linear=vector, angular=SimpleNamespace(x=0.0, y=0.0, z=0.0))
        inputs.publish(robot, SOURCE, message, "", age)

    assert inputs.summary()[SOURCE] == {"received": 0, "refused": 0, "reason": ""}
    for robot, vx, age, count, reason in (
        (None, 0.3, 0.0, 1, "the node is inactive"),
        (machine.robot, math.nan, 0.0, 2, "the twist is not finite"),
        (machine.robot, 0.3, 0.6, 3, "the twist is 0.600 s old; max_command_age is 0.5 s"),
        (machine.robot, 0.3, -0.2, 4, FUTURE),
        (machine.robot, 0.0, 0.4, 4, FUTURE),
        (machine.robot, 0.0, -0.05, 4, FUTURE),
    ):
        publish(robot, vx, age)
        summary = inputs.summary()[SOURCE]
        assert (summary["refused"], summary["reason"]) == (count, reason)
    assert inputs.summary()[SOURCE]["received"] == 6


def test_twists_of_another_type_are_named_while_somebody_publishes_them() -> None:
    warnings: list[str] = []
    inputs = TwistInputs(example_robot("2wd0ws_greenhouse"), {}, warnings.append)
    taken, other = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"
    for published in ([], [taken], [other, taken, other], [other]):
        inputs.note_types(SOURCE, published, taken)
    reason = inputs.summary()[SOURCE]["reason"]
    assert reason == f"a program sends {other}; the node takes {taken} (parameter `stamped`)"
    assert warnings == [f"`{SOURCE}`: {reason}"]
    inputs.note_types(SOURCE, [taken], taken)
    assert inputs.summary()[SOURCE]["reason"] == ""


def test_stamped_twists_are_in_the_frame_of_the_robot_and_of_now() -> None:
    machine = Machine()
    warnings: list[str] = []
    values = {"max_command_age": 0.5, "max_command_lead": 0.1, "base_frame_id": "base_link"}
    inputs = TwistInputs(machine.robot.driver.robot, values, warnings.append)
    zero = SimpleNamespace(x=0.0, y=0.0, z=0.0)

    def refused(time: float, frame: str) -> int:
        stamp = SimpleNamespace(sec=int(time), nanosec=round(time % 1.0 * 1e9))
        header = SimpleNamespace(stamp=stamp, frame_id=frame)
        message = SimpleNamespace(header=header, twist=SimpleNamespace(linear=zero, angular=zero))
        inputs.publish_stamped(machine.robot, SOURCE, message, "", 1000.0)
        return inputs.refused.get(SOURCE, (0, ""))[0]

    assert refused(999.75, "base_link") == 0
    assert refused(1000.0, "") == 0
    assert not warnings
    assert refused(0.0, "") == 0
    assert refused(0.0, "") == 0
    assert warnings == [f"the twists of `{SOURCE}` have a stamp of zero: they count as sent now"]
    assert refused(1.0, "base_link") == 1
    assert refused(1000.0, "map") == 2
    reason = "the twist is in the frame `map`; `base_link` and an empty frame are accepted"
    assert inputs.refused[SOURCE][1] == reason


def test_a_pause_voids_the_commands() -> None:
    machine = Machine()
    machine.run(0.1)
    machine.robot.call("arm")
    machine.drive()
    machine.robot.pause(True)
    before = machine.robot.now
    machine.run(1.0, FORWARD)
    assert machine.robot.now == before
    machine.robot.pause(False)
    assert machine.run(1.0, FORWARD) == 0.0


def test_stop_brings_the_robot_to_rest() -> None:
    machine = Machine()
    machine.run(0.1)
    machine.robot.call("arm")
    assert machine.drive() > 0.2
    machine.robot.shutdown()
    assert abs(machine.robot.driver.state.odometry.twist.vx) < 1e-3
