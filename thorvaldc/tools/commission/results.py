"""Results of the checks of a motor: figures, and what the operator has seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from thorvaldc.commissioning.commission_report import Figure
from thorvaldc.model import Actuator
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.tools.commission.motion_watch import Travel

WATCHDOG = "drive's watchdog acts"
STANDS = "stands by the drive's watchdog"
"""Names of the figures of the watchdog of a drive."""
EMERGENCY_STOP = "stands after the emergency stop"
"""Name of the figure of the emergency stop."""


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


@dataclass
class MotorResult:
    """Result of the checks of one motor.

    - ``skipped``: the motor or one of its checks was left out, or could not be measured;
    - ``not_tested``: checks that were left out or not measured, with the reason.
    """

    observation: Observation
    figures: list[Figure] = field(default_factory=list)
    not_tested: list[str] = field(default_factory=list)
    skipped: bool = False

    def leave_unmeasured(self, name: str, reason: str) -> None:
        """Notes that something else may have stopped the motor, so that a check shows nothing."""
        self.skipped = True
        self.not_tested.append(f"{name}: not measured: {reason}")

    def add(self, name: str, value: float, unit: str, least: float, most: float) -> None:
        """Adds a figure; a value that is not finite was not reached."""
        reached = value if math.isfinite(value) else None
        self.figures.append(Figure(name, reached, unit, least, most))
