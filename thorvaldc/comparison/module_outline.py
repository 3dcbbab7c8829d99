"""The modules of a robot with their types, places and parameters, for comparisons.

The model of a robot contains the names of its modules, but not their types and parameters, which
are only in the robot file.  The outline of a robot file has all of them.  The outline of a model,
such as that of a build, has the names and the places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.module_parameters import ModuleChoice
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.pipeline import library_folders_of
from thorvaldc.compiler.result import SourceFile
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.values.value_reader import INVALID
from thorvaldc.diagnostics import Report
from thorvaldc.model import Actuator, Battery, Robot, Sensor


@dataclass(frozen=True)
class Parameter:
    """The value of a parameter of a module in SI units, with its unit."""

    value: Any
    unit: str


@dataclass(frozen=True)
class ModuleOutline:
    """A module of a robot.

    Attributes
    ----------
    path : dotted path of the module, such as ``fl.drive``.
    type : module type, or an empty text if it is unknown.
    carrier : port or module that carries the module, such as ``frame.front_left``, or empty.
    pose : position (m) and quaternion of the module at the carrier.
    parameters : values of the parameters of the module, by name.
    shape : names of the links, joints and nodes of the module, without the name of the module.
        Modules of the same type and parameters have the same shape.
    document : the document of the module type, or ``None`` if it is unknown.
    """

    path: str
    type: str
    carrier: str
    pose: tuple[float, ...]
    parameters: dict[str, Parameter]
    shape: tuple[str, ...]
    document: Node | None = field(default=None, compare=False, repr=False)

    @property
    def place(self) -> str:
        """Text of the place, such as ``frame at (0, 0.285, 0.07) m``."""
        turned = self.pose[3:] not in ((), (1.0, 0.0, 0.0, 0.0))
        if not (any(self.pose[:3]) or turned):
            return self.carrier
        position = ", ".join(f"{value:.4g}" for value in self.pose[:3])
        return f"{self.carrier} at ({position}) m{', turned' if turned else ''}"


Outline = dict[str, ModuleOutline]
"""The modules of a robot, by path.  An assembly is followed by the modules that it contains."""


def outline_of_model(robot: Robot) -> Outline:
    """Returns the modules of a model, without parameters.

    The model has the types of all modules, but neither the assemblies nor the ports.  The place of
    a module of the robot file is its pose on a link.
    """
    joint_to = {joint.child: joint for joint in robot.joints}
    places: dict[str, tuple[str, tuple[float, ...]]] = {}
    shapes: dict[str, list[str]] = {}
    for link in robot.links:
        name = top_module(link.module)
        shapes.setdefault(name, []).append(f"link {without_module(link.name, name)}")
        joint = joint_to.get(link.name)
        if name not in places:
            pose = (*joint.pose.xyz, *joint.pose.quat) if joint is not None else ()
            places[name] = (joint.parent if joint is not None else "", pose)
    devices: tuple[Actuator | Sensor | Battery, ...] = robot.actuators
    for element in (*devices, *robot.sensors, *robot.batteries):
        name = top_module(element.module)
        kind = type(element).__name__.lower()
        shapes.setdefault(name, []).append(f"{kind} {without_module(element.name, name)}")
    for bus in robot.buses:
        for node in bus.nodes:
            name = top_module(node.module)
            text = f"{node.protocol} {without_module(node.name, name)}"
            shapes.setdefault(name, []).append(text)
    types = {module.name: module.type for module in robot.modules}
    names = dict.fromkeys([*shapes, *types])
    return {
        name: ModuleOutline(
            name,
            types.get(name, ""),
            *places.get(name, ("", ())),
            {},
            tuple(shapes.get(name, ())),
        )
        for name in names
        if name
    }


def outline_of_file(path: Path, library: Sequence[Path], model: Robot) -> Outline:
    """Returns the modules of a robot file with types, places and parameters.

    ``model`` is the robot of the file.  ``library``: additional folders with modules.
    """
    source, report = SourceFile(path, path.name, path.parent), Report()
    if source.document is None:
        return outline_of_model(model)
    document = source.check_shape(source.document)
    folders = library_folders_of(document, source.path.parent, library, report)
    root = Resolver(Library(folders), report).resolve(document)
    shapes = {name: module.shape for name, module in outline_of_model(model).items()}
    outline: Outline = {}
    for child in root.children.values():
        _add(child, outline, shapes)
    return outline


def top_module(path: str) -> str:
    """Returns the name of the module in the robot file that contains the module at ``path``."""
    return path.partition(".")[0]


def without_module(name: str, module: str) -> str:
    """Returns the name of an element without the name of its module."""
    return name[len(module) + 1 :] if name.startswith(f"{module}_") else name


def _add(instance: Instance, outline: Outline, shapes: dict[str, tuple[str, ...]]) -> None:
    if instance.type is None or instance.parent is None:
        return
    carrier, pose = _place(instance, instance.parent)
    outline[instance.path] = ModuleOutline(
        instance.path,
        instance.type.name,
        carrier,
        pose,
        _parameters(instance),
        shapes.get(instance.path, ()),
        instance.type.document,
    )
    for child in instance.children.values():
        _add(child, outline, shapes)


def _place(instance: Instance, parent: Instance) -> tuple[str, tuple[float, ...]]:
    mount = instance.entry.get("mount")
    if mount is None:
        return "", ()
    if not isinstance(mount.value, dict):
        return parent.scope.text(mount), ()
    carrier = parent.scope.text(mount.get("parent") or mount.get("port"))
    pose = parent.scope.pose(mount).clean()
    return carrier, (*pose.xyz, *pose.quat)


def _parameters(instance: Instance) -> dict[str, Parameter]:
    declarations = instance.type.section("params") if instance.type is not None else {}
    values = instance.scope.parameter_values()
    return {
        name: Parameter(_plain(value), _unit(declaration))
        for (name, declaration), value in zip(declarations.items(), values, strict=True)
    }


def _unit(declaration: Node) -> str:
    quantity = declaration.get("quantity")
    unit = QUANTITIES[str(quantity.value)].unit if quantity is not None else ""
    return "" if unit == "1" else unit


def _plain(value: Any) -> Any:
    """Returns the value of a parameter as text, number, truth value or list."""
    if isinstance(value, ModuleChoice):
        if not value.params:
            return value.module.name
        arguments = ", ".join(f"{name}: {_plain(value[name])}" for name in value.params)
        return f"{value.module.name} ({arguments})"
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Node):
        return value.plain()
    return None if value is INVALID else value
