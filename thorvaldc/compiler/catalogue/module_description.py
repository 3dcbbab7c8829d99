"""Describes a module type with default parameters: its mass, its ports, and what fits where."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from thorvaldc.compiler.hardware.hardware_parts import Hardware
from thorvaldc.compiler.hardware.hardware_reader import hardware_of
from thorvaldc.compiler.hardware.robot_parts import RobotParts, mass_by_source, modules_of
from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Link, SourcedMass, Vec3
from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.spatial import clean, clean3
from thorvaldc.model.statics.joint_tree import JointTree


@dataclass(frozen=True, slots=True)
class Port:
    """A port of a module type.

    Attributes
    ----------
    name, kind : as in the module file.
    position : position (m) relative to the first link of the module with all joints at 0, or
        ``None`` if it depends on a parameter without a default value.
    takes : module types that can be mounted on the port.
    """

    name: str
    kind: str
    position: Vec3 | None
    takes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ModuleDescription:
    """A module type with the default values of its parameters.

    Attributes
    ----------
    mounts_on : kinds of ports that the module can be mounted on.  Empty for a module that is the
        root of a robot.
    carriers : module types with such a port.
    masses : mass by source, or ``None`` if it depends on a parameter without a default value.
    units : SI unit of each parameter with a quantity, by its name.
    """

    type: str
    category: str
    description: str
    mounts_on: tuple[str, ...]
    carriers: tuple[str, ...]
    ports: tuple[Port, ...]
    masses: tuple[SourcedMass, ...] | None
    units: dict[str, str]

    @property
    def mass(self) -> float | None:
        """Mass of the module in kg, or ``None`` if it is unknown."""
        if self.masses is None:
            return None
        return clean(float_sum(part.mass for part in self.masses))


def describe_module(module: ModuleType, library: Library) -> ModuleDescription:
    """Returns the description of a module type.

    ``library`` contains the module types that can be mounted on it and that it can be mounted on.
    Module types with errors are left out.
    """
    tree = _Expanded(module, library)
    others = [_Expanded(other, library) for other in _module_types(library)]
    ports = [
        Port(name, kind, tree.position(name), tuple(o.name for o in others if kind in o.mounts_on))
        for name, kind in tree.port_kinds.items()
    ]
    return ModuleDescription(
        module.name,
        module.category,
        " ".join(str(module.document.plain().get("description", "")).split()),
        tree.mounts_on,
        tuple(o.name for o in others if set(tree.mounts_on) & set(o.port_kinds.values())),
        tuple(ports),
        tree.masses(),
        {
            name: QUANTITIES[declaration["quantity"]].unit
            for name, declaration in module.document.plain().get("params", {}).items()
            if declaration.get("quantity") in QUANTITIES
        },
    )


def _module_types(library: Library) -> Iterator[ModuleType]:
    for name in library.names():
        module = library.load(name, Node(name, Span(name)), Report())
        if module is not None:
            yield module


class _Expanded:
    """A module type that is expanded to its leaf modules with the default parameter values."""

    def __init__(self, module: ModuleType, library: Library) -> None:
        self.name = module.name
        self._module = module
        self._report = Report()
        span = module.document.span
        entry = Node({"type": Node(module.name, span)}, span)
        scope = Scope(None, {}, library, self._report, None)
        self._robot = Instance("", None, scope, entry, span, None)
        self._resolver = Resolver(library, self._report)
        self._hardware: dict[str, Hardware] | None = None
        self._known = all(
            declaration.get("default") is not None
            for declaration in module.section("params").values()
        )
        if self._known:
            self._resolver.expand(self._robot, "module", entry)
        self._part = self._robot.children.get("module")
        self._leaves = list(self._robot.leaves())

    @property
    def mounts_on(self) -> tuple[str, ...]:
        """Kinds of ports that the first leaf module fits."""
        module = self._module
        if module.is_assembly:
            first = next((leaf.type for leaf in self._leaves if leaf.type is not None), None)
            if first is None:
                return ()
            module = first
        mount = module.document.get("mount")
        kinds = mount.get("kinds") if mount is not None else None
        return tuple(str(kind) for kind in kinds.plain()) if kinds is not None else ()

    @property
    def port_kinds(self) -> dict[str, str]:
        """Kind of each port by its name."""
        kinds = {}
        for name, port in self._module.section("ports").items():
            leaf_port = self._leaf_port(name)
            node = (
                leaf_port[0].type.section("ports").get(leaf_port[1])
                if leaf_port and leaf_port[0].type
                else port
            )
            kind = node.get("kind") if node is not None else None
            if kind is not None:
                kinds[name] = str(kind.value)
        return kinds

    def _leaf_port(self, name: str) -> tuple[Instance, str] | None:
        """Returns the leaf module with a port of the module type, and its name there."""
        if self._part is None:
            return None
        if not self._module.is_assembly:
            return self._part, name
        port = self._module.section("ports")[name]
        if str(port.value).partition(".")[0] in self._part.left_out:
            return None
        return self._resolver.references.find_port(self._part, str(port.value), port)

    def _hardware_by_path(self) -> dict[str, Hardware] | None:
        """Returns the hardware of the leaf modules, or ``None`` if a module has errors."""
        if self._hardware is None and self._part is not None:
            hardware = {}
            for leaf in self._leaves:
                built = hardware_of(leaf.type, leaf.scope, self._report) if leaf.type else None
                if built is not None:
                    hardware[leaf.path] = built
            if len(hardware) == len(self._leaves) and not self._report.has_errors:
                self._hardware = hardware
        return self._hardware

    def position(self, name: str) -> Vec3 | None:
        """Returns the position (m) of a port relative to the first link, see ``Port``."""
        hardware, leaf_port = self._hardware_by_path(), self._leaf_port(name)
        if hardware is None or leaf_port is None:
            return None
        leaf, port_name = leaf_port
        if leaf.type is None:
            return None
        parts = RobotParts([Link("base_link", "", None, (), (), leaf.span)])
        for each in self._leaves:
            if hardware[each.path].links and (each is self._part or each.is_mechanical):
                parts.add(each, hardware)
        pose = JointTree(parts.links, parts.joints).pose
        port = leaf.type.section("ports")[port_name]
        links = hardware[leaf.path].links
        link = leaf.scope.text(port.get("link")) or (links[0].name if links else "")
        place = pose.get(f"{name_prefix(leaf.path)}_{link}")
        if place is None:
            return None
        position = place.apply(leaf.scope.pose(port).xyz)
        return clean3(position) if all(map(math.isfinite, position)) else None

    def masses(self) -> tuple[SourcedMass, ...] | None:
        """Returns the mass by source at the default values, or ``None`` if it is unknown."""
        hardware = self._hardware_by_path()
        if hardware is None:
            return None
        if not self._module.is_assembly and self._part is not None:
            return mass_by_source(hardware[self._part.path])
        masses: dict[str, float] = {}
        for module in modules_of(self._robot, hardware):
            for part in module.masses:
                masses[part.source] = masses.get(part.source, 0.0) + part.mass
        return tuple(SourcedMass(clean(mass), source) for source, mass in masses.items())
