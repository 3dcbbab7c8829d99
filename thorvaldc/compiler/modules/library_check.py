"""Checks module types by themselves, with the defaults of their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.bus.assemble_buses import BusSpec, Device, build_buses
from thorvaldc.compiler.library import Library, ModuleType
from thorvaldc.compiler.modules.hardware import hardware_of
from thorvaldc.compiler.modules.instance import Instance
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.modules.scope import Scope, hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span


@dataclass
class LibraryCheck:
    """The module types of a library folder and their diagnostics.

    ``sources`` maps file names in ``report`` to files.
    """

    names: list[str] = field(default_factory=list)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)


def check_library(folder: Path | None) -> LibraryCheck:
    """Checks every module type of a folder; ``None``: of the built-in library."""
    library = Library([(folder, str(folder))] if folder is not None else [])
    check = LibraryCheck(library.names_in(folder) if folder is not None else library.names())
    for name in check.names:
        check_module(name, library, check.report)
    check.sources = library.files
    return check


def check_module(name: str, library: Library, report: Report) -> None:
    """Load a type, expand it and work out its hardware; every fault goes to the report.

    A type with a parameter that has no default is expanded only as far as its
    document goes: what it is made of depends on a value that nobody has given.
    """
    module = library.load(name, Node(name, Span(name)), report)
    if module is None:
        return
    place = module.document.span
    asked = Node(name, place)
    for param in module.section("params").values():
        if param.get("default") is None:
            return
    entry = Node({"type": asked}, place)
    robot = Instance("", None, Scope(None, {}, library, report, None), entry, place, None)
    resolver = Resolver(library, report)
    own = name.rpartition("/")[2]
    resolver.expand(robot, own, entry)
    part = robot.children.get(own)
    if part is not None and module.is_assembly:
        _check_offers(part, module, resolver, report)
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        hardware_of(leaf.type, leaf.scope, report)
        can = leaf.type.document.get("can")
        if can is not None:
            channels = leaf.type.document.get("channels")
            device = Device(leaf.path, own, can, channels, (), None, leaf.scope, place)
            # Alone it drives no motor, which is a warning for a robot and nothing here.
            found = Report()
            build_buses([device], [BusSpec("bus", 500_000, place)], [], 0.02, found)
            for fault in found.errors:
                report.put(fault)


def _check_offers(
    assembly: Instance, module: ModuleType, resolver: Resolver, report: Report
) -> None:
    """That what an assembly offers to the outside is there."""
    for section, find in (
        ("ports", resolver.references.find_port),
        ("motors", resolver.references.find_motor),
    ):
        for node in module.section(section).values():
            # What its defaults leave out may be there with other parameters.
            if str(node.value).partition(".")[0] not in assembly.left_out:
                find(assembly, str(node.value), node)
    taker = module.document.get("can")
    known = [*assembly.children, *assembly.left_out, *assembly.failed]
    if taker is not None and taker.value not in known:
        report.add(
            "module-unknown",
            f"there is no module `{taker.value}` in `{assembly.path}`",
            taker.span,
            hint=hint_of_known(str(taker.value), list(assembly.children)),
        )
