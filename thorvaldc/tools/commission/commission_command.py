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
from thorvaldc.cli.completion import bus_interfaces
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.cli.robot_file import LoadedRobot
    from thorvaldc.commissioning.commission_report import CommissionReport
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
    from thorvaldc.cli.robot_file import load_robot, path_beside
    from thorvaldc.commissioning.commission_report import SUFFIX
    from thorvaldc.diagnostics import DiagnosticError, Report

    if bus != "virtual" and not sys.stdin.isatty():
        raise typer.BadParameter("needs a terminal to ask at", param_hint="'--bus'")
    if bus != "virtual":
        options.refuse_options({"--store": store}, "is for a simulated robot, --bus virtual")
    loaded = load_robot(file, library, trust)
    if loaded is None:
        return INPUT
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
    - ``entries``: the devices on the buses.
    """

    def __init__(self, path: Path, robot: Robot, operator: str, again: bool) -> None:
        """Reads the earlier report, and writes the new one once, before anything moves."""
        from thorvaldc.commissioning.commission_report import passed_motors, read_report

        self.path, self.robot, self._operator = path, robot, operator
        self.kept = passed_motors(robot, read_report(path)) if path.exists() and not again else {}
        self.results: dict[str, MotorResult] = {}
        self.entries: list[ScanEntry] = []
        self.report = self.write()

    def write(self, interruption: str = UNFINISHED) -> CommissionReport:
        from thorvaldc.commissioning.commission_page import write_report
        from thorvaldc.tools.commission.report_content import report_of

        now = datetime.datetime.now(datetime.UTC)
        self.report = report_of(
            self.robot,
            self.results,
            self.kept,
            self.entries,
            operator=self._operator,
            date=now.isoformat(timespec="seconds"),
            interruption=interruption,
        )
        try:
            write_report(self.path, self.robot, self.report)
        except OSError as error:
            reason = error.strerror or error
            raise OutsideError(f"cannot write {self.path}: {reason}") from None
        return self.report


def _commission(
    file: _ReportFile,
    loaded: LoadedRobot,
    bus: str,
    store: str,
    as_json: bool,
    locks: contextlib.ExitStack,
) -> int:
    """Checks all motors, prints the report and returns the exit status."""
    from thorvaldc.cli.diagnostic_output import message, print_json, table_width
    from thorvaldc.tools.commission.report_content import calibration_text, summary

    interfaces, operator = _open(loaded, bus, store, locks)
    file.entries = _devices(file.robot, interfaces)
    interruption = _differences(file.entries)
    if interruption:
        for interface in interfaces.values():
            interface.close()
        message("nothing was moved: `thorvaldc can plan` shows how to set up the devices")
    else:
        interruption = _check_motors(file, interfaces, operator, threaded=bus != "virtual")
    report = file.write(interruption)
    if as_json:
        print_json(report.as_json())
    else:
        print(summary(report, table_width()))
        print(f"{report.robot}: {'passed' if report.passed else 'not passed'}, see {file.path}")
    text = calibration_text(file.robot, file.results)
    if text:
        _offer_calibration(file.path, text, asks=bus != "virtual")
    return DONE if report.passed else INPUT


def _check_motors(
    file: _ReportFile, interfaces: Mapping[str, CanInterface], operator: Operator, *, threaded: bool
) -> str:
    """Checks the motors; returns the reason why the checks ended before their end, or nothing."""
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.tools.commission.motor_checks import MotorChecks
    from thorvaldc.tools.commission.motor_session import MotorSession

    message(SAFETY)
    if file.kept:
        message(f"passed before, not repeated: {', '.join(file.kept)} (--again repeats them)")
    session = MotorSession(file.robot, interfaces, threaded=threaded)
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
    from thorvaldc.cli.command import check_full_installation
    from thorvaldc.cli.robot_file import is_hardware, warn_once
    from thorvaldc.tools.commission.console_operator import ConsoleOperator

    robot = loaded.robot
    if bus != "virtual":
        lock_buses(bus, robot, locks)
        interfaces = open_interfaces(bus, robot)
        if is_hardware(bus):
            warn_once()
        return interfaces, ConsoleOperator(robot)
    check_full_installation("`--bus virtual`")
    from thorvaldc.cli.virtual_robot import read_store
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, write_memory
    from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

    simulated = SimulatedRobot(robot, nonvolatile=read_store(store, robot))
    if store:
        locks.callback(write_memory, Path(store), simulated)
    simulated.power_on()
    simulated.run(0.2)
    return {
        each.name: simulated.interface(each.name, fifo=True, receive_limit=100_000)
        for each in robot.buses
    }, SimulatedOperator(simulated)


def _devices(robot: Robot, interfaces: Mapping[str, CanInterface]) -> list[ScanEntry]:
    """Returns the devices on all buses.  The base compares their values with the file later."""
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.bus_master import BusMaster, other_master_error
    from thorvaldc.commissioning.scanner import Scanner

    entries: list[ScanEntry] = []
    for bus in robot.buses:
        master = BusMaster(interfaces[bus.name], bus)
        scanner = Scanner(master, configuration_of(robot, bus))
        # A request to a CANopen node can be a command for a drive with another protocol.
        asks = all(node.is_canopen for node in bus.nodes if node.channels)
        scan = scanner.active(values=False, texts=False) if asks else scanner.passive()
        if scan.masters:
            raise other_master_error(list(scan.masters))
        entries += scan.entries
    return entries


def _offer_calibration(path: Path, text: str, *, asks: bool) -> None:
    """Shows the measured zeros, and writes a calibration file if the operator agrees."""
    from thorvaldc.cli.bus_access import agrees
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.commissioning.commission_report import SUFFIX
    from thorvaldc.diagnostics.files import write_file

    target = path.with_name(f"{path.name.removesuffix(SUFFIX)}.calibration.yaml")
    message(f"measured zeros, for a calibration file (`calibration: {target.name}`):\n{text}")
    if not asks or target.exists() or not agrees(f"Write {target}?"):
        return
    try:
        write_file(target, text)
    except OSError as error:
        raise OutsideError(f"cannot write {target}: {error.strerror or error}") from None
