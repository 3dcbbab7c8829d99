"""The command ``thorvaldc sim``: drives a robot or fleet in simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT


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
    duration: options.Duration = "",
    parameters: options.Parameters = "",
    ideal: Annotated[
        bool, typer.Option("--ideal", help="Simulate ideal joints instead of physics.")
    ] = False,
    open_loop: Annotated[
        bool,
        typer.Option("--open-loop", help="Drive without speed control, for a log to calibrate."),
    ] = False,
    record: options.Record = "",
    log: options.JointLog = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.compiling import compile_and_show
    from thorvaldc.cli.drive_runs import run_drive
    from thorvaldc.cli.run_pictures import RunPictures
    from thorvaldc.cli.scenario_runs import run_scenario
    from thorvaldc.runtime.se2 import parse_twist

    seconds = options.parse_duration(duration, "--duration") if duration else 0.0
    commanded_twist = options.parsed(twist, parse_twist, "--twist") if twist else None
    pictures = RunPictures(plot, video, ideal=ideal)
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is not None:
        drive_options = {"--duration": duration, "--twist": twist, "--ideal": ideal}
        options.refuse_options(drive_options, "the scenario defines this")
        scenario_model = compilation.scenario
        return run_scenario(
            compilation,
            replace(scenario_model, open_loop=open_loop or scenario_model.open_loop),
            pictures,
            parameters=parameters,
            record=record,
            junit="",
            log=log,
            json=json,
        )
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
