"""Watches a clock of ROS that another node publishes."""

from __future__ import annotations

import math

LONGEST_JUMP = 1.0
"""Largest forward step (s) of the clock between two control cycles that is no jump."""


class ClockWatch:
    """Notices that a clock stands still or jumps.

    ``problem``: reason why no command counts at present, or an empty text.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._follows: bool | None = None
        self._ros_time = math.nan
        self._moved = math.nan

    def update(self, ros_time: float | None, now: float, longest_stand: float) -> str:
        """Judges the time ``ros_time`` (s) of the clock at the real time ``now`` (s).

        - ``ros_time``: ``None`` while the time is that of the computer, which needs no watch;
        - ``longest_stand``: longest real time (s) for which the clock may stand.

        Returns the description of a jump, or an empty text.
        """
        follows = ros_time is not None
        switched = follows is not self._follows and self._follows is not None
        first = switched or self._follows is None
        self._follows = follows
        last, self._ros_time = self._ros_time, math.nan if ros_time is None else ros_time
        step = 0.0 if first else self._ros_time - last
        if ros_time is None:
            self.problem = ""
        elif first:  # without a message it is 0, or the time of an earlier message
            self._moved = math.inf
            self.problem = "the clock /clock has not run yet"
        elif step != 0.0:
            self._moved = now
            self.problem = ""
        elif now - self._moved > longest_stand:
            self.problem = f"the clock /clock stands still at {ros_time:.3f} s"
        if switched:
            return f"use_sim_time has become {str(follows).lower()}"
        if step < 0.0:
            return f"the clock /clock jumped back by {-step:.3f} s"
        if step > LONGEST_JUMP:
            return f"the clock /clock jumped by {step:.3f} s"
        return ""
