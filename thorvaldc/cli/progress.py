"""What a command shows on stderr while it works: a progress bar, the states of the base driver."""

from __future__ import annotations

import math
import os
import sys
import time
from typing import TYPE_CHECKING

from thorvaldc.cli.diagnostic_output import message, width_of

if TYPE_CHECKING:  # the runtime package has no simulation
    from thorvaldc.runtime.driven_robot import DrivenRobot
    from thorvaldc.runtime.driver import DriverState
    from thorvaldc.runtime.run_session import RunSession
    from thorvaldc.simulation.control_loop import ControlLoop

BAR_WIDTH = 30  # characters
STATUS_PERIOD = 0.2
"""Time in s between two updates of the status line."""


class Progress:
    """A progress bar on stderr, which is shown only on a terminal.

    - ``total``: value at which the progress bar is full.
    - ``label``: text before the progress bar.
    """

    def __init__(self, total: float, unit: str = "s", label: str = "") -> None:
        self.total = total
        self.unit = unit
        self.label = f"{label} " if label else ""
        self.active = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._shown_percent = -1

    def show(self, value: float) -> None:
        """Shows the progress bar for ``value`` of the total."""
        percent = int(100 * min(value / self.total, 1.0)) if self.active else self._shown_percent
        if percent != self._shown_percent:
            self._shown_percent = percent
            print(f"\r{self.line(value)}", end="", file=sys.stderr, flush=True)

    def line(self, value: float) -> str:
        """Returns the progress bar for ``value`` of the total as text.

        The text is cut at the width of the terminal, because a wrapped line cannot be erased.
        """
        percent = int(100 * min(value / self.total, 1.0))
        bar = f"[{'#' * (percent * BAR_WIDTH // 100):<{BAR_WIDTH}}]"
        number = f"{value:.1f}" if self.unit == "s" else f"{value:.0f}"
        line = f"{self.label}{bar} {percent:3d} %  {number} of {self.total:g} {self.unit}"
        return line[: width_of(sys.stderr) - 1]

    def watch(self, loop: ControlLoop) -> None:
        """Shows the simulated time of a run in the progress bar."""
        self.show(loop.driver.state.time)

    def clear(self) -> None:
        """Erases the progress bar from the terminal."""
        if self._shown_percent >= 0:
            self._shown_percent = -1
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


class StatusView:
    """Prints each new state of the base driver and, on a terminal, a status line."""

    def __init__(self, session: RunSession) -> None:
        self._session = session
        self._last_time = -math.inf
        self._line_shown = False
        self._versions_shown = 0
        self._waits_for = ""
        self._end_shown = False

    def __enter__(self) -> StatusView:
        return self

    def __exit__(self, *error: object) -> None:
        self._erase_line()

    def watch(self, driven: DrivenRobot, state: DriverState) -> None:
        """Prints new state changes of the base driver and updates the status line.

        The method ``watch`` must be called after each control cycle of the base driver.
        """
        session = self._session
        changes = session.base.changes
        if changes:
            self._erase_line()
            for change in filter(session.is_news, changes):
                reason = f": {change.reason}" if change.reason else ""
                elapsed = change.time - session.start_time
                message(f"{elapsed:8.2f} s  {change.state.value}{reason}")
            changes.clear()
        if session.waits_for != self._waits_for:
            self._waits_for = session.waits_for
            if self._waits_for:
                self._erase_line()
                message(f"{session.elapsed:8.2f} s  waits, disarmed, until all controllers answer")
        if session.twist_ended and not self._end_shown:
            self._erase_line()
            message(f"{session.elapsed:8.2f} s  the twist has ended: {session.twist_ended}")
            self._end_shown = True
        for text in list(driven.other_versions.values())[self._versions_shown :]:
            self._erase_line()
            message(f"warning: {text}")
            self._versions_shown += 1
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._last_time >= STATUS_PERIOD:
            self._last_time = now
            self._show_line(f"{session.elapsed:6.1f} s  {session.status_line()}")

    def _show_line(self, text: str) -> None:
        width = max(os.get_terminal_size(sys.stderr.fileno()).columns - 1, 20)
        sys.stderr.write("\r" + text[:width] + "\x1b[K")
        sys.stderr.flush()
        self._line_shown = True

    def _erase_line(self) -> None:
        if self._line_shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
            self._line_shown = False
