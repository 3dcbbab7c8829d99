"""A progress bar."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from thorvaldc.cli.faults import width_of

if TYPE_CHECKING:
    from thorvaldc.simulation.control_loop import ControlLoop

BAR = 30  # characters


class Progress:
    """A bar on a terminal; nothing elsewhere.  ``what`` is named before it."""

    def __init__(self, total: float, unit: str = "s", what: str = "") -> None:
        self.total = total
        self.unit = unit
        self.what = f"{what} " if what else ""
        self.active = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._shown = -1

    def show(self, done: float) -> None:
        """``done`` of the total."""
        percent = int(100 * min(done / self.total, 1.0)) if self.active else self._shown
        if percent != self._shown:
            self._shown = percent
            bar = f"[{'#' * (percent * BAR // 100):<{BAR}}]"
            said = f"{done:.1f}" if self.unit == "s" else f"{done:.0f}"
            line = f"{self.what}{bar} {percent:3d} %  {said} of {self.total:g} {self.unit}"
            # A line that goes on in the next one could not be taken away.
            print(f"\r{line[: width_of(sys.stderr) - 1]}", end="", file=sys.stderr, flush=True)

    def watch(self, loop: ControlLoop) -> None:
        """``show`` the time of a run."""
        self.show(loop.driver.state.time)

    def clear(self) -> None:
        """Take the bar away."""
        if self._shown >= 0:
            self._shown = -1
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
