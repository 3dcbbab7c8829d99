"""The robot of a command: loaded from a robot.yaml or the model.json of a build, with the CAN bus
that ``--bus`` selects, or simulated in the process of the command."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from thorvaldc.cli.diagnostic_output import message, report_of, show_errors, show_report
from thorvaldc.cli.exits import INPUT, OutsideError, is_runtime_only
from thorvaldc.cli.options import library_folders
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Bus, Fleet, Robot
from thorvaldc.model.model_json import is_model_file, load_model

if TYPE_CHECKING:  # the runtime package has no compiler and no simulation
    from thorvaldc.compiler.result import Compilation
    from thorvaldc.model.scenario import BusFault
    from thorvaldc.simulation.bus.simulated_robot import Memory, SimulatedRobot
    from thorvaldc.simulation.physics.mujoco_base import MujocoBase

SIMULATED = ("virtual", "sim", "udp")
"""Kinds of CAN interfaces that are not connected to hardware."""


class LoadedRobot(NamedTuple):
    """The model of a robot and the source files of the robot.

    - ``sources``: maps the name of each source file to its path.
    - ``locate``: returns a report with source spans added to the diagnostics.
    """

    robot: Robot
    sources: Mapping[str, Path]
    locate: Callable[[Report], Report]

    def show(self, report: Report) -> int:
        """Prints the diagnostics of a report about the robot, and returns the exit status."""
        return show_report(self.locate(report), self.sources)


def load_robot(file: str, library: Sequence[str], trust: bool) -> LoadedRobot:
    """Returns the robot model from a robot.yaml or from the model.json of a build.

    A model is known by its content and may have any name.
    ``trust`` is whether xacro files of a robot.yaml are expanded without restrictions.
    If the robot file has errors, prints them and raises ``typer.Exit``. Raises
    ``typer.BadParameter`` if the file contains a fleet or anything else but a robot. Raises
    ``OutsideError`` for a robot.yaml if the compiler is not installed.
    """
    loaded = read_robot_file(file, library, trust)
    show_errors(loaded.report, loaded.sources, file)
    if loaded.model is None:
        raise typer.Exit(INPUT)
    if not isinstance(loaded.model, Robot):
        raise typer.BadParameter(f"{file} is no robot", param_hint="FILE")
    return LoadedRobot(loaded.model, loaded.sources, loaded.locate)


def path_beside(file: str, robot: Robot, suffix: str) -> Path:
    """Returns the path of a file of a robot that a command writes, such as a report.

    It lies in the folder of a robot.yaml, and in the current folder for the model.json of a build,
    because the next build replaces the files of its folder.
    """
    path = Path(file)
    if is_model_file(path):
        return Path(f"{robot.name}{suffix}")
    return path.with_name(f"{path.stem}{suffix}")


class RobotFile(NamedTuple):
    """The model in a file, or ``None`` if the file has errors, with the diagnostics of the file."""

    model: Robot | Fleet | None
    report: Report
    sources: Mapping[str, Path]
    locate: Callable[[Report], Report]


def read_robot_file(file: str, library: Sequence[str], trust: bool) -> RobotFile:
    """Reads a file as ``load_robot`` does, and prints nothing.

    Raises ``OutsideError`` for a robot.yaml if the compiler is not installed.
    """
    # A JSON file that is no model gets the message of `load_model`.
    if is_model_file(file) or Path(file).suffix == ".json":
        try:
            return RobotFile(load_model(Path(file)), Report(), {}, lambda report: report)
        except DiagnosticError as error:
            return RobotFile(None, report_of(error), {}, lambda report: report)
    if is_runtime_only():
        raise OutsideError(
            f"{file} needs the compiler, and this installation is the runtime alone: give the"
            " model.json of a build"
        )
    # The runtime package does not contain the compiler.
    from thorvaldc.compiler.pipeline import compile_file

    compilation = compile_file(file, library=library_folders(library), trust=trust)
    return RobotFile(
        compilation.model, compilation.report, compilation.sources, compilation.located
    )


def compile_and_show(
    file: str,
    library: Sequence[str],
    robot: str | None = None,
    values: Mapping[str, object] | None = None,
    *,
    trust: bool,
) -> Compilation:
    """Compiles a robot or fleet file and prints its errors on stderr, and the number of warnings.

    - ``robot``: path of a robot file that replaces the robot of a scenario.
    - ``values``: values of the options ``--set`` by their paths.
    - ``trust``: whether xacro files are expanded without restrictions.
    """
    # The compiler is imported only when it is used, because the runtime package does not contain
    # the compiler.
    from thorvaldc.compiler.pipeline import compile_file

    compilation = compile_file(
        file,
        library=library_folders(library),
        robot=robot,
        set=values,
        trust=trust,
    )
    show_errors(compilation.report, compilation.sources, file)
    return compilation


def select_bus(robot: Robot, spec: str) -> tuple[Bus, str]:
    """Returns the CAN bus of the robot and the CAN interface that the option ``--bus`` selects.

    For a robot with several CAN buses, ``--bus`` must name the bus and its interface, as in
    ``left=socketcan:can0``. For a robot with one CAN bus, ``--bus`` needs only the CAN interface.
    Raises ``DiagnosticError`` for a robot without a CAN bus. Raises ``typer.BadParameter`` if
    ``--bus`` does not name a CAN bus of the robot.
    """
    robot.require_bus()
    buses = {bus.name: bus for bus in robot.buses}
    name, equals, interface = spec.partition("=")
    if equals and name in buses:
        return buses[name], interface
    if len(buses) == 1:
        return robot.buses[0], spec
    example = (interface if equals else spec) or "socketcan:can0"
    problem = f"the robot has no bus {name}, but" if equals else "the robot has the buses"
    raise typer.BadParameter(
        f"{problem} {', '.join(buses)}; select one: {robot.buses[0].name}={example}",
        param_hint="'--bus'",
    )


def is_hardware(interface: str) -> bool:
    """Returns whether a CAN interface such as ``socketcan:can0`` can be connected to hardware."""
    return interface.partition(":")[0] not in SIMULATED


def warn_once() -> None:
    """Prints the warning about untested hardware, but only once for each user."""
    folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    mark = folder / "thorvaldc" / "untried-told"
    if mark.exists():
        return
    from thorvaldc.runtime.run_session import UNTESTED

    message(f"note: {UNTESTED}")
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.write_text("The note on untried hardware was shown.\n", encoding="utf-8")
    except OSError:
        return  # the next run shows it again


# -- simulated robots, which need the compiler and the simulation ---------------


def start_virtual_robot(
    robot: Robot, file: str, physics: str, faults: str, seed: int | None, report: Report
) -> SimulatedRobot:
    """Returns the robot of ``virtual_robot`` with the power switched on."""
    simulated = virtual_robot(robot, file, physics, faults, seed, report)
    simulated.power_on()
    return simulated


def virtual_robot(
    robot: Robot,
    file: str,
    physics: str,
    faults: str,
    seed: int | None,
    report: Report,
    *,
    delivered: bool = False,
    memory: Memory | None = None,
) -> SimulatedRobot:
    """Returns a simulated robot with a simulated device for each node of its CAN buses.

    - ``faults``: path of a file with faults to inject, or empty for a run without faults.

    Raises ``DiagnosticError`` if the fault file cannot be read or the robot cannot be simulated.
    """
    from thorvaldc.compiler.bus.injected_faults import read_faults
    from thorvaldc.simulation.bus.fault_injection import FaultInjector
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    script = read_faults(faults, robot, report) if faults else None
    if seed is None:
        seed = script.seed if script is not None else 0
    base = make_mujoco_base(robot, file, report) if physics == "mujoco" else None
    quirks = script.quirks if script is not None else ()
    simulated = SimulatedRobot(
        robot, seed=seed, base=base, delivered=delivered, nonvolatile=memory, quirks=quirks
    )
    if script is not None:
        FaultInjector(simulated, script, _show_injected_fault)
    return simulated


@contextmanager
def simulated_devices(
    robot: Robot, store: str, *, delivered: bool = False
) -> Iterator[SimulatedRobot]:
    """Yields a simulated robot that stands and has power, for the commissioning of its devices.

    ``store``: file with the non-volatile memory of the devices, which is written at the end.
    """
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, write_memory

    simulated = SimulatedRobot(robot, delivered=delivered, nonvolatile=read_store(store, robot))
    simulated.power_on()
    simulated.run(0.2)
    try:
        yield simulated
    finally:
        if store:
            write_memory(Path(store), simulated)


def make_mujoco_base(robot: Robot, file: str, report: Report) -> MujocoBase:
    """Loads a robot in MuJoCo and returns the base of the robot.

    ``file`` is the robot.yaml of the robot or the model.json of a build.
    """
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.simulation.physics.mujoco_base import MujocoBase
    from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

    # The mesh files of a build are next to model.json, in the same folder.
    files = Path(file).parent if is_model_file(file) else emit(robot, ["mjcf"], report)
    return MujocoBase(robot, MujocoScene(files))


def read_store(store: str, robot: Robot) -> Memory:
    """Returns the non-volatile memory of the simulated devices from the file of the option
    ``--store``.

    If the file has errors, prints them and raises ``typer.Exit``.
    """
    from thorvaldc.simulation.bus.simulated_robot import read_memory

    report = Report()
    memory = read_memory(Path(store), robot, report) if store else {}
    if memory is None:
        raise typer.Exit(show_report(report, {store: Path(store)}))
    return memory


def _show_injected_fault(time: float, fault: BusFault, begins: bool) -> None:
    kind = fault.kind.replace("_", " ")
    node = f" of {fault.node}" if fault.node is not None else ""
    message(f"{time:8.3f} s  simulated: {kind}{node}{'' if begins else ' ends'}")
