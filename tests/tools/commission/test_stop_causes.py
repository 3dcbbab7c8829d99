"""A check of a stop counts only if the stop has stopped the wheel, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.slow import mostly_slow
from tests.tools.commission.assemblies import Assembly, Outcome, run_checks
from tests.tools.commission.test_motor_checks import example, moves
from thorvaldc.can.canopen import NmtCommand, nmt_message
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.tools.commission.motor_session import MotorSession
from thorvaldc.tools.commission.questions import Question
from thorvaldc.tools.commission.report_content import report_of
from thorvaldc.tools.commission.results import EMERGENCY_STOP, STANDS, WATCHDOG
from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

Stimulus = Callable[[SimulatedRobot], object]


def fault(kind: str, **values: object) -> Stimulus:
    """Injects a fault into the first drive of the bus, or into the bus with ``node=None``."""

    def inject(simulated: SimulatedRobot) -> None:
        bus = simulated.robot.buses[0]
        node = next(n.name for n in bus.nodes if n.channels)
        fields = {"node": node, "time": None, "frame": None, **values}
        injected = BusFault(kind=kind, bus=bus.name, span=bus.span, **fields)  # type: ignore[arg-type]
        FaultInjector(simulated, BusFaults(())).inject(injected)

    return inject


def nmt(command: NmtCommand) -> Stimulus:
    data = nmt_message(command, 0)
    return fault("forged_frames", node=None, cob_id=0, data=data, period=10.0)


UNRELATED: dict[str, Stimulus] = {
    "stall": lambda simulated: simulated.run(0.3),
    "long stall": lambda simulated: simulated.run(0.7),
    "blink": fault("power_cut", duration=0.1),
    "power cut": fault("power_cut"),
    "mute": fault("mute", duration=0.3),
    "foreign NMT stop": nmt(NmtCommand.STOP),
    "foreign NMT reset": nmt(NmtCommand.RESET_NODE),
    "foreign heartbeat": fault(
        "forged_frames", node=None, cob_id=0x77F, data=b"\x05", period=0.1, duration=0.5
    ),
    "foreign SYNC": fault("forged_frames", node=None, cob_id=0x80, data=b"", period=0.05),
    "drive error": fault("emcy", code=0x2310, register=1),
    "bus-off": fault("bus_off"),
    "second drive": fault("clone"),
    "noise": fault("noise", node=None, share=1.0, duration=0.3),
}


def set_power_stages(simulated: SimulatedRobot, *, failed: bool) -> None:
    for bus in simulated.robot.buses:
        for node in bus.nodes:
            if node.channels:
                device = simulated.devices[node.name]
                device.power_stage_error = failed  # type: ignore[attr-defined]


def power_off(simulated: SimulatedRobot) -> None:
    set_power_stages(simulated, failed=True)


class Believer(SimulatedOperator):
    """Presses nothing, and believes every check that asks."""

    def ask(self, question: Question) -> None:
        super().ask(question)
        if "Release" in question.text:
            set_power_stages(self._simulated, failed=False)
        if question.kind in ("press", "pressed", "yes"):
            self._answer = (True,)


class Honest(Believer):
    """Presses nothing, and says so."""

    def ask(self, question: Question) -> None:
        super().ask(question)
        if question.kind == "pressed":
            self._answer = (False,)


def disturbed(robot: Robot, stimulus: Stimulus, check: str, person: type[Believer]) -> Outcome:
    """Runs all checks; the stimulus acts once, during one check, at the test speed."""
    state = {"text": "", "acted": ""}

    class Watched(person):  # type: ignore[misc,valid-type]
        def ask(self, question: Question) -> None:
            state["text"] = question.text
            super().ask(question)

    def inject(simulated: SimulatedRobot, session: MotorSession) -> bool:
        starved = session.base.starves_drives or check not in "by itself"
        if check in state["text"] and moves(session) and starved and not state["acted"]:
            state["acted"] = "yes"
            stimulus(simulated)
        return False

    outcome = run_checks(Assembly(robot), stop=inject, person=Watched)
    assert state["acted"]
    return outcome


def passed(outcome: Outcome) -> bool:
    report = report_of(
        outcome.session.driven.robot,
        outcome.results,
        {},
        (),
        operator="",
        date="",
        interruption=outcome.checks.interruption,
    )
    return report.passed


def values(outcome: Outcome) -> dict[str, bool]:
    figures = [f for result in outcome.results.values() for f in result.figures]
    return {figure.name: figure.passed for figure in figures}


KINDS = ("2wd0ws_greenhouse", "lss")
FIRST = [("stall", KINDS[0]), ("foreign heartbeat", KINDS[0]), ("blink", KINDS[1])]
CASES = FIRST + [(n, k) for n in UNRELATED for k in KINDS if (n, k) not in FIRST]
cases = pytest.mark.parametrize("case", mostly_slow(CASES, quick=1, slow=len(FIRST) + 3), ids=str)


@cases
def test_the_emergency_stop_is_not_measured_by_something_else(case: tuple[str, str]) -> None:
    """The operator believes that the wheel stopped because of the button."""
    name, kind = case
    outcome = disturbed(example(kind), UNRELATED[name], "until you press", Believer)
    assert not values(outcome).get(EMERGENCY_STOP)
    assert not passed(outcome)
    assert not outcome.moving
    reasons = [text for result in outcome.results.values() for text in result.not_tested]
    assert any("emergency stop: not measured: " in text for text in reasons) or (
        outcome.checks.interruption or EMERGENCY_STOP in values(outcome)
    ), reasons


def test_the_operator_says_whether_the_button_was_pressed() -> None:
    robot = example("2wd0ws_greenhouse")
    outcome = disturbed(robot, power_off, "until you press", Honest)
    assert not passed(outcome)
    reasons = [text for result in outcome.results.values() for text in result.not_tested]
    assert "emergency stop: not measured: nobody has pressed it" in reasons
    outcome = disturbed(robot, power_off, "until you press", Believer)
    assert values(outcome)[EMERGENCY_STOP]


@cases
def test_a_dead_watchdog_does_not_pass_because_of_something_else(case: tuple[str, str]) -> None:
    name, kind = case

    def act(simulated: SimulatedRobot) -> None:
        for bus in simulated.robot.buses:
            for node in bus.nodes:
                if node.channels:
                    simulated.devices[node.name].lose_watchdog()
        UNRELATED[name](simulated)

    outcome = disturbed(example(kind), act, "by itself", Believer)
    found = values(outcome)
    assert not (found.get(WATCHDOG) and found.get(STANDS)), found
    assert not passed(outcome)
    assert not outcome.moving


@pytest.mark.parametrize("kind", mostly_slow(KINDS, quick=1, slow=1))
@pytest.mark.parametrize("check", ["by the safety stop", "by a stop lock"])
def test_a_stop_is_not_measured_while_the_drive_restarts(check: str, kind: str) -> None:
    outcome = disturbed(example(kind), UNRELATED["blink"], check, Believer)
    assert not passed(outcome)
    assert not outcome.moving


def test_an_undisturbed_robot_passes() -> None:
    outcome = run_checks(Assembly(example("2wd0ws_greenhouse")))
    assert passed(outcome)
    figures = [f for result in outcome.results.values() for f in result.figures]
    (watchdog,) = [figure for figure in figures if figure.name == WATCHDOG]
    assert watchdog.value is not None
    assert 0.4 < watchdog.least <= watchdog.value
    assert all(figure.passed for figure in figures)
