"""The command ``thorvaldc sim``: drives a robot or fleet in simulation.

The command ``sim`` also accepts the options of the commands ``scenario``, ``batch`` and ``replay``,
which were parts of ``sim`` in the past. ``thorvaldc sim --help`` does not show the options of
``scenario``, ``batch`` and ``replay``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import typer

from thorvaldc.cli.compiling import compile_and_show
from thorvaldc.cli.drive_runs import run_drive
from thorvaldc.cli.exits import INPUT
from thorvaldc.cli.options import (
    BatchOutput,
    Draws,
    DrawSeed,
    Duration,
    Jobs,
    JointLog,
    Json,
    JUnit,
    Library,
    Parameters,
    Plot,
    Record,
    Settings,
    Trust,
    Variations,
    Video,
    parse_duration,
    parsed,
    refuse_options,
)
from thorvaldc.cli.replays import replay_run
from thorvaldc.cli.run_pictures import RunPictures
from thorvaldc.cli.scenario_runs import plan_runs, run_batch, run_scenario, single_run
from thorvaldc.compiler.scenario.variations import Change
from thorvaldc.runtime.twist_text import parse_twist


def sim(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A robot.yaml, fleet.yaml or scenario.")
    ],
    twist: Annotated[
        str,
        typer.Option(
            "--twist",
            metavar="VX,VY,WZ",
            help="Twist to drive, in m/s, m/s and rad/s; by default a manoeuvre that shows what the"
            " robot can do.",
        ),
    ] = "",
    duration: Duration = "",
    parameters: Parameters = "",
    ideal: Annotated[
        bool, typer.Option("--ideal", help="Simulate ideal joints instead of physics.")
    ] = False,
    open_loop: Annotated[
        bool,
        typer.Option("--open-loop", help="Drive without speed control, for a log to calibrate."),
    ] = False,
    record: Record = "",
    log: JointLog = "",
    plot: Plot = "",
    video: Video = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
    trust: Trust = False,
    scenario: Annotated[str, typer.Option("--scenario", metavar="FILE")] = "",
    junit: JUnit = "",
    settings: Settings = [],  # noqa: B006
    variations: Variations = False,
    draws: Draws = "",
    seed: DrawSeed = "",
    jobs: Jobs = "",
    output: BatchOutput = "",
    replay: Annotated[str, typer.Option("--replay", metavar="RECORD")] = "",
) -> int:
    seconds = parse_duration(duration, "--duration") if duration else 0.0
    commanded_twist = parsed(twist, parse_twist, "--twist") if twist else None
    drive_options = {"--duration": duration, "--twist": twist, "--ideal": ideal}
    run_options: dict[str, str | bool] = {"--open-loop": open_loop, "--parameters": parameters}
    run_options |= {"--junit": junit, "--log": log}
    name, robot = scenario or file, file if scenario else None
    changes: Sequence[Change] = ()
    if settings or variations:
        planned = plan_runs(name, settings, draws, seed, from_document=variations)
        if planned is None:
            return INPUT
        only_changes = single_run(planned)
        if only_changes is None:
            outputs = {"--record": record, "--plot": plot, "--video": video, "--replay": replay}
            reason = f"this is for one run, and there are {planned.size}"
            refuse_options({**drive_options, **run_options, **outputs}, reason)
            return run_batch(
                name, planned, robot, library, trust=trust, jobs=jobs, output=output, json=json
            )
        changes = only_changes
    else:
        batch_options = {"--draws": draws, "--seed": seed, "--jobs": jobs, "--output": output}
        refuse_options(batch_options, "this is for --set and --variations")
    pictures = RunPictures(plot, video, ideal=ideal)
    if replay:
        refuse_options({**drive_options, **run_options}, "a replay takes the run from its record")
    compilation = compile_and_show(name, library, robot, changes, trust=trust)
    if compilation.model is None:
        return INPUT
    if replay:
        return replay_run(compilation, compilation.model, replay, pictures, record, json)
    if compilation.scenario is not None:
        refuse_options(drive_options, "the scenario defines this")
        scenario_model = compilation.scenario
        scenario_model = replace(scenario_model, open_loop=open_loop or scenario_model.open_loop)
        return run_scenario(
            compilation,
            scenario_model,
            pictures,
            parameters=parameters,
            record=record,
            junit=junit,
            log=log,
            json=json,
        )
    refuse_options({"--scenario": scenario, "--junit": junit}, f"{name} is no scenario")
    return run_drive(
        compilation,
        compilation.model,
        pictures,
        twist=commanded_twist,
        duration=seconds,
        parameters=parameters,
        ideal=ideal,
        open_loop=open_loop,
        record=record,
        log=log,
        json=json,
    )
