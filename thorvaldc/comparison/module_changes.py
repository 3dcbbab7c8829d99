"""The modules of two robots: added, removed, renamed, moved, exchanged or given other values.

The model of a robot contains the names of its modules, but not their types and parameters, which
are only in the robot file.  The outline of a robot file has all of them.  The outline of a model,
such as that of a build, has the names and the places.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.comparison import robot_difference
from thorvaldc.comparison.robot_difference import ABSENT, ModuleChange, ValueChange
from thorvaldc.compiler.modules import module_parameters
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.values.document_section import read_pose
from thorvaldc.compiler.values.value_reader import INVALID
from thorvaldc.model import Actuator, Battery, Fleet, Robot, Sensor, robots_by_name


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


def outlines_of(compilation: Compilation) -> dict[str, Outline]:
    """Returns the modules of compiled robots with types, places and parameters.

    A robot has an empty name; the robots of a fleet have their names.  A robot that was read from a
    build, and not compiled, has no outline.
    """
    model = compilation.model
    outlines: dict[str, Outline] = {}
    for name, robot in robots_by_name(model).items() if model is not None else ():
        instance = compilation.instances.get(robot.span.file)
        if instance is not None:
            shapes = {path: module.shape for path, module in outline_of_model(robot).items()}
            outline = outlines[name if isinstance(model, Fleet) else ""] = {}
            for child in instance.children.values():
                _add(child, outline, shapes)
    return outlines


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
    pose = read_pose(mount, parent.scope).clean()
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
    if isinstance(value, module_parameters.ModuleChoice):
        if not value.params:
            return value.module.name
        arguments = ", ".join(f"{name}: {_plain(value[name])}" for name in value.params)
        return f"{value.module.name} ({arguments})"
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Node):
        return value.plain()
    return None if value is INVALID else value


def find_renames(before: Outline, after: Outline) -> dict[str, str]:
    """Returns the new names of renamed modules of the robot file, by their old names.

    A removed module and an added module are one renamed module if both have the same type and the
    same place, and no other module has.
    """
    removed = [module for name, module in before.items() if "." not in name and name not in after]
    added = [module for name, module in after.items() if "." not in name and name not in before]
    renames: dict[str, str] = {}
    while True:
        # A module that is mounted on a renamed module is recognised after its carrier.
        pairs = [(a, b) for a in removed for b in added if _same_place_and_type(a, b, renames)]
        unique = [
            (a, b)
            for a, b in pairs
            if a.path not in renames
            and [x for x, _ in pairs].count(a) == 1
            and [y for _, y in pairs].count(b) == 1
        ]
        if not unique:
            return renames
        renames.update({a.path: b.path for a, b in unique})


def renamed_document(document: Any, renames: Mapping[str, str], modules: Outline) -> Any:
    """Returns a document of a model in which modules have their new names.

    The names of links, joints, nodes and frames start with the name of their module.
    """
    if not renames:
        return document
    names = sorted({name for name in modules if "." not in name}, key=len, reverse=True)

    def rename(text: str) -> str:
        for name in names:
            if text == name or text.startswith((f"{name}_", f"{name}.")):
                return renames.get(name, name) + text[len(name) :]
        return text

    def visit(value: Any) -> Any:
        if isinstance(value, dict):
            return {rename(key): visit(item) for key, item in value.items()}
        if isinstance(value, list):
            return [visit(item) for item in value]
        return rename(value) if isinstance(value, str) else value

    return visit(document)


def changes_of(
    before: Outline, after: Outline, renames: Mapping[str, str]
) -> Iterator[ModuleChange]:
    """Yields the changes of modules, those of the robot before the change first.

    A change inside of an assembly is not listed if the assembly itself has another type or other
    parameters, which cause it.
    """
    covered: set[str] = set()
    for old_path, old in before.items():
        path = _renamed(old_path, renames)
        new = after.get(path)
        if _is_covered(path, covered):
            continue
        if new is None:
            covered.add(path)
            yield ModuleChange(
                (robot_difference.REMOVED,), path, old_path, old.type, "", old.place, ""
            )
            continue
        change = _change(old, new, renames)
        if change is not None:
            if robot_difference.EXCHANGED in change.kinds or change.parameters:
                covered.add(path)
            yield change
    known = {_renamed(path, renames) for path in before}
    for path, new in after.items():
        if path not in known and not _is_covered(path, covered):
            covered.add(path)
            yield ModuleChange((robot_difference.ADDED,), path, "", "", new.type, "", new.place)


def _change(
    old: ModuleOutline, new: ModuleOutline, renames: Mapping[str, str]
) -> ModuleChange | None:
    """Returns the change of a module that both robots have, or ``None`` if there is none."""
    kinds = []
    if old.path != new.path and "." not in old.path:
        kinds.append(robot_difference.RENAMED)
    if old.type and new.type and old.type != new.type:
        kinds.append(robot_difference.EXCHANGED)
    if not _same_place(old, new, renames):
        kinds.append(robot_difference.MOVED)
    parameters: list[ValueChange] = []
    if old.type and old.type == new.type:
        for name in dict.fromkeys([*old.parameters, *new.parameters]):
            a, b = old.parameters.get(name), new.parameters.get(name)
            if a != b:
                unit = next(p.unit for p in (b, a) if p is not None)
                x, y = (ABSENT if p is None else p.value for p in (a, b))
                parameters.append(ValueChange("modules", (new.path,), name, x, y, unit))
    if parameters or (not old.type and old.shape != new.shape):
        kinds.append(robot_difference.CHANGED)
    if not kinds:
        return None
    return ModuleChange(
        tuple(kinds),
        new.path,
        old.path,
        old.type,
        new.type,
        old.place,
        new.place,
        tuple(parameters),
    )


def _same_place_and_type(a: ModuleOutline, b: ModuleOutline, renames: Mapping[str, str]) -> bool:
    same_type = a.type == b.type if a.type and b.type else a.shape == b.shape
    return same_type and _same_place(a, b, renames)


def _same_place(a: ModuleOutline, b: ModuleOutline, renames: Mapping[str, str]) -> bool:
    return _renamed(a.carrier, renames) == b.carrier and all(
        abs(x - y) < 1e-9 for x, y in zip(_pose(a), _pose(b), strict=True)
    )


def _pose(module: ModuleOutline) -> tuple[float, ...]:
    return module.pose or (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def _renamed(path: str, renames: Mapping[str, str]) -> str:
    """Returns the new path of a module, port or link."""
    for separator in (".", "_"):
        first, found_separator, rest = path.partition(separator)
        if first in renames:
            return renames[first] + found_separator + rest
    return path


def _is_covered(path: str, covered: set[str]) -> bool:
    parts = path.split(".")
    return any(".".join(parts[:n]) in covered for n in range(1, len(parts)))


# Texts for readers, without an effect on the robot.
_TEXTS = ("description", "source")


def type_changes(before: Outline, after: Outline) -> Iterator[ValueChange]:
    """Yields the changes in the documents of module types with the same name."""
    old, new = _documents(before), _documents(after)
    for name, document in old.items():
        if name not in new or new[name] is document:
            continue  # One file was read for both robots.
        for leaf in robot_difference.leaf_differences(
            _with_indices(document), _with_indices(new[name])
        ):
            if leaf.path[-1] not in _TEXTS:
                yield ValueChange("module types", (name,), leaf.text_path, leaf.before, leaf.after)


def _documents(outline: Outline) -> dict[str, Node]:
    return {
        module.type: module.document for module in outline.values() if module.document is not None
    }


def _with_indices(node: Node) -> Any:
    """Returns a document with lists as mappings of their indices, so that items are compared."""
    if isinstance(node.value, dict):
        return {key: _with_indices(item) for key, item in node.value.items()}
    if isinstance(node.value, tuple) and any(isinstance(i.value, dict) for i in node.value):
        return {str(index): _with_indices(item) for index, item in enumerate(node.value)}
    return node.plain()
