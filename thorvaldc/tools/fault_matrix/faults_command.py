"""The command ``thorvaldc faults``: measures how a robot reacts to faults of its bus and of the
ground."""

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
    from thorvaldc.tools.fault_matrix import ground_faults
    from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix, markdown, matrix_json
    from thorvaldc.tools.fault_matrix.rehearsal import RehearsalError

    processes = options.parse_count(jobs, "--jobs", 1) or processors()
    number = options.parse_seed(seed) or 0
    loaded = robot_file.load_robot(file, library, trust)
    gc.enable()
    try:
        matrix = FaultMatrix(loaded.robot, parameters=parameters or None, seed=number)
        ground = ground_faults.ground_faults(loaded.robot)
        names = list(dict.fromkeys(case.name for case in matrix.cases))
        names += [group[0].name for group in ground]
        matrix.cases = [case for case in matrix.cases if only in case.name]
        ground = [group for group in ground if only in group[0].name]
        if not matrix.cases and not ground:
            raise typer.BadParameter(
                f"no fault contains {only!r}; there are: {'; '.join(names)}", param_hint="'--only'"
            )
        progress = Progress(matrix.cells + len(ground), "reactions")
        ground_rows = []
        try:
            rows = matrix.rows(processes, progress.show) if matrix.cases else []
            for row in ground_faults.ground_rows(loaded.robot, ground):
                ground_rows.append(row)
                progress.show(matrix.cells + len(ground_rows))
        finally:
            progress.clear()
    except DiagnosticError as error:
        return loaded.show(diagnostic_output.report_of(error))
    except RehearsalError as error:
        diagnostic_output.message(f"error: {file}: {error}")
        return INPUT
    if json:
        diagnostic_output.print_json(matrix_json(matrix, rows, ground_rows, file))
    else:
        width = diagnostic_output.table_width()
        print("\n".join(markdown(matrix, rows, ground_rows, file, width)))
    return DONE if all(row.passed for row in rows) else INPUT
