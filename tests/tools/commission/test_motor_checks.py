"""The checks of the first motion, on simulated buses with rightly and wrongly assembled robots."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.simulation.bus.robots import compiled
from tests.slow import mostly_slow
from tests.tools.commission.assemblies import (
    WATCHDOG,
    Assembly,
    has_lost_watchdog,
    problems,
    run_checks,
    with_encoder,
    wrong_assembly,
)
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.motor_wiring import Wiring
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.tools.commission.motor_session import MotorSession
from thorvaldc.tools.commission.questions import Answer, Question
from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

ROOT = Path(__file__).resolve().parents[3]
CIA402_STEERED = """
thorvaldc: 1
name: two_steered
defaults: {drive: {controller: controller/cia402_propulsion_steering}}
modules:
  frame: {type: frame/tube_rectangular}
  l: {type: assembly/steered_drive, mount: frame.rear_left, can: 1}
  r: {type: assembly/steered_drive, mount: frame.rear_right, can: 2}
  a: {type: caster/swivel, mount: frame.front_left}
  b: {type: caster/swivel, mount: frame.front_right}
"""
EXAMPLES = ("2wd0ws_greenhouse", "1wd1ws_front", "lss", "car", "4wd2ws_tall")
"""Roboteq with two wheels, Roboteq with a steered wheel, CiA 402, several controllers."""


@cache
def example(name: str) -> Robot:
    robot = compile_file(ROOT / "examples" / name / "robot.yaml").model
    assert isinstance(robot, Robot)
    return robot


def robot_of(kind: str) -> Robot:
    return compiled(CIA402_STEERED) if kind == "cia402_steered" else example(kind)


RIGHT_ROBOTS = (*EXAMPLES[:3], "cia402_steered", *EXAMPLES[3:])


@pytest.mark.parametrize("kind", mostly_slow(RIGHT_ROBOTS, quick=1, slow=3))
def test_a_right_robot_passes(kind: str) -> None:
    assembly = Assembly(robot_of(kind))
    outcome = run_checks(assembly)
    assert not problems(assembly, outcome)
    assert len(outcome.results) == len(outcome.session.base.axes)
    for name, result in outcome.results.items():
        assert outcome.passed(name), (name, result.figures)
    names = {figure.name for result in outcome.results.values() for figure in result.figures}
    assert names >= {
        "rest after silence",
        "rest after the safety stop",
        "rest after the stop lock",
        "drive's watchdog acts",
        "stands by the drive's watchdog",
    }
    if any(axis.steering for axis in outcome.session.base.axes):
        assert names >= {"homing", "deviation at the upper limit", "deviation at the lower limit"}


SLOW_DRIVERS = ["rate: 5 Hz, command_timeout: 2 s", "max_linear_acceleration: 0.02"]


@pytest.mark.parametrize("driver", mostly_slow(SLOW_DRIVERS, quick=1, slow=1))
def test_a_slow_robot_passes(driver: str) -> None:
    """Slow control cycles, or a ramp of half a minute."""
    text = (ROOT / "examples/lss/robot.yaml").read_text(encoding="utf-8")
    assembly = Assembly(compiled(f"{text}driver: {{{driver}}}\n"))
    assert not problems(assembly, run_checks(assembly))


# Two hundred assemblies: most on small robots, which take some seconds each.  The quick ones have
# each error once; with the slow ones, each robot has each error, but for `car`, which has several
# controllers of Roboteq as `4wd2ws_tall` has.
SEEDS = [
    *((seed, EXAMPLES[seed % 3]) for seed in range(170)),
    *((seed, EXAMPLES[3 + seed % 2]) for seed in range(170, 186)),
    *((seed, "cia402_steered") for seed in range(186, 200)),
]

QUICK_SEEDS = (1, 3, 5, 9, 12)
SLOW_SEEDS = (7, 8, 13, 14, 19, 26, 79, 90, 171, 173, 177, 181, 186, 188, 193, 195)


@pytest.mark.parametrize(
    "case",
    mostly_slow(
        sorted(SEEDS, key=lambda case: (case[0] not in QUICK_SEEDS, case[0] not in SLOW_SEEDS)),
        quick=len(QUICK_SEEDS),
        slow=len(SLOW_SEEDS),
    ),
    ids=str,
)
def test_wrong_assemblies_are_named(case: tuple[int, str]) -> None:
    seed, kind = case
    assembly = wrong_assembly(robot_of(kind), seed)
    outcome = run_checks(assembly)
    if has_lost_watchdog(outcome):  # the checks end there; the rest is found after the repair
        assert assembly.dead
        assert not outcome.moving
        assembly.dead.clear()
        assembly.expected = [case for case in assembly.expected if case[0] != WATCHDOG]
        outcome = run_checks(assembly)
    assert not problems(assembly, outcome), assembly.wiring


MUJOCO_CASES = [(seed, (*EXAMPLES[:3], "cia402_steered")[seed % 4]) for seed in range(12)]


@pytest.mark.parametrize("case", mostly_slow(MUJOCO_CASES, quick=1, slow=3))
def test_wrong_assemblies_with_the_motors_of_mujoco(case: tuple[int, str]) -> None:
    """The robot floats without gravity and contacts, as one whose wheels are off the ground."""
    seed, robot = case[0], robot_of(case[1])
    base = MujocoBase(robot, MujocoScene(emit(robot, ["mjcf"])))
    base.scene.model.opt.gravity[:] = 0.0
    base.scene.model.geom_contype[:] = 0
    base.scene.model.geom_conaffinity[:] = 0
    assembly = wrong_assembly(robot, seed) if seed else Assembly(robot)
    outcome = run_checks(assembly, base=base)
    # The ideal drive has no dynamics of its speed loop, that of MuJoCo overshoots a little.
    texts = [text for text in problems(assembly, outcome) if not text.startswith("faster")]
    assert not texts
    assert outcome.excess < 0.2


def test_the_drive_of_another_robot_is_named_before_any_motion() -> None:
    robot = example("2wd0ws_greenhouse")
    other = with_encoder(robot, "left_drive_propulsion", 4096)
    outcome = run_checks(Assembly(robot), devices=other)
    assert "controller: its left encoder is configured for 4096 pulses" in (
        outcome.checks.interruption
    )
    assert outcome.excess < 0.0
    assert not outcome.results


def test_two_errors_of_one_motor_are_found_together() -> None:
    robot = example("1wd1ws_front")
    wiring = {"front_steering_steering": Wiring(direction=-1, zero=-0.3)}
    assembly = Assembly(robot, joints=wiring)
    texts = [finding.text for finding in run_checks(assembly).found]
    assert len(texts) == 2
    assert "the wrong way" in texts[0]
    assert "-17.0 deg" in texts[1]


def test_a_plug_that_is_not_connected_is_named() -> None:
    robot = example("2wd0ws_greenhouse")

    def block(simulated: SimulatedRobot) -> None:
        simulated.motors["left_drive_propulsion"].blocked = True

    outcome = run_checks(Assembly(robot), prepare=block)
    assert [f.motors for f in outcome.found] == [("left_drive_propulsion",)]
    assert "does not move" in outcome.found[0].text


# -- nothing moves unasked -------------------------------------------------------------------------


class SilentOperator(SimulatedOperator):
    """Answers no question."""

    def answer(self) -> tuple[Answer] | None:
        return None


def test_nothing_has_torque_before_the_operator_starts_it() -> None:
    robot = example("1wd1ws_front")
    powered: list[str] = []
    seconds: list[float] = []

    def watch(simulated: SimulatedRobot, session: MotorSession) -> bool:
        now = simulated.timeline.seconds
        powered.extend(a.channel for a in session.base.axes if a.powered)
        seconds.append(now)
        positions = [abs(m.read(now).position) for m in simulated.motors.values()]
        assert max(positions) < 1e-9
        return now > 12.0

    outcome = run_checks(Assembly(robot), person=SilentOperator, stop=watch)
    assert not powered
    assert seconds[-1] > 12.0
    assert not outcome.results
    assert not outcome.moving


class RefusingOperator(SimulatedOperator):
    """Leaves all motors out."""

    kind = "motor"

    def ask(self, question: Question) -> None:
        super().ask(question)
        if question.kind == self.kind:
            self._answer = (False,)


class HastyOperator(RefusingOperator):
    """Leaves the checks out that follow the first motion of a motor."""

    kind = "start"


@pytest.mark.parametrize("person", [RefusingOperator, HastyOperator])
def test_what_is_left_out_has_not_passed(person: type[RefusingOperator]) -> None:
    outcome = run_checks(Assembly(example("2wd0ws_greenhouse")), person=person)
    left, right = outcome.results
    assert outcome.results[left].skipped
    assert not outcome.passed(left)
    # The stops of a controller are checked with its first wheel.
    assert outcome.passed(right) is (person is HastyOperator)
    assert not outcome.found


class PressingOperator(SimulatedOperator):
    """Presses the emergency stop when asked for it, and releases it when asked again."""

    def ask(self, question: Question) -> None:
        super().ask(question)
        drives = self._simulated.devices.values()
        if question.kind == "pressed":
            self._answer = (True,)
        elif question.kind == "press":
            self._answer = (True,)
            for drive in drives:
                drive.after(
                    self.delay, lambda drive=drive: setattr(drive, "power_stage_error", True)
                )
        elif "Release" in question.text:
            for drive in drives:
                drive.power_stage_error = False


class EarlyPress(PressingOperator):
    delay = 0.4


class LatePress(PressingOperator):
    delay = 3.0


@pytest.mark.parametrize("person", [EarlyPress, LatePress])
def test_the_emergency_stop_is_pressed_while_a_wheel_turns(person: type[SimulatedOperator]) -> None:
    assembly = Assembly(example("2wd0ws_greenhouse"))
    outcome = run_checks(assembly, person=person)
    assert not problems(assembly, outcome)
    names = {figure.name for figure in outcome.results["left_drive_propulsion"].figures}
    assert "stands after the emergency stop" in names
    assert all(outcome.passed(name) for name in outcome.results)


def moves(session: MotorSession) -> bool:
    return session.base.share > 0.9 and session.base.state is BaseState.ACTIVE


@pytest.mark.parametrize("kind", mostly_slow(["2wd0ws_greenhouse", "lss"], slow=0))
def test_the_end_of_the_program_ends_at_rest(kind: str) -> None:
    outcome = run_checks(Assembly(robot_of(kind)), stop=lambda simulated, session: moves(session))
    assert not outcome.moving
    assert not outcome.results
    assert not outcome.checks.interruption


AT_ONCE = {"node": None, "time": None, "frame": None}
SECOND_MASTER = {"cob_id": 0x77F, "data": b"\x05", "period": 0.1}


POWER_CUT = ({**AT_ONCE, "kind": "power_cut", "duration": 1.0}, "controller")
FORGED = ({**AT_ONCE, "kind": "forged_frames", **SECOND_MASTER}, "master")


@pytest.mark.parametrize(
    ("kind", "case"),
    [
        ("2wd0ws_greenhouse", POWER_CUT),
        ("lss", FORGED),
        pytest.param("2wd0ws_greenhouse", FORGED, marks=pytest.mark.exhaustive),
        pytest.param("lss", POWER_CUT, marks=pytest.mark.exhaustive),
    ],
)
def test_a_fault_of_the_bus_ends_at_rest_and_blames_no_motor(
    kind: str, case: tuple[dict[str, object], str]
) -> None:
    fault, text = case
    robot = robot_of(kind)
    injected = SimpleNamespace(done=False)

    def inject(simulated: SimulatedRobot, session: MotorSession) -> bool:
        if moves(session) and not injected.done:
            injected.done = True
            injector = FaultInjector(simulated, BusFaults(()))
            bus = robot.buses[0]
            injector.inject(BusFault(bus=bus.name, span=bus.span, **fault))  # type: ignore[arg-type]
        return False

    outcome = run_checks(Assembly(robot), stop=inject)
    assert injected.done
    assert text in outcome.checks.interruption
    assert not outcome.moving
    assert not outcome.found
    assert outcome.excess < 0.0


def test_a_driver_that_cannot_power_a_single_motor_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from thorvaldc.runtime.can_base.roboteq_driver import RoboteqScriptController

    monkeypatch.setattr(RoboteqScriptController, "powers_single_motors", False)
    outcome = run_checks(Assembly(example("2wd0ws_greenhouse")))
    assert "cannot power a single motor" in outcome.checks.interruption
    assert outcome.excess < 0.0
    assert not outcome.moving
