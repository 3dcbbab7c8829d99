"""Simulated robots on virtual CAN buses and in MuJoCo, in the process of a command.

This module needs the compiler and the simulation, which are not in the runtime package.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import typer

from thorvaldc.cli.diagnostic_output import message, show_report
from thorvaldc.compiler.bus.injected_faults import read_faults
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.model_json import is_model_file
from thorvaldc.model.scenario import BusFault
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.simulated_robot import Memory, SimulatedRobot, read_memory
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


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
    show_fault: Callable[[float, BusFault, bool], None] | None = None,
) -> SimulatedRobot:
    """Returns a simulated robot with a simulated device for each node of its CAN buses.

    - ``faults``: path of a file with faults to inject, or empty for a run without faults.
    - ``show_fault``: prints a fault when it begins and ends.

    Raises ``DiagnosticError`` if the fault file cannot be read or the robot cannot be simulated.
    """
    script = read_faults(faults, robot, report) if faults else None
    if seed is None:
        seed = script.seed if script is not None else 0
    base = make_mujoco_base(robot, file, report) if physics == "mujoco" else None
    quirks = script.quirks if script is not None else ()
    simulated = SimulatedRobot(
        robot, seed=seed, base=base, delivered=delivered, nonvolatile=memory, quirks=quirks
    )
    if script is not None:
        FaultInjector(simulated, script, show_fault or _show_injected_fault)
    return simulated


def make_mujoco_base(robot: Robot, file: str, report: Report) -> MujocoBase:
    """Loads a robot in MuJoCo and returns the base of the robot.

    ``file`` is the robot.yaml of the robot or the model.json of a build.
    """
    # The mesh files of a build are next to model.json, in the same folder.
    files = Path(file).parent if is_model_file(file) else emit(robot, ["mjcf"], report)
    return MujocoBase(robot, MujocoScene(files))


def read_store(store: str, robot: Robot) -> Memory:
    """Returns the non-volatile memory of the simulated devices from the file of the option
    ``--store``.

    If the file has errors, prints them and raises ``typer.Exit``.
    """
    report = Report()
    memory = read_memory(Path(store), robot, report) if store else {}
    if memory is None:
        raise typer.Exit(show_report(report, {store: Path(store)}))
    return memory


def describe_injected_fault(fault: BusFault, begins: bool) -> str:
    """Returns a description of an injected fault, such as ``power cut of fl_controller``.

    At the end of the injected fault, the description ends with ``ends``.
    """
    kind = fault.kind.replace("_", " ")
    node = f" of {fault.node}" if fault.node is not None else ""
    return f"{kind}{node}{'' if begins else ' ends'}"


def _show_injected_fault(time: float, fault: BusFault, begins: bool) -> None:
    message(f"{time:8.2f} s  simulated: {describe_injected_fault(fault, begins)}")
