"""The library of modules for its readers: checks a module type, and describes it.

A module type is checked and described with the default values of its parameters: its mass, its
ports, and what fits where.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from thorvaldc.compiler.bus.assemble_buses import build_buses
from thorvaldc.compiler.bus.device_sections import BusSpec, Device
from thorvaldc.compiler.hardware.hardware_reader import Hardware, hardware_of
from thorvaldc.compiler.hardware.robot_parts import RobotParts, masses_by_source, modules_of
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.mounting import mount_kinds
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.result import accept_warnings, read_acceptances, report_unused
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.values.document_section import read_pose
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import SourcedMass, Vec3
from thorvaldc.model.spatial import clean, clean3
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.sums import float_sum

# Bit rate (bit/s) of the bus, and control cycle (s), for the check of a single device.
BITRATE = 500_000
CYCLE = 0.02


@dataclass
class LibraryCheck:
    """Result of checking all module types of a library folder.

    Attributes
    ----------
    names : names of the module types in the folder.
    report : diagnostics about the module types.
    sources : path of the module file for each file name in ``report``.
    """

    names: list[str] = field(default_factory=list)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)


def check_library(checked: Path | Library | None) -> LibraryCheck:
    """Checks every module type of a library folder, or of all folders of a robot's library.

    ``None`` is the built-in library, which is not checked with those of a robot.
    """
    library = (
        checked
        if isinstance(checked, Library)
        else Library([] if checked is None else [(checked, str(checked))])
    )
    folders = [folder for folder, name in library.folders if name != BUILTIN_LIBRARY]
    names = {name for folder in folders for name in library.names_in(folder)}
    check = LibraryCheck(sorted(names) if checked is not None else library.names())
    for name in check.names:
        check_module(name, library, check.report)
    check.sources = library.files
    acceptances = [
        entry
        for module in library.user_modules()
        for entry in read_acceptances(module.document, check.report, is_module=True)
    ]
    accept_warnings(check.report, acceptances)
    if not check.report.has_errors:
        report_unused(acceptances, check.report)
    return check


def check_module(name: str, library: Library, report: Report) -> None:
    """Checks a module type and reports every error.

    The function computes the links, joints and motors of the module type with the default values of
    the parameters.  For a module type with a parameter without a default value, only the schema
    check is done.
    """
    module = library.load(name, Node(name, Span(name)), report)
    if module is None or not _has_values(module):
        return
    part_name = name.rpartition("/")[2]
    robot, resolver = _expanded(module, part_name, library, report)
    part = robot.children.get(part_name)
    if part is not None and module.is_assembly:
        _check_assembly_references(part, module, resolver, report)
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        hardware_of(leaf.type, leaf.scope, report)
        can = leaf.type.document.get("can")
        if can is not None:
            channels = leaf.type.document.get("channels")
            device = Device(leaf.path, part_name, can, channels, (), None, leaf.scope, leaf.span)
            # Warnings about a CAN device are dropped, because without a robot no motors are
            # connected to the CAN device.
            bus_report = Report()
            build_buses([device], [BusSpec("bus", BITRATE, leaf.span)], [], CYCLE, bus_report)
            for diagnostic in bus_report.errors:
                if diagnostic.code.name != "can-bitrate":  # a robot may state a slower bus
                    report.put(diagnostic)


def _has_values(module: ModuleType) -> bool:
    """Returns whether all parameters of a module type have default values."""
    return all(p.get("default") is not None for p in module.section("params").values())


def _expanded(
    module: ModuleType, name: str, library: Library, report: Report
) -> tuple[Instance, Resolver]:
    """Returns a robot with one module of a type, called ``name``, and its resolver."""
    span = module.document.span
    entry = Node({"type": Node(module.name, span), "params": Node({}, span)}, span)
    robot = Instance("", None, Scope(None, {}, library, report, None), entry, span, None)
    resolver = Resolver(library, report)
    resolver.expand(robot, name, entry)
    return robot, resolver


def _check_assembly_references(
    assembly: Instance, module: ModuleType, resolver: Resolver, report: Report
) -> None:
    """Checks that the sections `ports`, `motors` and `can` of an assembly name existing modules of
    the assembly.
    """
    references = resolver.references
    for section, find in (("ports", references.find_port), ("motors", references.find_motor)):
        for node in module.section(section).values():
            # A module of an assembly that is left out with the default parameter values may exist
            # with other parameter values.
            if str(node.value).partition(".")[0] not in assembly.left_out:
                find(assembly, str(node.value), node)
    controller = module.document.get("can")
    part_names = [*assembly.children, *assembly.left_out, *assembly.failed]
    if controller is not None and controller.value not in part_names:
        report.add(
            "module-unknown",
            f"there is no module `{controller.value}` in `{assembly.path}`",
            controller.span,
            hint=hint_of_known(str(controller.value), list(assembly.children)),
        )


# -- description -------------------------------------------------------------------------


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
    masses: tuple[SourcedMass, ...] | None
    mounts_on: tuple[str, ...]
    carriers: tuple[str, ...]
    ports: tuple[Port, ...]
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
        module.description,
        tree.masses(),
        tree.mounts_on,
        tuple(o.name for o in others if set(tree.mounts_on) & set(o.port_kinds.values())),
        tuple(ports),
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
        self._hardware: dict[str, Hardware] | None = None
        self._part: Instance | None = None
        self._leaves: list[Instance] = []
        if _has_values(module):
            self._robot, self._resolver = _expanded(module, "module", library, self._report)
            self._part = self._robot.children.get("module")
            self._leaves = list(self._robot.leaves())

    @property
    def mounts_on(self) -> tuple[str, ...]:
        """Kinds of ports that the first leaf module fits."""
        module: ModuleType | None = self._module
        if self._module.is_assembly:
            module = next((leaf.type for leaf in self._leaves if leaf.type is not None), None)
        return tuple(mount_kinds(module))

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
        leaves = [
            each
            for each in self._leaves
            if hardware[each.path].links and (each is self._part or each.is_mechanical)
        ]
        parts = RobotParts.of_modules(leaves, hardware, leaf.span)
        pose = JointTree(parts.links, parts.joints).pose
        port = leaf.type.section("ports")[port_name]
        links = hardware[leaf.path].links
        link = leaf.scope.text(port.get("link")) or (links[0].name if links else "")
        place = pose.get(f"{name_prefix(leaf.path)}_{link}")
        if place is None:
            return None
        position = place.apply(read_pose(port, leaf.scope).xyz)
        return clean3(position) if all(map(math.isfinite, position)) else None

    def masses(self) -> tuple[SourcedMass, ...] | None:
        """Returns the mass by source at the default values, or ``None`` if it is unknown."""
        hardware = self._hardware_by_path()
        if hardware is None:
            return None
        if not self._module.is_assembly and self._part is not None:
            return masses_by_source(hardware[self._part.path].masses)
        modules = modules_of(self._robot, hardware)
        return masses_by_source(part for module in modules for part in module.masses)


# -- output of the command ``thorvaldc modules`` -----------------------------------------

Row = tuple[str, str]


def description_rows(module: ModuleType, description: ModuleDescription) -> list[Row]:
    """Returns what a module type is, fits and consists of, as table rows."""
    document = module.document.plain()
    rows = [("what", description.description), ("category", description.category)]
    if description.mounts_on:
        rows.append(("mounts on", ", ".join(description.mounts_on)))
        rows.append(("carried by", ", ".join(description.carriers) or "no type of the library"))
    parts = ("links", "joints", "motors", "channels", "modules")
    rows += [(key, ", ".join(document[key])) for key in parts if document.get(key)]
    mass = description.mass
    rows.append(("mass", "depends on params without default" if mass is None else f"{mass:.4g} kg"))
    return rows


def mass_rows(description: ModuleDescription) -> list[Row]:
    """Returns the mass by source of a module type as table rows."""
    return [
        (f"{part.mass:.4g} kg", part.source or "no source stated")
        for part in description.masses or ()
    ]


def port_rows(description: ModuleDescription) -> list[Row]:
    """Returns a table row for each port: kind, position, and the types that it takes.

    Types are listed for the first port of each kind.
    """
    rows: list[Row] = []
    listed: set[str] = set()
    for port in description.ports:
        text = port.kind
        if port.position is not None:
            text += " at ({:g}, {:g}, {:g}) m".format(*port.position)
        if port.kind not in listed:
            listed.add(port.kind)
            text += f": takes {', '.join(port.takes) or 'no type of the library'}"
        rows.append((port.name, text))
    return rows


def description_document(description: ModuleDescription) -> dict[str, Any]:
    """Returns a description as JSON values: lengths in m, masses in kg."""
    facts = asdict(description)
    del facts["type"], facts["description"]
    return {"category": description.category, "mass": description.mass, **facts}


def parameter_rows(module: ModuleType) -> Iterable[Row]:
    """Yields a table row for each parameter of a module type.

    The second column contains the kind, default, range, description and source of the parameter.
    """
    for name, declaration in module.document.plain().get("params", {}).items():
        yield name, _parameter_text(declaration)


def _parameter_text(declaration: dict[str, Any]) -> str:
    """Describes a parameter of a module type in one line of text."""
    kind = str(declaration.get("quantity") or declaration.get("type") or "number")
    unit = QUANTITIES[kind].unit if kind in QUANTITIES else "1"
    facts = [kind.replace("_", " ") + (f" in {unit}" if unit != "1" else "")]
    if "default" in declaration:
        facts.append(f"default {_yaml_text(declaration['default'])}")
    else:
        facts.append("required")
    for key, label in (("minimum", "from"), ("maximum", "to"), ("choices", "one of")):
        if key in declaration:
            facts.append(f"{label} {_yaml_text(declaration[key])}")
    text = f"{', '.join(facts)}. {declaration.get('description', '')}"
    return text + (f" [{declaration['source']}]" if "source" in declaration else "")


def _yaml_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
