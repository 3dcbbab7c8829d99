"""The program ``thorvaldc`` with its global options."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc import __version__
from thorvaldc.cli.command import CommandGroup

app = typer.Typer(
    cls=CommandGroup,
    help="A compiler for modular robots: robot.yaml in; URDF, MJCF, ROS 2 parameters and a CAN"
    " map out.",
    no_args_is_help=True,
    # The help text is plain, because the import of the package rich takes longer than the rest of
    # ``--help``.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(value: bool) -> None:
    if value:
        typer.echo(f"thorvaldc {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass
