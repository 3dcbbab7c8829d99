"""The command table: name, function and help text of each command.

The commands in the table have the order of ``thorvaldc --help``.
"""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc import __version__
from thorvaldc.cli.command import CommandEntry, GroupEntry, lazy_group

MODULES = (
    CommandEntry("list", "modules_list:list_modules", "List the module types."),
    CommandEntry(
        "show",
        "modules_show:show_module",
        "Show a module type: parameters, ports, sources of its numbers.",
    ),
    CommandEntry("check", "modules_check:check_modules", "Check the modules in folders."),
    CommandEntry("new", "modules_new:new_module", "Make a module with a mesh to start from."),
)
CAN = (
    CommandEntry(
        "scan", "can_scan:scan", "Find the nodes on a bus and compare them with the robot."
    ),
    CommandEntry(
        "plan", "can_plan:plan", "Show the steps that would set up the bus; writes nothing."
    ),
    CommandEntry("flash", "can_flash:flash", "Write addresses and values to the nodes, verified."),
    CommandEntry("verify", "can_verify:verify", "Check identities, values, periods and bus load."),
    CommandEntry(
        "monitor",
        "can_monitor:monitor",
        "Show frames, bus load and node states; sends nothing.",
    ),
)
STUDY = (
    CommandEntry("run", "study_run:run_study", "Evaluate the designs of a study, or continue."),
    CommandEntry("show", "study_show:show_study", "Show the best designs, or ask in SQL."),
    CommandEntry("report", "study_report:write_report", "Write the results as a web page."),
    CommandEntry("best", "study_best:write_best", "Write the robot file of the best design."),
)
# The command `sim` also accepts the options of the commands `scenario`, `batch` and `replay`, which
# were parts of `sim` in the past.
OLD_SIM_OPTIONS = (
    *("--scenario", "--junit", "--replay", "--set", "--variations"),
    *("--draws", "--seed", "--jobs", "--output"),
)
COMMANDS: tuple[CommandEntry | GroupEntry, ...] = (
    CommandEntry("new", "new:new", "Make a folder with a robot.yaml to start from."),
    CommandEntry("check", "check:check", "Report every error in robot and fleet files."),
    CommandEntry("build", "build:build", "Compile robots and write the target files."),
    CommandEntry(
        "sim",
        "sim:sim",
        "Drive a robot in simulation, without a display.",
        hidden_options=OLD_SIM_OPTIONS,
    ),
    CommandEntry("scenario", "scenario:scenario", "Run a scenario and check its expectations."),
    CommandEntry("batch", "batch:batch", "Run variations of a scenario in parallel."),
    GroupEntry("study", STUDY, "Find the best designs of a robot among many."),
    CommandEntry("replay", "replay:replay", "Show a recorded run again, without physics."),
    CommandEntry("render", "render:render", "Draw a picture of a robot or fleet."),
    CommandEntry("preview", "preview:preview", "Show a robot in a browser while you edit it."),
    CommandEntry("view", "view:view", "Show a robot in MuJoCo's viewer or as a web page."),
    CommandEntry("run", "run:run", "Run the base driver on a real or simulated CAN bus."),
    CommandEntry("teleop", "teleop:teleop", "Drive a robot with the keyboard or a joystick."),
    CommandEntry("call", "call:call", "Call a service of a running driver."),
    CommandEntry("bus", "bus:bus", "Simulate a robot's CAN bus for other programs."),
    CommandEntry("faults", "faults:faults", "Measure how a robot reacts to faults on its CAN bus."),
    GroupEntry("can", CAN, "Set up, check and monitor a robot's CAN bus."),
    CommandEntry(
        "calibrate",
        "calibrate:calibrate",
        "Estimate wheel radii and steering offsets from a joint log.",
    ),
    GroupEntry("modules", MODULES, "List, show, check and make hardware modules."),
    CommandEntry("info", "info:info", "Show size, loads, limits, wiring and parts of a robot."),
    CommandEntry("diff", "diff:diff", "Compare two robots, builds or git revisions."),
    CommandEntry("why", "why:why", "Explain where a number of a robot comes from."),
    CommandEntry("audit", "audit:audit", "Report contradictions in the files of any robot."),
    CommandEntry("targets", "targets:targets", "List the targets that a robot can be built for."),
    CommandEntry("schema", "schema:schema", "Print the JSON Schema of a kind of document."),
    CommandEntry("lsp", "lsp:lsp", "Serve editors: diagnostics, completion, navigation."),
    CommandEntry("explain", "explain:explain", "Explain a diagnostic code."),
    CommandEntry(
        "import",
        "import_original:import_original",
        "Convert a configuration of the original Thorvald system.",
    ),
    CommandEntry(
        "demo",
        "demo:demo",
        "Build robots, drive each in simulation, print a table.",
        hidden=True,
    ),
)

app = typer.Typer(
    cls=lazy_group(COMMANDS),
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
