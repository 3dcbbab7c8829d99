"""Checks the module types of a library with the default values of the parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.bus.assemble_buses import BusSpec, Device, build_buses
from thorvaldc.compiler.hardware.hardware_reader import hardware_of
from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.result.acceptances import accept_warnings, read_acceptances, report_unused
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span

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


def check_library(folder: Path | None) -> LibraryCheck:
    """Checks every module type of a library folder.

    ``folder``: path of the library folder, or ``None`` for the built-in library.
    """
    library = Library([(folder, str(folder))] if folder is not None else [])
    check = LibraryCheck(library.names_in(folder) if folder is not None else library.names())
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
    if module is None:
        return
    if any(param.get("default") is None for param in module.section("params").values()):
        return
    span = module.document.span
    entry = Node({"type": Node(name, span)}, span)
    robot = Instance("", None, Scope(None, {}, library, report, None), entry, span, None)
    resolver = Resolver(library, report)
    part_name = name.rpartition("/")[2]
    resolver.expand(robot, part_name, entry)
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
            device = Device(leaf.path, part_name, can, channels, (), None, leaf.scope, span)
            # Warnings about a CAN device are dropped, because without a robot no motors are
            # connected to the CAN device.
            bus_report = Report()
            build_buses([device], [BusSpec("bus", BITRATE, span)], [], CYCLE, bus_report)
            for diagnostic in bus_report.errors:
                report.put(diagnostic)


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
