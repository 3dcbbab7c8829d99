"""Reads a document with injected faults for the simulated CAN buses of a robot."""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.modules.value_reader import items
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.bus import Bus
from thorvaldc.model.bus import Node as Device
from thorvaldc.model.bus_faults import FAULT_KINDS, BusFault, BusFaults, FaultKind
from thorvaldc.model.bus_quirks import Quirk
from thorvaldc.model.robot import Robot

LONGEST = 86400.0
"""Latest start time of an injected fault in s (one day)."""
_WHEN = ("fault", "bus", "at", "frame", "delay")
_CANOPEN_FAULTS = (
    "commands_ignored",
    "sync_ignored",
    "nmt_ignored",
    "frozen_reports",
)
_BATTERIES = "kc_battery"


def read_bus_faults(document: Node, robot: Robot, report: Report) -> BusFaults:
    """Returns the injected faults that a document lists for the simulated CAN buses.

    Reports an error if an injected fault refers to an unknown bus or device, or if the device does
    not support the fault.
    """
    scope = Scope(None, {}, Library(), report, None)
    quantities = BoundedQuantities(scope, report)
    seed = document.get("seed")
    return BusFaults(
        tuple(_Reader(robot, quantities, report).injected_faults(document.get("faults"))),
        seed.value if seed is not None and isinstance(seed.value, int) else 0,
        scope.text(document.get("description")),
        tuple(_quirks(document.get("quirks"))),
    )


def _quirks(names: Node | None) -> Iterator[Quirk]:
    for node in names.value if names is not None and isinstance(names.value, tuple) else ():
        if node.value in tuple(Quirk):
            yield Quirk(node.value)


class _Reader:
    def __init__(self, robot: Robot, numbers: BoundedQuantities, report: Report) -> None:
        self.robot = robot
        self.numbers = numbers
        self.report = report

    def injected_faults(self, fault_list: Node | None) -> Iterator[BusFault]:
        items = fault_list.value if fault_list is not None else None
        for node in items if isinstance(items, tuple) else ():
            kind = node.get("fault")
            if kind is not None and isinstance(kind.value, str) and kind.value in FAULT_KINDS:
                injected_fault = self._injected_fault(node, kind.value)
                if injected_fault is not None:
                    yield injected_fault

    def _injected_fault(self, node: Node, name: str) -> BusFault | None:
        kind = FAULT_KINDS[name]
        bus, device = self._bus_and_device(node, kind)
        if not self._has_keys(node, name, kind) or bus is None:
            return None
        if device is not None and not self._suits(node, name, device):
            return None
        numbers = self.numbers
        lasts = node.get("for") is not None
        bitrate = numbers(node, "bitrate", "bitrate", least=10e3, most=1e6)
        return BusFault(
            name,
            bus.name,
            device.name if device is not None else None,
            numbers(node, "at", "time", least=0.0, most=LONGEST) if node.get("at") else None,
            _integer(node, "frame"),
            node.span,
            numbers(node, "delay", "time", least=0.0, most=LONGEST),
            numbers(node, "for", "time", least=0.0, above=True) if lasts else None,
            _integer(node, "id") or 0,
            _integer(node, "cob_id"),
            numbers(node, "period", "time", 0.0, least=1e-5),
            _integer(node, "code") or 0,
            _integer(node, "register") or 0,
            str(channel.value) if (channel := node.get("channel")) is not None else "",
            round(bitrate),
            numbers(node, "share", "number", least=0.0, most=1.0),
            _data(node),
            numbers(node, "latency", "time", least=0.0, most=LONGEST),
            numbers(node, "angle", "angle"),
            numbers(node, "charge", "number", least=0.0, most=1.0),
            numbers(node, "speed", "angular_velocity"),
            _integer(node, "index") or 0,
            _integer(node, "subindex") or 0,
            _integer(node, "value") or 0,
            str(form.value) if (form := node.get("format")) is not None else "standard",
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
        low, high = (0, 15) if device.id_space == _BATTERIES else (1, 127)
        if number is not None and isinstance(number.value, int) and not low <= number.value <= high:
            self.report.add(
                "can-id-range",
                f"the id {number.value} of `{device.name}` is not between {low} and {high}",
                number.span,
            )
            return False
        return True


def _integer(node: Node, key: str) -> int | None:
    number = node.get(key)
    return number.value if number is not None and type(number.value) is int else None


def _data(node: Node) -> bytes | None:
    """Returns the data bytes of a forged frame, or ``None`` if the document has no valid data."""
    if node.get("data") is None:
        return None
    values = [element.value for element in items(node.get("data"))]
    numbers = [value for value in values if type(value) is int]
    return bytes(numbers) if len(numbers) == len(values) else None
