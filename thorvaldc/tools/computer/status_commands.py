"""The commands ``thorvaldc status`` and ``logs``, of robots that are installed on a computer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message, print_json
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.tools.computer.install_commands import (
    Host,
    Root,
    check_host,
    check_installed,
    root_folder,
)

if TYPE_CHECKING:
    from thorvaldc.tools.computer.installed_versions import Computer

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name in /etc/thorvaldc; default: all.")]
Follow = Annotated[bool, typer.Option("--follow", help="Go on with what it writes from now on.")]


def status(name: Name = "", host: Host = "", root: Root = "", json: options.Json = False) -> int:
    from thorvaldc.tools.computer.installed_versions import Computer
    from thorvaldc.tools.computer.robot_status import is_well, robot_status, status_lines

    if host:
        exit_status, statuses = _far_statuses(host, name, root)
    else:
        computer = Computer(root_folder(root))
        names = _installed(computer, name)
        statuses = [robot_status(computer, each, is_live=not root) for each in names]
        exit_status = DONE if statuses and all(map(is_well, statuses)) else INPUT
    try:
        lines = [line for each in statuses for line in status_lines(each)]
    except (KeyError, TypeError, AttributeError, ValueError):  # of another build
        raise OutsideError(f"{host} answers as another build of this version does") from None
    if json:
        print_json(statuses)
    elif lines:
        print("\n".join(lines))
    return exit_status


def _far_statuses(host: str, name: str, root: str) -> tuple[int, list[Any]]:
    """Returns the exit status of a far ``thorvaldc status``, and its result with the difference of
    the clocks."""
    from thorvaldc.diagnostics.files import read_json
    from thorvaldc.tools.computer.far_computer import reach

    check_host(host, root)
    far = reach(host, compare_clocks=True)
    exit_status, text = far.read("status", "--json", "--", *([name] if name else []))
    if exit_status not in (DONE, INPUT):
        return exit_status, []
    try:
        statuses = read_json(text.encode())
        for each in statuses:
            each["clock"] |= {} if far.clock is None else vars(far.clock)
    except (KeyError, TypeError, ValueError):
        raise OutsideError(f"{host} answers as another build of this version does") from None
    return exit_status, statuses


def logs(name: Name = "", host: Host = "", root: Root = "", follow: Follow = False) -> int:
    from thorvaldc.tools.computer.far_computer import reach
    from thorvaldc.tools.computer.installed_versions import Computer
    from thorvaldc.tools.computer.robot_journal import show_journal

    if host:
        check_host(host, root)
        words = ["--follow"] if follow else []
        return reach(host).show("logs", *words, "--", *([name] if name else []))
    computer = Computer(root_folder(root))
    units = [unit for each in _installed(computer, name) for unit in computer.units(each)]
    if not units:
        return INPUT
    show_journal(units, computer.root, follow=follow)
    return DONE


def _installed(computer: Computer, name: str) -> list[str]:
    """Returns the name, or all names of installed robots."""
    from thorvaldc.tools.computer.installed_versions import installed_names

    names = installed_names(computer.root)
    if name:
        check_installed(name, names)
    elif not names:
        message("no robot is installed on this computer")
    return [name] if name else list(names)
