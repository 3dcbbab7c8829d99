"""The command table: name, function, one line of help, in the order of ``thorvaldc --help``."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc import __version__
from thorvaldc.cli.command import CommandEntry, GroupEntry, lazy_group

_IN = "thorvaldc.cli.commands"

MODULES = (
    CommandEntry("list", f"{_IN}.modules_list:list_modules", "List the module types."),
    CommandEntry(
        "show",
        f"{_IN}.modules_show:show_module",
        "Show a module type: parameters, ports, sources of its numbers.",
    ),
    CommandEntry("check", f"{_IN}.modules_check:check_modules", "Check the modules in folders."),
)
CAN = (
    CommandEntry(
        "scan", f"{_IN}.can_scan:scan", "Find the nodes on a bus and compare them with the robot."
    ),
    CommandEntry(
        "plan", f"{_IN}.can_plan:plan", "Show the steps that would set up the bus; writes nothing."
    ),
    CommandEntry(
        "flash", f"{_IN}.can_flash:flash", "Write addresses and values to the nodes, verified."
    ),
    CommandEntry(
        "verify", f"{_IN}.can_verify:verify", "Check identities, values, periods and bus load."
    ),
    CommandEntry(
        "monitor", f"{_IN}.can_monitor:monitor", "Show frames, load and states; sends nothing."
    ),
)
COMMANDS: tuple[CommandEntry | GroupEntry, ...] = (
    CommandEntry("new", f"{_IN}.new:new", "Make a folder with a robot.yaml to start from."),
    CommandEntry("check", f"{_IN}.check:check", "Report every error in robot and fleet files."),
    CommandEntry("build", f"{_IN}.build:build", "Compile robots and write the target files."),
    CommandEntry(
        "sim",
        f"{_IN}.sim:sim",
        "Drive a robot in simulation, without a display.",
        # Options of `scenario`, `batch` and `replay`, which were parts of `sim`.
        hidden_options=(
            "--scenario",
            "--junit",
            "--set",
            "--variations",
            "--draws",
            "--seed",
            "--jobs",
            "--output",
            "--replay",
        ),
    ),
    CommandEntry(
        "scenario", f"{_IN}.scenario:scenario", "Run a scenario and check its expectations."
    ),
    CommandEntry("batch", f"{_IN}.batch:batch", "Run variations of a scenario in parallel."),
    CommandEntry("replay", f"{_IN}.replay:replay", "Show a recorded run again, without physics."),
    CommandEntry("render", f"{_IN}.render:render", "Draw a picture of a robot or fleet."),
    CommandEntry("view", f"{_IN}.view:view", "Show a robot in MuJoCo's viewer or as a web page."),
    CommandEntry("run", f"{_IN}.run:run", "Run the base driver on a real or simulated CAN bus."),
    CommandEntry(
        "teleop", f"{_IN}.teleop:teleop", "Drive a robot with the keyboard or a joystick."
    ),
    CommandEntry("call", f"{_IN}.call:call", "Call a service of a running driver."),
    CommandEntry("bus", f"{_IN}.bus:bus", "Simulate a robot's CAN bus for other programs."),
    GroupEntry("can", CAN, "Set up, check and monitor a robot's CAN bus."),
    CommandEntry(
        "calibrate", f"{_IN}.calibrate:calibrate", "Estimate wheel radii and steering offsets."
    ),
    GroupEntry("modules", MODULES, "List, show and check the hardware modules."),
    CommandEntry("targets", f"{_IN}.targets:targets", "List the targets of a build."),
    CommandEntry("schema", f"{_IN}.schema:schema", "Print the JSON Schema of a document."),
    CommandEntry("explain", f"{_IN}.explain:explain", "Explain a diagnostic code."),
    CommandEntry(
        "import", f"{_IN}.import_original:import_original", "Convert a Thorvald configuration."
    ),
    CommandEntry(
        "demo", f"{_IN}.demo:demo", "Build robots, drive each in simulation, print a table.", True
    ),
)

app = typer.Typer(
    cls=lazy_group(COMMANDS),
    help="A compiler for modular robots: robot.yaml in; URDF, MJCF, ROS 2 parameters and a CAN"
    " map out.",
    no_args_is_help=True,
    # Plain help: the import of rich takes longer than the rest of --help.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(value: bool) -> None:
    if value:
        typer.echo(f"thorvaldc {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass
