"""The status display of a running base driver on stderr."""

from __future__ import annotations

import math
import os
import sys
import time
from types import TracebackType

from thorvaldc.cli.diagnostic_output import message
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.run_session import RunSession

STATUS_PERIOD = 0.2
"""Time in s between two updates of the status line."""


class StatusView:
    """Prints each new state of the base driver and, on a terminal, a status line."""

    def __init__(self, session: RunSession) -> None:
        self._session = session
        self._last_time = -math.inf
        self._line_shown = False

    def __enter__(self) -> StatusView:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._erase_line()

    def watch(self, driven: DrivenRobot, state: DriverState) -> None:
        """Prints new state changes of the base driver and updates the status line.

        The method ``watch`` must be called after each control cycle of the base driver.
        """
        session = self._session
        changes = session.base.changes
        if changes:
            self._erase_line()
            for change in changes:
                reason = f": {change.reason}" if change.reason else ""
                elapsed = change.time - session.start_time
                message(f"{elapsed:8.2f} s  {change.state.value}{reason}")
            changes.clear()
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._last_time >= STATUS_PERIOD:
            self._last_time = now
            self._show_line(f"{session.elapsed:8.1f} s  {session.status_line()}")

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
