"""Simulated JK BMS.

Assumed, because no source says it: the BMS repeats ALM_INFO every 100 ms while there is an alarm,
and rounds the state of charge to whole per cent.
"""

from __future__ import annotations

import struct

from thorvaldc.simulation.bus.battery_and_io_devices import SimulatedBattery

CELLS = 16


class JkBms(SimulatedBattery):
    """A simulated battery of 16 cells with a JK BMS; ``alarms`` has two bits for each alarm."""

    temperature = 25
    """Temperature (degrees Celsius) of all cells."""

    def start(self) -> None:
        super().start()
        for period, report in (
            (0.1, self._report_cell_voltages),
            (0.5, self._report_temperatures),
            (0.1, self._report_alarms),
        ):
            self.every(lambda s=period: s, report, first=self.random.uniform(0.0, period))

    def report(self) -> None:
        volts, amps = round(10.0 * self.voltage), round(10.0 * (400.0 - self.current))
        self.send(0x2F4 + self.id, struct.pack("<HHB", volts, amps, round(100.0 * self.charge)))

    def _report_cell_voltages(self) -> None:
        millivolts = round(1000.0 * self.voltage / CELLS)
        self.send(0x4F4 + self.id, struct.pack("<HBHB", millivolts, 1, millivolts, CELLS))

    def _report_temperatures(self) -> None:
        raw = self.temperature + 50
        self.send(0x5F4 + self.id, bytes([raw, 1, raw, 2, raw]))

    def _report_alarms(self) -> None:
        if self.alarms:
            self.send(0x7F4 + self.id, struct.pack("<I", self.alarms))
