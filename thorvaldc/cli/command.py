"""Typer commands whose modules are imported only when the user calls the command.

All parameters of a command function are texts, lists of texts or flags.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, ParamSpec

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from thorvaldc.cli.command_table import CORE
from thorvaldc.cli.exits import protect
from thorvaldc.cli.installation import is_runtime_only, require_full_installation
from thorvaldc.tool_folders import CommandEntry, load_target, tool_commands

P = ParamSpec("P")
PLUGINS = "thorvaldc.commands"


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


class PlainCommand(TyperCommand):
    """A typer command whose parameters are texts, lists of texts and flags.

    By default, typer converts every parameter with pydantic, whose import takes a third of the time
    of a short command (60 of 200 ms).  typer's attribute ``_runtime_param`` avoids the import; a
    version of typer without the attribute ignores it.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_conversion(super().get_params(ctx))


class CommandGroup(TyperGroup):
    """The commands of the core, of the tools and of other packages.

    A command of the core is found in the table alone.  The declarations of the tools are read for
    other names, the metadata of installed packages only for a name that no tool has.  The help
    reads all of them and imports no command.

    - ``group``: name of a group within the program, such as ``can``, or empty.
    """

    group: ClassVar[str] = ""

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_conversion(super().get_params(ctx))

    def list_commands(self, ctx: Any) -> list[str]:
        return [entry.word for _, entries in self._sections() for entry in entries]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        name = f"{self.group} {cmd_name}".strip()
        entry = find_command(name)
        if entry is None:
            # TyperGroup suggests a similar name from ``commands``.
            self.commands: Any = dict.fromkeys(self.list_commands(ctx))
            if is_runtime_only() and not ctx.resilient_parsing and not self._is_near(cmd_name):
                # The names of the tools that the runtime lacks are not known here.
                raise typer.Exit(protect(lambda: require_full_installation(f"`thorvaldc {name}`")))
            return None
        if not entry.target:
            return command_group(entry.name)(
                name=entry.name, help=entry.help, no_args_is_help=True, rich_markup_mode=None
            )
        return load_command(entry)

    def _is_near(self, name: str) -> bool:
        """Returns whether a name is a misspelled command of this group."""
        from thorvaldc.diagnostics import nearest

        return nearest(name, self.commands) is not None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for title, entries in self._sections():
            with formatter.section(title):
                formatter.write_dl([(entry.word, entry.help) for entry in entries])

    def _sections(self) -> Iterator[tuple[str, list[CommandEntry]]]:
        """Yields the visible rows of this group, and the title of each part of them."""
        own = [e for e in CORE if e.group == self.group]
        of_tools = tool_commands(self.group)
        sections = [("Commands", [*own, *of_tools])]
        if not self.group:
            sections = [("Commands", own), ("Tools", of_tools), ("Plug-ins", plugin_commands())]
        for title, entries in sections:
            visible = [entry for entry in entries if not entry.hidden]
            if visible:
                yield title, visible


def find_command(name: str) -> CommandEntry | None:
    """Returns the row of a command or group, such as ``can scan``, or ``None``."""
    for entry in CORE:
        if entry.name == name:
            return entry
    for entry in tool_commands(name.rpartition(" ")[0]):
        if entry.name == name:
            return entry
    return next((entry for entry in plugin_commands() if entry.name == name), None)


def command_group(name: str) -> type[CommandGroup]:
    """Returns the typer class of a group of commands."""
    return type("CommandGroup", (CommandGroup,), {"group": name})


def plugin_commands() -> list[CommandEntry]:
    """Returns the commands of other packages: their entry points ``thorvaldc.commands``.

    The function ``module:function`` of an entry point is a command as those of the tools, and its
    docstring is its help.
    """
    from importlib.metadata import entry_points

    return [
        CommandEntry(entry.name, entry.value, f"Of the package {entry.dist.name}.", package="")
        for entry in entry_points(group=PLUGINS)
        if entry.dist is not None
    ]


def all_commands() -> list[CommandEntry]:
    """Returns the rows of all commands of this package, without those of other packages."""
    return [*CORE, *tool_commands()]


def load_command(entry: CommandEntry) -> Any:
    """Imports the module of a command and builds the typer command from the signature of its
    function."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    help_text = entry.help if entry.package else None
    declare = app.command(entry.word, cls=PlainCommand, help=help_text, hidden=entry.hidden)
    declare(guarded(load_target(entry), entry.name))
    return get_command(app)


def guarded(function: Callable[P, int], name: str) -> Callable[P, None]:
    """Returns a function that calls ``function`` and ends the process with the returned exit
    status.

    The helper ``protect`` converts an exception of ``function`` to an exit status.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(protect(lambda: run(*args, **kwargs)))

    def run(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return function(*args, **kwargs)
        except ImportError:
            if not is_runtime_only():
                raise
            require_full_installation(f"`thorvaldc {name}`")

    return call
