"""The program ``thorvaldc``: its entry point and its global options."""

from __future__ import annotations

import gc
import importlib.util
import sys
from typing import Annotated

import typer

from thorvaldc import __version__
from thorvaldc.cli import exits
from thorvaldc.cli.command import CommandGroup
from thorvaldc.cli.completion import is_completion, shell_completion

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
        typer.echo(f"thorvaldc {__version__}{' (compiled)' if _is_compiled() else ''}")
        raise typer.Exit


def _is_compiled() -> bool:
    """Returns whether the modules of a control cycle are machine code."""
    driver = importlib.util.find_spec("thorvaldc.runtime.driver")
    return driver is not None and not str(driver.origin).endswith(".py")


@app.callback()
def main(
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
    return exits.protect(_call_app)


def _call_app() -> int:
    try:
        if is_completion():
            with shell_completion():
                app(prog_name="thorvaldc")
        app(prog_name="thorvaldc")
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else exits.DONE
    return exits.DONE


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
