"""The commands under ``can``: a robot's bus, from its first module to a verified robot."""

from __future__ import annotations

import typer

from thorvaldc.cli.command import LightGroup

can = typer.Typer(cls=LightGroup, no_args_is_help=True, rich_markup_mode=None)


@can.callback()
def main() -> None:
    """Set up, check and watch a robot's CAN bus."""
