"""The command ``thorvaldc run``: runs the base driver on the CAN buses of a robot."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completion import bus_interfaces
from thorvaldc.cli.exits import INPUT, OutsideError, check_full_installation

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.cli.robot_file import LoadedRobot
    from thorvaldc.commissioning.commission_report import CommissionReport
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Robot
    from thorvaldc.runtime.run_session import RunSession


Commissioned = Annotated[
    bool,
    typer.Option(
        "--commissioned",
        help="Refuse a robot whose report of `can commission` is missing, old, not passed, or of"
        " other controllers.",
    ),
]


def run(
    file: options.RobotFile,
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            autocompletion=bus_interfaces,
            help="virtual, sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of"
            " python-can.",
        ),
    ],
    duration: Annotated[
        str,
        typer.Option(
            "--duration", metavar="TIME", help="Duration of the run once the robot is ready: 20 s."
        ),
    ] = "",
    twist: Annotated[
        str,
        typer.Option("--twist", metavar="VX,VY,WZ", help="Twist to drive, in m/s, m/s and rad/s."),
    ] = "",
    parameters: options.Parameters = "",
    physics: options.Physics = "ideal",
    faults: options.InjectedFaults = "",
    seed: options.Seed = "",
    fast: Annotated[
        bool, typer.Option("--fast", help="Simulate a virtual robot faster than real time.")
    ] = False,
    name: Annotated[
        str,
        typer.Option(
            "--name",
            metavar="NAME",
            help="Name of the control channel, for `teleop --to` and `call`.",
            show_default="the robot's; none with --twist or --duration",
        ),
    ] = "",
    commissioned: Commissioned = False,
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.can.open_interface import lock_buses, open_interfaces
    from thorvaldc.cli.robot_file import is_hardware, load_robot, warn_once
    from thorvaldc.diagnostics import DiagnosticError, Report
    from thorvaldc.runtime.run_session import RunSession
    from thorvaldc.runtime.se2 import parse_twist

    seconds = options.parse_duration(duration, "--duration") if duration else math.inf
    commanded_twist = options.parsed(twist, parse_twist, "--twist") if twist else None
    options.check_physics(physics)
    virtual = bus == "virtual"
    if not virtual:
        _refuse_simulation(faults, seed, physics, fast)
    if fast and not duration:
        raise typer.BadParameter("needs a --duration", param_hint="'--fast'")
    if fast:
        options.refuse_options({"--name": name}, "a run with --fast has no control channel")
    loaded = load_robot(file, library, trust)
    if loaded is None:
        return INPUT
    with contextlib.ExitStack() as locks:
        report = Report()
        try:
            checked = _read_report(file, loaded.robot) if commissioned else None
            if not virtual:
                lock_buses(bus, loaded.robot, locks)
            interfaces = (
                _virtual_interfaces(
                    loaded.robot, file, physics, faults, options.parse_seed(seed), report
                )
                if virtual
                else open_interfaces(bus, loaded.robot)
            )
            session = RunSession(
                _identified(loaded.robot, checked, interfaces),
                interfaces,
                parameters=parameters or None,
                twist=commanded_twist,
                duration=seconds,
                # Without a twist and a duration, other programs drive the robot through the control
                # channel.
                channel=name or ("" if twist or duration else loaded.robot.name),
                threaded=not virtual,
                paced=virtual and not fast,
            )
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return loaded.show(report)
        except OSError as error:  # the control channel is in use
            raise OutsideError(f"{error}; --name selects another name") from None
        if report.has_errors:
            return loaded.show(report)
        if is_hardware(bus):
            warn_once()
        loaded.show(report)
        return _drive(session, loaded, json)


def _read_report(file: str, robot: Robot) -> tuple[Path, CommissionReport]:
    from thorvaldc.cli.robot_file import path_beside
    from thorvaldc.commissioning.commission_report import SUFFIX, read_report

    path = path_beside(file, robot, SUFFIX)
    return path, read_report(path)


def _identified(
    robot: Robot,
    checked: tuple[Path, CommissionReport] | None,
    interfaces: Mapping[str, CanInterface],
) -> Robot:
    """Compares a report with the robot and with the devices on its buses, before anything can move.

    Returns the robot with the serial numbers of the devices, or as it is if no report is demanded.
    """
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.commissioning.commission_report import identity_note, require_commissioned
    from thorvaldc.commissioning.scanner import scan_robot, with_serial_numbers
    from thorvaldc.diagnostics import DiagnosticError

    if checked is None:
        return robot
    try:
        devices = scan_robot(robot, interfaces)
        require_commissioned(*checked, robot, devices)
    except DiagnosticError:
        for interface in interfaces.values():
            interface.close()
        raise
    if note := identity_note(robot, devices):
        message(f"note: {note}")
    return with_serial_numbers(robot, devices)


def _refuse_simulation(faults: str, seed: str, physics: str, fast: bool) -> None:
    simulated = {"--faults": faults, "--seed": seed, "--fast": fast}
    simulated["--physics"] = physics != "ideal"
    options.refuse_options(simulated, "is for a simulated robot, --bus virtual")


def _drive(session: RunSession, loaded: LoadedRobot, json: bool) -> int:
    """Runs the base driver, prints its state and returns the exit status."""
    from thorvaldc.cli.diagnostic_output import print_json
    from thorvaldc.cli.progress import StatusView
    from thorvaldc.diagnostics import Report

    with StatusView(session) as view:
        diagnostic = session.run(None if json else view.watch)
    if json:
        print_json(session.summary())
    else:
        print(session.status_line())
    report = Report()
    if diagnostic is not None:
        report.put(diagnostic)
    return loaded.show(report)


def _virtual_interfaces(
    robot: Robot, file: str, physics: str, faults: str, seed: int | None, report: Report
) -> Mapping[str, CanInterface]:
    check_full_installation("`--bus virtual`")
    from thorvaldc.cli.virtual_robot import start_virtual_robot

    simulated = start_virtual_robot(robot, file, physics, faults, seed, report)
    return {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}
