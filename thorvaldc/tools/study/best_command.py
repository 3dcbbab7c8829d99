"""The command ``thorvaldc study best``: writes the robot file of the best design."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.tools.study.study_definition import Objective


def write_best(
    study: options.StudyFile,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="The robot file to write.")
    ],
    by: Annotated[
        str,
        typer.Option("--by", metavar="OBJECTIVE", help="The objective, if the study has several."),
    ] = "",
    results: options.StudyResults = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import message, show_report
    from thorvaldc.tools.study.study_journal import read_results
    from thorvaldc.tools.study.study_runs import plan_study, results_folder
    from thorvaldc.tools.study.winning_robot import find_winner, winner_text, write_winner

    run = plan_study(study, library, trust)
    if run is None:
        return INPUT
    objective = _choose(run.inputs.study.objectives, by)
    folder = results_folder(run.inputs.study.name, results)
    try:
        known = read_results(folder)
    except FileNotFoundError:
        known = {}
    run.replay(known)
    finished = sum(1 for key in run.keys if key in known)
    total = max(run.number, len(run.keys))
    if finished < total:
        missing = f"{total - finished} of {total} designs have no result in {folder}"
        if not finished:
            raise OutsideError(f"{missing}; `thorvaldc study run {study}` evaluates them")
        message(f"warning: {missing}")
    winner = find_winner(run, known, objective)
    if winner is None:
        message("no design meets every constraint and passes every scenario")
        return INPUT
    try:
        text = winner_text(run, winner, objective, study)
        compilation = write_winner(Path(output), text, run)
    except FileExistsError as error:
        raise OutsideError(str(error)) from None
    status = show_report(compilation.report, compilation.sources)
    if status == DONE:
        message(f"wrote {output}: design {winner.number}")
    return status


def _choose(objectives: tuple[Objective, ...], by: str) -> Objective:
    from thorvaldc.diagnostics import did_you_mean

    names = [objective.name for objective in objectives]
    if not by and len(objectives) > 1:
        raise typer.BadParameter(
            f"the study has several objectives: {', '.join(names)}", param_hint="'--by'"
        )
    for objective in objectives:
        if by in ("", objective.name):
            return objective
    hint = did_you_mean(by, names, f"it has {', '.join(names)}")
    raise typer.BadParameter(f"the study has no objective {by!r}; {hint}", param_hint="'--by'")
