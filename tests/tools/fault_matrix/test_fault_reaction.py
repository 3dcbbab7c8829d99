"""Reactions to faults: what is measured, and which promises are broken."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.runtime.can_base.test_even_stop import DRIVES, robot
from tests.runtime.test_runner_services import TWO_BUSES
from tests.simulation.bus.robots import ROBOTS, cia402_robot, compiled
from tests.simulation.test_worker_processes import end_the_parent
from tests.slow import mostly_slow
from thorvaldc.model.stopping import swerve_bounds
from thorvaldc.runtime.se2 import Twist
from thorvaldc.tools.fault_matrix.fault_cases import (
    DRIVING,
    IDLE,
    START,
    STOPPING,
    Evidence,
    FaultCase,
    fault_cases,
)
from thorvaldc.tools.fault_matrix.fault_matrix import (
    FaultMatrix,
    broken_limits,
    markdown,
    matrix_json,
    rest_limit,
)
from thorvaldc.tools.fault_matrix.fault_reaction import Reaction
from thorvaldc.tools.fault_matrix.rehearsal import Rehearsal

ROBOT = ROBOTS["Thorvald script"]


def case_of(name: str) -> FaultCase:
    return next(case for case in fault_cases(ROBOT()) if case.name == name)


def reaction(**changes: float | str | None) -> Reaction:
    """Returns a reaction that keeps every promise of a cut power."""
    good = Reaction("fault", 0.05, "no tpdo1", 0.3, 0.1, 0.4, 0.0)
    return replace(good, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, ""),
        ({"reaction": "continues", "after": None}, "the driver does not stop the robot"),
        ({"reaction": "warns"}, "the driver does not stop the robot"),
        ({"after": 0.5}, "the driver reacts after 0.50 s"),
        ({"rest_time": None, "rest_distance": None}, "the wheels still turn"),
        ({"rest_time": 9.0}, "at rest after 9.00 s"),
        ({"rest_distance": 9.0}, "at rest after 9.00 m"),
        ({"unasked": 0.2}, "the wheels became faster by 0.20 m/s without a command"),
    ],
)
def test_each_broken_promise_has_a_sentence(
    changes: dict[str, float | str | None], sentence: str
) -> None:
    problems = broken_limits(ROBOT(), case_of("power of a drive cut"), DRIVING, reaction(**changes))
    assert len(problems) == bool(sentence)
    assert all(problem.startswith(sentence) for problem in problems)


def test_the_limit_grows_with_the_detection() -> None:
    robot = ROBOT()
    time, distance = rest_limit(robot, case_of("power of a drive cut"), DRIVING)
    later, farther = rest_limit(robot, case_of("heartbeat of a drive stops"), DRIVING)
    assert later - time == pytest.approx(0.23, abs=0.03)
    assert farther - distance == pytest.approx(
        (later - time) * robot.driver.max_linear_velocity, abs=0.01
    )


def spin(rehearsal: Rehearsal) -> None:
    """A wheel turns without a command, as a short circuit lets it."""
    motor, _ = rehearsal.wheels[0]
    motor.turn(5.0, rehearsal.now)
    motor.turn = lambda velocity, now: None  # type: ignore[method-assign]


def test_a_wheel_that_turns_without_a_command_is_seen() -> None:
    case = FaultCase("a wheel turns", "any", (IDLE,), spin, {})
    result = FaultMatrix(ROBOT()).react(case, IDLE, Evidence())
    assert result.moved_unasked
    assert result.unasked == pytest.approx(1.0, abs=0.05)
    assert "without a command" in broken_limits(ROBOT(), case, IDLE, result)[-1]


def test_a_device_that_cannot_have_the_fault_is_named() -> None:
    def impossible(rehearsal: Rehearsal) -> None:
        raise ValueError("it has no watchdog")

    case = FaultCase("impossible", "any", (IDLE,), impossible, {IDLE: 0.1})
    result = FaultMatrix(ROBOT()).react(case, IDLE, Evidence())
    assert result.reaction == "not simulated"
    assert not broken_limits(ROBOT(), case, IDLE, result)


SAME = """
import itertools, json, sys, types
from tests.simulation.bus.robots import ROBOTS
from thorvaldc.runtime import control_channel
from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix
from thorvaldc.tools.fault_matrix.fault_matrix import can_fork

matrix = FaultMatrix(ROBOTS["Thorvald script"]())
matrix.cases = [case for case in matrix.cases if case.name == "connection of the client closed"]
rows = matrix.rows(int(sys.argv[1]))
forked = [{p: r.as_json() for p, r in row.reactions.items()} for row in rows]
control_channel.time = types.SimpleNamespace(monotonic=itertools.count().__next__)
alone = [{p: matrix.react(row.case, p).as_json() for p in row.case.phases} for row in rows]
print(json.dumps([can_fork(), forked, alone]))
"""


@pytest.mark.slow
def test_copies_of_a_process_react_as_a_new_start_does() -> None:
    """Also as a new start on a computer that is so busy that each request takes a second."""
    command = [sys.executable, "-c", SAME, "2"]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    forked_at_all, forked, alone = json.loads(output)
    assert forked_at_all or sys.platform == "win32"
    assert forked == alone


def test_mixed_drives_and_several_buses() -> None:
    names = [(case.name, case.drives) for case in fault_cases(compiled(TWO_BUSES))]
    assert len(names) == len(set(names))
    case = next(c for c in fault_cases(compiled(TWO_BUSES)) if c.name == "a drive sends nothing")
    matrix = FaultMatrix(compiled(TWO_BUSES))
    result = matrix.react(case, STOPPING, Evidence())
    assert result.reaction == "fault"
    assert result.rest_time is not None


def test_phases_of_the_cases() -> None:
    """Faults of the bus are tried in all phases, faults of the client where the robot moves."""
    cases = {case.name: case for case in fault_cases(cia402_robot())}
    assert cases["power of a drive cut"].phases == (START, IDLE, DRIVING, STOPPING)
    assert cases["client hangs"].phases == (DRIVING, STOPPING)
    assert {"battery empty", "driver process killed", "another master sends SYNC"} <= set(cases)


@pytest.mark.parametrize("drives", mostly_slow(reversed(DRIVES)))
def test_one_bus_of_several(drives: str) -> None:
    """The page states the yaw, and the robot stops as for a dead driver."""
    model = robot(drives)
    cases = [case for case in fault_cases(model) if "of several" in case.name]
    assert [case.name for case in cases] == [
        "the driver loses the bus port of several",
        "the bus port of several is silent",
    ]
    matrix = FaultMatrix(model, cases=cases, twist=Twist(0.8, 0.0, 0.0))
    rows = matrix.rows()
    assert [row.broken for row in rows] == [{}, {}]
    assert rows[0].reactions[DRIVING].reason == (
        "the CAN controller of the bus `port` is off the bus (bus-off)"
    )
    lines = [line for line in markdown(matrix, rows, [], "robot.yaml") if line.startswith("- Yaw")]
    assert len(lines) == 2
    for bound, line in zip(swerve_bounds(model), lines, strict=True):
        assert f" {math.ceil(math.degrees(bound.yaw))} deg if " in line
        assert bound.kind in matrix_json(matrix, rows, [], "robot.yaml")["swerve"]
    assert not any("of several" in case.name for case in fault_cases(ROBOT()))


def test_objects_that_a_service_tool_overwrites() -> None:
    names = {case.name for case in fault_cases(ROBOTS["CiA 402"]())}
    assert "a deceleration of a drive is overwritten (0x6084)" in names
    assert "two drives swap their reports (0x1800)" in names
    assert {f"{form} frames with the id of a command" for form in ("extended", "remote")} <= names


FORK = """
import os, time
from thorvaldc.tools.fault_matrix.fault_matrix import run_forked

def work():
    os.write(1, b"working\\n")  # one call, so that the lines of two workers stay apart
    time.sleep(600)

list(run_forked([work] * 4, 2))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize(
    "number", mostly_slow([signal.SIGKILL, signal.SIGTERM, signal.SIGINT], slow=1)
)
def test_the_end_of_the_parent_ends_its_copies(tmp_path: Path, number: signal.Signals) -> None:
    end_the_parent(tmp_path, FORK, number)
