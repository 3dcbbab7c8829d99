"""The commands ``thorvaldc install`` and ``uninstall``, on the computer of a robot."""

from __future__ import annotations

import contextlib
import os
import pwd
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import DONE, OutsideError, write_errors
from thorvaldc.cli.robot_file import load_robot
from thorvaldc.diagnostics import did_you_mean
from thorvaldc.model.model_json import is_model_file
from thorvaldc.model.settings import AT_START, AUTOMATIC

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.tools.computer.installed_versions import Computer, Version

Root = Annotated[
    str,
    typer.Option(
        "--root",
        metavar="DIR",
        help="File system of another computer, such as a mounted image; starts nothing.",
        show_default="this computer",
    ),
]
Host = Annotated[
    str,
    typer.Option(
        "--host", metavar="HOST", help="Computer of the robot, by ssh: robot or user@10.0.0.2."
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="List the changes and make none.")]


def install(
    file: options.RobotFile, host: Host = "", root: Root = "", dry_run: DryRun = False
) -> int:
    from thorvaldc.tools.computer.answering_devices import compare_devices
    from thorvaldc.tools.computer.installed_versions import Computer, version_of_model

    if host:
        check_host(host, root)
    file = os.path.relpath(file)  # absolute names are those of files that belong to others
    # The service builds the file without options, and root runs no program of others (`--trust`).
    loaded = load_robot(file, [], False)
    robot, computer = loaded.robot, Computer(root_folder(root))
    if is_model_file(file):
        version = version_of_model(robot, Path(file))
    else:
        # The runtime package does not contain the compiler.
        from thorvaldc.tools.computer.robot_folder import version_of

        version = version_of(robot, Path(file), loaded.sources, computer.root)
    if host:
        return _install_there(host, version, dry_run)
    plan = computer.plan(version)
    if not plan:
        message(f"{robot.name} is installed, and nothing has changed")
        return DONE
    current = computer.current(version.name)
    for name in computer.edited(current) if current is not None else ():
        message(f"note: {name} was edited on this computer; it stays in {current}")
    if robot.driver.homing == AT_START:
        message("warning: the steering turns whenever the service starts (`homing: at_start`)")
    if robot.driver.arming == AUTOMATIC:
        message("warning: the robot arms itself after each start (`arming: automatic`)")
    print("\n".join(plan))
    if dry_run:
        return DONE
    if not root:
        _check_computer(robot)
        _check_at_rest(computer, version.name)
        answers = compare_devices(robot)
        for note in answers.notes:
            message(f"note: {note}")
        if answers.report.has_errors:
            return loaded.show(answers.report)
    with write_errors(computer.folder(version.name)):
        computer.install(version)
    if not root:
        _reload()
        _run(["systemctl", "restart", *version.units], "the service does not start")
        message(
            f"`thorvaldc logs {version.name}` shows what it does; an interface that was in use gets"
            " its new name at the next boot"
        )
    return DONE


def _install_there(host: str, version: Version, dry_run: bool) -> int:
    """Lets a far ``thorvaldc install`` make the same version of the same files."""
    from thorvaldc.tools.computer.far_computer import reach
    from thorvaldc.tools.computer.installed_versions import CACHE

    sources = ("files/", f"{CACHE}/")
    files = {name: data for name, data in version.files.items() if name.startswith(sources)}
    folder, words = f"files/{version.robot_folder}", ["--dry-run"] if dry_run else []
    return reach(host).install(files, folder, version.robot_file, *words)


def uninstall(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name in /etc/thorvaldc.", show_default=False)
    ],
    root: Root = "",
    dry_run: DryRun = False,
) -> int:
    from thorvaldc.backends.computer import FOLDER, STATE
    from thorvaldc.tools.computer.installed_versions import Computer, installed_names

    computer = Computer(root_folder(root))
    check_installed(name, installed_names(computer.root))
    links = computer.links_of(name)
    folder = FOLDER.format(name=name).removesuffix("/current")
    print("\n".join(f"remove {path}" for path in [*links, folder, STATE.format(name=name)]))
    if dry_run:
        return DONE
    if not root:
        _check_at_rest(computer, name)
        _run(["systemctl", "stop", f"thorvaldc-{name}.*"], "the service may still run")
    with write_errors(computer.folder(name)):
        computer.uninstall(name)
    if not root:
        _reload()
    return DONE


def check_host(host: str, root: str) -> None:
    """Raises ``typer.BadParameter`` if the option ``--host`` names no computer, or beside
    ``--root``."""
    from thorvaldc.tools.computer import far_computer

    far_computer.check_host(host)
    options.refuse_options({"--root": root}, "--host is for the file system of that computer")


def check_installed(name: str, names: Sequence[str]) -> None:
    """Raises ``typer.BadParameter`` if no robot of this name is installed."""
    if name not in names:
        near = did_you_mean(name, names, f"installed are: {', '.join(names) or 'none'}")
        raise typer.BadParameter(f"`{name}` is not installed; {near}", param_hint="NAME")


def root_folder(root: str) -> Path:
    """Returns the folder that the option ``--root`` names.

    Raises ``typer.BadParameter`` if it is none.
    """
    if root and not Path(root).is_dir():
        raise typer.BadParameter(f"there is no folder {root}", param_hint="'--root'")
    return Path(root or "/")


def _check_computer(robot: Robot) -> None:
    """Raises ``OutsideError`` if the services could not start on this computer."""
    computer = robot.computer
    if computer is None:
        raise OutsideError("this model has no `computer`: name the robot file")
    if sys.platform != "linux" or not Path("/run/systemd/system").is_dir():
        raise OutsideError("this computer does not run systemd; --root installs to an image")
    if os.geteuid() != 0:
        raise OutsideError(f"only root may install services: sudo {computer.program} install ...")
    if not os.access(computer.program, os.X_OK):
        raise OutsideError(
            f"there is no {computer.program}: python3 -m venv {Path(computer.program).parents[1]},"
            " and install thorvaldc there; or state `program` in `computer`"
        )
    try:
        pwd.getpwnam(computer.user)
    except KeyError:
        raise OutsideError(
            f"there is no user `{computer.user}`: sudo useradd --system --user-group"
            f" --groups dialout,input {computer.user}; or state `user` in `computer`"
        ) from None


def _check_at_rest(computer: Computer, name: str) -> None:
    """Raises ``OutsideError`` if the robot is armed, or if nobody knows because ROS 2 runs."""
    from thorvaldc.backends.computer import CONTROL, starts_ros
    from thorvaldc.runtime.control_channel import ControlClient

    for unit, text in computer.units(name).items():
        if starts_ros(text) and _run(["systemctl", "is-active", "--quiet", unit]):
            raise OutsideError(f"the robot may be armed: systemctl stop {unit}")
    channel = CONTROL.format(name=name)
    try:
        client = ControlClient(channel)
    except OSError:
        return  # no base driver runs
    with contextlib.closing(client):
        if client.call("state")["armed"]:
            raise OutsideError(f"the robot is armed: thorvaldc call {channel} disarm")


def _reload() -> None:
    """Lets systemd and udev read their files again."""
    _run(["systemctl", "daemon-reload"], "systemd did not read its files")
    if _run(["udevadm", "control", "--reload"], "devices get their names at the next boot"):
        # With `add`, interfaces that are down get their names, too.
        _run(["udevadm", "trigger", "--action=add", "--subsystem-match=net"])
        _run(["udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=input"])
    _run(["networkctl", "reload"], "CAN interfaces need systemctl enable --now systemd-networkd")
    _run(["systemctl", "try-restart", "systemd-timesyncd.service"])


def _run(command: Sequence[str], failure: str = "") -> bool:
    """Runs a command, and returns whether it succeeded.

    ``failure``: what follows if it does not, for a warning, or empty.
    """
    try:
        subprocess.run(command, check=True, timeout=120.0, capture_output=True, text=True)
        return True
    except FileNotFoundError:
        reason = f"there is no {command[0]}"
    except subprocess.CalledProcessError as error:
        lines = str(error.stderr).strip().splitlines() or [f"exit status {error.returncode}"]
        reason = f"{command[0]}: {lines[0]}"
    except (OSError, subprocess.SubprocessError) as error:
        reason = str(error)
    if failure:
        message(f"warning: {failure} ({reason})")
    return False
