"""``calibrate``: what a joint log tells of a robot's wheels."""

from __future__ import annotations

import json as json_format
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, message


def calibrate_robot(
    log: str,
    robot: str,
    output: str,
    distance: str,
    parameters: str,
    json: bool,
    library: Sequence[str],
) -> int:
    """Print what was found; write it to ``output`` if any of it is determined."""
    metres = _metres(distance) if distance else None
    done = compile_one(robot, library)
    if done.model is None:
        return INPUT
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.model import Fleet
    from thorvaldc.runtime.driver_parameters import Parameters
    from thorvaldc.simulation.records.joint_csv import read_log

    if isinstance(done.model, Fleet):
        raise typer.BadParameter(f"{robot} is a fleet; name one robot's file", param_hint="ROBOT")
    report, faults = Report(), Faults("text", sys.stderr)
    try:
        Parameters.from_robot(done.model, parameters or None)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        faults.add(done.located(report), done.sources)
        return faults.finish()
    read = read_log(Path(log), log, done.model, report)
    result = None
    if read is not None:
        from thorvaldc.tools.calibration.calibration_text import as_json, overlay, table
        from thorvaldc.tools.calibration.self_calibration import calibrate

        result = calibrate(done.model, read, report, metres, log, parameters or None)
    faults.add(report, done.sources | {log: Path(log)})
    status = faults.finish()
    if result is None:
        return status
    print(json_format.dumps(as_json(result), indent=1) if json else table(result))
    if output and status == DONE:
        if not result.tells:
            message(f"{output} is not written: the log determines nothing")
            return INPUT
        _write(Path(output), overlay(result, _included(Path(robot))))
        message(f"{output}: include it in {robot} by `calibration: {Path(output).name}`")
    return status


def _included(robot: Path) -> dict[str, dict[str, Any]]:
    """What the robot's calibration says of its wheels now, in SI."""
    from thorvaldc.compiler.modules.wheel_calibration import load_calibration
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report

    document = read_file(robot, robot.name, Report())
    found = load_calibration(document, robot.parent, Report(), {}) if document else None
    if found is None:
        return {}
    wheels: dict[str, dict[str, Any]] = {name: {} for name in found.names}
    for name, (value, _) in found.radii.items():
        wheels[name]["radius"] = value
    for name, named in found.named_radii.items():
        wheels[name]["radii"] = {key: value for key, (value, _) in named.items()}
    for name, (value, _) in found.offsets.items():
        wheels[name]["steering_offset"] = value
    return wheels


def _metres(text: str) -> float:
    from thorvaldc.compiler.source.units import UnitError, parse_quantity

    try:
        metres = parse_quantity(text, "length")
    except UnitError as fault:
        raise typer.BadParameter(f"{text!r}: {fault}", param_hint="'--distance'") from None
    if not 0.0 < metres <= 1e6:
        raise typer.BadParameter(
            f"{text!r} is not between 0 and 1000 km", param_hint="'--distance'"
        )
    return metres


def _write(path: Path, text: str) -> None:
    """The whole file, or what was there; never in place of anything but a calibration."""
    if path.exists() and not _is_calibration(path):
        raise OutsideError(f"will not overwrite {path}, which is no calibration")
    new = path.with_name(f".{path.name}.new")
    try:
        new.write_text(text, encoding="utf-8")
        os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)


def _is_calibration(path: Path) -> bool:
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report

    node = read_file(path, path.name, Report())
    return node is not None and node.get("robot") is not None and node.get("wheels") is not None
