"""Command-line options that several commands share, the values that a shell proposes for them, and
the functions that parse their text."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from thorvaldc.cli.exits import OutsideError, write_errors

if TYPE_CHECKING:
    from thorvaldc.compiler.source.node import Node

T = TypeVar("T")

# -- values that the shell proposes ----------------------------------------------
#
# A press of the Tab key starts the program, so the answer must come at once: a completer imports
# what it needs when it is called.

Values = Callable[[typer.Context, str], list[str]]


def completer(propose: Callable[[typer.Context, str], Iterator[str]]) -> Values:
    """Returns a completer with the proposed values that begin with the incomplete word.

    A completer that fails proposes nothing.
    """

    @functools.wraps(propose)
    def values(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            return [value for value in propose(ctx, incomplete) if value.startswith(incomplete)]
        except Exception:
            # A shell would print a traceback into the command line that the user types.
            return []

    return values


@completer
def target_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes targets, also after a comma."""
    from thorvaldc import backends

    chosen = incomplete.split(",")[:-1]
    for name in backends.names():
        if name not in chosen:
            yield ",".join([*chosen, name])


@completer
def preset_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the presets of new robots."""
    from thorvaldc.compiler.scaffolding import presets

    yield from presets()


@completer
def module_types(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the module types of the library and of the folders of ``--library``."""
    from thorvaldc.compiler.modules.library import Library

    folders = [(Path(name), name) for name in ctx.params.get("library") or ()]
    yield from Library(folders).names()


@completer
def diagnostic_codes(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes numbers of diagnostics, and names where the word begins as none."""
    from thorvaldc.diagnostics.codes import all_codes

    for code in all_codes():
        yield code.number
        if incomplete:
            yield code.name


@completer
def schema_kinds(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the kinds of documents that have a schema."""
    from thorvaldc.schema import KINDS

    yield from (*KINDS, "model")


@completer
def view_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the named viewing directions of pictures."""
    from thorvaldc.simulation.pictures.render import VIEWS

    yield from VIEWS


@completer
def driver_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the running drivers of this user."""
    yield from _socket_names("-control")


@completer
def service_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the services of the running driver in the argument NAME."""
    from thorvaldc.runtime.control_channel import ControlClient

    client = ControlClient(ctx.params["name"], answer_time=0.2)
    try:
        yield from (service["name"] for service in client.call("services"))
    finally:
        client.close()


@completer
def bus_interfaces(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes CAN interfaces: simulated buses that run, SocketCAN, serial ports and the rest."""
    name, equals, _ = incomplete.partition("=")
    start = name + equals if equals else ""
    yield start + "virtual"
    yield from (f"{start}sim:{bus}" for bus in _socket_names("", without="-control"))
    for interface in sorted(Path("/sys/class/net").glob("*can*")):
        yield f"{start}socketcan:{interface.name}"
    for port in (*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("ttyUSB*")):
        yield f"{start}slcan:{port}"
    yield start + "udp"


@completer
def base_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the bases that ``teleop --on`` drives."""
    yield from ("sim", "ideal", *bus_interfaces(ctx, ""))


@completer
def document_paths(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the paths of the numbers, texts and flags of the file, for ``--set``."""
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report

    # An option without its value ends the parsing, and the words before it are in ``args``.
    files = ctx.params.get("files") or ()
    words = (ctx.params.get("scenario"), ctx.params.get("file"), *files, *ctx.args)
    name = next(word for word in words if word and Path(word).is_file())
    document = read_file(Path(name), name, Report())
    if document is not None:
        yield from (f"{path}=" for path in _paths(document.plain(), ""))


def _paths(value: Any, path: str) -> Iterator[str]:
    """Returns the paths of the values in a document that are neither mappings nor lists."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _paths(inner, f"{path}.{key}" if path else str(key))
    elif path and not isinstance(value, list):
        yield path


def _socket_names(suffix: str, without: str = "\n") -> Iterator[str]:
    """Returns the sorted names of the local sockets of this user that a program listens on."""
    import socket

    from thorvaldc.can.local_socket import runtime_directory

    for path in sorted(runtime_directory().glob(f"*{suffix}.sock")):
        name = path.name.removesuffix(".sock")
        if name.endswith(without):
            continue
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(0.05)
            try:
                probe.connect(os.fspath(path))
            except OSError:
                continue  # the program was killed
        yield name.removesuffix(suffix)


# -- options ---------------------------------------------------------------------

LONGEST = 86400.0
"""Longest duration in s that a user can request. A longer duration is probably a typing error."""

RobotFile = Annotated[
    str, typer.Argument(metavar="FILE", help="A robot.yaml, or the model.json of a build.")
]
ModelFile = Annotated[str, typer.Argument(metavar="FILE", help="A robot.yaml or fleet.yaml.")]
ModelFiles = Annotated[
    list[str], typer.Argument(metavar="FILE", help="A robot.yaml or fleet.yaml.")
]
ScenarioFile = Annotated[str, typer.Argument(metavar="SCENARIO", help="A scenario file.")]
ScenarioRobot = Annotated[
    str,
    typer.Option("--robot", metavar="FILE", help="Use this robot instead of the scenario's."),
]
Format = Annotated[
    str,
    typer.Option(
        "--format", metavar="text|json|github|sarif", help="Output format of the diagnostics."
    ),
]
Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings as errors.")]
Library = Annotated[
    list[str],
    typer.Option("--library", metavar="DIR", help="A folder with your modules; may be repeated."),
]
Settings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        autocompletion=document_paths,
        help="Replace a value of the file: driver.rate=100 Hz; may be repeated.",
        show_default=False,
    ),
]
Trust = Annotated[
    bool,
    typer.Option(
        "--trust", help="Run xacro files without restrictions, as programs that you trust."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Parameters = Annotated[
    str, typer.Option("--parameters", metavar="SET", help="A parameter set of the robot file.")
]
Physics = Annotated[
    str,
    typer.Option(
        "--physics", metavar="ideal|mujoco", help="Model of the motors of the simulated robot."
    ),
]
InjectedFaults = Annotated[
    str,
    typer.Option("--faults", metavar="FILE", help="Faults to inject into the simulated bus."),
]
Seed = Annotated[
    str, typer.Option("--seed", metavar="N", help="Seed for all random numbers of the simulation.")
]
BusInterface = Annotated[
    str,
    typer.Option(
        "--bus",
        metavar="BUS",
        autocompletion=bus_interfaces,
        help="socketcan:can0, slcan:PORT, sim:NAME, virtual (devices as in the file) or"
        " virtual:delivered; for a robot with several buses NAME=BUS.",
    ),
]
Store = Annotated[
    str,
    typer.Option(
        "--store", metavar="FILE", help="Non-volatile memory of the simulated devices, kept here."
    ),
]
Duration = Annotated[
    str, typer.Option("--duration", metavar="TIME", help="Simulated time: 5, or '5 s'.")
]
Record = Annotated[
    str,
    typer.Option(
        "--record",
        metavar="OUT",
        help="Record the run: OUT.mcap (Foxglove, PlotJuggler, ROS 2), or a folder of CSV files.",
    ),
]
JointLog = Annotated[
    str,
    typer.Option(
        "--log",
        metavar="FILE",
        help="Write the joint states as CSV, for `calibrate`; a folder for several robots.",
    ),
]
Plot = Annotated[
    str,
    typer.Option(
        "--plot", metavar="OUT.png", help="Draw paths and velocities (.png, .svg or .pdf)."
    ),
]
Video = Annotated[
    str, typer.Option("--video", metavar="OUT.mp4", help="Make a video of the run (.mp4 or .gif).")
]
JUnit = Annotated[
    str, typer.Option("--junit", metavar="OUT.xml", help="Write the expectations as JUnit XML.")
]
Jobs = Annotated[
    str,
    typer.Option("--jobs", "-j", metavar="N", help="Number of processes (default: one per core)."),
]

_TIME = r"(?a)([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµ]*)"
_SECONDS = {
    name: factor
    for names, factor in (
        (("", "s", "sec", "second", "seconds"), (1, 1)),
        (("ms", "millisecond", "milliseconds"), (1, 1000)),
        (("us", "microsecond", "microseconds"), (1, 1_000_000)),
        (("min", "minute", "minutes"), (60, 1)),
        (("h", "hr", "hour", "hours"), (3600, 1)),
    )
    for name in names
}


def parse_time(text: str) -> float:
    """Returns the seconds of a text such as ``5``, ``5 s``, ``300 ms`` or ``2 min``.

    Raises ``ValueError`` if the text is not a time. The compiler has another parser for values with
    units, which the runtime package does not contain.
    """
    match = re.fullmatch(_TIME, text.strip())
    if match is None or match[2] not in _SECONDS:
        raise ValueError(f"{text!r} is not a time; write it as in `5 s`")
    numerator, denominator = _SECONDS[match[2]]
    return float(match[1]) * numerator / denominator


MAX_PORT = 65535


def parse_port(text: str, option: str) -> int:
    """Returns the TCP port of an option.  Raises ``typer.BadParameter`` if it is none."""
    number = int(text) if text.isascii() and text.isdigit() else -1
    if not 0 <= number <= MAX_PORT:
        raise typer.BadParameter(
            f"expected a port from 0 to {MAX_PORT}, got {text!r}", param_hint=f"'{option}'"
        )
    return number


def parse_duration(text: str, option: str, least: float = 0.0) -> float:
    """Parses a duration from an option and returns the duration in s.

    Raises ``typer.BadParameter`` if the duration is not between ``least`` s and one day.
    """
    seconds = parsed(text, parse_time, option)
    if not (seconds > 0.0 and least <= seconds <= LONGEST):
        raise typer.BadParameter(
            f"{text!r} is not between {least:g} and {LONGEST:g} s", param_hint=f"'{option}'"
        )
    return seconds


def parse_seed(text: str) -> int | None:
    """Returns the random seed from the option ``--seed``, or ``None`` for empty text.

    Raises ``typer.BadParameter`` if the text is not a whole number.
    """
    if not text:
        return None
    try:
        return int(text, 0)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no whole number", param_hint="'--seed'") from None


def parse_count(text: str, option: str, least: int) -> int | None:
    """Returns a whole number from an option, or ``None`` for empty text.

    Raises ``typer.BadParameter`` if the text is not a whole number or the number is less than
    ``least``.
    """
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text) >= least):
        raise typer.BadParameter(
            f"{text!r} is not a whole number of at least {least}", param_hint=f"'{option}'"
        )
    return int(text)


def parsed(text: str, parse: Callable[[str], T], option: str) -> T:
    """Calls ``parse`` with the text of an option and returns the result.

    If ``parse`` raises ``ValueError``, a ``typer.BadParameter`` with the name of the option is
    raised.
    """
    try:
        return parse(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint=f"'{option}'") from None


def refuse_options(options: Mapping[str, object], reason: str) -> None:
    """Raises ``typer.BadParameter`` if the user has set any of the options."""
    for option, value in options.items():
        if value:
            raise typer.BadParameter(reason, param_hint=f"'{option}'")


def check_physics(physics: str) -> None:
    """Raises ``typer.BadParameter`` if ``physics`` is neither ``ideal`` nor ``mujoco``."""
    if physics not in ("ideal", "mujoco"):
        raise typer.BadParameter(
            f"{physics!r} is neither ideal nor mujoco", param_hint="'--physics'"
        )


def new_values(settings: Sequence[str]) -> dict[str, Node]:
    """Returns the values of the options ``--set`` by their paths, for ``compile_file``."""
    if not settings:
        return {}
    from thorvaldc.compiler.source.overrides import parse_change

    return _by_path(settings, parse_change)


def choices(settings: Sequence[str]) -> dict[str, tuple[Node, ...]]:
    """Returns the values of the options ``--set`` of a sweep by their paths."""
    if not settings:
        return {}
    from thorvaldc.compiler.source.overrides import parse_choices

    return _by_path(settings, parse_choices)


def _by_path(settings: Sequence[str], parse: Callable[[str], tuple[str, T]]) -> dict[str, T]:
    values: dict[str, T] = {}
    for text in settings:
        path, value = parsed(text, parse, "--set")
        if path in values:
            raise typer.BadParameter(f"{path} is set twice", param_hint="'--set'")
        values[path] = value
    return values


def library_folders(names: Sequence[str], option: str = "'--library'") -> list[Path]:
    """Returns the paths of the module library folders.

    Raises ``typer.BadParameter`` if a library folder does not exist.
    """
    for name in names:
        if not Path(name).is_dir():
            raise typer.BadParameter(f"there is no folder {name!r}", param_hint=option)
    return [Path(name) for name in names]


def check_output(path: str, suffixes: Sequence[str], option: str) -> None:
    """Checks before a long run that the file of an option can be written.

    Raises ``typer.BadParameter`` if the name of the file has none of the allowed suffixes. Raises
    ``OutsideError`` if the folder of the file does not exist or cannot be written.
    """
    import tempfile

    target = Path(path)
    if target.suffix.lower().lstrip(".") not in suffixes:
        known = " or ".join(f".{suffix}" for suffix in suffixes)
        raise typer.BadParameter(f"{path!r} does not end in {known}", param_hint=f"'{option}'")
    if target.is_dir():
        raise OutsideError(f"cannot write {path}: it is a folder")
    with write_errors(path), tempfile.TemporaryFile(dir=target.parent):
        pass
