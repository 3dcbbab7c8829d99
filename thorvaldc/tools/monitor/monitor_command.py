"""The command ``thorvaldc can monitor``: shows the CAN frames on a robot's bus."""

from __future__ import annotations

import functools
import gc
import math
import sys
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import diagnostic_output, options, robot_file
from thorvaldc.cli.exits import DONE, OutsideError
from thorvaldc.diagnostics import DiagnosticError

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.model import Bus

LIVE_INTERVAL = 0.25
INTERVAL = 1.0
SHORTEST = 0.05
"""Time in s between two views."""


def monitor(
    file: options.RobotFile,
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            autocompletion=options.bus_interfaces,
            help="sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of python-can;"
            " for a robot with several buses NAME=BUS.",
        ),
    ],
    duration: Annotated[
        str, typer.Option("--duration", metavar="TIME", help="Duration of the monitoring: 10 s.")
    ] = "",
    interval: Annotated[
        str,
        typer.Option(
            "--interval",
            metavar="TIME",
            help="Time between two views.",
            show_default="0.25 s on a terminal, else 1 s",
        ),
    ] = "",
    json: Annotated[
        bool, typer.Option("--json", help="Print a line of JSON for each interval.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.tools.monitor import monitor_view
    from thorvaldc.tools.monitor.bus_monitor import BusMonitor

    live = sys.stdout.isatty() and not json
    seconds = options.parse_duration(duration, "--duration", SHORTEST) if duration else math.inf
    period = LIVE_INTERVAL if live else INTERVAL
    if interval:
        period = options.parse_duration(interval, "--interval", SHORTEST)
    loaded = robot_file.load_robot(file, library, trust)
    try:
        model_bus, interface_name = robot_file.select_bus(loaded.robot, bus)
        interface = _open(interface_name, model_bus)
    except DiagnosticError as error:
        return loaded.show(diagnostic_output.report_of(error))
    gc.enable()
    bus_monitor = BusMonitor(loaded.robot, model_bus)
    try:
        if live:
            keys = sys.stdin if sys.stdin.isatty() else None
            monitor_view.watch_live(interface, bus_monitor, period, seconds, keys, sys.stdout)
        elif json:
            show = functools.partial(diagnostic_output.print_json, one_line=True)
            monitor_view.watch_stream(interface, bus_monitor, period, seconds, show)
        else:
            last: deque[Mapping[str, Any]] = deque(maxlen=1)
            monitor_view.watch_stream(interface, bus_monitor, period, seconds, last.append)
            summary = last[0] if last else bus_monitor.summary(interface.now)
            print("\n".join(monitor_view.monitor_lines(summary)))
    except ConnectionError as error:
        raise OutsideError(f"the CAN interface is lost: {error}") from None
    finally:
        interface.close()
    return DONE


def _open(name: str, bus: Bus) -> CanInterface:
    from thorvaldc.can.open_interface import open_interface

    if name == "virtual":
        raise typer.BadParameter(
            "a virtual bus exists only in its own process; run `thorvaldc bus FILE` and monitor"
            " sim:NAME",
            param_hint="'--bus'",
        )
    return open_interface(name, bus, listen_only=True)
