"""``can monitor``: what goes on on a robot's bus."""

from __future__ import annotations

import gc
import json as json_format
import math
import shutil
import signal
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, finite
from thorvaldc.cli.options import bus_of, seconds_of

if TYPE_CHECKING:
    from thorvaldc.can.interface import CanInterface
    from thorvaldc.model import Robot
    from thorvaldc.model.bus import Bus

LIVE_INTERVAL = 0.25
INTERVAL = 1.0
SHORTEST = 0.05
"""s between two views."""


def monitor(
    file: str,
    bus: str,
    duration: str,
    interval: str,
    json: bool,
    library: Sequence[str],
) -> int:
    """Until its time is over, ``q`` is typed, or it is interrupted or terminated."""
    live = sys.stdout.isatty() and not json
    seconds = seconds_of(duration, "--duration", SHORTEST) if duration else math.inf
    default = LIVE_INTERVAL if live else INTERVAL
    period = seconds_of(interval, "--interval", SHORTEST) if interval else default
    from thorvaldc.cli.running import load_robot
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    loaded = load_robot(file, library)
    if loaded is None:
        return INPUT
    robot, sources, located = loaded
    try:
        watched, spec = bus_of(robot, bus)
        port = _open(spec, watched)
    except DiagnosticError as fault:
        report = Report()
        report.put(fault.diagnostic)
        faults = Faults("text", sys.stderr)
        faults.add(located(report), sources)
        return faults.finish()
    gc.enable()
    try:
        _watch(robot, watched, port, period, seconds, json, live)
    except ConnectionError as fault:
        raise OutsideError(f"the bus is gone: {fault}") from None
    finally:
        port.close()
    return DONE


def _watch(
    robot: Robot,
    bus: Bus,
    port: CanInterface,
    period: float,
    seconds: float,
    json: bool,
    live: bool,
) -> None:
    from thorvaldc.tools.monitor.bus_monitor import BusMonitor, watch
    from thorvaldc.tools.monitor.monitor_text import monitor_lines
    from thorvaldc.tools.teleoperation.terminal import Terminal

    asked: list[int] = []
    last: list[Mapping[str, Any]] = []
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda n, _: asked.append(n)) for number in signals}
    monitor = BusMonitor(robot, bus)
    until = port.now + seconds
    try:
        if live:
            keys = sys.stdin if sys.stdin.isatty() else None
            with Terminal(keys, sys.stdout, whole=True) as terminal:
                screen = _Screen(terminal)
                watch(
                    port,
                    monitor,
                    period,
                    screen.show,
                    until=until,
                    ended=lambda: bool(asked) or screen.ended(),
                )
        else:
            tell = _print_json if json else lambda found: last.__setitem__(slice(None), [found])
            watch(port, monitor, period, tell, until=until, ended=lambda: bool(asked))
            if not json:
                found = last[0] if last else monitor.summary(port.now)
                print("\n".join(monitor_lines(found)))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Screen:
    """The live view: the summary's lines, which the arrow keys move."""

    def __init__(self, terminal: Any) -> None:
        self._terminal = terminal
        self._first = 0
        self._lines: list[str] = []
        self._quits = False

    def show(self, summary: Mapping[str, Any]) -> None:
        from thorvaldc.tools.monitor.monitor_text import monitor_lines

        self._lines = monitor_lines(summary)
        self._draw()

    def ended(self) -> bool:
        try:
            keys = self._terminal.read()
        except EOFError:
            return True
        for key in keys:
            if key in ("q", "Q", "ctrl-d", "ctrl-c"):
                self._quits = True
            step = {"down": 1, "j": 1, "up": -1, "k": -1, " ": self._height() - 2}.get(key, 0)
            if step:
                most = max(len(self._lines) - self._height() + 1, 0)
                self._first = min(max(self._first + step, 0), most)
                self._draw()
        return self._quits

    def _draw(self) -> None:
        from thorvaldc.tools.monitor.monitor_text import page

        self._terminal.show(page(self._lines, self._height(), self._first))

    @staticmethod
    def _height() -> int:
        return shutil.get_terminal_size().lines


def _print_json(found: Mapping[str, Any]) -> None:
    print(json_format.dumps(finite(found), ensure_ascii=False), flush=True)


def _open(spec: str, bus: Bus) -> CanInterface:
    from thorvaldc.can.open_interface import open_interface

    if spec == "virtual":
        raise typer.BadParameter(
            "a virtual bus is the own process's alone; run `thorvaldc bus FILE` and watch sim:NAME",
            param_hint="'--bus'",
        )
    return open_interface(spec, bus, listen_only=True)
