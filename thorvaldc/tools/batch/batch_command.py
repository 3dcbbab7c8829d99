"""The command ``thorvaldc batch``: runs many variations of a scenario."""

from __future__ import annotations

from thorvaldc.cli.exits import INPUT
from thorvaldc.cli.options import (
    BatchOutput,
    Draws,
    DrawSeed,
    Jobs,
    Json,
    Library,
    ScenarioFile,
    ScenarioRobot,
    Settings,
    Trust,
    Variations,
)


def batch(
    file: ScenarioFile,
    robot: ScenarioRobot = "",
    settings: Settings = [],  # noqa: B006
    variations: Variations = False,
    draws: Draws = "",
    seed: DrawSeed = "",
    jobs: Jobs = "",
    output: BatchOutput = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
    trust: Trust = False,
) -> int:
    from thorvaldc.cli.scenario_runs import plan_runs
    from thorvaldc.tools.batch.batch_run import run_batch

    planned = plan_runs(file, settings, draws, seed, from_document=variations or not settings)
    if planned is None:
        return INPUT
    return run_batch(
        file, planned, robot or None, library, trust=trust, jobs=jobs, output=output, json=json
    )
