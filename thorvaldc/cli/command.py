"""The table of commands, and typer commands that are imported only when the user calls them.

All parameters of a command function are texts, lists of texts or flags.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, ClassVar, NoReturn, ParamSpec

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from thorvaldc import tool_folders
from thorvaldc.cli.exits import OutsideError, protect
from thorvaldc.tool_folders import CommandEntry

P = ParamSpec("P")
CORE: tuple[CommandEntry, ...] = (
    CommandEntry("new", "new:new", "Make a folder with a robot.yaml to start from."),
    CommandEntry("check", "check:check", "Report every error in robot and fleet files."),
    CommandEntry("build", "build:build", "Compile robots and write the target files."),
    CommandEntry(
        "sim",
        "sim:sim",
        "Drive a robot in simulation, without a display.",
        topic=tool_folders.SIMULATION,
    ),
    CommandEntry(
        "scenario",
        "sim:scenario",
        "Run a scenario and check its expectations.",
        topic=tool_folders.SIMULATION,
    ),
    CommandEntry(
        "run",
        "run:run",
        "Run the base driver on a real or simulated CAN bus.",
        topic=tool_folders.BUS,
    ),
    CommandEntry(
        "bus", "bus:bus", "Simulate a robot's CAN bus for other programs.", topic=tool_folders.BUS
    ),
    CommandEntry("can", "", "Set up, check and monitor a robot's CAN bus.", topic=tool_folders.BUS),
    CommandEntry(
        "can scan", "can:scan", "Find the nodes on a bus and compare them with the robot."
    ),
    CommandEntry(
        "can plan", "can:plan", "Show the steps that would set up the bus; writes nothing."
    ),
    CommandEntry("can flash", "can:flash", "Write addresses and values to the nodes, verified."),
    CommandEntry(
        "can identify", "identify:identify", "Find the file of the robot that is on a bus."
    ),
    CommandEntry("can verify", "can:verify", "Check identities, values, periods and bus load."),
    CommandEntry("modules", "", "List, show, check and make hardware modules."),
    CommandEntry("modules list", "modules:list_modules", "List the module types."),
    CommandEntry(
        "modules show",
        "modules:show_module",
        "Show a module type: parameters, ports, sources of its numbers.",
    ),
    CommandEntry("modules check", "modules:check_modules", "Check the modules in folders."),
    CommandEntry("modules new", "modules:new_module", "Make a module with a mesh to start from."),
    CommandEntry("targets", "build:targets", "List the targets that a robot can be built for."),
    CommandEntry("schema", "new:schema", "Print the JSON Schema of a kind of document."),
    CommandEntry("explain", "check:explain", "Explain a diagnostic code."),
)
"""The commands of the core, in the order of ``thorvaldc --help``; tools add their own, which
``tool_folders`` finds."""
PLUGINS = "thorvaldc.commands"
# Both packages contain the same files, so a computer must not have both.
REPLACE_RUNTIME = (
    "to replace it: `pip uninstall thorvaldc-runtime`, then `pip install` with the path of the"
    " wheel or the checkout of thorvaldc"
)


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
                raise _not_installed(name)
            return None
        if not entry.target:
            return command_group(entry.name)(
                name=entry.name, help=entry.help, no_args_is_help=True, rich_markup_mode=None
            )
        try:
            return load_command(entry)
        except ImportError:
            if not is_runtime_only():
                raise
            raise _not_installed(name) from None

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
        of_tools = tool_folders.tool_commands(self.group)
        sections = [("Commands", [*own, *of_tools])]
        if not self.group:
            sections = [
                (topic, [entry for entry in (*own, *of_tools) if entry.topic == topic])
                for topic in tool_folders.TOPICS
            ]
            sections.append(("Plug-ins", plugin_commands()))
        for title, entries in sections:
            visible = [entry for entry in entries if not entry.hidden]
            if visible:
                yield title, visible


def find_command(name: str) -> CommandEntry | None:
    """Returns the row of a command or group, such as ``can scan``, or ``None``."""
    for entry in CORE:
        if entry.name == name:
            return entry
    for entry in tool_folders.tool_commands(name.rpartition(" ")[0]):
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
    return [
        CommandEntry(entry.name, entry.value, f"Of the package {entry.dist.name}.", package="")
        for entry in tool_folders.plugin_entries(PLUGINS)
        if entry.dist is not None
    ]


def all_commands() -> list[CommandEntry]:
    """Returns the rows of all commands of this package, without those of other packages."""
    return [*CORE, *tool_folders.tool_commands()]


def load_command(entry: CommandEntry) -> Any:
    """Imports the module of a command and builds the typer command from the signature of its
    function."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    help_text = entry.help if entry.package else None
    declare = app.command(entry.word, cls=PlainCommand, help=help_text, hidden=entry.hidden)
    declare(guarded(tool_folders.load_target(entry), entry.name))
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


# -- the runtime alone ---------------------------------------------------------------


def is_runtime_only() -> bool:
    """Returns whether only the package ``thorvaldc-runtime`` is installed, for the computer of a
    robot.

    It has the rooms ``runtime``, ``can``, ``commissioning``, ``model``, ``diagnostics`` and
    ``cli``, and the tools ``monitor``, ``service_calls`` and ``teleoperation``.
    """
    return find_spec("thorvaldc.compiler") is None


def require_full_installation(feature: str) -> NoReturn:
    """Raises ``OutsideError`` for a feature that needs the compiler or the simulation."""
    raise OutsideError(
        f"{feature} is not available: this installation is the runtime alone; {REPLACE_RUNTIME}"
    )


def _not_installed(command: str) -> typer.Exit:
    return typer.Exit(protect(lambda: require_full_installation(f"`thorvaldc {command}`")))


def check_full_installation(feature: str) -> None:
    """Raises ``OutsideError`` if only the runtime package is installed."""
    if is_runtime_only():
        require_full_installation(feature)
