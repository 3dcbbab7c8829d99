"""Simulated runs for the command ``sim``: a robot or fleet drives with a constant twist or a
manoeuvre."""

from __future__ import annotations

import contextlib
import gc

from thorvaldc.cli.diagnostic_output import message, print_json, show_report, table_width
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.run_pictures import RunPictures
from thorvaldc.cli.run_records import call_all, open_joint_logs, open_recorders, record_summary
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import TickCallback, result_table
from thorvaldc.simulation.records.recorder import record_ticks
from thorvaldc.simulation.simulation_run import Simulation

TWIST_DURATION = 5.0
"""Duration in s of a run with a twist and without the option ``--duration``."""


def run_drive(
    compilation: Compilation,
    model: Robot | Fleet,
    pictures: RunPictures,
    *,
    twist: Twist | None,
    duration: float,
    parameters: str,
    ideal: bool,
    open_loop: bool,
    record: str,
    log: str,
    json: bool,
) -> int:
    """Drives a robot or fleet in simulation, prints the result and returns the exit status.

    - ``twist``: commanded twist, or ``None`` for the demonstration manoeuvre of the robot.
    - ``duration``: duration in s, or 0 for the default duration.
    - ``record``, ``log``: paths of the record and the joint log, or empty for no file.
    """
    gc.enable()
    report = Report()
    try:
        files = None if ideal else emit(model, ["mjcf"], report)
        simulation = Simulation(model, files, parameters or None, open_loop=open_loop)
        if not duration:
            duration = TWIST_DURATION if twist is not None else simulation.demonstration()[1]
        robots = simulation.robots
        with contextlib.ExitStack() as stack:
            progress = Progress(duration)
            watches: list[TickCallback] = [progress.watch, pictures.watch]
            recorders = open_recorders(record, robots, GROUPS, 0.0, stack)
            if recorders:
                watches.append(record_ticks(recorders))
            if log:
                watches.append(open_joint_logs(log, robots, stack))
            stack.callback(progress.clear)
            if twist is not None:
                result = simulation.run(duration, twist, report, call_all(watches))
            else:
                result = simulation.demonstrate(report, duration, call_all(watches))
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return show_report(compilation.located(report), compilation.sources)
    if json:
        print_json(result.as_json())
    else:
        print(result_table([result], table_width()))
    status = show_report(compilation.located(report), compilation.sources)
    if record:
        message(record_summary(record, robots))
    pictures.write(model, robots, files)
    return status
