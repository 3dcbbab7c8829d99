"""The operator at a terminal: asks questions and reads the answers while the control loop runs."""

from __future__ import annotations

import queue
import sys
import threading

from thorvaldc.cli.diagnostic_output import message
from thorvaldc.commissioning.commission_report import driven_joints
from thorvaldc.model import Actuator, Robot
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.tools.commission.questions import (
    Answer,
    Question,
    joint_text,
    plan_view,
    wheel_numbers,
)

_HINTS = {
    "motor": "Enter: start, s: leave this motor out, Ctrl-C: end",
    "start": "Enter: go on, s: leave this check out, Ctrl-C: end",
    "press": "Enter: start, s: leave this check out, Ctrl-C: end",
    "joint": "number of the wheel that rolled, with s of one that steered; n: none",
    "turns": "turns, such as 1 or -0.5; positive: forwards",
    "degrees": "degrees off straight ahead, such as 0 or -12; positive: to the left",
    "pressed": "y or n",
    "yes": "y or n",
}


class ConsoleOperator:
    """A person beside the robot who sees a terminal of 80 columns.

    A thread reads the lines, because the control loop must not wait for them.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._question: Question | None = None
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.closed = False
        """``True`` after the end of the input."""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self.put(line)
        self.closed = True

    def put(self, line: str) -> None:
        """Takes a line of the operator."""
        self._lines.put(line.strip())

    def note_motion(self, axis: Axis) -> None:
        """Does nothing: the person watches the robot."""

    def look(self) -> None:
        message("Look now: does the wheel stand?")

    def alarm(self, text: str) -> None:
        message(f"\n{text}")

    def ask(self, question: Question) -> None:
        while not self._lines.empty():  # a line from before the question is no answer to it
            self._lines.get_nowait()
        self._question = question
        if question.kind == "motor":
            wheel = self._robot.wheels[question.axis.wheel]
            message(f"\n{joint_text(self._robot, question.axis.actuator)}")
            message(plan_view(self._robot, wheel.name))
        message(question.text)
        self._prompt()

    def _prompt(self) -> None:
        if self._question is not None:
            print(f"  ({_HINTS[self._question.kind]}) ", end="", file=sys.stderr, flush=True)

    def answer(self) -> tuple[Answer] | None:
        if self._question is None or self._lines.empty():
            return None
        answer = self._parsed(self._question.kind, self._lines.get_nowait().lower())
        if answer is None:
            message("this is no answer to the question")
            self._prompt()
            return None
        self._question = None
        return answer

    def _parsed(self, kind: str, line: str) -> tuple[Answer] | None:
        if kind in ("motor", "start", "press"):
            return {"": (True,), "s": (False,)}.get(line)
        if kind in ("pressed", "yes"):
            return {"y": (True,), "yes": (True,), "n": (False,), "no": (False,)}.get(line)
        if kind == "joint":
            return (None,) if line in ("n", "none") else self._joint(line)
        try:
            return (float(line.removesuffix("deg").replace(",", ".")),)
        except ValueError:
            return None

    def _joint(self, line: str) -> tuple[Actuator] | None:
        steers = line.endswith("s")
        numbers = {str(number): name for name, number in wheel_numbers(self._robot).items()}
        name = numbers.get(line.removesuffix("s").strip())
        for wheel in self._robot.wheels:
            if wheel.name == name:
                joint = wheel.steering_joint if steers else wheel.spin_joint
                by_joint = {motor.joint: motor for motor in driven_joints(self._robot)}
                motor = by_joint.get(joint or "")
                return None if motor is None else (motor,)
        return None
