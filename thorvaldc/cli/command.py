"""Typer commands whose modules are imported only when the user calls the command.

All parameters of a command function are texts, lists of texts or flags.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib import import_module
from typing import Any, ClassVar, NamedTuple, ParamSpec

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from thorvaldc.cli.completion import placeholders
from thorvaldc.cli.exits import protect
from thorvaldc.cli.installation import is_runtime_only, require_full_installation

P = ParamSpec("P")
PACKAGE = "thorvaldc.cli.commands"


class CommandEntry(NamedTuple):
    """A row of the command table for one command.

    - ``target``: function of the command as ``module:function`` in the package
      ``thorvaldc.cli.commands``.
    - ``help``: help text on one line, for the list of commands and for the help of the command.
    - ``hidden_options``: options that the command accepts but its help does not show.
    """

    name: str
    target: str
    help: str
    hidden: bool = False
    hidden_options: tuple[str, ...] = ()


class GroupEntry(NamedTuple):
    """A row of the command table for a group of commands, such as ``thorvaldc can``."""

    name: str
    commands: tuple[CommandEntry, ...]
    help: str
    hidden: bool = False


class _PlainText:
    """A typer parameter that returns text, lists of texts and flags without conversion."""

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        if value is None or isinstance(value, str | bool):
            return value
        return list(value)


def _without_conversion(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        parameter._runtime_param = _PlainText()
    return parameters


class LightCommand(TyperCommand):
    """A typer command whose parameters are texts, lists of texts and flags.

    By default, typer converts parameters with pydantic. The import of pydantic takes longer than
    the compilation of a robot: ``--help`` takes 172 ms without pydantic and 333 ms with pydantic. A
    command without conversions sets typer's attribute ``_runtime_param`` to avoid the import of
    pydantic. A version of typer without ``_runtime_param`` ignores the attribute.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_conversion(super().get_params(ctx))


class LazyGroup(TyperGroup):
    """A command group that imports the module of a command only when the user calls the command.

    The help text of the command group needs only the table ``entries``.
    """

    entries: ClassVar[tuple[CommandEntry | GroupEntry, ...]] = ()

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self._entries = {entry.name: entry for entry in self.entries}
        # If a user types an unknown command, TyperGroup suggests a similar name from ``commands``.
        self.commands: Any = dict.fromkeys(self._entries)

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_conversion(super().get_params(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        entry = self._entries.get(cmd_name)
        if entry is None:
            return None
        if isinstance(entry, GroupEntry):
            return lazy_group(entry.commands)(
                name=entry.name, help=entry.help, no_args_is_help=True, rich_markup_mode=None
            )
        if ctx.resilient_parsing:  # shell completion
            with placeholders():
                return load_command(entry)
        try:
            return load_command(entry)
        except ImportError:
            if not is_runtime_only():
                raise
            require_full_installation(f"`{ctx.command_path} {entry.name}`")

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(entry.name, entry.help) for entry in self.entries if not entry.hidden]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def lazy_group(table: tuple[CommandEntry | GroupEntry, ...]) -> type[LazyGroup]:
    """Returns a typer group class for the commands of a table."""
    return type("CommandGroup", (LazyGroup,), {"entries": table})


def load_command(entry: CommandEntry) -> Any:
    """Imports the module of a command and builds the typer command from the signature of its
    function."""
    module, function = entry.target.split(":")
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    declare = app.command(entry.name, cls=LightCommand, help=entry.help, hidden=entry.hidden)
    declare(guarded(getattr(import_module(f"{PACKAGE}.{module}"), function)))
    command: Any = get_command(app)
    for parameter in command.params:
        parameter.hidden = parameter.hidden or bool(set(parameter.opts) & set(entry.hidden_options))
    return command


def guarded(function: Callable[P, int]) -> Callable[P, None]:
    """Returns a function that calls ``function`` and ends the process with the returned exit
    status.

    The helper ``protect`` converts an exception of ``function`` to an exit status.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(protect(lambda: function(*args, **kwargs)))

    return call
