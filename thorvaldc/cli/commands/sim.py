"""The commands ``thorvaldc sim``, which drives a robot or fleet in simulation, and ``scenario``,
which runs a scenario and checks its expectations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT

if TYPE_CHECKING:
    from thorvaldc.compiler.scenario.variations import Change


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
    sensors: Annotated[
        bool,
        typer.Option("--sensors", help="Record the sensors of the modules as well, in a .mcap."),
    ] = False,
    record: options.Record = "",
    log: options.JointLog = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.robot_file import compile_and_show
    from thorvaldc.cli.run_outputs import RunPictures
    from thorvaldc.cli.simulation_runs import RunOptions, run_drive, run_scenario
    from thorvaldc.runtime.se2 import parse_twist

    seconds = options.parse_duration(duration, "--duration") if duration else 0.0
    commanded_twist = options.parsed(twist, parse_twist, "--twist") if twist else None
    run_options = RunOptions(RunPictures(plot, video, ideal=ideal), parameters, record, log, json)
    if sensors and not record.lower().endswith(".mcap"):
        raise typer.BadParameter("needs a --record OUT.mcap", param_hint="'--sensors'")
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is not None:
        drive_options = {"--duration": duration, "--twist": twist, "--ideal": ideal}
        drive_options["--sensors"] = sensors
        options.refuse_options(drive_options, "the scenario defines this")
        open_loop = open_loop or compilation.scenario.open_loop
        changed = replace(compilation.scenario, open_loop=open_loop)
        return run_scenario(compilation, changed, run_options)
    return run_drive(
        compilation,
        compilation.model,
        run_options,
        twist=commanded_twist,
        duration=seconds,
        ideal=ideal,
        open_loop=open_loop,
        sensors=sensors,
    )


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
    from thorvaldc.cli.robot_file import compile_and_show
    from thorvaldc.cli.run_outputs import RunPictures
    from thorvaldc.cli.simulation_runs import RunOptions, plan_runs, run_scenario

    changes: Sequence[Change] = ()
    if settings:
        variations = plan_runs(file, settings, "", "", from_document=False)
        if variations is None:
            return INPUT
        if variations.size != 1:
            raise typer.BadParameter(
                f"these are {variations.size} runs; `thorvaldc batch` runs them",
                param_hint="'--set'",
            )
        changes = next(variations.runs())
    run_options = RunOptions(RunPictures(plot, video), parameters, record, log, json, junit)
    compilation = compile_and_show(file, library, robot or None, changes, trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is None:
        raise typer.BadParameter(f"{file} is no scenario", param_hint="SCENARIO")
    return run_scenario(compilation, compilation.scenario, run_options)
