"""Decides whether the base driver may follow a commanded motion.

A gap in time, a fault or a person takes the permission away.  The states::

                  void: a gap in time, a pause
        GRANTED -------------------------------> ZERO_AWAITED <-----------+
           |    <-------------------------------       |                  |
           |     zero was commanded since then,        |                  | reset
           |     or the robot was armed                |                  |
           |                                           v                  |
           +---------------------------------------> FAULT ---------------+
                  fail: a long gap, or the third gap in two seconds

Beside it the robot is armed or disarmed.  A motion needs both: armed, and GRANTED.
"""

from __future__ import annotations

import enum
import math

from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


class Permission(enum.Enum):
    """State of the permission to move, see the text of this module."""

    GRANTED = "granted"
    ZERO_AWAITED = "zero awaited"
    FAULT = "fault"


class MotionPermission:
    """Permission of the base driver to follow a commanded motion.

    - ``state``: state of the permission;
    - ``armed``: ``False`` if no motion is accepted until the robot is armed;
    """

    def __init__(self) -> None:
        self.state = Permission.GRANTED
        self.armed = True
        self._disarmed_by = ""
        self._reason = ""
        self._since = -math.inf

    @property
    def fault(self) -> str:
        """Reason of the state FAULT, or an empty text."""
        return self._reason if self.state is Permission.FAULT else ""

    @property
    def waiting_reason(self) -> str:
        """Reason why no motion is accepted at present although there is no fault."""
        if not self.armed:
            return self._disarmed_by or "disarmed"
        if self.state is Permission.ZERO_AWAITED:
            return f"{self._reason}; command zero first"
        return ""

    def void(self, reason: str, now: float) -> None:
        """Accepts no motion until a zero twist is commanded after ``now`` (s)."""
        if self.state is not Permission.FAULT:
            self.state, self._reason = Permission.ZERO_AWAITED, reason
        self._since = now

    def fail(self, reason: str, now: float) -> None:
        """Accepts no motion until ``reset``."""
        self.state, self._reason, self._since = Permission.FAULT, reason, now

    def reset(self, now: float) -> None:
        """Leaves the state FAULT; a zero twist must be commanded after ``now`` (s)."""
        if self.state is Permission.FAULT:
            self.state, self._since = Permission.ZERO_AWAITED, now

    def note_command(self, twist: Twist, time: float) -> None:
        """Grants motion again if the newest command, given at ``time`` (s), is a zero twist."""
        if self.state is Permission.ZERO_AWAITED and twist == ZERO_TWIST and time > self._since:
            self.state = Permission.GRANTED

    def arm(self) -> None:
        """Accepts motion.  The caller must have checked that no motion is commanded."""
        self.armed = True
        if self.state is Permission.ZERO_AWAITED:
            self.state = Permission.GRANTED

    def disarm(self, reason: str = "") -> None:
        """Accepts no motion until ``arm``.

        ``reason``: reason that the operator sees, such as ``disarmed: the battery is empty``.
        """
        self.armed, self._disarmed_by = False, reason
