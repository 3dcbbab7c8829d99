"""The program ``thorvaldc``: its commands, its entry point and its global options."""

from __future__ import annotations

import contextlib
import functools
import gc
import importlib.util
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Annotated, Any, ParamSpec

import typer
import typer.core
from typer.main import get_command

from thorvaldc import __version__, tool_folders
from thorvaldc.cli import exits
from thorvaldc.tool_folders import CommandEntry

P = ParamSpec("P")
CORE: tuple[CommandEntry, ...] = (
    CommandEntry("new", "library_commands:new", "Make a folder with a robot.yaml to start from."),
    CommandEntry("check", "file_commands:check", "Report every error in robot and fleet files."),
    CommandEntry("build", "file_commands:build", "Compile robots and write the target files."),
    CommandEntry(
        "sim", "simulation_commands:sim", "Drive a robot in simulation, without a display."
    ),
    CommandEntry(
        "scenario", "simulation_commands:scenario", "Run a scenario and check its expectations."
    ),
    CommandEntry(
        "run", "driver_commands:run", "Run the base driver on a real or simulated CAN bus."
    ),
    CommandEntry("bus", "driver_commands:bus", "Simulate a robot's CAN bus for other programs."),
    CommandEntry("can", "", "Set up, check and monitor a robot's CAN bus."),
    CommandEntry(
        "can scan", "can_commands:scan", "Find the nodes on a bus and compare them with the robot."
    ),
    CommandEntry(
        "can plan", "can_commands:plan", "Show the steps that would set up the bus; writes nothing."
    ),
    CommandEntry(
        "can flash", "can_commands:flash", "Write addresses and values to the nodes, verified."
    ),
    CommandEntry(
        "can identify", "identify_command:identify", "Find the file of the robot that is on a bus."
    ),
    CommandEntry(
        "can verify", "can_commands:verify", "Check identities, values, periods and bus load."
    ),
    CommandEntry("modules", "", "List, show, check and make hardware modules."),
    CommandEntry("modules list", "library_commands:list_modules", "List the module types."),
    CommandEntry(
        "modules show",
        "library_commands:show_module",
        "Show a module type: parameters, ports, sources of its numbers.",
    ),
    CommandEntry(
        "modules check", "library_commands:check_modules", "Check the modules in folders."
    ),
    CommandEntry(
        "modules new", "library_commands:new_module", "Make a module with a mesh to start from."
    ),
    CommandEntry(
        "targets", "file_commands:targets", "List the targets that a robot can be built for."
    ),
    CommandEntry(
        "schema", "library_commands:schema", "Print the JSON Schema of a kind of document."
    ),
    CommandEntry("explain", "file_commands:explain", "Explain a diagnostic code."),
)
"""The commands of the core, in the order of ``thorvaldc --help``; those of the tools follow."""
_COMPILER = ["new", "check", "build", "sim", "scenario", "bus", "modules", "targets", "schema"]
PLUGINS = "thorvaldc.commands"


_UNCONVERTED = SimpleNamespace(coerce=lambda value, param, ctx: value)
_conversion = getattr(typer.core, "build_runtime_param", None)


def _text_without_conversion(descriptor: Any) -> Any:
    if _conversion is None or descriptor.annotation in (str, list[str], bool):
        return _UNCONVERTED
    return _conversion(descriptor)


# typer converts each value of an option with pydantic, even text to text.  The import of pydantic
# takes a quarter of the time of a short command (60 of 240 ms).  A version of typer without this
# function ignores the line.
vars(typer.core)["build_runtime_param"] = _text_without_conversion


# -- the commands --------------------------------------------------------------------


def all_commands() -> list[CommandEntry]:
    """Returns the rows of all commands of this package, without those of other packages."""
    return [*CORE, *tool_folders.tool_commands()]


def plugin_commands() -> list[CommandEntry]:
    """Returns the commands of other packages: their entry points ``thorvaldc.commands``.

    The function ``module:function`` of an entry point is a command as those of the tools, and its
    docstring is its help.
    """
    return [
        CommandEntry(entry.name, entry.value, "", package="")
        for entry in tool_folders.plugin_entries(PLUGINS)
    ]


def program(words: Sequence[str]) -> typer.Typer:
    """Returns the typer application with the commands that a command line can name.

    The import of all commands takes longer than a short command.  So the command or group of the
    first word is imported alone; all are imported for the help and for a word that is no command.
    """
    app = typer.Typer(
        help="A compiler for modular robots: robot.yaml in; URDF, MJCF, ROS 2 parameters and a CAN"
        " map out.",
        no_args_is_help=True,
        # Errors are plain text, also in logs; typer would draw boxes around them.
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_global_options)
    groups = {"": app}
    for entry in _named_by(words):
        if not entry.target:
            groups[entry.name] = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
            app.add_typer(groups[entry.name], name=entry.name, help=entry.help)
        elif function := _load(entry):
            declare = groups[entry.group].command(entry.word, help=entry.help or None)
            declare(ending_with_status(function))
    return app


def _named_by(words: Sequence[str]) -> list[CommandEntry]:
    if words == ["--version"]:
        return []
    core = [entry for entry in CORE if entry.name in words[:1] and entry.target]
    if core:
        return core
    entries = all_commands()
    named = [entry for entry in entries if entry.name.split()[0] in words[:1]]
    if not named and exits.is_runtime_only():
        entries = [entry for entry in entries if entry.name.split()[0] not in _COMPILER]
    # typer 0.26 shows hidden commands in its plain help.
    return named or [*(entry for entry in entries if not entry.hidden), *plugin_commands()]


def _load(entry: CommandEntry) -> Callable[..., int] | None:
    """Imports and returns the function of a command, or ``None`` for a broken one of others."""
    try:
        return tool_folders.load_target(entry)  # type: ignore[no-any-return]
    except Exception as error:
        if entry.package:
            raise
        reason = f"{type(error).__name__}: {error}"
        print(f"warning: no command `{entry.name}` ({entry.target}): {reason}", file=sys.stderr)
        return None


def ending_with_status(function: Callable[P, int]) -> Callable[P, None]:
    """Returns a function that calls ``function`` and ends the program with its exit status."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(exits.protect(lambda: function(*args, **kwargs)))

    return call


def click_command(name: str) -> Any:
    """Returns the command that typer makes of a row, such as ``can scan``."""
    command: Any = get_command(program(name.split()))
    for word in name.split():
        command = command.commands[word]
    return command


# -- completion in the shells bash, zsh and fish, whose scripts typer generates --

COMPLETE_VARIABLE = "_THORVALDC_COMPLETE"


def is_completion() -> bool:
    """Returns whether a shell asks for the completion of a command line."""
    return os.environ.get(COMPLETE_VARIABLE, "").startswith("complete_")


@contextlib.contextmanager
def shell_completion() -> Iterator[list[str]]:
    """Adapts the answer of typer to the shell that asks for a completion, and yields the words of
    the command line.

    bash splits words at ``=`` and ``:``, and replaces only the part after them.
    """
    # typer formats help texts with rich if rich is installed. Its import takes 100 ms.
    sys.modules.setdefault("rich", None)  # type: ignore[arg-type]
    prefix = ""
    if os.environ[COMPLETE_VARIABLE] == "complete_bash":
        words, number, prefix = joined_words(
            os.environ.get("COMP_WORDS", "").split(), int(os.environ.get("COMP_CWORD", "0"))
        )
        os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(words), str(number)
    answer = io.StringIO()
    try:
        with contextlib.redirect_stdout(answer):
            yield (os.environ.get("COMP_WORDS") or os.environ["_TYPER_COMPLETE_ARGS"]).split()[1:]
    finally:
        for line in answer.getvalue().splitlines():
            print(line.removeprefix(prefix))


def joined_words(words: Sequence[str], number: int) -> tuple[list[str], int, str]:
    """Joins the words of a command line that bash has split at ``=`` and ``:``.

    Returns the words, the index of the incomplete word, and the part of the incomplete word that
    bash does not replace.  An option and its value, as in ``--bus=sim:a``, remain two words.
    """
    words = list(words[: number + 1])
    if number >= len(words):  # the incomplete word is empty
        words.append("")
    joined: list[str] = []
    prefix = ""
    glued = False
    for word in words:
        if word in ("=", ":") and joined:
            if word == "=" and joined[-1].startswith("--"):
                joined.append("")
            else:
                joined[-1] += word
            prefix, glued = joined[-1], True
        elif glued:
            joined[-1] += word
            glued = False
        else:
            joined.append(word)
            prefix = ""
    return joined, len(joined) - 1, prefix


# -- the entry point -----------------------------------------------------------------


def _show_version(value: bool) -> None:
    if value:
        typer.echo(f"thorvaldc {__version__}{' (compiled)' if _is_compiled() else ''}")
        raise typer.Exit


def _is_compiled() -> bool:
    """Returns whether the modules of a control cycle are machine code."""
    driver = importlib.util.find_spec("thorvaldc.runtime.driver")
    return driver is not None and not str(driver.origin).endswith(".py")


def _global_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass


def run() -> None:
    """Runs the command in ``sys.argv`` and ends the process with the exit status of the command."""
    # A short command such as ``check`` allocates only a few megabytes and keeps most of them until
    # its end. Python's garbage collection would take a sixth of the time of a short command. Long
    # commands such as ``sim`` enable garbage collection again.
    gc.disable()
    exits.prepare_standard_streams()
    try:
        status = run_command()
    except Exception as error:
        status = _report_internal_error(error)
    try:
        sys.exit(status)
    finally:
        if status != exits.DONE:
            _flush_quietly()


def run_command() -> int:
    """Runs the command in ``sys.argv`` in this process and returns its exit status.

    An exception that leaves this function is a bug in thorvaldc.
    """
    return exits.protect(_call_program)


def _call_program() -> int:
    words = sys.argv[1:]
    try:
        if is_completion():
            with shell_completion() as typed:
                program(typed)(prog_name="thorvaldc")
        program(words)(prog_name="thorvaldc")
    except SystemExit as end:
        if end.code == exits.USAGE and exits.is_runtime_only() and not _command_name(words):
            print(f"note: {exits.RUNTIME_ALONE}", file=sys.stderr)
        return end.code if isinstance(end.code, int) else exits.DONE
    except ImportError:
        exits.check_full_installation(f"`thorvaldc {_command_name(words)}`")
        raise
    return exits.DONE


def _command_name(words: Sequence[str]) -> str:
    """Returns the name of the command or group that a command line calls, or an empty text."""
    names = {entry.name for entry in all_commands()}
    return next((n for n in (" ".join(words[:2]), *words[:1]) if n in names), "")


def _flush_quietly() -> None:
    """Flushes stdout, and drops the buffered output if stdout is closed or the disk is full."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except exits.OutputError:
        exits.discard_output()


def _report_internal_error(error: Exception) -> int:
    exits.show_traceback()
    description = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    python = ".".join(str(part) for part in sys.version_info[:3])
    print(
        f"internal error: {description}\n"
        f"This is an error in thorvaldc {__version__} (Python {python}, {sys.platform}), not in"
        f" your file; please report it.\n{exits.TRACEBACK_VARIABLE}=1 shows where it happened.",
        file=sys.stderr,
    )
    return exits.INTERNAL
