"""The command ``thorvaldc faults``: measures how a robot reacts to faults on its simulated bus."""

from __future__ import annotations

import gc
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT


def faults(
    file: options.RobotFile,
    parameters: options.Parameters = "",
    only: Annotated[
        str,
        typer.Option("--only", metavar="TEXT", help="Only faults whose name contains this text."),
    ] = "",
    seed: options.Seed = "",
    jobs: options.Jobs = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output, robot_file
    from thorvaldc.cli.diagnostic_output import Progress
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.simulation.worker_processes import processors
    from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix, markdown, matrix_json
    from thorvaldc.tools.fault_matrix.rehearsal import RehearsalError

    processes = options.parse_count(jobs, "--jobs", 1) or processors()
    number = options.parse_seed(seed) or 0
    loaded = robot_file.load_robot(file, library, trust)
    gc.enable()
    try:
        matrix = FaultMatrix(loaded.robot, parameters=parameters or None, seed=number)
        names = list(dict.fromkeys(case.name for case in matrix.cases))
        matrix.cases = [case for case in matrix.cases if only in case.name]
        if not matrix.cases:
            raise typer.BadParameter(
                f"no fault contains {only!r}; there are: {'; '.join(names)}", param_hint="'--only'"
            )
        progress = Progress(matrix.cells, "reactions")
        try:
            rows = matrix.rows(processes, progress.show)
        finally:
            progress.clear()
    except DiagnosticError as error:
        return loaded.show(diagnostic_output.report_of(error))
    except RehearsalError as error:
        diagnostic_output.message(f"error: {file}: {error}")
        return INPUT
    if json:
        diagnostic_output.print_json(matrix_json(matrix, rows, file))
    else:
        print("\n".join(markdown(matrix, rows, file, diagnostic_output.table_width())))
    return DONE if all(row.passed for row in rows) else INPUT
