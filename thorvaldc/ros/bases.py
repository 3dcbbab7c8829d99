"""Opens the base that the parameter ``base`` names."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Mapping
from pathlib import Path

from thorvaldc.can.frame import CanInterface
from thorvaldc.can.open_interface import lock_buses, open_interfaces
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.model_json import load_model
from thorvaldc.model.settings import NAME_PREFIX
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot


class NodeError(Exception):
    """The node cannot start or drive; the message is one line for the operator."""


def open_robot(
    robot: Robot, model_file: Path, base: str, bus: str, factor: float, world: str = ""
) -> DrivenRobot:
    """Opens a robot on the base ``base``; ``world`` is the parameter of the node.

    Raises ``NodeError`` if the base needs a package that is not installed, and ``DiagnosticError``
    if the base cannot be opened.
    """
    gc.collect()
    gc.freeze()  # a pause of the garbage collector delays the control loop
    if base == "bus":
        return _on_buses(robot, bus)
    try:
        return _simulated(robot, model_file, base, factor, world)
    except ModuleNotFoundError as error:
        raise NodeError(
            f"base `{base}` needs the Python package {error.name}: install the whole package"
            " thorvaldc in place of thorvaldc-runtime"
        ) from None


def _on_buses(robot: Robot, bus: str) -> DrivenRobot:
    with contextlib.ExitStack() as stack:
        lock_buses(bus, robot, stack)
        driven = _over_buses(robot, open_interfaces(bus, robot))
        driven.resources.enter_context(stack.pop_all())
        return driven


def _over_buses(
    robot: Robot, interfaces: Mapping[str, CanInterface], factor: float | None = None
) -> DrivenRobot:
    """Returns a robot on CAN buses.

    ``factor``: speed of buses that are simulated in this process relative to the real time, or
    ``None`` for buses that run by themselves.
    """
    try:
        base = CanBase(robot, interfaces, threaded=factor is None)
    except DiagnosticError:
        for interface in interfaces.values():
            interface.close()
        raise
    return DrivenRobot(robot, base, interfaces[robot.buses[0].name], factor=factor)


def _simulated(robot: Robot, model_file: Path, base: str, factor: float, world: str) -> DrivenRobot:
    # Only a computer with the whole package has these rooms.
    if base == "virtual":
        from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

        simulated = SimulatedRobot(robot)
        simulated.power_on()
        interfaces = {b.name: simulated.interface(b.name, fifo=True) for b in robot.buses}
        return _over_buses(robot, interfaces, factor)
    if base == "ideal":
        from thorvaldc.simulation.physics.sim_base import SimBase

        return DrivenRobot(robot, SimBase(robot), factor=factor)
    from thorvaldc.simulation.physics.mujoco_base import MujocoBase
    from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

    scene = MujocoScene(scene_files(robot, model_file, world))
    return DrivenRobot(robot, MujocoBase(robot, scene), factor=factor)


def scene_files(robot: Robot, model_file: Path, world: str) -> Path | Mapping[str, bytes]:
    """Returns the folder with the MJCF files of ``world`` or of the build, or makes them from the
    model."""
    from thorvaldc.simulation.physics.mujoco_scene import SCENE

    if world:
        return Path(world)
    if (model_file.parent / SCENE).is_file() and _has_names_of(robot, model_file):
        return model_file.parent
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report

    report = Report()
    files = emit(robot, ["mjcf"], report)
    if report.has_errors:
        raise DiagnosticError("simulation-scene", f"{robot.name} cannot be simulated in MuJoCo")
    return files


def _has_names_of(robot: Robot, model_file: Path) -> bool:
    """Returns whether the files of a build have the names of the robot, whose name space may be
    that of its node."""
    built = load_model(model_file)
    return isinstance(built, Robot) and built.namespace == robot.namespace


def description_text(robot: Robot, model_file: Path) -> str:
    """Returns the URDF of the robot, from the files of the build or made from the model.

    Raises ``NodeError`` if there is no file and the compiler is not installed.
    """
    for folder in (model_file.parent, model_file.parent.parent):
        path = folder / "urdf" / "robot.urdf"
        if path.is_file():
            text = path.read_text(encoding="utf-8")
            if NAME_PREFIX in text or _has_names_of(robot, model_file):
                return text.replace(NAME_PREFIX, robot.prefix)
    try:
        from thorvaldc.backends.urdf import urdf_text
    except ModuleNotFoundError:
        raise NodeError(
            f"publish_description: there is no file urdf/robot.urdf of this robot beside"
            f" {model_file}"
        ) from None
    return urdf_text(robot)
