"""The command ``thorvaldc can commission``: checks the first motion of each motor of a robot."""

from __future__ import annotations

import contextlib
import datetime
import getpass
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completion import bus_interfaces
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.cli.robot_file import LoadedRobot
    from thorvaldc.commissioning.scan_result import ScanEntry
    from thorvaldc.model import Robot
    from thorvaldc.tools.commission.questions import Operator

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
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.robot_file import load_robot
    from thorvaldc.commissioning.commission_report import report_path
    from thorvaldc.diagnostics import DiagnosticError, Report

    if bus != "virtual" and not sys.stdin.isatty():
        raise typer.BadParameter("needs a terminal to ask at", param_hint="'--bus'")
    loaded = load_robot(file, library, trust)
    if loaded is None:
        return INPUT
    path = Path(report) if report else report_path(file, loaded.robot)
    if path.suffix != ".json":
        raise typer.BadParameter(f"{path} must end in .json", param_hint="'--report'")
    errors = Report()
    try:
        with contextlib.ExitStack() as locks:
            return _commission(loaded, bus, path, operator or _user(), again, json, locks)
    except DiagnosticError as error:
        errors.put(error.diagnostic)
    return loaded.show(errors)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""


def _commission(
    loaded: LoadedRobot,
    bus: str,
    path: Path,
    operator_name: str,
    again: bool,
    as_json: bool,
    locks: contextlib.ExitStack,
) -> int:
    from thorvaldc.cli.diagnostic_output import message, print_json, table_width
    from thorvaldc.commissioning.scan_result import OK
    from thorvaldc.tools.commission import report_content
    from thorvaldc.tools.commission.motor_checks import MotorChecks
    from thorvaldc.tools.commission.motor_session import MotorSession
    from thorvaldc.tools.commission.results import MotorResult

    robot = loaded.robot
    earlier = _earlier(path)
    kept = {} if again or earlier is None else report_content.kept_motors(robot, earlier)
    interfaces, operator = _open(loaded, bus, locks)
    entries = _devices(robot, interfaces)
    differences = [entry for entry in entries if entry.verdict != OK]
    results: dict[str, MotorResult] = {}
    interruption = ""
    content: dict[str, Any] = {}

    def save() -> None:
        content.clear()
        content.update(
            report_content.as_json(
                robot,
                results,
                kept,
                entries,
                operator=operator_name,
                date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                interruption=interruption,
            )
        )
        _write(path, robot, content)

    if differences:
        for interface in interfaces.values():
            interface.close()
        interruption = "; ".join(
            f"{entry.node or 'device'}: {entry.verdict} {entry.detail}".strip()
            for entry in differences
        )
        message("nothing was moved: `thorvaldc can plan` shows how to set up the devices")
        save()
    else:
        message(SAFETY)
        if kept:
            message(f"passed before, not repeated: {', '.join(kept)} (--again repeats them)")
        session = MotorSession(robot, interfaces, threaded=bus != "virtual")
        motor_checks = MotorChecks(session, operator, results, kept, save)
        ended = session.run(motor_checks.run(), stop=lambda: operator.closed)
        interruption = motor_checks.interruption or ("" if ended else "ended by the operator")
        if not ended:
            message("")  # ends the line of the open question
        save()
    if as_json:
        print_json(content)
    else:
        print(report_content.summary(content, table_width()))
        print(f"{robot.name}: {'passed' if content['passed'] else 'not passed'}, see {path}")
    _offer_calibration(path, report_content.calibration_text(robot, results), bus == "virtual")
    return DONE if content["passed"] else INPUT


def _earlier(path: Path) -> Mapping[str, Any] | None:
    from thorvaldc.commissioning.commission_report import read_report

    return read_report(path) if path.exists() else None


def _open(
    loaded: LoadedRobot, bus: str, locks: contextlib.ExitStack
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
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
    from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

    simulated = SimulatedRobot(robot)
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


def _write(path: Path, robot: Robot, content: dict[str, Any]) -> None:
    from thorvaldc.commissioning.commission_report import write_report

    try:
        write_report(path, robot, content)
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror or error}") from None


def _offer_calibration(path: Path, text: str, simulated: bool) -> None:
    """Writes the measured zeros as a calibration file, if the operator agrees."""
    from thorvaldc.cli.bus_access import agrees
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.diagnostics.files import write_file

    if not text:
        return
    target = path.with_name(path.name.removesuffix(".json").removesuffix(".commission"))
    target = target.with_name(f"{target.name}.calibration.yaml")
    message(f"measured zeros, for a calibration file (`calibration: {target.name}`):\n{text}")
    if simulated or target.exists() or not agrees(f"Write {target}?"):
        return
    write_file(target, text)
