"""Options that many commands have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.model.bus import Bus

LONGEST = 86400.0
"""s: what lasts longer than a day is a slip."""

Format = Annotated[
    str, typer.Option("--format", metavar="text|json|github|sarif", help="How faults are shown.")
]
Library = Annotated[
    list[str],
    typer.Option("--library", metavar="DIR", help="A folder of modules of yours; may be repeated."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def seconds_of(text: str, option: str, least: float = 0.0) -> float:
    """A time that is given on the command line, in s.  Raises ``typer.BadParameter``."""
    from thorvaldc.compiler.source.units import UnitError, parse_quantity

    try:
        seconds = parse_quantity(text, "time")
    except UnitError as fault:
        raise typer.BadParameter(f"{text!r}: {fault}", param_hint=f"'{option}'") from None
    if not (seconds > 0.0 and least <= seconds <= LONGEST):
        raise typer.BadParameter(
            f"{text!r} is not between {least:g} and {LONGEST:g} s", param_hint=f"'{option}'"
        )
    return seconds


def bus_of(robot: Robot, spec: str) -> tuple[Bus, str]:
    """The bus that ``--bus`` means, and where it is: ``left=socketcan:can0`` of several.

    Raises ``DiagnosticError`` for a robot without a bus, ``typer.BadParameter`` where it is
    not said which.
    """
    from thorvaldc.model.buses import require_bus

    require_bus(robot)
    names = {bus.name: bus for bus in robot.buses}
    name, given, rest = spec.partition("=")
    if given and name in names:
        return names[name], rest
    if len(names) == 1:
        return robot.buses[0], spec
    where = (rest if given else spec) or "socketcan:can0"
    wrong = f"the robot has no bus {name}, but" if given else "the robot has the buses"
    raise typer.BadParameter(
        f"{wrong} {', '.join(names)}; say which: {robot.buses[0].name}={where}",
        param_hint="'--bus'",
    )
