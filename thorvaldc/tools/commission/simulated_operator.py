"""An operator who stands beside a simulated robot and sees its joints."""

from __future__ import annotations

import math

from thorvaldc.commissioning.commission_report import driven_joints
from thorvaldc.runtime.motion_supervision import STANDING, Axis
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.tools.commission.questions import Answer, Question

SEEN_TRAVEL = 0.02
"""Smallest travel (rad) of a joint that the operator sees."""
TURNS_STEP, DEGREES_STEP = 0.05, 1.0
"""Accuracy of the answers."""


class SimulatedOperator:
    """Starts every motion, and answers as accurately as a person does."""

    closed = False

    def __init__(self, simulated: SimulatedRobot) -> None:
        self._simulated = simulated
        self._joints = driven_joints(simulated.robot)
        self._before = self._positions()
        self._answer: tuple[Answer] | None = None
        self._stood = True

    def _positions(self) -> dict[str, float]:
        now = self._simulated.timeline.seconds
        return {j.name: self._simulated.motors[j.name].read(now).position for j in self._joints}

    def note_motion(self, axis: Axis) -> None:
        self._before = self._positions()

    def look(self) -> None:
        now, motors = self._simulated.timeline.seconds, self._simulated.motors
        self._stood = all(abs(motors[j.name].read(now).velocity) < STANDING for j in self._joints)

    def alarm(self, text: str) -> None:
        """Does nothing: the report has the reason."""

    def ask(self, question: Question) -> None:
        now = self._positions()
        travels = {name: now[name] - before for name, before in self._before.items()}
        name = max(travels, key=lambda name: abs(travels[name]))
        is_seen = abs(travels[name]) >= SEEN_TRAVEL
        moved = next(joint for joint in self._joints if joint.name == name)
        if not is_seen:
            moved = question.axis.actuator
        if question.kind == "joint":
            self._answer = (moved if is_seen else None,)
        elif question.kind in ("press", "pressed"):  # a simulated robot has no button
            self._answer = (False,)
        elif question.kind == "turns":
            turns = travels[moved.name] / math.tau
            self._answer = (TURNS_STEP * round(turns / TURNS_STEP),)
        elif question.kind == "degrees":
            self._answer = (DEGREES_STEP * round(math.degrees(now[moved.name]) / DEGREES_STEP),)
        else:
            self._answer = (question.kind in ("motor", "start") or self._stood,)
            self._stood = True

    def answer(self) -> tuple[Answer] | None:
        answer, self._answer = self._answer, None
        return answer
