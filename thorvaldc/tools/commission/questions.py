"""Questions to the operator who stands beside the robot, and the answers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from thorvaldc.model import Actuator, Robot
from thorvaldc.runtime.motion_supervision import Axis


class Question(NamedTuple):
    """A question about the motion of a motor.

    - ``kind``: ``motor``, ``start``, ``press``, ``pressed``, ``joint``, ``turns``, ``degrees`` or
      ``yes``;
    - ``text``: the question; the operator's program adds how to answer;
    - ``axis``: the motor that is driven.

    Answers by kind:

    - ``motor``, ``start``, ``press``: ``True`` to begin the motion, ``False`` to leave it out;
    - ``joint``: the ``Actuator`` whose joint has moved, or ``None`` if nothing has moved;
    - ``turns``: turns of the wheel of the latest ``joint``, positive if it would drive forwards;
    - ``degrees``: direction of the wheel of the latest ``joint``, positive to the left of straight
      ahead;
    - ``pressed``: ``True`` if the operator has pressed the emergency stop;
    - ``yes``: ``True`` or ``False``.
    """

    kind: str
    text: str
    axis: Axis


Answer = bool | float | Actuator | None


class Operator(Protocol):
    """The person beside the robot.  A question is answered while the control loop goes on.

    - ``closed``: ``True`` if no answer will come any more.
    """

    closed: bool

    def note_motion(self, axis: Axis) -> None:
        """Is called before each motion of a motor."""

    def look(self) -> None:
        """Is called when a wheel must stand; the next question asks for it."""

    def alarm(self, text: str) -> None:
        """Is called when the checks end early, while the program still stops the robot."""

    def ask(self, question: Question) -> None:
        """Asks a question, after the answer to the one before."""

    def answer(self) -> tuple[Answer] | None:
        """Returns the answer in a tuple, or ``None`` as long as there is none."""


# -- a picture of the robot in a terminal ----------------------------------------------------------

COLUMNS, ROWS = 46, 9
"""Size of the picture in characters."""


def wheel_numbers(robot: Robot) -> dict[str, int]:
    """Returns the number of each wheel in the picture, by its name."""
    return {wheel.name: number for number, wheel in enumerate(robot.wheels, 1)}


def plan_view(robot: Robot, marked: str) -> str:
    """Returns the wheels of a robot seen from above, with its front up, and one wheel marked.

    ``marked``: name of the marked wheel.
    """
    xs, ys = [w.x for w in robot.wheels], [w.y for w in robot.wheels]
    height, width = max(max(xs) - min(xs), 0.1), max(max(ys) - min(ys), 0.1)
    grid = [[" "] * (COLUMNS + 16) for _ in range(ROWS)]
    for wheel, number in zip(robot.wheels, wheel_numbers(robot).values(), strict=True):
        row = round((max(xs) - wheel.x) / height * (ROWS - 1)) if max(xs) > min(xs) else ROWS // 2
        column = round((max(ys) - wheel.y) / width * (COLUMNS - 8)) if max(ys) > min(ys) else 20
        text = f"[{number}]" if wheel.name != marked else f">>[{number}]<<"
        column = max(column - (2 if wheel.name == marked else 0) + 2, 0)
        for at, letter in enumerate(text):
            grid[row][column + at] = letter
    lines = ["".join(row).rstrip() for row in grid]
    names = ", ".join(f"{number} {name}" for name, number in wheel_numbers(robot).items())
    return "\n".join([" " * (COLUMNS // 2 - 2) + "front", *lines, names])


# -- texts of joints -------------------------------------------------------------------------------


def joint_text(robot: Robot, actuator: Actuator) -> str:
    """Returns the joint of a motor for an operator: ``wheel fl`` or ``steering of wheel fl``."""
    for wheel in robot.wheels:
        if wheel.spin_joint == actuator.joint:
            return f"wheel {wheel.name}"
        if wheel.steering_joint == actuator.joint:
            return f"steering of wheel {wheel.name}"
    return actuator.name
