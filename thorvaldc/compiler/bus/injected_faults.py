"""Reads a document with injected faults for the simulated CAN buses of a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.node import Node, insertion
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.diagnostics import Proposal, Report, did_you_mean
from thorvaldc.model import Bus, Robot
from thorvaldc.model import Node as Device
from thorvaldc.model.scenario import FAULT_KINDS, BusFault, BusFaults, FaultKind, Quirk

_WHEN = ("fault", "bus", "at", "frame", "delay")
_CANOPEN_FAULTS = (
    "commands_ignored",
    "sync_ignored",
    "nmt_ignored",
    "frozen_reports",
)
_BATTERIES = "kc_battery"
_STORED: tuple[tuple[str, Callable[[Any], Any]], ...] = (("bitrate", round), ("data", bytes))
"""How the model stores values that the document has in another type."""


def read_bus_faults(document: Node, robot: Robot, report: Report) -> BusFaults:
    """Returns the injected faults that a document lists for the simulated CAN buses.

    Reports an error if an injected fault refers to an unknown bus or device, or if the device does
    not support the fault.
    """
    content = read_document(document, "bus_faults", Scope(None, {}, Library(), report, None))
    return BusFaults(
        tuple(_Reader(robot, report).injected_faults(content["faults"])),
        content["seed"],
        content["description"],
        tuple(map(Quirk, content["quirks"])),
    )


class _Reader:
    def __init__(self, robot: Robot, report: Report) -> None:
        self.robot = robot
        self.report = report

    def injected_faults(self, sections: tuple[Section, ...]) -> Iterator[BusFault]:
        for section in sections:
            injected_fault = self._injected_fault(section) if "fault" in section else None
            if injected_fault is not None:
                yield injected_fault

    def _injected_fault(self, section: Section) -> BusFault | None:
        node, name = section.node, section["fault"]
        kind = FAULT_KINDS[name]
        bus, device = self._bus_and_device(node, kind)
        if not self._has_keys(node, name, kind) or bus is None:
            return None
        if (section["cob_id"] or 0) > 0x7FF and section["format"] != "extended":
            hint = "write `format: extended` for an identifier with 29 bits"
            written = node.get("format")
            self.report.add(
                "can-cob-id-range",
                f"the fault `{name}` has the identifier {section['cob_id']:#x}; a "
                f"{section['format']} frame has 0x0 to 0x7ff",
                node.where,
                hint=Proposal(hint, "extended", span=written.span)
                if written is not None
                else insertion(hint, node, "format", "extended", is_example=False),
            )
            return None
        if device is not None and not self._suits(node, name, device):
            return None
        values = {key: value for key, value in section.items() if key not in _WHEN}
        values |= {key: function(values[key]) for key, function in _STORED if key in values}
        device_name = device.name if device is not None else None
        values["duration"], values["node"] = values.pop("for", None), device_name
        return BusFault(
            kind=name,
            bus=bus.name,
            time=section["at"],
            frame=section["frame"],
            delay=section["delay"],
            span=node.span,
            **values,
        )

    def _bus_and_device(self, node: Node, kind: FaultKind) -> tuple[Bus | None, Device | None]:
        """Returns the CAN bus and the device that an injected fault affects.

        The device is ``None`` for an injected fault of a whole CAN bus.  If the robot does not have
        the CAN bus or the device, returns ``(None, None)``.
        """
        buses = self.robot.buses
        bus_node, device = node.get("bus"), node.get("node")
        if bus_node is not None:
            bus = next((b for b in buses if b.name == bus_node.value), None)
            if bus is None:
                known = [b.name for b in buses]
                self.report.add(
                    "can-bus-unknown",
                    f"{self.robot.name} has no bus `{bus_node.value}`",
                    bus_node.span,
                    hint=did_you_mean(str(bus_node.value), known, f"its buses: {', '.join(known)}"),
                )
                return None, None
            buses = (bus,)
        if device is None:
            if kind.node != "yes":
                return buses[0] if buses else None, None
            return None, None  # the method `_has_keys` reports the missing key `node`
        for bus in buses:
            for candidate in bus.nodes:
                if candidate.name == device.value:
                    return bus, candidate
        names = [n.name for bus in buses for n in bus.nodes]
        self.report.add(
            "bus-fault-node",
            f"{self.robot.name} has no device `{device.value}`",
            device.span,
            hint=did_you_mean(str(device.value), names, f"its devices: {', '.join(names)}"),
        )
        return None, None

    def _has_keys(self, node: Node, name: str, kind: FaultKind) -> bool:
        """Checks that an injected fault has all required keys and exactly one start condition.

        Reports missing, conflicting and unknown keys of an injected fault in the YAML document.
        """
        entries = node.value if isinstance(node.value, dict) else {}
        needs = (*(("node",) if kind.node == "yes" else ()), *kind.needs)
        complete = True
        for key in needs:
            if key not in entries:
                self.report.add("missing-key", f"the fault `{name}` has no `{key}`", node.where)
                complete = False
        if ("at" in entries) == ("frame" in entries):
            code = "conflicting-keys" if "at" in entries else "missing-key"
            both = "both `at` and `frame`" if "at" in entries else "neither `at` nor `frame`"
            self.report.add(
                code, f"the fault `{name}` has {both}", node.where, hint="state when it begins"
            )
            complete = False
        may = (*_WHEN, *needs, *kind.may, *(("for",) if kind.lasts else ()))
        allowed = may if kind.node == "no" else (*may, "node")
        for key, entry in entries.items():
            if key not in allowed:
                self.report.add(
                    "conflicting-keys", f"the fault `{name}` has no `{key}`", entry.where
                )
        return complete

    def _suits(self, node: Node, name: str, device: Device) -> bool:
        """Checks that a simulated device supports the injected fault ``name``."""
        frames = [f for bus in self.robot.buses for f in bus.frames if f.producer == device.name]
        kinds = {"heartbeat_stop": "heartbeat", "emcy": "emcy"}
        reason = ""
        if name in kinds and not any(f.kind == kinds[name] for f in frames):
            reason = "sends no heartbeat" if name == "heartbeat_stop" else "sends no emergencies"
        elif name in ("duplicate_id", "clone") and not device.id_space:
            reason = "has no id"
        elif name == "watchdog_lost" and not device.channels:
            reason = "is no motor controller"
        elif name == "object_written" and not any(f.kind == "sdo" for f in frames):
            reason = "has no object dictionary"
        elif name in _CANOPEN_FAULTS and not device.is_canopen:
            reason = "is no CANopen device"
        elif name == "battery_charge" and all(
            battery.node != device.name for battery in self.robot.batteries
        ):
            reason = "is no battery"
        if reason:
            self.report.add(
                "bus-fault-unsuited",
                f"`{device.name}` {reason}, so it cannot have the fault `{name}`",
                node.where,
            )
            return False
        channel, number = node.get("channel"), node.get("id")
        if channel is not None and all(c.name != channel.value for c in device.channels):
            known = [c.name for c in device.channels]
            self.report.add(
                "channel-unknown",
                f"`{device.name}` has no channel `{channel.value}`",
                channel.span,
                hint=did_you_mean(str(channel.value), known, f"it has: {', '.join(known)}"),
            )
            return False
        low, high = int(device.is_canopen), 15 if device.id_space == _BATTERIES else 127
        if number is not None and isinstance(number.value, int) and not low <= number.value <= high:
            self.report.add(
                "can-id-range",
                f"the id {number.value} of `{device.name}` is not between {low} and {high}",
                number.span,
            )
            return False
        return True


def read_faults(path: Path | str, robot: Robot, report: Report) -> BusFaults | None:
    """Reads the injected faults from a file.

    Returns ``None`` and reports the errors if the file is not valid.
    """
    shape, content = Report(), Report()
    document = read_file(Path(path), str(path), shape)
    if document is None:
        report.extend(shape)
        return None
    check(document, "bus_faults", shape)
    script = read_bus_faults(without_invalid_values(document, shape), robot, content)
    report.extend(shape)
    report.extend(content.excluding_spans_of(shape))
    return None if shape.has_errors or content.has_errors else script
