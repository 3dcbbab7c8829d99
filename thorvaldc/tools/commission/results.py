"""Results of the checks of a motor: figures with their bounds, and what the operator has seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.commissioning.commission_page import YES
from thorvaldc.model import Actuator
from thorvaldc.runtime.can_base.motor_controller import Axis
from thorvaldc.tools.commission.motion_watch import Travel


class Figure(NamedTuple):
    """A measured value with its bounds.

    - ``name``: what was measured;
    - ``value``: the value, NaN if it could not be measured;
    - ``least``, ``most``: bounds, infinite where there is none.
    """

    name: str
    value: float
    unit: str
    least: float
    most: float

    @property
    def passed(self) -> bool:
        return self.least <= self.value <= self.most

    @property
    def text(self) -> str:
        """The figure with its bounds on one line."""
        if self.unit == YES:
            return f"{self.name}: {'yes' if self.value else 'no'}"
        unit = f" {self.unit}" if self.unit else ""
        value = f"{self.value:.2f}{unit}" if math.isfinite(self.value) else "not reached"
        return f"{self.name} {value}, must be {self.least:.2f} to {self.most:.2f}{unit}"


@dataclass
class Observation:
    """The motion of a motor, as the drives reported it and as the operator has seen it.

    - ``travel``: motion of the motor; ``homing``: motion of its homing, for a steering motor;
    - ``moved``: motor of the joint that has moved, ``None`` if nothing has moved;
    - ``seen``: travel (rad) that the operator has seen, NaN if it was not asked;
    - ``zero``: angle (rad) of the wheel at the angle 0 of the drive, NaN if it was not asked.
    """

    axis: Axis
    travel: Travel | None = None
    homing: Travel | None = None
    moved: Actuator | None = None
    seen: float = math.nan
    zero: float = math.nan


class Finding(NamedTuple):
    """What is wrong in the assembly.

    - ``motors``: names of the motors that it concerns;
    - ``text``: what is wrong;
    - ``change``: what to change, in the file or on the robot.
    """

    motors: tuple[str, ...]
    text: str
    change: str


@dataclass
class MotorResult:
    """Result of the checks of one motor.

    - ``skipped``: the operator has left the motor or one of its checks out;
    - ``not_tested``: checks that were left out, with the reason.
    """

    observation: Observation
    figures: list[Figure] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    not_tested: list[str] = field(default_factory=list)
    skipped: bool = False

    @property
    def passed(self) -> bool:
        figures = all(figure.passed for figure in self.figures)
        return figures and not self.findings and not self.skipped
