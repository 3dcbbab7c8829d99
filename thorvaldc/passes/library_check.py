"""Checks module types by themselves, with the defaults of their parameters."""

from __future__ import annotations

from thorvaldc.diagnostics import Report, Span
from thorvaldc.library import Library
from thorvaldc.passes.bus import BusSpec, Device, build_buses
from thorvaldc.passes.hardware import hardware_of
from thorvaldc.passes.resolve import Instance, Resolver
from thorvaldc.passes.scope import Scope
from thorvaldc.source.node import Node


def check_module(name: str, library: Library, report: Report) -> None:
    """Load a type, expand it and work out its hardware; every fault goes to the report.

    A type with a parameter that has no default is expanded only as far as its
    document goes: what it is made of depends on a value that nobody has given.
    """
    place = Span(name)
    asked = Node(name, place)
    module = library.load(name, asked, report)
    if module is None:
        return
    for param in module.section("params").values():
        if param.get("default") is None:
            return
    entry = Node({"type": asked}, place)
    robot = Instance("", None, Scope(None, {}, library, report, None), entry, place, None)
    resolver = Resolver(library, report)
    resolver.expand(robot, "module", entry)
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        hardware_of(leaf.type, leaf.scope, report)
        can = leaf.type.document.get("can")
        if can is not None:
            channels = leaf.type.document.get("channels")
            device = Device(leaf.path, "module", can, channels, (), None, leaf.scope, place)
            # Alone it drives no motor, which is a warning for a robot and nothing here.
            found = Report()
            build_buses([device], [BusSpec("bus", 500_000, place)], [], 0.02, found)
            for fault in found.errors:
                report.put(fault)
