"""Driver of a battery with a JK BMS, which only listens.

JK BMS, from power-on on                       driver
every 20 ms   BATT_ST1    0x2F4 + address --->  voltage, current, state of charge
every 500 ms  CELL_TEMP   0x5F4 + address --->  temperatures
each alarm    ALM_INFO    0x7F4 + address --->  alarms, until none has arrived for ALARM_TIME
"""

from __future__ import annotations

import math

from thorvaldc.model import Bus, Node
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryDriver

ALARM_TIME = 5.0
"""Time (s) without ALM_INFO after which there is no alarm: no source says that it is sent again
when an alarm ends."""


class JkBmsDriver(BatteryDriver):
    """Driver of one JK BMS."""

    def __init__(self, bus: Bus, node: Node) -> None:
        super().__init__(bus, node)
        self._alarm_time = -math.inf
        self._alarms: dict[str, float] = {}
        for name, handler in (
            ("status", self._handle_status),
            ("cell_temperatures", self._handle_temperatures),
            ("alarms", self._handle_alarms),
        ):
            self.handlers[self.codecs[name].key] = handler

    def _handle_status(self, data: bytes, time: float) -> None:
        values = self.codecs["status"].decode_named(data)
        state = self.state
        state.time = time
        state.voltage = values["voltage"]
        state.current = values["current"]
        state.charge = values["state_of_charge"] / 100.0
        if time - self._alarm_time > ALARM_TIME:
            self._alarms, state.alarms = {}, 0

    def _handle_temperatures(self, data: bytes, time: float) -> None:
        values = self.codecs["cell_temperatures"].decode_named(data)
        self.state.temperatures = [values["lowest_temperature"], values["highest_temperature"]]

    def _handle_alarms(self, data: bytes, time: float) -> None:
        self._alarms = self.codecs["alarms"].decode_named(data)
        self._alarm_time = time
        self.state.alarms = int.from_bytes(data[:4], "little")

    @property
    def warning(self) -> str:
        names = [name.replace("_", " ") for name, level in self._alarms.items() if level]
        return f"alarm: {', '.join(names)}" if names else ""
