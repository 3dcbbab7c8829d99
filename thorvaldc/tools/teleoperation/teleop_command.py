"""The command ``thorvaldc teleop``: drives a robot with the keyboard or a joystick."""

from __future__ import annotations

import contextlib
import gc
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import diagnostic_output, options, robot_file
from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import DONE, OutsideError, check_full_installation
from thorvaldc.cli.robot_file import (
    LoadedRobot,
    is_hardware,
    make_mujoco_base,
    start_virtual_robot,
    warn_once,
)
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.diagnostics.installation import install_command

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.runtime.teleop_loop import Vehicle
    from thorvaldc.tools.teleoperation.joystick import Search


def teleop(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="A robot.yaml, or the model.json of a build.", show_default=False
        ),
    ] = "",
    on: Annotated[
        str,
        typer.Option(
            "--on",
            metavar="BASE",
            autocompletion=options.base_names,
            help="sim: MuJoCo; ideal: ideal joints; virtual: a simulated bus; or a bus as for"
            " `run --bus`.",
        ),
    ] = "sim",
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="NAME",
            autocompletion=options.driver_names,
            help="Drive the running driver of this name.",
        ),
    ] = "",
    name: Annotated[
        str,
        typer.Option(
            "--name",
            metavar="NAME",
            help="Name of this driver's control channel.",
            show_default="the robot's",
        ),
    ] = "",
    source: Annotated[
        str,
        typer.Option("--source", metavar="SOURCE", help="Twist source of this operator."),
    ] = "teleop_joy",
    speed: Annotated[
        str,
        typer.Option("--speed", metavar="PERCENT", help="Initial share of the top speed."),
    ] = "50%",
    joystick: Annotated[
        str,
        typer.Option(
            "--joystick", metavar="DEVICE", help="auto, or a path such as /dev/input/event5."
        ),
    ] = "",
    map: Annotated[
        str,
        typer.Option(
            "--map", metavar="ENTRIES", help="Axes and buttons of the joystick: enable=BTN_TL,..."
        ),
    ] = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.runtime.pace import end_signals
    from thorvaldc.tools.teleoperation.keyboard import drive_from_console

    if bool(file) == bool(to):
        raise typer.BadParameter("name a robot's FILE, or a running driver with --to NAME")
    if on not in ("sim", "ideal", "virtual", "udp") and ":" not in on:
        raise typer.BadParameter(
            f"{on!r} is none of sim, ideal, virtual, sim:NAME, slcan:PORT, socketcan:can0, udp",
            param_hint="'--on'",
        )
    options.library_folders(library)
    share = _parse_share(speed)
    if map and not joystick:
        raise typer.BadParameter("is for a --joystick", param_hint="'--map'")
    loaded = robot_file.load_robot(file, library, trust) if file else None
    search = _joystick_search(joystick, map) if joystick else None
    if search is None and not sys.stdin.isatty():
        raise OutsideError("the keyboard needs a terminal, and standard input is none")
    gc.enable()
    with end_signals() as end_requested, contextlib.ExitStack() as locks:
        vehicle = _start_driver(loaded, file, on, name, locks) if loaded else _connect(to)
        try:
            _check_source(source, vehicle.call("description"))
            drive_from_console(vehicle, source, share, search, end_requested)
        except ConnectionError as error:
            raise OutsideError(str(error)) from None
        finally:
            vehicle.shutdown()
    return DONE


def _connect(name: str) -> Vehicle:
    from thorvaldc.runtime.control_channel import ControlClient
    from thorvaldc.runtime.teleop_loop import RemoteVehicle

    client = ControlClient(name)
    try:
        if warning := client.other_version():
            message(f"warning: {warning}")
    except ConnectionError as error:
        client.close()
        raise OutsideError(str(error)) from None
    return RemoteVehicle(client)


def _start_driver(
    loaded: LoadedRobot, file: str, on: str, name: str, locks: contextlib.ExitStack
) -> Vehicle:
    """Starts a base driver for the robot in this process."""
    from thorvaldc.can.open_interface import lock_buses

    robot = loaded.robot
    channel = name or robot.name
    try:
        if on in ("sim", "ideal"):
            return _simulated_vehicle(robot, file, on, channel)
        if on != "virtual":
            lock_buses(on, robot, locks)
        return _bus_vehicle(robot, file, on, channel)
    except DiagnosticError as error:
        raise typer.Exit(loaded.show(diagnostic_output.report_of(error))) from None
    except OSError as error:  # the control channel is in use
        raise OutsideError(f"{error}; --name selects another name") from None


def _simulated_vehicle(robot: Robot, file: str, on: str, channel: str) -> Vehicle:
    from thorvaldc.model.settings import AUTOMATIC
    from thorvaldc.runtime.driven_robot import DrivenRobot

    check_full_installation(f"`--on {on}`")
    from thorvaldc.simulation.physics.sim_base import SimBase

    base = make_mujoco_base(robot, file, Report()) if on == "sim" else SimBase(robot)
    return DrivenRobot(robot, base, arming=AUTOMATIC, channel=channel)


def _bus_vehicle(robot: Robot, file: str, on: str, channel: str) -> Vehicle:
    from thorvaldc.can.open_interface import open_interfaces
    from thorvaldc.runtime.run_session import RunSession

    if on == "virtual":
        check_full_installation("`--on virtual`")
        simulated = start_virtual_robot(robot, file, "ideal", "", None, Report())
        interfaces = {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}
        session = RunSession(robot, interfaces, channel=channel, threaded=False, paced=True)
    else:
        session = RunSession(robot, open_interfaces(on, robot), channel=channel)
    if is_hardware(on):
        warn_once()
    return session.driven


def _joystick_search(joystick: str, mapping: str) -> Search:
    """Returns a function that searches for the joystick of the operator.

    Raises ``OutsideError`` if no joystick is plugged in at the start or if the package evdev is not
    installed.
    """
    from thorvaldc.runtime.base_interface import ParameterError
    from thorvaldc.tools.teleoperation.joystick import evdev_search

    try:
        search = evdev_search("" if joystick == "auto" else joystick, mapping)
    except ImportError:
        raise OutsideError(
            f"a joystick needs the package evdev (Linux): {install_command('joystick')}"
        ) from None
    except ParameterError as error:
        raise typer.BadParameter(str(error), param_hint="'--map'") from None
    device_and_layout = search()
    if device_and_layout is None:
        where = "under /dev/input" if joystick == "auto" else f"at {joystick}"
        raise OutsideError(
            f"there is no joystick {where}; is it plugged in, and has your user permission to read"
            " it (group `input`)?"
        )
    device_and_layout[0].close()
    return search


def _check_source(source: str, description: dict[str, Any]) -> None:
    sources = description["sources"]
    if source not in sources:
        raise typer.BadParameter(
            f"the robot has no source {source!r}; it has {', '.join(sources)}",
            param_hint="'--source'",
        )


def _parse_share(text: str) -> float:
    from thorvaldc.runtime.teleop_loop import SMALLEST_SHARE

    try:
        share = float(text.rstrip("% ")) / 100
    except ValueError:
        share = 0.0
    if not SMALLEST_SHARE <= share <= 1.0:
        raise typer.BadParameter(
            f"{text!r} is not between {SMALLEST_SHARE * 100:.0f} and 100 % of the top speed",
            param_hint="'--speed'",
        )
    return share
