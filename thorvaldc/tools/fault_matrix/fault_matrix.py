"""The fault matrix of a robot: each fault in each phase, with the measured reactions.

One simulation is continued in many processes, each of which has its own copy of the simulation::

    parent  start-up ---- ready ------------------ driving ----------
                             |  fork: a copy for     |
    child                    +- each fault           +- each fault

A fork copies the whole state of the process.  The start-up of the robot is thus simulated once for
all faults.
"""

from __future__ import annotations

import gc
import math
import multiprocessing
import os
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from thorvaldc import __version__
from thorvaldc.diagnostics.text_layout import markdown_table, text_table
from thorvaldc.model import Robot, stopping
from thorvaldc.model.model_json import model_hash
from thorvaldc.model.statics.slope import roll_out
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.promised_times import rest_after
from thorvaldc.simulation.worker_processes import become_worker
from thorvaldc.tools.fault_matrix import fault_cases, fault_reaction, ground_faults
from thorvaldc.tools.fault_matrix.fault_cases import Evidence, FaultCase
from thorvaldc.tools.fault_matrix.fault_reaction import Reaction, react
from thorvaldc.tools.fault_matrix.ground_faults import GroundRow
from thorvaldc.tools.fault_matrix.rehearsal import Rehearsal

T = TypeVar("T")


class WorkError(RuntimeError):
    """A process ended with an exception.  The message contains the traceback of the process."""


def can_fork() -> bool:
    """Returns ``True`` if the process can be copied: other threads would not be copied."""
    return hasattr(os, "fork") and threading.active_count() == 1


def run_forked(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T]]:
    """Calls each function in a copy of this process, and yields its index and its result.

    At most ``jobs`` copies run at the same time.  The results come in any order.  Raises
    ``WorkError`` if a function raises an exception.  Ends the copies if the iterator is closed.
    """
    context = multiprocessing.get_context("fork")
    waiting = list(enumerate(work))
    running: dict[Connection, tuple[int, Any]] = {}
    # A garbage collection in a copy would touch, and so copy, the memory of the whole simulation.
    was_frozen = gc.get_freeze_count() > 0
    gc.collect()
    gc.freeze()
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                index, function = waiting.pop(0)
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_work, args=(function, sender))
                process.start()
                sender.close()
                running[receiver] = index, process
            ready = wait(list(running))
            for receiver in [candidate for candidate in running if candidate in ready]:
                index, process = running.pop(receiver)
                yield index, _result(receiver)
                process.join()
    finally:
        if not was_frozen:  # else also by others, who count on it
            gc.unfreeze()
        for _, process in running.values():
            process.terminate()
            process.join()


def _result(receiver: Connection) -> Any:
    try:
        failed, result = receiver.recv()
    except EOFError:
        raise WorkError("a process was killed") from None
    finally:
        receiver.close()
    if failed:
        raise WorkError(result)
    return result


def _work(function: Callable[[], Any], sender: Connection) -> None:
    become_worker()
    gc.disable()
    try:
        sender.send((False, function()))
    except BaseException:
        sender.send((True, traceback.format_exc()))
    finally:
        sender.close()


def rest_limit(robot: Robot, case: FaultCase, phase: str) -> tuple[float, float]:
    """Returns the longest time (s) and distance (m) until the robot stands after a fault.

    The robot stops by itself, or rolls out without power.
    """
    if case.rolls_out:
        _, time, distance = roll_out(robot)
        return time, distance
    delay = case.detection.get(phase, 0.0) if case.braking is None else case.braking
    by_ramp = case.by_ramp or (phase not in case.detection and case.braking is None)
    return rest_after(robot, delay, stopping.STOP_LOCK if by_ramp else stopping.DETECTED_FAULT)


def broken_limits(robot: Robot, case: FaultCase, phase: str, reaction: Reaction) -> list[str]:
    """Returns a sentence for each promise that the reaction does not keep."""
    if reaction.reaction == fault_reaction.NOT_SIMULATED:
        return []
    problems = []
    limit = case.detection.get(phase)
    stopped = reaction.reaction in fault_reaction.STOPS
    if limit is not None and not stopped:
        problems.append(f"the driver does not stop the robot; {limit:.2f} s are promised")
    elif limit is not None and (reaction.after or 0.0) > limit:
        problems.append(f"the driver reacts after {reaction.after:.2f} s; promised: {limit:.2f} s")
    moves = phase in fault_cases.MOVING_PHASES
    must_stand = stopped or (moves and (phase == fault_cases.STOPPING or case.must_stop))
    if must_stand and not case.motion:
        longest, farthest = rest_limit(robot, case, phase) if moves else (math.inf, math.inf)
        if moves and math.isinf(longest):
            pass  # nothing is promised
        elif reaction.rest_time is None or reaction.rest_distance is None:
            problems.append("the wheels still turn at the end of the observation")
        elif reaction.rest_time > longest:
            problems.append(f"at rest after {reaction.rest_time:.2f} s; promised: {longest:.2f} s")
        elif reaction.rest_distance > farthest:
            problems.append(
                f"at rest after {reaction.rest_distance:.2f} m; promised: {farthest:.2f} m"
            )
    if reaction.unasked > fault_reaction.UNASKED + case.motion:
        problems.append(
            f"the wheels became faster by {reaction.unasked:.2f} m/s without a command; "
            f"{fault_reaction.UNASKED + case.motion:g} m/s are tolerated"
        )
    return problems


@dataclass(frozen=True)
class FaultRow:
    """The reactions to one fault by phase."""

    case: FaultCase
    reactions: Mapping[str, Reaction]
    broken: Mapping[str, Sequence[str]]
    """Broken limits by phase; a phase without broken limits has no entry."""

    @property
    def passed(self) -> bool:
        return not self.broken


class FaultMatrix:
    """The faults that are tried with a robot.

    - ``cases``: the faults.
    - ``cells``: number of pairs of a fault and a phase.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        parameters: str | None = None,
        cases: Sequence[FaultCase] | None = None,
        twist: Twist | None = None,
        seed: int = 0,
    ) -> None:
        """Prepares the faults of a robot.

        - ``parameters``: name of a parameter set of the robot file.
        - ``cases``: faults; default: those of ``fault_cases``.
        - ``twist``: twist while the robot drives; default: the top speed in a curve.
        - ``seed``: seed of all random numbers.

        Raises ``DiagnosticError`` if the robot has no bus.
        """
        robot.require_bus()
        self.robot = robot
        self.parameters = parameters
        self.cases = list(fault_cases.fault_cases(robot) if cases is None else cases)
        self.twist = fault_reaction.top_twist(robot, parameters) if twist is None else twist
        self.seed = seed

    @property
    def cells(self) -> int:
        return sum(len(case.phases) for case in self.cases)

    def rows(
        self, jobs: int = 1, progress: Callable[[int], None] = lambda number: None
    ) -> list[FaultRow]:
        """Tries every fault in every phase and returns the reactions.

        - ``jobs``: number of processes; the result does not depend on it.
        - ``progress``: function that is called with the number of finished cells.

        Raises ``RehearsalError`` if the robot does not drive even without faults.
        """
        reactions: dict[tuple[int, str], Reaction] = {}
        source = self._forked(jobs) if can_fork() else self._one_by_one()
        for cell, reaction in source:
            reactions[cell] = reaction
            progress(len(reactions))
        rows = []
        for number, case in enumerate(self.cases):
            row = {phase: reactions[number, phase] for phase in case.phases}
            broken = {
                phase: problems
                for phase, reaction in row.items()
                if (problems := broken_limits(self.robot, case, phase, reaction))
            }
            rows.append(FaultRow(case, row, broken))
        return rows

    def react(self, case: FaultCase, phase: str, evidence: Evidence | None = None) -> Reaction:
        """Tries one fault in one phase, with a new start of the robot."""
        evidence = evidence if evidence is not None else self._evidence()
        rehearsal = self._rehearsal()
        try:
            for earlier in fault_cases.PHASES[1 : fault_cases.PHASES.index(phase) + 1]:
                fault_reaction.advance(rehearsal, earlier, self.twist)
            return react(rehearsal, case, phase, evidence)
        finally:
            rehearsal.close()

    # -- inside ------------------------------------------------------------------------------

    def _rehearsal(self) -> Rehearsal:
        return Rehearsal(self.robot, parameters=self.parameters, seed=self.seed)

    def _evidence(self) -> Evidence:
        """Returns the frames of the robot at rest and of the driving robot."""
        rehearsal = self._rehearsal()
        try:
            fault_reaction.advance(rehearsal, fault_cases.IDLE, self.twist)
            at_rest = dict(rehearsal.frames)
            fault_reaction.advance(rehearsal, fault_cases.DRIVING, self.twist)
            return Evidence(at_rest, dict(rehearsal.frames))
        finally:
            rehearsal.close()

    def _one_by_one(self) -> Iterator[tuple[tuple[int, str], Reaction]]:
        evidence = self._evidence()
        for number, case in enumerate(self.cases):
            for phase in case.phases:
                yield (number, phase), self.react(case, phase, evidence)

    def _forked(self, jobs: int) -> Iterator[tuple[tuple[int, str], Reaction]]:
        """Simulates the way to each phase once, and copies the process for each fault."""
        evidence = self._evidence()
        rehearsal = self._rehearsal()
        try:
            for phase in fault_cases.PHASES:
                fault_reaction.advance(rehearsal, phase, self.twist)
                cases = [(i, case) for i, case in enumerate(self.cases) if phase in case.phases]
                work = [partial(_cell, rehearsal, case, phase, evidence) for _, case in cases]
                for index, reaction in run_forked(work, jobs):
                    yield (cases[index][0], phase), reaction
        finally:
            rehearsal.close()


def _cell(rehearsal: Rehearsal, case: FaultCase, phase: str, evidence: Evidence) -> Reaction:
    rehearsal.renew_connection()
    return react(rehearsal, case, phase, evidence)


# -- the matrix as JSON values and as a Markdown table ------------------------------------

SIMULATED = (
    "The reactions were measured on a simulated bus with simulated drives and motors. They do not"
    " replace tests on the hardware, and a stop in software is not a safety function."
)
GROUND = (
    "Faults of the ground, in MuJoCo, of which nothing is promised: how wrong the odometry is at"
    " the end of 7 s, and which standard deviation it states. The worst wheel is shown."
)
HEADINGS = ("fault", "drives", *fault_cases.PHASES, "promised", "unasked motion")


def matrix_json(
    matrix: FaultMatrix, rows: Sequence[FaultRow], ground: Sequence[GroundRow], file: str
) -> dict[str, Any]:
    """Returns the fault matrix as JSON values, with times in s, paths in m and speeds in m/s."""
    robot, twist = matrix.robot, matrix.twist
    return {
        "robot": robot.name,
        "file": file,
        "model_sha256": model_hash(robot),
        "thorvaldc": __version__,
        "simulated": True,
        "note": SIMULATED,
        "driving": twist._asdict(),
        "swerve": {
            bound.kind: bound.yaw
            for bound in stopping.swerve_bounds(robot)
            if math.isfinite(bound.yaw)
        },
        "passed": all(row.passed for row in rows),
        "faults": [row_json(robot, row) for row in rows],
        "ground": [ground_faults.ground_json(row) for row in ground],
    }


def row_json(robot: Robot, row: FaultRow) -> dict[str, Any]:
    """Returns the reactions to one fault as JSON values."""
    phases = {}
    for phase, reaction in row.reactions.items():
        limits: dict[str, float] = {}
        if phase in row.case.detection:
            limits["reaction"] = row.case.detection[phase]
        if phase in fault_cases.MOVING_PHASES and reaction.rest_time is not None:
            time, distance = rest_limit(robot, row.case, phase)
            limits |= {"rest_time": time, "rest_distance": distance}
        finite = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        phases[phase] = {
            **reaction.as_json(),
            "promised": finite,
            "broken": list(row.broken.get(phase, ())),
        }
    return {
        "fault": row.case.name,
        "drives": row.case.drives,
        "passed": row.passed,
        "phases": phases,
    }


def markdown(
    matrix: FaultMatrix,
    rows: Sequence[FaultRow],
    ground: Sequence[GroundRow],
    file: str,
    width: int | None = None,
) -> Iterator[str]:
    """Yields the lines of a Markdown page with the fault matrix.

    ``width``: number of columns of the terminal, or ``None`` for a file.  On a terminal the matrix
    is a text table, because a table in Markdown has one line per row.
    """
    robot = matrix.robot
    yield f"# Faults of the robot {robot.name}"
    yield ""
    yield SIMULATED if width is None else textwrap.fill(SIMULATED, width)
    yield ""
    yield f"- Robot file: `{file}`"
    yield f"- SHA-256 of its model.json: `{model_hash(robot)}`"
    yield f"- thorvaldc {__version__}"
    if rows:
        yield from _bus_faults(matrix, rows, width)
    if ground:
        yield ""
        yield GROUND if width is None else textwrap.fill(GROUND, width)
        yield ""
        cells = [ground_faults.HEADINGS, *map(ground_faults.ground_cells, ground)]
        yield from _table(cells, width)


def _bus_faults(matrix: FaultMatrix, rows: Sequence[FaultRow], width: int | None) -> Iterator[str]:
    robot, twist = matrix.robot, matrix.twist
    yield f"- Driving: {twist.vx:.2f} m/s in curves of {abs(twist.wz):.2f} rad/s to both sides"
    for bound in stopping.swerve_bounds(robot):
        yield f"- Yaw, straight ahead: {_swerve_text(bound)}"
    yield ""
    yield from _table([HEADINGS, *(row_cells(robot, row) for row in rows)], width)
    broken = [(row, phase, text) for row in rows for phase, texts in row.broken.items()
              for text in texts]  # fmt: skip
    yield ""
    if broken:
        yield "Promises that are not kept:"
        yield ""
        for row, phase, text in broken:
            yield f"- {row.case.name} ({row.case.drives}), {phase}: {text}"
    else:
        yield "All promises are kept."


def _table(cells: Sequence[Sequence[str]], width: int | None) -> Iterable[str]:
    if width is None:
        return markdown_table(cells, aligned=True)
    return [text_table(cells, width)]


def _swerve_text(bound: stopping.SwerveBound) -> str:
    bus = f"the bus `{bound.bus}`"
    cause = f"the driver loses {bus}" if bound.kind == stopping.BUS_LOST else f"{bus} is silent"
    if math.isinf(bound.yaw):
        return f"no bound if {cause}, because a drive has no watchdog"
    return f"at most {math.ceil(math.degrees(bound.yaw))} deg if {cause}"


def row_cells(robot: Robot, row: FaultRow) -> tuple[str, ...]:
    """Returns the cells of the table for one fault."""
    phases = [
        reaction_text(row.reactions[phase]) if phase in row.reactions else ""
        for phase in fault_cases.PHASES
    ]
    moving = [(p, r) for p, r in row.reactions.items() if p in fault_cases.MOVING_PHASES]
    unasked = max((r.unasked for r in row.reactions.values() if r.moved_unasked), default=None)
    return (
        row.case.name,
        row.case.drives,
        *phases,
        _promise(robot, row, moving),
        "none" if unasked is None else f"+{unasked:.2f} m/s",
    )


def reaction_text(reaction: Reaction) -> str:
    """Returns the reaction with its time, and the time and the path until all wheels stand.

    Without a stop, the text has the largest difference of the true and the commanded speeds.
    """
    if reaction.reaction == fault_reaction.NOT_SIMULATED:
        return reaction.reaction
    after = "" if reaction.after is None else f" in {_rounded_up(reaction.after, 10)} s"
    if reaction.rest_time is None or reaction.rest_distance is None:
        rest = f"no stop, {_rounded_up(reaction.speed_error, 20)} m/s"
    else:
        rest = f"rest {_rounded_up(reaction.rest_time, 10)} s"
        rest += f", {_rounded_up(reaction.rest_distance, 20)} m"
    return f"{reaction.reaction}{after}; {rest}"


def _promise(robot: Robot, row: FaultRow, moving: list[tuple[str, Reaction]]) -> str:
    """Returns the promised time until the reaction, and time and distance until the robot stands,
    for the phase driving."""
    parts = []
    limit = max(row.case.detection.values(), default=None)
    if limit is not None:
        parts.append(f"{_rounded_up(limit, 10)} s")
    if any(r.rest_time is not None for p, r in moving if p == fault_cases.DRIVING):
        time, distance = rest_limit(robot, row.case, fault_cases.DRIVING)
        finite = math.isfinite(time)
        known = [f"{_rounded_up(time, 10)} s", f"{_rounded_up(distance, 20)} m"] if finite else []
        parts += known or ["unlimited"]
    return ", ".join(parts)


def _rounded_up(value: float, parts: int) -> str:
    """Returns a value rounded up to a whole number of parts, so that single cycles do not change
    the table."""
    rounded = math.ceil(parts * value - 1e-6) / parts
    return f"{rounded:.2f}" if parts > 10 else f"{rounded:.1f}"
