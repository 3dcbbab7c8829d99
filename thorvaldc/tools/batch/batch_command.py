"""The command ``thorvaldc batch``: runs many variations of a scenario."""

from __future__ import annotations

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT


def batch(
    file: options.ScenarioFile,
    robot: options.ScenarioRobot = "",
    settings: options.Settings = [],  # noqa: B006
    variations: options.Variations = False,
    draws: options.Draws = "",
    seed: options.DrawSeed = "",
    jobs: options.Jobs = "",
    output: options.BatchOutput = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.scenario_runs import plan_runs
    from thorvaldc.tools.batch.batch_run import run_batch

    planned = plan_runs(file, settings, draws, seed, from_document=variations or not settings)
    if planned is None:
        return INPUT
    return run_batch(
        file, planned, robot or None, library, trust=trust, jobs=jobs, output=output, json=json
    )
