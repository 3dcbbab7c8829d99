"""A document of bus faults, of a robot that is compiled already, as a script."""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.bus import Bus
from thorvaldc.model.bus import Node as Device
from thorvaldc.model.bus_faults import FAULT_KINDS, BusFault, BusFaults, FaultKind
from thorvaldc.model.robot import Robot

LONGEST = 86400.0
"""A day: the latest fault (s)."""
_WHEN = ("fault", "bus", "at", "frame", "delay")
_BATTERIES = "kc_battery"


def read_bus_faults(document: Node, robot: Robot, report: Report) -> BusFaults:
    """The script.  Faults of devices that the robot does not have are reported."""
    scope = Scope(None, {}, Library(), report, None)
    quantities = BoundedQuantities(scope, report)
    seed = document.get("seed")
    return BusFaults(
        tuple(_Reader(robot, quantities, report).faults(document.get("faults"))),
        seed.value if seed is not None and isinstance(seed.value, int) else 0,
        scope.text(document.get("description")),
    )


class _Reader:
    def __init__(self, robot: Robot, numbers: BoundedQuantities, report: Report) -> None:
        self.robot = robot
        self.numbers = numbers
        self.report = report

    def faults(self, listed: Node | None) -> Iterator[BusFault]:
        items = listed.value if listed is not None else None
        for node in items if isinstance(items, tuple) else ():
            named = node.get("fault")
            if named is not None and isinstance(named.value, str) and named.value in FAULT_KINDS:
                fault = self._fault(node, named.value)
                if fault is not None:
                    yield fault

    def _fault(self, node: Node, name: str) -> BusFault | None:
        kind = FAULT_KINDS[name]
        bus, device = self._place(node, kind)
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
        )

    def _place(self, node: Node, kind: FaultKind) -> tuple[Bus | None, Device | None]:
        """The bus, and the device if there is one; nothing where they are not the robot's."""
        buses = self.robot.buses
        named, device = node.get("bus"), node.get("node")
        if named is not None:
            bus = next((b for b in buses if b.name == named.value), None)
            if bus is None:
                known = [b.name for b in buses]
                self.report.add(
                    "can-bus-unknown",
                    f"{self.robot.name} has no bus `{named.value}`",
                    named.span,
                    hint=did_you_mean(str(named.value), known, f"its buses: {', '.join(known)}"),
                )
                return None, None
            buses = (bus,)
        if device is None:
            if kind.node != "yes":
                return buses[0] if buses else None, None
            return None, None  # reported as a key that is missing
        for bus in buses:
            for found in bus.nodes:
                if found.name == device.value:
                    return bus, found
        names = [n.name for bus in buses for n in bus.nodes]
        self.report.add(
            "bus-fault-node",
            f"{self.robot.name} has no device `{device.value}`",
            device.span,
            hint=did_you_mean(str(device.value), names, f"its devices: {', '.join(names)}"),
        )
        return None, None

    def _has_keys(self, node: Node, name: str, kind: FaultKind) -> bool:
        """Whether the fault has what it needs, and when it begins, and nothing else."""
        entries = node.value if isinstance(node.value, dict) else {}
        needs = (*(("node",) if kind.node == "yes" else ()), *kind.needs)
        whole = True
        for key in needs:
            if key not in entries:
                self.report.add("missing-key", f"the fault `{name}` has no `{key}`", node.where)
                whole = False
        if ("at" in entries) == ("frame" in entries):
            code = "conflicting-keys" if "at" in entries else "missing-key"
            both = "both `at` and `frame`" if "at" in entries else "neither `at` nor `frame`"
            self.report.add(
                code, f"the fault `{name}` has {both}", node.where, hint="say when it begins"
            )
            whole = False
        may = (*_WHEN, *needs, *kind.may, *(("for",) if kind.lasts else ()))
        allowed = may if kind.node == "no" else (*may, "node")
        for key, entry in entries.items():
            if key not in allowed:
                self.report.add(
                    "conflicting-keys", f"the fault `{name}` has no `{key}`", entry.where
                )
        return whole

    def _suits(self, node: Node, name: str, device: Device) -> bool:
        """Whether the device can have the fault at all."""
        frames = [f for bus in self.robot.buses for f in bus.frames if f.producer == device.name]
        kinds = {"heartbeat_stop": "heartbeat", "emcy": "emcy"}
        what = ""
        if name in kinds and not any(f.kind == kinds[name] for f in frames):
            what = "sends no heartbeat" if name == "heartbeat_stop" else "sends no emergencies"
        elif name == "duplicate_id" and not device.id_space:
            what = "has no id"
        if what:
            self.report.add(
                "bus-fault-unsuited",
                f"`{device.name}` {what}, and so cannot have the fault `{name}`",
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
    found = node.get(key)
    return found.value if found is not None and type(found.value) is int else None
