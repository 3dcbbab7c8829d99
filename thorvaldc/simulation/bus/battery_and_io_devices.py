"""Simulated devices without CANopen: KC battery, IO board, and devices of other makers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.can.canopen import RPDO, TPDO, NmtState
from thorvaldc.can.frame import CanFrame
from thorvaldc.model.sums import float_sum
from thorvaldc.simulation.bus.simulated_device import (
    NODE_ID,
    DeviceSpecification,
    SimulatedDevice,
)

BATTERY_FRAMES = (0x3C0, 0x3D0, 0x3E0)
"""Bases of the identifiers; the battery id is added."""
_SECONDS_PER_HOUR = 3600.0


class SimulatedBattery(SimulatedDevice):
    """A simulated battery, whose subclass implements the method ``report``.

    * ``id``, ``voltage``: battery id, and battery voltage (V).
    * ``capacity``: battery capacity (Ah).
    * ``current``: battery current (A), positive while the battery discharges.
    * ``charge``: state of charge, 0..1.
    * ``period``: time between two calls of ``report`` (s).
    """

    def __init__(self, specification: DeviceSpecification) -> None:
        """Creates a battery with the data of its module, and the shortest period of its frames."""
        node, robot = specification.node, specification.robot
        super().__init__(specification, {NODE_ID: node.id})
        properties = {b.node: dict(b.properties) for b in robot.batteries}.get(node.name, {})
        capacity = properties.get("capacity")  # the model has the capacity in A s
        self.period = min((f.period for f in specification.sent if f.period), default=0.1)
        self.voltage = float(properties.get("voltage") or 48.0)
        self.capacity = float(capacity) / _SECONDS_PER_HOUR if capacity else 70.0
        self.current = 2.0
        self.charge = 0.9
        self.alarms = 0
        # In parallel, each has the share of the current that keeps their states of charge equal.
        shared = [battery.capacity or 0.0 for battery in robot.common_source]
        if capacity and shared and all(shared):
            self.current *= float(capacity) * len(shared) / float_sum(shared)

    def start(self) -> None:
        first = self.random.uniform(0.0, self.period)
        self.every(lambda: self.period, self._discharge, first=first)

    @property
    def id(self) -> int:
        return int(self.nonvolatile[NODE_ID])

    def change_node_id(self, node_id: int) -> None:
        self.nonvolatile[NODE_ID] = node_id

    def set_charge(self, charge: float) -> float:
        previous, self.charge = self.charge, charge
        return previous

    def _discharge(self) -> None:
        used = self.current * self.period / (self.capacity * _SECONDS_PER_HOUR)
        self.charge = min(max(self.charge - used, 0.0), 1.0)
        self.report()

    def report(self) -> None:
        """Sends the CAN frames with the state of the battery."""
        raise NotImplementedError


class KcBattery(SimulatedBattery):
    """A simulated battery of the maker KC, which sends three CAN frames periodically."""

    health = 1.0
    cycles = 12
    charge_enabled = discharge_enabled = True
    temperatures: Sequence[int] = (25, 25, 25, 25, 25, 25)

    def report(self) -> None:
        switches = int(self.charge_enabled) | int(self.discharge_enabled) << 1
        volts = round(100.0 * self.voltage)
        status, current, charge = (base + self.id for base in BATTERY_FRAMES)
        temperatures = self.temperatures
        self.send(status, struct.pack("<xBHHbb", switches, volts, self.alarms, *temperatures[:2]))
        amps = round(100.0 * self.current)
        self.send(current, struct.pack("<4bhxx", *temperatures[2:6], amps))
        percent = round(100.0 * self.charge), round(100.0 * self.health)
        self.send(charge, struct.pack("<BBHxxxx", *percent, self.cycles))


class IoBoard(SimulatedDevice):
    """A simulated IO board with relays and a beacon.

    The CAN frame with the identifier 0x200 + node id sets the outputs of the IO board.  The CAN
    frame with the identifier 0x180 + node id reports the outputs and inputs of the IO board.  Bits
    0 and 1 of ``outputs`` switch the two relays of the IO board.  Bits 2 to 4 of ``outputs`` switch
    the red, yellow and green light of the beacon.

    * ``at_start``: states of the outputs after power-on, one bit for each output.
    * ``period``: period of the report frame (s).
    """

    def __init__(self, specification: DeviceSpecification) -> None:
        node = specification.node
        super().__init__(specification, {NODE_ID: node.id})
        relays = [bool(specification.property(f"relay_{i}_at_start")) for i in range(2)]
        self.period = specification.period(TPDO[0] + node.id, 0.1)
        self.at_start = int(relays[0]) | int(relays[1]) << 1
        self.outputs = 0
        self.inputs = 0

    def start(self) -> None:
        self.outputs = self.at_start
        self.handlers[RPDO[0] + self.id] = self._set_outputs
        self.every(lambda: self.period, self._report, first=self.random.uniform(0.0, self.period))

    def stop(self) -> None:
        self.outputs = 0

    @property
    def id(self) -> int:
        return int(self.nonvolatile[NODE_ID])

    def change_node_id(self, node_id: int) -> None:
        handler = self.handlers.pop(RPDO[0] + self.id, None)
        self.nonvolatile[NODE_ID] = node_id
        if handler is not None:
            self.handlers[RPDO[0] + node_id] = handler

    def _set_outputs(self, frame: CanFrame) -> None:
        if len(frame.data) >= 3 and frame.data[0] == 1:
            self.outputs = frame.data[1] & 0x1F

    def _report(self) -> None:
        self.send(TPDO[0] + self.id, bytes([1, self.outputs, self.inputs]))


class ForeignFrame(NamedTuple):
    """A CAN frame that a device of another maker sends.

    * ``key``: key of the frame, see ``EXTENDED`` in the module ``model.bus``.
    * ``length``: number of data bytes.
    * ``period``: period of the frame (s), or ``None`` for a frame that answers a command.
    * ``data``: data of the frame.  If ``data`` is ``None``, the first data byte of the CAN frame is
      a frame counter.
    """

    key: int
    length: int
    period: float | None
    data: bytes | None = None


class ForeignDevice(SimulatedDevice):
    """A simulated device of another maker, whose protocol is unknown.

    The device sends periodic CAN frames and answers received command frames.  ``commands`` has the
    last 64 received CAN frames, from the oldest to the newest.
    """

    def __init__(self, specification: DeviceSpecification) -> None:
        super().__init__(specification)
        data_frames = ("pdo", "broadcast", "relay")
        self._receives = [f.key for f in specification.received if f.kind in data_frames]
        self._sends = [
            ForeignFrame(
                frame.key,
                frame.length,
                frame.period,
                bytes([NmtState.OPERATIONAL]) if frame.kind == "heartbeat" else None,
            )
            for frame in specification.sent
            if frame.kind in (*data_frames, "heartbeat")
        ]
        self._count = 0
        self.commands: list[CanFrame] = []

    def start(self) -> None:
        for key in self._receives:
            self.handlers[key] = self._receive
        for frame in self._sends:
            if frame.period is not None:
                self._send_periodically(frame, frame.period)

    def _send_periodically(self, frame: ForeignFrame, period: float) -> None:
        first = self.random.uniform(0.0, period)
        self.every(lambda: period, lambda: self._send_frame(frame), first=first)

    def _receive(self, frame: CanFrame) -> None:
        self.commands.append(frame)
        del self.commands[:-64]
        for answer in self._sends:
            if answer.period is None:
                self._send_frame(answer)

    def _send_frame(self, frame: ForeignFrame) -> None:
        data = frame.data
        if data is None:
            self._count = (self._count + 1) % 256
            data = bytes([self._count]).ljust(frame.length, b"\0")[: frame.length]
        self.send(frame.key, data)
