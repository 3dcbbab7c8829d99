"""The commands under ``can``: a robot's bus, from its first module to a verified robot."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.command import LightCommand, LightGroup, guarded

can = typer.Typer(cls=LightGroup, no_args_is_help=True, rich_markup_mode=None)


@can.callback()
def main() -> None:
    """Set up, check and watch a robot's CAN bus."""


@can.command(cls=LightCommand)
@guarded
def monitor(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A robot.yaml.")],
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            help="sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of python-can.",
        ),
    ],
    of: Annotated[
        str,
        typer.Option(
            "--of", metavar="NAME", help="Which of the robot's buses.", show_default="the first"
        ),
    ] = "",
    duration: Annotated[
        str, typer.Option("--duration", metavar="TIME", help="To listen for: 10 s.")
    ] = "",
    interval: Annotated[
        str,
        typer.Option(
            "--interval",
            metavar="TIME",
            help="Between two views.",
            show_default="0.25 s on a terminal, else 1 s",
        ),
    ] = "",
    json: Annotated[bool, typer.Option("--json", help="A line of JSON for each interval.")] = False,
    library: Annotated[
        list[str],
        typer.Option("--library", metavar="DIR", help="A folder of modules of yours."),
    ] = [],  # noqa: B006
) -> int:
    """Watch a robot's bus: frames decoded by its map, load, states, emergencies.  Sends nothing."""
    from thorvaldc.cli.monitoring import monitor as watch

    return watch(file, bus, of, duration, interval, json, library)
