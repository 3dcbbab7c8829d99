"""The command line: what can be said.  Each command's work is imported when it is called.

All parameters are text, lists of text, or flags (see ``LightCommand``).
"""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.can import can
from thorvaldc.cli.command import LightCommand, LightGroup, guarded
from thorvaldc.cli.modules import modules
from thorvaldc.cli.options import Format, Json, Library

app = typer.Typer(
    cls=LightGroup,
    help="A compiler for modular robots: robot.yaml in; URDF, MJCF, ROS 2 parameters and a CAN"
    " map out.",
    no_args_is_help=True,
    # Plain help: rich costs more time than all the rest of --help.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(modules, name="modules", help="The hardware modules of the library.")
app.add_typer(can, name="can", help="Set up, check and watch a robot's CAN bus.")

Files = Annotated[list[str], typer.Argument(metavar="FILE", help="A robot.yaml or fleet.yaml.")]
File = Annotated[str, typer.Argument(metavar="FILE", help="A robot.yaml or fleet.yaml.")]


def _show_version(value: bool) -> None:
    if value:
        from thorvaldc import __version__

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


@app.command(cls=LightCommand)
@guarded
def check(
    files: Files,
    format: Format = "text",
    strict: Annotated[bool, typer.Option("--strict", help="Warnings count as errors.")] = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Report every fault of robot and fleet files at once."""
    from thorvaldc.cli.compiling import check_files

    return check_files(files, format, strict, library)


@app.command(cls=LightCommand)
@guarded
def build(
    files: Files,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            "-t",
            metavar="NAMES",
            help="Targets, separated by commas.",
            show_default="see `thorvaldc targets`",
        ),
    ] = None,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            show_default="build/<name>",
            help="The folder to write; with several FILEs, the one to hold a folder for each.",
        ),
    ] = "",
    format: Format = "text",
    library: Library = [],  # noqa: B006
) -> int:
    """Compile and write the targets' files."""
    from thorvaldc.cli.compiling import build_files

    return build_files(files, target, output, format, library)


@app.command(cls=LightCommand)
@guarded
def sim(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A robot.yaml, fleet.yaml or scenario.")
    ],
    scenario: Annotated[
        str,
        typer.Option("--scenario", metavar="FILE", help="A scenario for the robot to drive."),
    ] = "",
    record: Annotated[
        str,
        typer.Option(
            "--record",
            metavar="OUT",
            help="Record the run: OUT.mcap (Foxglove, PlotJuggler, ROS 2), or a folder of CSV"
            " files.",
        ),
    ] = "",
    replay: Annotated[
        str,
        typer.Option(
            "--replay", metavar="RECORD", help="Play a record back (as of --record), no physics."
        ),
    ] = "",
    junit: Annotated[
        str,
        typer.Option("--junit", metavar="OUT.xml", help="Write a scenario's report as JUnit XML."),
    ] = "",
    set: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUES",
            help="Other values in a scenario: world.friction=0.3,0.6 for a run with each,"
            " =0.3..0.9 to draw from.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    variations: Annotated[
        bool, typer.Option("--variations", help="Run the variations that a scenario names.")
    ] = False,
    draws: Annotated[
        str, typer.Option("--draws", metavar="N", help="How often to draw from ranges.")
    ] = "",
    seed: Annotated[
        str, typer.Option("--seed", metavar="N", help="Number that ranges are drawn by.")
    ] = "",
    jobs: Annotated[
        str,
        typer.Option("--jobs", "-j", metavar="N", help="Processes for variations (default: all)."),
    ] = "",
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT.csv", help="What came of variations: .csv, .json."
        ),
    ] = "",
    duration: Annotated[
        str,
        typer.Option("--duration", metavar="TIME", help="Simulated time: 5, or '5 s'."),
    ] = "",
    twist: Annotated[
        str,
        typer.Option(
            "--twist",
            metavar="VX,VY,WZ",
            help="Velocity to command, in m/s, m/s and rad/s; without, the robot shows what it"
            " can do.",
        ),
    ] = "",
    parameters: Annotated[
        str,
        typer.Option("--parameters", metavar="SET", help="Parameter set of the robot's file."),
    ] = "",
    ideal: Annotated[bool, typer.Option("--ideal", help="Ideal joints, no physics.")] = False,
    open_loop: Annotated[
        bool,
        typer.Option(
            "--open-loop", help="Drives without speed control, for a log to calibrate by."
        ),
    ] = False,
    log: Annotated[
        str,
        typer.Option(
            "--log",
            metavar="FILE",
            help="Write the joint states as CSV, to calibrate by; of several robots to a folder.",
        ),
    ] = "",
    plot: Annotated[
        str,
        typer.Option(
            "--plot", metavar="OUT.png", help="Draw paths and velocities (.png, .svg or .pdf)."
        ),
    ] = "",
    video: Annotated[
        str, typer.Option("--video", metavar="OUT.mp4", help="Film the run (.mp4 or .gif).")
    ] = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Drive a robot in simulation, or run a scenario, without a display."""
    from thorvaldc.cli.simulating import Varying, simulate

    return simulate(
        file,
        duration,
        twist,
        parameters,
        json,
        ideal,
        open_loop,
        log,
        library,
        plot,
        video,
        scenario,
        record,
        junit,
        replay,
        Varying(set, variations, draws, seed, jobs, output),
    )


@app.command(cls=LightCommand)
@guarded
def calibrate(
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="Recorded joint states: CSV, as of sim --log.")
    ],
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="The robot's robot.yaml.")],
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Calibration to write.", show_default=False
        ),
    ] = "",
    distance: Annotated[
        str,
        typer.Option(
            "--distance",
            metavar="LENGTH",
            help="Measured from where the log begins to where it ends: '10.00 m'. Gives the radii"
            " their common scale.",
        ),
    ] = "",
    parameters: Annotated[
        str,
        typer.Option("--parameters", metavar="SET", help="Parameter set that the robot drove by."),
    ] = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Find steering offsets and wheel radii from recorded joint states."""
    from thorvaldc.cli.calibrating import calibrate_robot

    return calibrate_robot(log, robot, output, distance, parameters, json, library)


@app.command(cls=LightCommand)
@guarded
def bus(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A robot.yaml.")],
    channel: Annotated[
        str,
        typer.Option(
            "--channel",
            metavar="NAME",
            help="Name of the bus for other programs, or the path of its socket.",
            show_default="the robot's name",
        ),
    ] = "",
    physics: Annotated[
        str,
        typer.Option("--physics", metavar="ideal|mujoco", help="What moves the motors."),
    ] = "ideal",
    faults: Annotated[
        str, typer.Option("--faults", metavar="FILE", help="What is to go wrong, and when.")
    ] = "",
    seed: Annotated[
        str, typer.Option("--seed", metavar="N", help="Of everything that happens by chance.")
    ] = "",
    store: Annotated[
        str,
        typer.Option(
            "--store",
            metavar="FILE",
            help="What devices keep without power: read at the start, written at the end.",
        ),
    ] = "",
    delivered: Annotated[
        bool,
        typer.Option(
            "--delivered", help="Devices as their makers send them, without ids and parameters."
        ),
    ] = False,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep", help="Time runs only while all programs in lockstep wait for it."
        ),
    ] = False,
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Run a robot's bus in simulation, for programs that attach to it by python-can."""
    from thorvaldc.cli.bus import run_bus

    return run_bus(file, channel, physics, faults, seed, store, delivered, lockstep, json, library)


@app.command(cls=LightCommand)
@guarded
def run(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A robot.yaml, or the model.json of a build.")
    ],
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            help="virtual, sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of"
            " python-can.",
        ),
    ],
    duration: Annotated[
        str,
        typer.Option(
            "--duration", metavar="TIME", help="To run for, from when the robot is ready: 20 s."
        ),
    ] = "",
    twist: Annotated[
        str,
        typer.Option("--twist", metavar="VX,VY,WZ", help="Drive this, in m/s, m/s and rad/s."),
    ] = "",
    parameters: Annotated[
        str,
        typer.Option("--parameters", metavar="NAME", help="A parameter set of the robot's file."),
    ] = "",
    physics: Annotated[
        str,
        typer.Option(
            "--physics", metavar="ideal|mujoco", help="What moves the motors of a virtual robot."
        ),
    ] = "ideal",
    faults: Annotated[
        str,
        typer.Option("--faults", metavar="FILE", help="What is to go wrong with a virtual robot."),
    ] = "",
    seed: Annotated[
        str, typer.Option("--seed", metavar="N", help="Of a virtual robot's chances.")
    ] = "",
    fast: Annotated[
        bool, typer.Option("--fast", help="Let a virtual robot's time run as fast as it can.")
    ] = False,
    name: Annotated[
        str,
        typer.Option(
            "--name",
            metavar="NAME",
            help="Of its control channel, for `teleop --to` and `call`.",
            show_default="the robot's; none with --twist or --duration",
        ),
    ] = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
) -> int:
    """Drive a robot over its CAN bus, a real or a simulated one."""
    from thorvaldc.cli.running import run as run_driver

    return run_driver(
        file, bus, duration, twist, parameters, physics, faults, seed, fast, name, json, library
    )


@app.command(cls=LightCommand)
@guarded
def render(
    file: File,
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT.png", show_default="<name>.png"),
    ] = "",
    size: Annotated[
        str, typer.Option("--size", metavar="WxH", help="Width and height in pixels.")
    ] = "1000x700",
    view: Annotated[
        str,
        typer.Option(
            "--view",
            metavar="VIEW",
            help="corner, front, rear, left, right, top, or azimuth,elevation in degrees.",
        ),
    ] = "corner",
    replay: Annotated[
        str, typer.Option("--replay", metavar="RECORD", help="Where a record has the robots.")
    ] = "",
    at: Annotated[
        str,
        typer.Option(
            "--at", metavar="TIME", help="Of the record: 5, or '5 s'.", show_default="its end"
        ),
    ] = "",
    library: Library = [],  # noqa: B006
) -> int:
    """Draw a picture of a robot or fleet, without a display."""
    from thorvaldc.cli.picturing import render_file

    return render_file(file, output, size, view, library, replay, at)


@app.command(cls=LightCommand)
@guarded
def view(
    file: File,
    html: Annotated[
        bool, typer.Option("--html", help="A web page, though there is a display.")
    ] = False,
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT.html", show_default="<name>.html"),
    ] = "",
    library: Library = [],  # noqa: B006
) -> int:
    """Look at a robot or fleet: in MuJoCo's viewer, or without a display as a web page."""
    from thorvaldc.cli.viewing import view_file

    return view_file(file, output, html, library)


@app.command(cls=LightCommand)
@guarded
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
            metavar="WHAT",
            help="sim: MuJoCo; ideal: ideal joints; virtual: a simulated bus; or a bus as `run`"
            " takes it.",
        ),
    ] = "sim",
    to: Annotated[
        str,
        typer.Option(
            "--to", metavar="NAME", help="Drive a robot whose driver is run by that name."
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
        typer.Option("--source", metavar="SOURCE", help="The source of twists that this is."),
    ] = "teleop_joy",
    speed: Annotated[
        str, typer.Option("--speed", metavar="PERCENT", help="Of the top speed, to start with.")
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
            "--map", metavar="ENTRIES", help="The joystick's axes and buttons: enable=BTN_TL,..."
        ),
    ] = "",
    library: Library = [],  # noqa: B006
) -> int:
    """Drive a robot by hand, from the keyboard of a terminal or with a joystick."""
    from thorvaldc.cli.teleoperating import teleoperate

    return teleoperate(file, on, to, name, source, speed, joystick, map, library)


@app.command(cls=LightCommand)
@guarded
def call(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of the driver that is run.")],
    service: Annotated[
        str, typer.Argument(metavar="SERVICE", help="Without one, they are listed.")
    ] = "",
    arguments: Annotated[
        list[str], typer.Argument(metavar="ARGUMENT=VALUE", help="Values as in JSON, or text.")
    ] = [],  # noqa: B006
    json: Json = False,
) -> int:
    """Call a service of a running driver: its state, a stop, parameters, an output."""
    from thorvaldc.cli.teleoperating import call_service

    return call_service(name, service, arguments, json)


@app.command("import", cls=LightCommand)
@guarded
def import_(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="A configuration file of the original Thorvald system."
        ),
    ],
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT", help="File to write.", show_default="stdout"),
    ] = "",
    format: Format = "text",
) -> int:
    """Make a robot.yaml of an original Thorvald configuration."""
    from thorvaldc.cli.importing import import_file

    return import_file(file, output, format)


@app.command(cls=LightCommand)
@guarded
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the robot and its folder.")],
    preset: Annotated[
        str, typer.Option("--preset", metavar="PRESET", help="4wd4ws, 2wd0ws or 1wd1ws.")
    ] = "4wd4ws",
) -> int:
    """Start a robot of your own: a folder with a robot.yaml."""
    from thorvaldc.cli.scaffold import new_robot

    return new_robot(name, preset)


@app.command(cls=LightCommand)
@guarded
def targets(json: Json = False) -> int:
    """List what a robot can be built to."""
    from thorvaldc.cli.listing import list_targets

    return list_targets(json)


@app.command(cls=LightCommand)
@guarded
def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="robot, module, fleet, calibration, scenario or bus_faults; model: model.json.",
        ),
    ],
) -> int:
    """Print the JSON Schema of a kind of document, for editors."""
    from thorvaldc.cli.listing import show_schema

    return show_schema(kind)


@app.command(cls=LightCommand)
@guarded
def explain(
    code: Annotated[str, typer.Argument(metavar="CODE", help="TV501 or can-id-duplicate.")],
) -> int:
    """Explain a fault: what it means and how to mend it."""
    from thorvaldc.cli.listing import explain as show

    return show(code)


@app.command(cls=LightCommand, hidden=True)
@guarded
def demo(
    files: Annotated[list[str], typer.Argument(metavar="FILE")] = [],  # noqa: B006
    original: Annotated[list[str], typer.Option("--original", metavar="FILE")] = [],  # noqa: B006
    output: Annotated[str, typer.Option("--output", "-o", metavar="DIR")] = "build",
) -> int:
    """Build robots, drive each in simulation, print a table."""
    from thorvaldc.cli.demo import run_demo

    return run_demo(files, original, output)
