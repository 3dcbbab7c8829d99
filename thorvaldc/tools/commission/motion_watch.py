"""Compares the reports of all motors with the command of the single motor that is driven.

The supervision of a run (``motion_supervision``) allows deviations that a loaded robot has.  A
wheel in the air follows its command closely, and a wrong encoder must be found before the wheel is
fast: if it counts against its motor, no ramp of the drive stops it, but only the loss of torque.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.tools.commission.motor_session import SingleMotorBase

SPEED = 1.0
"""Test speed (rad/s) of a joint."""
SPEED_SHARE = 0.25
"""Largest test speed as a share of the top speed of a joint."""
TOLERANCE = 0.4
"""Largest deviation of a reported speed from the commanded one, as a share of the test speed."""
DELAY = 0.2
"""Time (s) in which a motor may follow its command, and at least ``CYCLES`` control cycles."""
QUIET = 0.25
"""Time (s) of commanded motion after which the motor must have reported motion, and at least
``CYCLES`` control cycles."""
CYCLES = 5
QUIET_TRAVEL = 0.01
"""Reported travel (rad) that is no motion."""
OTHER_TRAVEL = 0.04
"""Travel (rad) reported by a motor without torque that is more than play or vibration."""
WINDOW = 0.1
"""Time (s) over which the speed of a steering joint is averaged."""
HOMING_SHARE = 0.9
"""Largest speed of a homing as a share of the top speed of a joint."""
HOMING_QUIET = 1.5
"""Time (s) of a homing without a report of motion."""

OTHERS, OPPOSITE, TOO_FAST, SILENT = "others", "opposite", "too fast", "silent"
"""Values of ``Travel.cause``."""
ABORTS = {
    OTHERS: "another motor reported the motion",
    OPPOSITE: "it reported motion against its command",
    TOO_FAST: "it was faster than commanded",
    SILENT: "it reported no motion",
}


class Travel(NamedTuple):
    """Motion of the driven motor.

    - ``commanded``, ``reported``: travel (rad) of the joint; ``commanded`` is NaN for a homing;
    - ``cause``: one of ``ABORTS`` if the motor lost its torque for it, or an empty text;
    - ``fault``: reason of a fault of the base that the motion caused, or an empty text;
    - ``others``: motors without torque that reported the motion.
    """

    commanded: float
    reported: float
    cause: str = ""
    fault: str = ""
    others: tuple[Axis, ...] = ()

    @property
    def completed(self) -> bool:
        return not self.cause and not self.fault


def test_speed(axis: Axis) -> float:
    """Returns the test speed (rad/s) of a joint."""
    return min(SPEED, SPEED_SHARE * axis.actuator.max_velocity)


class _Reports:
    """Travel and speed of one motor, from its reports since the begin of a motion.

    - ``travel``: reported travel (rad);
    - ``speed``: mean reported speed (rad/s) in the last ``WINDOW`` s.

    A steering joint that follows a moving target angle moves in steps, so that its reported speed
    tells little.  Its position does, except in a homing, which sets it.
    """

    def __init__(self, axis: Axis, *, by_speed: bool) -> None:
        self._axis = axis
        self._by_speed = by_speed
        self._newest = axis.time
        self._first = axis.position
        self._recent: deque[tuple[float, float]] = deque()
        self.travel = 0.0
        self.speed = 0.0

    def update(self) -> bool:
        """Takes over the newest report.  Returns whether there is one."""
        axis, elapsed = self._axis, self._axis.time - self._newest
        self._newest = axis.time
        if not 0.0 < elapsed < 1.0:
            return False
        if self._by_speed:
            self.speed = axis.velocity
            self.travel += axis.velocity * elapsed
            return True
        self.travel = axis.position - self._first
        self._recent.append((axis.time, self.travel))
        while self._recent[0][0] < axis.time - WINDOW:
            self._recent.popleft()
        time, travel = self._recent[0]
        self.speed = (self.travel - travel) / (axis.time - time) if axis.time > time else 0.0
        return True


class MotionWatch:
    """Compares reports and command, in each control cycle of a motion or of a homing.

    - ``cause``: reason to take the torque of the motor, one of ``ABORTS``, or an empty text.
    """

    def __init__(self, base: SingleMotorBase, axis: Axis, velocity: float) -> None:
        """``velocity``: test speed (rad/s) with its sign, NaN for a homing."""
        self.base = base
        self.axis = axis
        self.velocity = velocity
        self.cause = ""
        is_homing = math.isnan(velocity)
        self._reports = {
            each: _Reports(each, by_speed=not each.steering or (is_homing and each is axis))
            for each in base.axes
        }
        self._delay = max(DELAY, CYCLES * base.period)
        quiet = max(QUIET, CYCLES * base.period)
        self._quiet = HOMING_QUIET + quiet if is_homing else quiet
        self._moves_for = 0.0
        self._deviations = 0
        self._commands: deque[tuple[float, float]] = deque()
        self._updated_at = math.nan

    @property
    def reported(self) -> float:
        """Reported travel (rad) of the driven motor."""
        return self._reports[self.axis].travel

    @property
    def others(self) -> tuple[Axis, ...]:
        """Motors without torque that have reported motion."""
        return tuple(
            each
            for each, reports in self._reports.items()
            if each is not self.axis and abs(reports.travel) > OTHER_TRAVEL
        )

    def update(self, now: float) -> None:
        for each, reports in self._reports.items():
            if reports.update() and each is self.axis:
                self._judge_speed(now, reports.speed)
        self._judge_silence(now)

    def _judge_speed(self, now: float, speed: float) -> None:
        if math.isnan(self.velocity):
            deviates = abs(speed) > HOMING_SHARE * self.axis.actuator.max_velocity
        else:
            self._commands.append((now, self.base.speed))
            while self._commands[0][0] < now - self._delay:
                self._commands.popleft()
            limit = TOLERANCE * abs(self.velocity)
            # A motor that is too slow is the matter of `_judge_silence` and of the base.
            speeds = [0.0, *(commanded for _, commanded in self._commands)]
            deviates = not min(speeds) - limit <= speed <= max(speeds) + limit
        self._deviations = self._deviations + 1 if deviates else 0
        if self._deviations >= 2 and not self.cause:
            self.cause = OPPOSITE if speed * self.velocity < 0.0 else TOO_FAST

    def _judge_silence(self, now: float) -> None:
        is_homing = math.isnan(self.velocity)
        moves = is_homing or abs(self.base.speed) > TOLERANCE * abs(self.velocity)
        if moves and math.isfinite(self._updated_at):
            self._moves_for += now - self._updated_at
        self._updated_at = now
        if self.cause or abs(self.reported) > QUIET_TRAVEL:
            return
        if self.others:
            self.cause = OTHERS
        elif self._moves_for > self._quiet:
            self.cause = SILENT
