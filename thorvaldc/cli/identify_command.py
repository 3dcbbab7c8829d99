"""The command ``thorvaldc can identify``: finds the file of the robot that is on a CAN bus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import (
    Progress,
    message,
    print_json,
    report_of,
    show_report,
    table_width,
)
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.robot_file import is_hardware, read_robot_file
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.files import read_bounded

if TYPE_CHECKING:
    from thorvaldc.commissioning.identify import Candidate, Match


_LARGEST = 1_000_000
"""Size in bytes of the files in a folder that are read."""


def identify(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FOLDER", help="Folders with robot files, robot.yaml or model.json files."
        ),
    ],
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="[NAME=]BUS",
            help="socketcan:can0, slcan:PORT or sim:NAME; with NAME, only the buses of this name.",
        ),
    ],
    bitrate: Annotated[
        str,
        typer.Option(
            "--bitrate",
            metavar="KBIT",
            help="Bit rate in kbit/s, where the files have several.",
            show_default="that of the files",
        ),
    ] = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.can.open_interface import bus_lock, open_interface
    from thorvaldc.cli.can_commands import UNTESTED
    from thorvaldc.commissioning.identify import identify as identify_robot
    from thorvaldc.commissioning.identify import only_listens

    head, equals, tail = bus.partition("=")
    # The name of a socket may contain `=`, as in `sim:./a=b`.
    name, interface_name = (head, tail) if equals and ":" not in head else ("", bus)
    if interface_name.partition(":")[0] == "virtual":
        raise typer.BadParameter(
            "`virtual` simulates the robot of one file; `thorvaldc bus` gives a bus sim:NAME",
            param_hint="'--bus'",
        )
    candidates = _candidates(files, library, trust, bitrate, name)
    if is_hardware(interface_name):
        message(UNTESTED)
    if why := only_listens(candidates):
        message(f"no request is sent, because it could be a command for a drive: {why}")
    bar = Progress(1.0, "")
    try:
        with bus_lock(interface_name):
            interface = open_interface(interface_name, candidates[0].bus)
            try:
                matches = identify_robot(interface, candidates, bar.show_activity)
            finally:
                bar.clear()
                interface.close()
    except DiagnosticError as error:
        return show_report(report_of(error), {})
    if json:
        print_json([match.as_json() for match in matches])
    else:
        _print(matches)
    best = matches[0]
    is_clear = len(matches) == 1 or matches[1].rank != best.rank
    return DONE if best.ok and not best.differences and is_clear else INPUT


def _print(matches: Sequence[Match]) -> None:
    from thorvaldc.commissioning.identify import match_table, verdict

    print(match_table(matches, table_width()))
    print()
    print(verdict(matches))
    best = matches[0]
    for difference in best.differences if best.ok or best.serials else ():
        print(f"- {difference.text}")
        if difference.change:
            print(f"  {difference.change}")


def _candidates(
    files: Sequence[str], library: Sequence[str], trust: bool, bitrate: str, name: str
) -> list[Candidate]:
    """Returns the buses of the robot files, with ``name`` only those of this name.

    Raises ``typer.BadParameter`` if there are none.
    """
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.identify import Candidate
    from thorvaldc.model import Robot

    candidates: dict[str, Candidate] = {}
    for path in _robot_files(files):
        robot = read_robot_file(str(path), library, trust).model
        if not isinstance(robot, Robot):
            reason = "it is no robot" if robot else "it has errors, which `thorvaldc check` shows"
            message(f"{path} is left out: {reason}")
            continue
        for bus in (bus for bus in robot.buses if name in ("", bus.name)):
            # A model.json of a build beside its robot.yaml is the same robot.
            key = configuration_of(robot, bus).hash
            candidates.setdefault(key, Candidate(str(path), robot, bus))
    if not candidates:
        text = f"there is no robot file with a bus{f' {name}' if name else ''}"
        raise typer.BadParameter(text, param_hint="FOLDER")
    rates = sorted({candidate.bus.bitrate // 1000 for candidate in candidates.values()})
    if not bitrate and len(rates) > 1:
        raise typer.BadParameter(
            f"the files have buses with {', '.join(map(str, rates))} kbit/s; say which one it is",
            param_hint="'--bitrate'",
        )
    chosen = [
        candidate
        for candidate in candidates.values()
        if bitrate in ("", str(candidate.bus.bitrate // 1000))
    ]
    if not chosen:
        raise typer.BadParameter(
            f"the files have buses with {', '.join(map(str, rates))} kbit/s",
            param_hint="'--bitrate'",
        )
    return chosen


def _robot_files(files: Sequence[str]) -> Iterator[Path]:
    """Yields the files that the user names, and in folders the robot files before the models."""
    from thorvaldc.cli.exits import is_runtime_only

    for file in files:
        path = Path(file)
        if not path.exists():
            raise OutsideError(f"{file} does not exist")
        if not path.is_dir():
            yield path
            continue
        names = (p for p in sorted(path.rglob("*")) if not _is_hidden(p.relative_to(path)))
        inside = [p for p in names if p.suffix in (".yaml", ".yml", ".json") and p.is_file()]
        if not is_runtime_only():
            yield from (p for p in inside if p.suffix != ".json" and _is_robot(p))
        yield from (p for p in inside if p.name == "model.json")


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") or part == "node_modules" for part in path.parts)


def _is_robot(path: Path) -> bool:
    from thorvaldc.compiler.validation.document_check import kind_of

    try:
        text = read_bounded(path, _LARGEST).decode()
    except (OSError, UnicodeDecodeError):
        return False
    return kind_of(text, path.name) == "robot"
