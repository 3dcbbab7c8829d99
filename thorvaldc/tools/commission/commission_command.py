"""The command ``thorvaldc can commission``: checks the first motion of each motor of a robot."""

from __future__ import annotations

import contextlib
import datetime
import getpass
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message, print_json, table_width
from thorvaldc.cli.exits import DONE, INPUT, check_full_installation, write_errors
from thorvaldc.cli.options import bus_interfaces
from thorvaldc.cli.robot_file import (
    LoadedRobot,
    is_hardware,
    load_robot,
    path_beside,
    simulated_devices,
    warn_once,
)
from thorvaldc.diagnostics import DiagnosticError, Report

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.commissioning.commission_report import CheckedMotor, CommissionReport
    from thorvaldc.commissioning.scan_result import ScanEntry
    from thorvaldc.model import Robot
    from thorvaldc.tools.commission.questions import Operator
    from thorvaldc.tools.commission.results import MotorResult

SAFETY = (
    "Lift all wheels off the ground, keep people away from them, and keep the emergency stop in"
    " reach. The stops of this program are no safety functions."
)


def commission(
    file: options.RobotFile,
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            autocompletion=bus_interfaces,
            help="As for `run`; with `virtual`, a simulated operator answers.",
        ),
    ],
    report: Annotated[
        str,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Report as JSON, and as HTML beside it.",
            show_default="<robot>.commission.json",
        ),
    ] = "",
    operator: Annotated[
        str,
        typer.Option(
            "--operator", metavar="NAME", help="Your name in the report.", show_default="user name"
        ),
    ] = "",
    again: Annotated[
        bool, typer.Option("--again", help="Check also the motors that have passed before.")
    ] = False,
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.commissioning.commission_report import SUFFIX

    if bus != "virtual" and not sys.stdin.isatty():
        raise typer.BadParameter("needs a terminal to ask at", param_hint="'--bus'")
    if bus != "virtual":
        options.refuse_options({"--store": store}, "is for a simulated robot, --bus virtual")
    loaded = load_robot(file, library, trust)
    path = Path(report) if report else path_beside(file, loaded.robot, SUFFIX)
    if path.suffix != ".json":
        raise typer.BadParameter(f"{path} must end in .json", param_hint="'--report'")
    errors = Report()
    try:
        with contextlib.ExitStack() as locks:
            file_of_report = _ReportFile(path, loaded.robot, operator or _user(), again)
            return _commission(file_of_report, loaded, bus, store, json, locks)
    except DiagnosticError as error:
        errors.put(error.diagnostic)
    return loaded.show(errors)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""


UNFINISHED = "the program ended before all checks"
"""Interruption in the report while the checks run, which a killed program leaves there."""


class _ReportFile:
    """The report that is written after each motor.

    - ``kept``: motors of an earlier report that are not checked again;
    - ``results``: new results by the name of the motor;
    - ``devices``: the devices on the buses.
    """

    def __init__(self, path: Path, robot: Robot, operator: str, again: bool) -> None:
        """Reads the earlier report, before a bus is opened."""
        from thorvaldc.commissioning.commission_report import read_report

        self.path, self.robot, self._operator = path, robot, operator
        self._earlier = read_report(path) if path.exists() and not again else None
        self.kept: Mapping[str, CheckedMotor] = {}
        self.results: dict[str, MotorResult] = {}
        self.devices: Sequence[ScanEntry] = ()

    def begin(self, devices: Sequence[ScanEntry]) -> None:
        """Keeps the motors that have passed with these devices; writes before anything moves."""
        from thorvaldc.commissioning.commission_report import passed_motors

        self.devices = devices
        if self._earlier is not None:
            self.kept = passed_motors(self.robot, self._earlier, devices)
        self.write()

    def write(self, interruption: str = UNFINISHED) -> CommissionReport:
        from thorvaldc.commissioning.commission_page import write_report

        report = self.content(interruption)
        with write_errors(self.path):
            write_report(self.path, self.robot, report)
        return report

    def content(self, interruption: str) -> CommissionReport:
        from thorvaldc.tools.commission.report_content import report_of

        now = datetime.datetime.now(datetime.UTC)
        return report_of(
            self.robot,
            self.results,
            self.kept,
            self.devices,
            operator=self._operator,
            date=now.isoformat(timespec="seconds"),
            interruption=interruption,
        )


def _commission(
    file: _ReportFile,
    loaded: LoadedRobot,
    bus: str,
    store: str,
    as_json: bool,
    locks: contextlib.ExitStack,
) -> int:
    """Checks all motors, prints the report and returns the exit status."""
    from thorvaldc.commissioning.commission_report import identity_note, shortcomings
    from thorvaldc.commissioning.scanner import scan_robot
    from thorvaldc.tools.commission.report_content import calibration_text, summary

    interfaces, operator = _open(loaded, bus, store, locks)
    devices = scan_robot(file.robot, interfaces)
    if differences := _differences(devices):
        for interface in interfaces.values():
            interface.close()
        message(
            "nothing was moved, and no report was written: `thorvaldc can plan` shows how to set up"
            " the devices"
        )
        file.devices, report = devices, file.content(differences)
    else:
        file.begin(devices)
        if note := identity_note(file.robot, devices):
            message(f"note: {note}")
        report = file.write(_check_motors(file, interfaces, operator, threaded=bus != "virtual"))
    passed = not shortcomings(file.robot, report, devices)
    if as_json:
        print_json(report.as_json())
    else:
        print(summary(report, table_width()))
        where = "" if differences else f", see {file.path}"
        print(f"{report.robot}: {'passed' if passed else 'not passed'}{where}")
    text = calibration_text(file.robot, file.results)
    if text:
        _offer_calibration(file.path, text, asks=bus != "virtual")
    return DONE if passed else INPUT


def _check_motors(
    file: _ReportFile, interfaces: Mapping[str, CanInterface], operator: Operator, *, threaded: bool
) -> str:
    """Checks the motors; returns the reason why the checks ended before their end, or nothing."""
    from thorvaldc.commissioning.scanner import with_serial_numbers
    from thorvaldc.tools.commission.motor_checks import MotorChecks
    from thorvaldc.tools.commission.motor_session import MotorSession

    message(SAFETY)
    if file.kept:
        message(f"passed before, not repeated: {', '.join(file.kept)} (--again repeats them)")
    robot = with_serial_numbers(file.robot, file.devices)
    session = MotorSession(robot, interfaces, threaded=threaded)
    checks = MotorChecks(session, operator, file.results, file.kept, file.write)
    if session.run(checks.run(), stop=lambda: operator.closed):
        return checks.interruption
    message("")  # ends the line of the open question
    return "ended by the operator"


def _differences(entries: Sequence[ScanEntry]) -> str:
    """Returns what differs between the devices and the robot file, or an empty text."""
    from thorvaldc.commissioning.scan_result import OK

    return "; ".join(
        f"{entry.node or 'device'}: {entry.verdict} {entry.detail}".strip()
        for entry in entries
        if entry.verdict != OK
    )


def _open(
    loaded: LoadedRobot, bus: str, store: str, locks: contextlib.ExitStack
) -> tuple[Mapping[str, CanInterface], Operator]:
    """Returns the CAN interface of each bus, and the operator."""
    from thorvaldc.can.open_interface import lock_buses, open_interfaces
    from thorvaldc.tools.commission.console_operator import ConsoleOperator

    robot = loaded.robot
    if bus != "virtual":
        lock_buses(bus, robot, locks)
        interfaces = open_interfaces(bus, robot)
        if is_hardware(bus):
            warn_once()
        return interfaces, ConsoleOperator(robot)
    check_full_installation("`--bus virtual`")
    from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

    simulated = locks.enter_context(simulated_devices(robot, store))
    return {
        each.name: simulated.interface(each.name, fifo=True, receive_limit=100_000)
        for each in robot.buses
    }, SimulatedOperator(simulated)


def _offer_calibration(path: Path, text: str, *, asks: bool) -> None:
    """Shows the measured zeros, and writes a calibration file if the operator agrees."""
    from thorvaldc.cli.can_commands import agrees
    from thorvaldc.commissioning.commission_report import SUFFIX
    from thorvaldc.diagnostics.files import write_file

    target = path.with_name(f"{path.name.removesuffix(SUFFIX)}.calibration.yaml")
    message(f"measured zeros, for a calibration file (`calibration: {target.name}`):\n{text}")
    if not asks or target.exists() or not agrees(f"Write {target}?"):
        return
    with write_errors(target):
        write_file(target, text)
