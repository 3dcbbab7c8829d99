"""Compares the devices that answer on the buses of a computer with the robot file.

An installation on the computer of another robot would drive that robot with wrong numbers.
``thorvaldc can flash`` refuses devices by the same rule, ``planner.is_stranger``.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import NamedTuple

from thorvaldc.can.open_interface import bus_lock, open_interface
from thorvaldc.commissioning.bus_configuration import NodeConfiguration, configuration_of
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.commissioning.planner import is_stranger
from thorvaldc.commissioning.scan_result import (
    OK,
    WRONG_IDENTITY,
    ScanEntry,
    ScanResult,
    identity_text,
    numbers_text,
)
from thorvaldc.commissioning.scanner import scan_bus
from thorvaldc.diagnostics import CODES, Diagnostic, DiagnosticError, Report, Span
from thorvaldc.model import Bus, Robot
from thorvaldc.model.bus_identity import Heard, wrong_buses

_UNCHANGED = "nothing was installed; "


class Answers(NamedTuple):
    """What the devices on the buses of a robot have answered.

    - ``report``: an error for each device that is not the one of the robot file.
    - ``notes``: a line for each bus: how many devices are as in the file, or why nobody knows.
    """

    report: Report
    notes: list[str]


def compare_devices(robot: Robot) -> Answers:
    """Asks the devices at the CAN interfaces of a robot's computer for their identities.

    A bus without an answer is no error: the devices may have no power.  A bus is not asked if its
    interface does not exist, or while another program uses it; the base driver compares the devices
    at its start.
    """
    report, notes = Report(), []
    heard: dict[str, Heard] = {}
    adapters = robot.computer.adapters if robot.computer is not None else ()
    buses = {bus.name: bus for bus in robot.buses}
    for adapter in adapters:
        bus = buses[adapter.bus]
        try:
            with ExitStack() as stack:
                stack.enter_context(bus_lock(adapter.spec))
                interface = open_interface(adapter.spec, bus)
                stack.callback(interface.close)
                master = BusMaster(interface, bus)
                scan = scan_bus(robot, master)
        except DiagnosticError as error:
            notes.append(
                f"the devices on the bus `{bus.name}` were not compared with the file: {error}"
            )
            continue
        serials = [entry.identity.serial for entry in scan.entries if entry.identity is not None]
        heard[bus.name] = Heard(master.received, serials)
        notes.append(_note(bus, scan))
        for diagnostic in _contradictions(robot, bus, scan):
            report.put(diagnostic)
    if exchange := wrong_buses(robot.buses, heard):
        report = Report()  # each of their devices is a stranger on the other bus
        hint = "state in `computer` which CAN adapter each bus has, or exchange their plugs"
        report.put(_error(exchange, robot.span, hint))
    return Answers(report, notes)


def _note(bus: Bus, scan: ScanResult) -> str:
    answering = sum(1 for entry in scan.entries if entry.node and entry.verdict == OK)
    if not answering and all(entry.device is None for entry in scan.entries):
        return f"nothing answered on the bus `{bus.name}`: its devices may have no power"
    verb = "are" if scan.active else "send"
    return f"{answering} of {len(bus.nodes)} devices on the bus `{bus.name}` {verb} as in the file"


def _contradictions(robot: Robot, bus: Bus, scan: ScanResult) -> list[Diagnostic]:
    configuration = configuration_of(robot, bus)
    spans = {node.name: node.span for node in bus.nodes}
    by_id = {node.id: node for node in configuration.nodes if node.canopen}
    diagnostics = []
    for entry in scan.entries:
        if entry.node:
            node = configuration.node(entry.node)
            is_other_type = entry.device is not None and not entry.device.has_type_of(node)
            if entry.verdict == WRONG_IDENTITY and is_other_type:
                text = f"`{node.name}` on the bus `{bus.name}`: {entry.detail}"
                diagnostics.append(_error(text, spans[node.name], "look at what is plugged in"))
        elif is_stranger(configuration, scan, entry):
            stated = by_id.get(entry.device_id or 0)
            span = robot.span if stated is None else spans[stated.name]
            diagnostics.append(_stranger(bus, entry, stated, span))
    return diagnostics


def _stranger(
    bus: Bus, entry: ScanEntry, stated: NodeConfiguration | None, span: Span
) -> Diagnostic:
    place = f"with {entry.device.id_text}" if entry.device is not None else ""
    device = f"the device {place} on the bus `{bus.name}` is {identity_text(entry.identity)}"
    hint = "is it the file of this robot? `thorvaldc can identify FOLDER` finds the one that fits"
    if stated is None:
        return _error(f"{device}; the robot file does not name it", span, hint)
    if entry.identity is not None and entry.identity.serial:
        hint += f'; if `{stated.name}` was replaced, write `serial: "{entry.identity.serial:#x}"`'
    numbers = numbers_text(stated.vendor, stated.product, stated.revision, stated.serial)
    return _error(f"{device}; in the file, `{stated.name}` is {numbers}", span, hint)


def _error(text: str, span: Span, hint: str) -> Diagnostic:
    return Diagnostic(CODES["bus-wrong-robot"], text, span, _UNCHANGED + hint)
