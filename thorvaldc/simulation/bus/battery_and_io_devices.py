"""Devices without CANopen: the KC battery, the IO board, devices of others."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.wire import Wire

BATTERY_FRAMES = (0x3C0, 0x3D0, 0x3E0)
_SECONDS_PER_HOUR = 3600.0


class KcBattery(SimulatedDevice):
    """The battery by KC: three frames, again and again.

    ``current`` (A, positive: discharging) may be set, or given as a function of time;
    ``charge`` is the state of charge, 0..1.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        battery_id: int,
        *,
        voltage: float = 48.0,
        capacity: float = 70.0,
        period: float = 0.1,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        """``voltage`` V, ``capacity`` Ah, ``period`` s."""
        super().__init__(name, wire, bitrate, seed=seed, nonvolatile=nonvolatile)
        self.id = battery_id
        self.period = period
        self.voltage = voltage
        self.capacity = capacity
        self.current = 2.0
        self.charge = 0.9
        self.health = 1.0
        self.cycles = 12
        self.alarms = 0
        self.temperatures = [25, 25, 25, 25, 25, 25]
        self.charge_enabled = self.discharge_enabled = True

    def start(self) -> None:
        self.every(lambda: self.period, self._report, first=self.random.uniform(0.0, self.period))

    def change_node_id(self, node_id: int) -> None:
        self.id = node_id

    def _report(self) -> None:
        used = self.current * self.period / (self.capacity * _SECONDS_PER_HOUR)
        self.charge = min(max(self.charge - used, 0.0), 1.0)
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
    """Outputs switched by 0x200 + id, reported with the inputs as 0x180 + id.

    ``outputs``: bit 0 and 1 the relays, 2 to 4 the beacon (red, yellow, green).
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        node_id: int,
        *,
        at_start: int = 0,
        period: float = 0.1,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(name, wire, bitrate, seed=seed, nonvolatile=nonvolatile)
        self.id = node_id
        self.period = period
        self.at_start = at_start
        self.outputs = 0
        self.inputs = 0

    def start(self) -> None:
        self.outputs = self.at_start
        self.handlers[0x200 + self.id] = self._switch
        self.every(lambda: self.period, self._report, first=self.random.uniform(0.0, self.period))

    def stop(self) -> None:
        self.outputs = 0

    def change_node_id(self, node_id: int) -> None:
        handler = self.handlers.pop(0x200 + self.id, None)
        self.id = node_id
        if handler is not None:
            self.handlers[0x200 + node_id] = handler

    def _switch(self, frame: CanFrame) -> None:
        if len(frame.data) >= 3 and frame.data[0] == 1:
            self.outputs = frame.data[1] & 0x1F

    def _report(self) -> None:
        self.send(0x180 + self.id, bytes([1, self.outputs, self.inputs]))


class ForeignFrame(NamedTuple):
    """A frame of a device that nothing else is known of; ``period`` (s) ``None``: an answer.

    ``data`` ``None``: it counts in its first byte.
    """

    cob_id: int
    length: int
    period: float | None
    data: bytes | None = None


class ForeignDevice(SimulatedDevice):
    """A device of somebody else's: reports by time, and answers what it is told.

    ``heard`` holds the frames that were for it, the newest last.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        listens: Sequence[int],
        sends: Sequence[ForeignFrame],
        *,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(name, wire, bitrate, seed=seed, nonvolatile=nonvolatile)
        self._listens = tuple(listens)
        self._sends = tuple(sends)
        self._count = 0
        self.heard: list[CanFrame] = []

    def start(self) -> None:
        for cob_id in self._listens:
            self.handlers[cob_id] = self._hear
        for frame in self._sends:
            if frame.period is not None:
                self._say_every(frame, frame.period)

    def _say_every(self, frame: ForeignFrame, period: float) -> None:
        first = self.random.uniform(0.0, period)
        self.every(lambda: period, lambda: self._say(frame), first=first)

    def _hear(self, frame: CanFrame) -> None:
        self.heard.append(frame)
        del self.heard[:-64]
        for answer in self._sends:
            if answer.period is None:
                self._say(answer)

    def _say(self, frame: ForeignFrame) -> None:
        data = frame.data
        if data is None:
            self._count = (self._count + 1) % 256
            data = bytes([self._count]).ljust(frame.length, b"\0")[: frame.length]
        self.send(frame.cob_id, data)
