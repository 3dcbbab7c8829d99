"""A progress bar on stderr."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from thorvaldc.cli.diagnostic_output import width_of

if TYPE_CHECKING:  # the runtime package has no simulation
    from thorvaldc.simulation.control_loop import ControlLoop

BAR_WIDTH = 30  # characters


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
