"""The command ``thorvaldc scenario``: runs a scenario and checks its expectations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT

if TYPE_CHECKING:
    from thorvaldc.compiler.scenario.variations import Change


def scenario(
    file: options.ScenarioFile,
    robot: options.ScenarioRobot = "",
    settings: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Replace a value of the scenario: world.friction=0.3; may be repeated.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    parameters: options.Parameters = "",
    junit: options.JUnit = "",
    record: options.Record = "",
    log: options.JointLog = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.compiling import compile_and_show
    from thorvaldc.cli.run_pictures import RunPictures
    from thorvaldc.cli.scenario_runs import plan_runs, run_scenario, single_run

    changes: Sequence[Change] = ()
    if settings:
        variations = plan_runs(file, settings, "", "", from_document=False)
        if variations is None:
            return INPUT
        only_changes = single_run(variations)
        if only_changes is None:
            raise typer.BadParameter(
                f"these are {variations.size} runs; `thorvaldc batch` runs them",
                param_hint="'--set'",
            )
        changes = only_changes
    pictures = RunPictures(plot, video)
    compilation = compile_and_show(file, library, robot or None, changes, trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is None:
        raise typer.BadParameter(f"{file} is no scenario", param_hint="SCENARIO")
    return run_scenario(
        compilation,
        compilation.scenario,
        pictures,
        parameters=parameters,
        record=record,
        junit=junit,
        log=log,
        json=json,
    )
