"""The commands ``thorvaldc status`` and ``logs``, of robots that are installed on a computer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message, print_json
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.tools.computer.install_commands import Root, check_installed, root_folder

if TYPE_CHECKING:
    from thorvaldc.tools.computer.installed_versions import Computer

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name in /etc/thorvaldc; default: all.")]
Follow = Annotated[bool, typer.Option("--follow", help="Go on with what it writes from now on.")]


def status(name: Name = "", root: Root = "", json: options.Json = False) -> int:
    from thorvaldc.tools.computer.installed_versions import Computer
    from thorvaldc.tools.computer.robot_status import is_well, robot_status, status_lines

    computer = Computer(root_folder(root))
    names = _installed(computer, name)
    statuses = [robot_status(computer, each, is_live=not root) for each in names]
    if json:
        print_json(statuses)
    else:
        for each in statuses:
            print("\n".join(status_lines(each)))
    return DONE if statuses and all(map(is_well, statuses)) else INPUT


def logs(name: Name = "", root: Root = "", follow: Follow = False) -> int:
    from thorvaldc.tools.computer.installed_versions import Computer
    from thorvaldc.tools.computer.robot_journal import show_journal

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
