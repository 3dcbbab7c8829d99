"""A bus to commission in virtual time: simulated devices, a master that can die, a journal."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.commissioning.bus_configuration import BusConfiguration, configuration_of
from thorvaldc.commissioning.bus_master import BusMaster, Timing
from thorvaldc.commissioning.flash import Flash, Operator
from thorvaldc.commissioning.journal import Journal
from thorvaldc.commissioning.plan import Plan
from thorvaldc.commissioning.planner import make_plan
from thorvaldc.commissioning.scan_result import ScanResult
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_device import NODE_ID, PARAMETERS
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, VirtualTimeInterface

QUICK = Timing(absent=0.01, probe_gap=0.001, probe_tail=0.02, boot=1.0)
"""Shorter time-outs, because simulated devices answer quickly."""
NODES = ("fl_controller", "fr_controller", "rl_controller", "rr_controller")
SWAPPED = {"fl_controller": {"node_id": 2}, "fr_controller": {"node_id": 1}}
"""Four new nodes: two without an id, two with the id of the other."""
FEW = (0x1000, 0x1015, 0x1017, 0x1018, 0x1802, 0x6007, 0x6041, 0x6083, 0x6841, 0x687C)


@functools.cache
def four_drives() -> Robot:
    """Returns a robot with four drives and few values each: a short flash."""
    robot = cia402_robot()
    bus = robot.buses[0]
    nodes = tuple(
        dataclasses.replace(node, objects=tuple(o for o in node.objects if o.index in FEW))
        for node in bus.nodes
        if node.name in NODES
    )
    frames = tuple(f for f in bus.frames if f.producer in ("master", *NODES))
    bus = dataclasses.replace(bus, nodes=nodes, frames=frames)
    return dataclasses.replace(robot, buses=(bus,))


class Dead(BaseException):
    """The master's process ends; no handler of the master may catch this."""


class MortalInterface(VirtualTimeInterface):
    """An interface whose program dies at its next call once ``dead`` is set."""

    dead = False

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        self._check_alive()
        sent = super().send(frame, timeout)
        self._check_alive()
        return sent

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        self._check_alive()
        received = super().receive(timeout)
        self._check_alive()
        return received

    def _check_alive(self) -> None:
        if self.dead:
            raise Dead


class Watch:
    """Checks at every change of an id that no two powered devices have the same."""

    def __init__(self, devices: Iterable[CanopenDevice], still: bool) -> None:
        self.doubles: list[str] = []
        self.devices = tuple(devices)
        watch = self

        for device in self.devices:

            class Watched(type(device)):  # type: ignore[misc]
                def initialised(self) -> None:
                    """Does not control the motors if ``still``: this halves the duration."""
                    if not still:
                        super().initialised()

                @property
                def node_id(self) -> int:
                    return int(self.__dict__["node_id"])

                @node_id.setter
                def node_id(self, value: int) -> None:
                    self.__dict__["node_id"] = value
                    watch.check(self)

            device.__class__ = Watched

    def check(self, changed: CanopenDevice) -> None:
        for other in self.devices:
            same = other is not changed and other.node_id == changed.node_id != 255
            if same and other.powered and changed.powered:
                self.doubles.append(f"{changed.name} and {other.name} at {other.node_id}")


class MemoryStorage:
    """A journal in memory."""

    name = "memory"

    def __init__(self, data: bytes = b"") -> None:
        self.data = data
        self.flushed: list[int] = []

    def read(self) -> bytes:
        return self.data

    def append(self, data: bytes) -> None:
        self.data += data
        self.flushed.append(len(self.data))


class Bench:
    """A robot's bus.  ``memory``: contents of the non-volatile memory by node; id 255: none."""

    def __init__(
        self,
        robot: Robot,
        memory: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        delivered: bool = True,
        timing: Timing | None = None,
        torn: bool = False,
        still: bool = True,
        quirks: Iterable[Quirk] = (),
    ) -> None:
        self.robot = robot
        self.bus = robot.buses[0]
        self.configuration: BusConfiguration = configuration_of(robot, self.bus)
        self.simulated = SimulatedRobot(
            robot, delivered=delivered, nonvolatile=memory, quirks=quirks
        )
        for device in self.simulated.devices.values():
            device.torn_writes = torn
        self.wire = self.simulated.wire()
        self.storage = MemoryStorage()
        self.timing = timing
        self.watch = Watch(self.devices().values(), still)
        self.simulated.power_on()
        self.simulated.run(0.15)

    def master(self) -> BusMaster:
        self.interface = MortalInterface(self.wire, "master", receive_limit=100_000)
        return BusMaster(self.interface, self.bus, self.timing)

    def scan(self, **options: Any) -> ScanResult:
        master = self.master()
        try:
            return Scanner(master, self.configuration).active(**options)
        finally:
            master.interface.close()

    def plan(self) -> Plan:
        return make_plan(self.configuration, self.scan())

    def run(
        self,
        how: Callable[[Flash], Plan],
        operator: Operator | None = None,
        target: BusConfiguration | None = None,
    ) -> Plan:
        """Runs as a new process does: with a new interface, and the journal read again."""
        master = self.master()
        try:
            flash = Flash(
                master, target or self.configuration, Journal(self.storage), operator=operator
            )
            return how(flash)
        finally:
            master.interface.close()

    def apply(self, expected: str | None = None) -> Plan:
        return self.run(lambda flash: flash.apply(expected))

    def resume(self) -> Plan:
        return self.run(Flash.resume)

    def rollback(self) -> Plan:
        return self.run(Flash.rollback)

    def state(self) -> dict[str, tuple[int, dict[str, Any]]]:
        """Returns the stored id and parameters of every CANopen device."""
        return {
            name: (
                device.nonvolatile.get(NODE_ID, 255),
                dict(device.nonvolatile.get(PARAMETERS, {})),
            )
            for name, device in self.simulated.devices.items()
            if isinstance(device, CanopenDevice)
        }

    def devices(self) -> dict[str, CanopenDevice]:
        return {
            name: device
            for name, device in self.simulated.devices.items()
            if isinstance(device, CanopenDevice)
        }
