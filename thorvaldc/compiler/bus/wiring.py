"""Collects the CAN buses, the CAN devices and the motor connections of a robot."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable, Iterator
from contextvars import ContextVar
from typing import Any, NamedTuple

from thorvaldc.compiler.bus.assemble_buses import BusSpec, Device, Wire, build_buses
from thorvaldc.compiler.bus.lock_file import Lock
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Actuator, Bus, Joint

DEFAULT_BITRATE = 500_000  # bit/s
DEFAULT_BUS = "main"


MAX_REMEMBERED = 256
"""Largest number of robots whose buses ``remembered_buses`` keeps."""

_remembered: ContextVar[dict[Any, tuple[Bus, ...]] | None] = ContextVar("buses", default=None)


@contextlib.contextmanager
def remembered_buses() -> Iterator[None]:
    """Within this context, the buses of equal devices are built once.

    The context is for many compilations of one robot, in which other values than those of its
    devices change.  Buses with diagnostics are built each time.
    """
    token = _remembered.set({})
    try:
        yield
    finally:
        _remembered.reset(token)


class Wiring(NamedTuple):
    """Collects the CAN devices of a robot and the motors on the channels of motor controllers.

    - ``document``: robot document.
    - ``resolver``: resolver of the references to motors.
    - ``scope``: names and values for expressions in the robot document.
    - ``actuators``: actuators of the model, by name.
    - ``joints``: joints of the model, by name.
    - ``lock``: node ids of the last build, from the lock file.
    """

    document: Node
    resolver: Resolver
    scope: Scope
    actuators: dict[str, Actuator]
    joints: dict[str, Joint]
    lock: Lock
    report: Report

    def buses(self, robot: Instance, period: float, watchdog: float = math.inf) -> tuple[Bus, ...]:
        """Returns the CAN buses of a robot.

        - ``robot``: root of the tree of module instances.
        - ``period``: control cycle of the base driver in s.
        - ``watchdog``: longest heartbeat consumer time of a drive in s.
        """
        devices: list[Device] = []
        for leaf in robot.leaves():
            can = leaf.type.document.get("can") if leaf.type is not None else None
            if can is not None:
                devices.append(self._device(leaf, can))
        specs, actuators = self._specs(), list(self.actuators.values())
        foreign = self.document.get("foreign_devices")
        remembered, key = _remembered.get(), None
        if remembered is not None and foreign is None:
            inputs = tuple(map(_inputs, devices))
            key = (inputs, *specs, *actuators, *self.lock.items(), period, watchdog)
            if key in remembered:
                return remembered[key]
        number = len(self.report)
        buses = build_buses(
            devices,
            specs,
            actuators,
            period,
            self.report,
            foreign=foreign,
            lock=self.lock,
            watchdog=watchdog,
        )
        if remembered is not None and key is not None and len(self.report) == number:
            if len(remembered) >= MAX_REMEMBERED:
                remembered.clear()
            remembered[key] = buses
        return buses

    def _specs(self) -> list[BusSpec]:
        node = self.document.get("buses")
        if node is None or not isinstance(node.value, dict) or not node.value:
            named = self.document.get("name") or self.document
            return [BusSpec(DEFAULT_BUS, DEFAULT_BITRATE, named.span, stated=False)]
        return [
            BusSpec(
                name,
                round(self.scope.quantity(entry.get("bitrate"), "bitrate", DEFAULT_BITRATE)),
                entry.where,
                stated=entry.get("bitrate") is not None,
            )
            for name, entry in node.value.items()
        ]

    def _device(self, leaf: Instance, can: Node) -> Device:
        wires: list[Wire] = []
        for channel, node in leaf.wiring.items():
            wire = self._wire(leaf, channel, node)
            if wire is not None:
                wires.append(wire)
        document = leaf.type.document if leaf.type is not None else can
        return Device(
            path=leaf.path,
            name=name_prefix(leaf.path),
            can=can,
            channels=document.get("channels"),
            wires=tuple(wires),
            address=leaf.can,
            scope=leaf.scope,
            span=leaf.span,
        )

    def _wire(self, leaf: Instance, channel: str, node: Node) -> Wire | None:
        inside = leaf.parent if leaf.parent is not None else leaf
        reference = inside.scope.text(node)
        if not reference:
            return None
        motor = self.resolver.references.find_motor(inside, reference, node)
        if motor is None:
            return None
        actuator = self.actuators.get(f"{name_prefix(motor[0].path)}_{motor[1]}")
        if actuator is None:
            return None
        joint = self.joints[actuator.joint]
        return Wire(channel, actuator, joint.lower, joint.upper, node.where)


def _inputs(device: Device) -> Hashable:
    """Returns all of a device that its nodes and frames depend on.

    The expressions in the section `can` use only the parameters of the module, and values that the
    module document computes from them.
    """
    values = tuple(tuple(v) if isinstance(v, list) else v for v in device.scope.parameter_values())
    address = None if device.address is None else repr(device.address)
    return device.path, device.scope.module, values, device.wires, address, device.span
