"""The command ``thorvaldc calibrate``: finds wheel radii and steering offsets from a joint log."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import diagnostic_output, options, robot_file
from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import DONE, INPUT, OutsideError, write_errors
from thorvaldc.cli.robot_file import path_beside
from thorvaldc.diagnostics import DiagnosticError, Report

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.tools.calibration.self_calibration import CalibrationResult


def calibrate(
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="Recorded joint states: CSV, as of sim --log.")
    ],
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="The robot's robot.yaml.")],
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Calibration to write.", show_default=False
        ),
    ] = "",
    distance: Annotated[
        str,
        typer.Option(
            "--distance",
            metavar="LENGTH",
            help="Measured distance between the first and the last pose of the log: '10.00 m'."
            " Determines the common scale of the radii.",
        ),
    ] = "",
    report: Annotated[
        bool, typer.Option("--report", help="Add the result to the report of `can commission`.")
    ] = False,
    parameters: options.Parameters = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.model import Robot
    from thorvaldc.runtime.run_time_parameters import Parameters as DriverParameters
    from thorvaldc.simulation.records.joint_csv import read_log

    metres = _parse_distance(distance) if distance else None
    compilation = robot_file.compile_and_show(robot, library, trust=trust)
    model = compilation.model
    if model is None:
        return INPUT
    if not isinstance(model, Robot):
        raise typer.BadParameter(f"{robot} is a fleet; name one robot's file", param_hint="ROBOT")
    try:
        DriverParameters.from_robot(model, parameters or None)
    except DiagnosticError as error:
        return diagnostic_output.show_report(
            compilation.located(diagnostic_output.report_of(error)), compilation.sources
        )
    # The calibration module is imported only in this command, because it imports numpy.
    from thorvaldc.tools.calibration import calibration_file
    from thorvaldc.tools.calibration.self_calibration import calibrate as estimate

    findings = Report()
    joint_log = read_log(Path(log), log, model, findings)
    result = None
    if joint_log is not None:
        result = estimate(model, joint_log, findings, metres, log, parameters or None)
    status = diagnostic_output.show_report(findings, compilation.sources | {log: Path(log)})
    if result is None:
        return status
    if json:
        diagnostic_output.print_json(calibration_file.as_json(result))
    else:
        print(calibration_file.table(result, diagnostic_output.table_width()))
    if report and status == DONE:
        _add_to_report(robot, model, result)
    if output and status == DONE:
        if not result.determines_anything:
            diagnostic_output.message(f"{output} is not written: the log determines nothing")
            return INPUT
        try:
            calibration_file.write_calibration(
                Path(output), calibration_file.overlay_text(result, Path(robot))
            )
        except FileExistsError as error:
            raise OutsideError(str(error)) from None
        diagnostic_output.message(
            f"{output}: include it in {robot} by `calibration: {Path(output).name}`"
        )
    return status


def _add_to_report(file: str, robot: Robot, result: CalibrationResult) -> None:
    """Adds a calibration to the report of the robot's first motion."""
    from thorvaldc.commissioning import commission_page, commission_report
    from thorvaldc.tools.calibration.calibration_file import as_report

    path = path_beside(file, robot, commission_report.SUFFIX)
    try:
        report = commission_report.read_report(path)
        report = dataclasses.replace(report, calibration=as_report(result))
    except DiagnosticError as error:
        raise typer.BadParameter(error.diagnostic.message, param_hint="'--report'") from None
    with write_errors(path):
        commission_page.write_report(path, robot, report)
    message(f"added to {path}")


def _parse_distance(text: str) -> float:
    """Parses the text of an option and returns the distance in m. Raises ``typer.BadParameter`` if
    the text of the option is no distance."""
    from thorvaldc.compiler.source.units import UnitError, parse_quantity

    try:
        metres = parse_quantity(text, "length")
    except UnitError as error:
        raise typer.BadParameter(f"{text!r}: {error}", param_hint="'--distance'") from None
    if not 0.0 < metres <= 1e6:
        raise typer.BadParameter(
            f"{text!r} is not between 0 and 1000 km", param_hint="'--distance'"
        )
    return metres
