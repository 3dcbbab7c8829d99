"""The command ``thorvaldc replay``: shows a recorded run as a table, a plot or a video.

The command ``replay`` can also convert the record to another file format.
"""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT


def replay(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="The robot.yaml, fleet.yaml or scenario that ran.")
    ],
    source: Annotated[
        str, typer.Argument(metavar="RECORD", help="A record of `sim --record` or `scenario`.")
    ],
    robot: options.ScenarioRobot = "",
    record: Annotated[
        str,
        typer.Option("--record", metavar="OUT", help="Convert the record: OUT.mcap, or CSV files."),
    ] = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.compiling import compile_and_show
    from thorvaldc.cli.run_pictures import RunPictures
    from thorvaldc.tools.pictures.replays import replay_run

    pictures = RunPictures(plot, video)
    compilation = compile_and_show(file, library, robot or None, trust=trust)
    if compilation.model is None:
        return INPUT
    return replay_run(compilation, compilation.model, source, pictures, record, json)
