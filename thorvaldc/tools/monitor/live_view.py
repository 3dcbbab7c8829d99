"""Shows the summaries of a bus monitor on a terminal, or passes the summaries to a function."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from typing import IO, Any

from thorvaldc.can.frame import CanInterface
from thorvaldc.cli.terminal import Terminal
from thorvaldc.runtime.pace import end_signals
from thorvaldc.tools.monitor.bus_monitor import BusMonitor, watch
from thorvaldc.tools.monitor.monitor_text import monitor_lines, page

COLUMNS = 8
"""Number of columns by which the keys left and right scroll."""


def watch_live(
    interface: CanInterface,
    monitor: BusMonitor,
    interval: float,
    duration: float,
    keys: IO[str] | None,
    screen: IO[str],
) -> None:
    """Shows the state of a CAN bus on the terminal.

    The function returns when the user presses ``q``, when a termination signal arrives, or after
    ``duration`` seconds.  ``interval``: time (s) between two updates of the terminal.  Raises
    ``ConnectionError`` if the connection to the CAN interface is lost.
    """
    until = interface.now + duration
    with end_signals() as end_requested, Terminal(keys, screen, whole=True) as terminal:
        view = LiveView(terminal)
        watch(
            interface,
            monitor,
            interval,
            view.show,
            until=until,
            ended=lambda: end_requested() or view.poll(),
        )


def watch_stream(
    interface: CanInterface,
    monitor: BusMonitor,
    interval: float,
    duration: float,
    show: Callable[[Mapping[str, Any]], None],
) -> None:
    """Calls the function ``show`` with a summary of the CAN bus every ``interval`` seconds.

    The function returns when a termination signal arrives, or after ``duration`` seconds.
    """
    with end_signals() as end_requested:
        until = interface.now + duration
        watch(interface, monitor, interval, show, until=until, ended=end_requested)


class LiveView:
    """View of a CAN bus summary on a terminal, which the user can scroll with the arrow keys."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self._first_line = self._first_column = 0
        self._lines: list[str] = []
        self._quit = False

    def show(self, summary: Mapping[str, Any]) -> None:
        """Shows a new summary of the CAN bus on the terminal."""
        self._lines = monitor_lines(summary)
        self._draw()

    def poll(self) -> bool:
        """Reads the pressed keys and scrolls the terminal view.

        Returns ``True`` if the user has pressed the key to quit.
        """
        try:
            keys = self._terminal.read()
        except EOFError:
            return True
        for key in keys:
            if key in ("q", "Q", "ctrl-d", "ctrl-c"):
                self._quit = True
            step = {"down": 1, "j": 1, "up": -1, "k": -1, " ": _height() - 2}.get(key, 0)
            sideways = {"right": COLUMNS, "l": COLUMNS, "left": -COLUMNS, "h": -COLUMNS}.get(key, 0)
            if step or sideways:
                last = max(len(self._lines) - _height() + 1, 0)
                self._first_line = min(max(self._first_line + step, 0), last)
                last = max(max(map(len, self._lines), default=0) - COLUMNS, 0)
                self._first_column = min(max(self._first_column + sideways, 0), last)
                self._draw()
        return self._quit

    def _draw(self) -> None:
        lines = [line[self._first_column :] for line in self._lines]
        self._terminal.show(page(lines, _height(), self._first_line))


def _height() -> int:
    return shutil.get_terminal_size().lines
