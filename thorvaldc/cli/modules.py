"""The commands under ``modules``: the hardware of the library."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.command import LightCommand, LightGroup, guarded
from thorvaldc.cli.options import Format, Json, Library

modules = typer.Typer(cls=LightGroup, no_args_is_help=True, rich_markup_mode=None)


@modules.command("list", cls=LightCommand)
@guarded
def modules_list(json: Json = False, library: Library = []) -> int:  # noqa: B006
    """List the module types."""
    from thorvaldc.cli.listing import list_modules

    return list_modules(library, json)


@modules.command("show", cls=LightCommand)
@guarded
def modules_show(
    type: Annotated[str, typer.Argument(metavar="TYPE", help="drive/standard, for instance.")],
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Show a module type: its parameters, ports and where its numbers come from."""
    from thorvaldc.cli.listing import show_module

    return show_module(type, library, json)


@modules.command("check", cls=LightCommand)
@guarded
def modules_check(
    folders: Annotated[
        list[str],
        typer.Argument(metavar="[DIR]...", help="Library folders.", show_default="the project's"),
    ] = [],  # noqa: B006
    format: Format = "text",
    strict: Annotated[bool, typer.Option("--strict", help="Warnings count as errors.")] = False,
) -> int:
    """Report every fault of the modules in library folders."""
    from thorvaldc.cli.compiling import check_modules

    return check_modules(folders, format, strict)
