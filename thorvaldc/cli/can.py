"""The commands under ``can``: a robot's bus, from its first module to a verified robot."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.command import LightCommand, LightGroup, guarded
from thorvaldc.cli.options import Json, Library

can = typer.Typer(cls=LightGroup, no_args_is_help=True, rich_markup_mode=None)

File = Annotated[
    str, typer.Argument(metavar="FILE", help="A robot.yaml, or the model.json of a build.")
]
BusOption = Annotated[
    str,
    typer.Option(
        "--bus",
        metavar="BUS",
        help="socketcan:can0, slcan:PORT, sim:NAME, virtual (as the file says) or"
        " virtual:delivered; of a robot with several buses NAME=BUS.",
    ),
]
Store = Annotated[
    str,
    typer.Option(
        "--store", metavar="FILE", help="With virtual: where its devices keep their memory."
    ),
]


@can.callback()
def main() -> None:
    """Set up, check and watch a robot's CAN bus."""


@can.command(cls=LightCommand)
@guarded
def scan(
    file: File,
    bus: BusOption,
    active: Annotated[
        bool, typer.Option("--active", help="Ask every node, after listening.")
    ] = False,
    store: Store = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """See what is on the bus and compare it with the robot's file."""
    from thorvaldc.cli.commissioning import scan_bus

    return scan_bus(file, bus, active, store, json, library)


@can.command(cls=LightCommand)
@guarded
def plan(
    file: File,
    bus: BusOption,
    store: Store = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Show the steps that would make the bus what the file says; nothing is written."""
    from thorvaldc.cli.commissioning import plan_bus

    return plan_bus(file, bus, store, json, library)


@can.command(cls=LightCommand)
@guarded
def flash(
    file: File,
    bus: BusOption,
    apply: Annotated[
        bool, typer.Option("--apply", help="Write; without, it is a dry run.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a flash that was broken off.")
    ] = False,
    rollback: Annotated[
        bool, typer.Option("--rollback", help="Undo the last flash of the journal.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for tools.")] = False,
    plan: Annotated[
        str,
        typer.Option("--plan", metavar="HASH", help="Write only if the plan still has this hash."),
    ] = "",
    journal: Annotated[
        str,
        typer.Option(
            "--journal", metavar="FILE", help="What was done.", show_default="<robot>.flash.jsonl"
        ),
    ] = "",
    store: Store = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Give every node its address and its values, each step verified and in a journal."""
    from thorvaldc.cli.commissioning import flash_bus

    return flash_bus(file, bus, apply, resume, rollback, yes, plan, journal, store, json, library)


@can.command(cls=LightCommand)
@guarded
def verify(
    file: File,
    bus: BusOption,
    store: Store = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Check identities, values, periods and load of the bus; nothing is written."""
    from thorvaldc.cli.commissioning import verify_bus

    return verify_bus(file, bus, store, json, library)


@can.command(cls=LightCommand)
@guarded
def monitor(
    file: File,
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            help="sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of python-can;"
            " of a robot with several buses NAME=BUS.",
        ),
    ],
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
    library: Library = [],  # noqa: B006
) -> int:
    """Watch a robot's bus: frames decoded by its map, load, states, emergencies.  Sends nothing."""
    from thorvaldc.cli.monitoring import monitor as watch

    return watch(file, bus, duration, interval, json, library)
