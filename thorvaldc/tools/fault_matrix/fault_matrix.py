"""The fault matrix of a robot: each fault in each phase, with the measured reactions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.tools.fault_matrix.fault_cases import (
    DRIVING,
    IDLE,
    PHASES,
    Evidence,
    FaultCase,
    fault_cases,
)
from thorvaldc.tools.fault_matrix.fault_limits import broken_limits
from thorvaldc.tools.fault_matrix.fault_reaction import (
    Reaction,
    advance,
    react,
    top_twist,
)
from thorvaldc.tools.fault_matrix.forked_work import can_fork, run_forked
from thorvaldc.tools.fault_matrix.rehearsal import Rehearsal


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
        self.cases = list(fault_cases(robot) if cases is None else cases)
        self.twist = top_twist(robot, parameters) if twist is None else twist
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
            for earlier in PHASES[1 : PHASES.index(phase) + 1]:
                advance(rehearsal, earlier, self.twist)
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
            advance(rehearsal, IDLE, self.twist)
            at_rest = dict(rehearsal.frames)
            advance(rehearsal, DRIVING, self.twist)
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
            for phase in PHASES:
                advance(rehearsal, phase, self.twist)
                cases = [(i, case) for i, case in enumerate(self.cases) if phase in case.phases]
                work = [partial(_cell, rehearsal, case, phase, evidence) for _, case in cases]
                for index, reaction in run_forked(work, jobs):
                    yield (cases[index][0], phase), reaction
        finally:
            rehearsal.close()


def _cell(rehearsal: Rehearsal, case: FaultCase, phase: str, evidence: Evidence) -> Reaction:
    rehearsal.renew_connection()
    return react(rehearsal, case, phase, evidence)
