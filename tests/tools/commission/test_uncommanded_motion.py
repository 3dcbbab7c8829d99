"""A wheel that turns although nobody commands it is named at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.slow import mostly_slow
from tests.tools.commission.assemblies import Assembly, Outcome, run_checks
from tests.tools.commission.test_motor_checks import example, moves, robot_of
from tests.tools.commission.test_stop_causes import passed
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.model.robot import Brake
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.bus.wire import CanController
from thorvaldc.tools.commission.motor_session import MotorSession
from thorvaldc.tools.commission.questions import Question
from thorvaldc.tools.commission.simulated_operator import SimulatedOperator
from thorvaldc.tools.commission.uncommanded_motion import UncommandedMotion

LIMIT = 1.0
"""Longest time (s) from the begin of the motion until the operator is told."""


def injection(robot: Robot, motor: str, kind: str) -> Callable[[SimulatedRobot], None]:
    """Injects a fault into the channel of a motor, or into its drive."""
    bus, node, channel = next(
        (bus, node, channel)
        for bus in robot.buses
        for node in bus.nodes
        for channel in node.channels
        if channel.actuator == motor
    )
    values = {"channel": channel.name, "speed": 1.0} if kind == "runaway_motor" else {}
    fault = BusFault(
        kind=kind,
        bus=bus.name,
        span=bus.span,
        node=node.name,
        time=None,
        frame=None,
        **values,  # type: ignore[arg-type]
    )
    return lambda simulated: FaultInjector(simulated, BusFaults(())).inject(fault)


class Record:
    """Times (s) of one run of the checks.

    - ``injected``: of the fault; ``reported``: of the first report of a motor;
    - ``commanded``: of the latest command to the motor with the fault;
    - ``alarm``: when the operator is told; ``rest``: from which on the wheel stands.
    """

    def __init__(self) -> None:
        self.injected = self.reported = self.alarm = math.nan
        self.commanded = self.rest = -math.inf
        self.text = ""

    @property
    def delay(self) -> float:
        """Time (s) from the motion that nobody commands to the alarm."""
        return self.alarm - max(self.injected, self.reported, self.commanded)


Moment = Callable[[SimulatedRobot, MotorSession], bool]


def disturbed(
    robot: Robot,
    motor: str,
    kind: str,
    moment: str | Moment,
    prepare: Callable[[SimulatedRobot], object] = lambda simulated: None,
) -> tuple[Outcome, Record]:
    """Runs the checks with a fault from a moment on."""
    record, inject = Record(), injection(robot, motor, kind)
    begins = MOMENTS[moment] if isinstance(moment, str) else moment

    class Listener(SimulatedOperator):
        def alarm(self, text: str) -> None:
            record.alarm, record.text = self._simulated.timeline.seconds, text

    def watch(simulated: SimulatedRobot, session: MotorSession) -> bool:
        now = simulated.timeline.seconds
        (axis,) = [axis for axis in session.base.axes if axis.actuator.name == motor]
        if math.isnan(record.reported) and math.isfinite(axis.velocity):
            record.reported = now
        if math.isnan(record.injected) and begins(simulated, session):
            record.injected = now
            inject(simulated)
        if session.base.commands(axis):
            record.commanded = now
        return False

    def start(simulated: SimulatedRobot) -> None:
        def look() -> None:
            now = simulated.timeline.seconds
            if abs(simulated.motors[motor].read(now).velocity) > 0.02:
                record.rest = now
            simulated.timeline.after(20_000_000, look)

        look()
        prepare(simulated)

    outcome = run_checks(Assembly(robot), stop=watch, prepare=start, person=Listener)
    assert not math.isnan(record.injected)
    return outcome, record


MOMENTS: dict[str, Moment] = {
    "at power-on": lambda simulated, session: True,
    "while waiting": lambda simulated, session: (
        simulated.timeline.seconds > 3.0 and not moves(session)
    ),
    "in a motion": lambda simulated, session: moves(session),
    "in the safety stop": lambda simulated, session: session.base.state_machine.stop_engaged,
    "in the silence": lambda simulated, session: session.base.starves_drives,
    "in a homing": lambda simulated, session: any(
        axis.powered and abs(axis.velocity) > 0.1 for axis in session.base.axes if axis.steering
    ),
}


GREENHOUSE, LSS, STEERED = "2wd0ws_greenhouse", "lss", "1wd1ws_front"
LEFT, RIGHT = "left_drive_propulsion", "right_drive_propulsion"
RUNAWAYS = [
    (GREENHOUSE, LEFT, "at power-on", "wheel left_wheel (controller left)"),
    (LSS, RIGHT, "in a motion", "wheel right_wheel (right_controller propulsion)"),
    (LSS, LEFT, "in a motion", "wheel left_wheel (left_controller propulsion)"),  # the driven one
    (LSS, RIGHT, "in the silence", "wheel right_wheel (right_controller propulsion)"),
    (LSS, RIGHT, "at power-on", "wheel right_wheel (right_controller propulsion)"),
    (GREENHOUSE, RIGHT, "while waiting", "wheel right_wheel (controller right)"),
    (GREENHOUSE, RIGHT, "in the safety stop", "wheel right_wheel (controller right)"),
    (GREENHOUSE, LEFT, "in a motion", "wheel left_wheel (controller left)"),
    (STEERED, "front_drive_propulsion", "in a homing", "wheel front_wheel (front_controller prop"),
    (
        STEERED,
        "front_steering_steering",
        "in a motion",
        "steering of wheel front_wheel (front_contr",
    ),
]


@pytest.mark.parametrize("case", mostly_slow(RUNAWAYS, quick=3, slow=6), ids=str)
def test_a_motor_that_turns_by_itself_is_named_within_a_second(
    case: tuple[str, str, str, str],
) -> None:
    kind, motor, moment, text = case
    outcome, record = disturbed(robot_of(kind), motor, "runaway_motor", moment)
    assert record.text == outcome.checks.interruption
    assert record.text.startswith(f"cut the power: {text}"), record.text
    assert record.text.endswith("reports 1.00 rad/s, which nobody commands")
    assert 0.0 < record.delay <= LIMIT
    # Nothing on the bus stops this motor; all others stand without torque.
    assert outcome.moving == [motor]
    assert not any(axis.powered for axis in outcome.session.base.axes)
    assert not passed(outcome)


@pytest.mark.parametrize("kind", mostly_slow([LSS, GREENHOUSE], quick=1, slow=1))
def test_a_drive_that_turns_its_motor_without_torque_is_started_anew(kind: str) -> None:
    """The drive reports no torque, so that the ladder of the base takes its motion for a push."""
    robot = robot_of(kind)

    def heal_at_boot(simulated: SimulatedRobot) -> None:
        (bus,) = robot.buses
        (node,) = [n for n in bus.nodes if any(c.actuator == RIGHT for c in n.channels)]

        def see(controller: CanController, frame: CanFrame) -> bool:
            if frame.id == 0x700 + node.id and frame.data == b"\0":
                simulated.motors[RIGHT].disturb(simulated.timeline.seconds)
            return True

        simulated.wires[bus.name].filters.append(see)

    outcome, record = disturbed(robot, RIGHT, "runaway_motor", "in a motion", prepare=heal_at_boot)
    assert record.text.startswith("cut the power: wheel right_wheel")
    assert record.delay <= LIMIT
    assert outcome.moving == []
    assert record.rest - record.alarm < outcome.session.base.longest_stop


DISOBEDIENT = [
    (LSS, "commands_ignored", "in a motion"),
    (LSS, "frozen_reports", "in a motion"),
    (GREENHOUSE, "frozen_reports", "in the safety stop"),
    (GREENHOUSE, "frozen_reports", "in a motion"),
    ("cia402_steered", "commands_ignored", "in a motion"),
]


@pytest.mark.parametrize("case", mostly_slow(DISOBEDIENT, quick=2, slow=3), ids=str)
def test_a_drive_that_does_not_obey_is_named_within_a_second(
    case: tuple[str, str, str],
) -> None:
    """From the last command to the wheel on; it then stops by the ladder of the base."""
    kind, fault, moment = case
    robot = robot_of(kind)
    motor = "l_drive_propulsion" if kind == "cia402_steered" else LEFT
    outcome, record = disturbed(robot, motor, fault, moment)
    assert record.text.startswith("cut the power: wheel l"), record.text
    assert record.delay <= LIMIT
    assert outcome.moving == []
    assert record.rest - record.alarm < outcome.session.base.longest_stop
    assert not passed(outcome)


def test_a_drive_whose_watchdog_acts_is_named_by_its_motion() -> None:
    outcome, _ = disturbed(example(GREENHOUSE), LEFT, "commands_ignored", "in a motion")
    assert any(f"{LEFT} stopped: controller: the left" in f.text for f in outcome.found)
    assert outcome.moving == []


def test_a_stop_of_a_wheel_that_stood_is_not_measured() -> None:
    begun: list[bool] = [False]

    def in_second_motion(simulated: SimulatedRobot, session: MotorSession) -> bool:
        if moves(session) is not begun[-1]:
            begun.append(not begun[-1])
        return begun.count(True) == 2

    outcome, _ = disturbed(example(GREENHOUSE), LEFT, "commands_ignored", in_second_motion)
    reasons = outcome.results[LEFT].not_tested
    assert "stop lock: not measured: it reported no motion" in reasons
    assert not outcome.passed(LEFT)


@pytest.mark.slow
def test_a_drive_that_keeps_its_torque_is_named() -> None:
    robot = robot_of("cia402_steered")
    outcome, record = disturbed(robot, "l_steering_steering", "frozen_reports", "in a homing")
    assert record.text == "cut the power: l_controller reports torque, which nobody commands"
    assert outcome.moving == []


def test_a_wheel_that_the_operator_turns_is_no_alarm() -> None:
    """The question about the brake asks for it."""
    robot = example(GREENHOUSE)
    actuators = [
        replace(a, brake=Brake(50.0, 0.1)) if a.name == LEFT else a for a in robot.actuators
    ]
    braked = replace(robot, actuators=tuple(actuators))
    held: list[float] = []

    class Pusher(SimulatedOperator):
        def alarm(self, text: str) -> None:
            raise AssertionError(text)

        def ask(self, question: Question) -> None:
            super().ask(question)
            if "by hand" in question.text:
                held.append(self._simulated.timeline.seconds)
                injection(robot, LEFT, "runaway_motor")(self._simulated)
                self._answer = None

        def answer(self) -> object:  # type: ignore[override]
            now = self._simulated.timeline.seconds
            if held and now - held[-1] > 2.0:
                self._simulated.motors[LEFT].disturb(now)
                self._answer, held[:] = (False,), []
            return super().answer()

    outcome = run_checks(Assembly(braked), person=Pusher)
    figures = {figure.name: figure.passed for figure in outcome.results[LEFT].figures}
    assert figures["brake holds"] is False
    assert not outcome.checks.interruption


# -- the rule itself -------------------------------------------------------------------------------

PERIOD = 0.02


def first_alarm(speed: Callable[[float], float], until: float = 20.0) -> float | None:
    """Returns the time (s) of the first alarm for a speed over time, if there is one."""
    axis = Axis(example(GREENHOUSE).actuators[0], 0, "left")
    motion = UncommandedMotion(axis, PERIOD)
    for cycle in range(round(until / PERIOD)):
        now = cycle * PERIOD
        axis.update(now, 0.0, speed(now))
        if motion.update(now, commanded=False):
            return now
    return None


@pytest.mark.parametrize(
    ("name", "speed", "latest"),
    [
        ("stands", lambda t: 0.0, None),
        ("vibrates", lambda t: 0.05 * math.sin(40.0 * t), None),
        ("coasts", lambda t: max(1.0 - 0.3 * t, 0.0), None),
        ("coasts from high speed", lambda t: 10.0 * math.exp(-0.3 * t), None),
        ("is touched", lambda t: 1.0 if t % 2.0 < 0.4 else 0.0, None),
        ("is pushed and coasts", lambda t: max(min(3.0 * t, 1.5 - t), 0.0), None),
        ("turns by itself", lambda t: 1.0, 0.6),
        ("turns slowly", lambda t: -0.15, 1.0),
        ("turns faster and faster", lambda t: t, 1.0),
        ("turns with a noisy report", lambda t: 1.0 + 0.05 * math.sin(90.0 * t), 0.8),
        ("coasts much too long", lambda t: 1.0 - 0.05 * t, 1.0),
    ],
)
def test_motion_that_nobody_commands(
    name: str, speed: Callable[[float], float], latest: float | None
) -> None:
    alarm = first_alarm(speed)
    if latest is None:
        assert alarm is None
    else:
        assert alarm is not None
        assert alarm <= latest
