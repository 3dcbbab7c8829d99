"""Devices on the bus that drive nothing: batteries and IO boards."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from thorvaldc.model.bus import Bus, Node
from thorvaldc.model.plugins import PluginTable
from thorvaldc.runtime.can_base.motor_controller import MASTER, Message, driver_class, frames_of
from thorvaldc.runtime.can_base.signal_codec import FrameCodec


@dataclass(slots=True)
class BatteryState:
    """V, A (out of the battery positive), shares of 1, degrees C; NaN: not told yet.

    ``time`` (s) is that of the newest report.  ``alarms`` are the maker's bits.
    """

    time: float = -math.inf
    voltage: float = math.nan
    current: float = math.nan
    charge: float = math.nan
    health: float = math.nan
    cycles: int = 0
    alarms: int = 0
    charge_enabled: bool = False
    discharge_enabled: bool = False
    temperatures: list[float] = field(default_factory=list)


class BatteryDriver(abc.ABC):
    """A battery's reports.  Others are found by the entry points ``thorvaldc.batteries``."""

    def __init__(self, bus: Bus, node: Node) -> None:
        self.node = node
        self.codecs = {
            frame.name.removeprefix(f"{node.name}_"): FrameCodec(frame)
            for frame in frames_of(bus, node)
        }
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        self.state = BatteryState()

    @property
    @abc.abstractmethod
    def warning(self) -> str:
        """What somebody should know of it; empty: nothing."""


class KcBatteryDriver(BatteryDriver):
    """The battery by KC: three frames, all of them its own."""

    def __init__(self, bus: Bus, node: Node) -> None:
        super().__init__(bus, node)
        self._temperatures = [math.nan] * 6
        for codec in self.codecs.values():
            self._listen(codec)

    def _listen(self, codec: FrameCodec) -> None:
        def take(data: bytes, time: float) -> None:
            self._take(codec.named(data), time)

        self.handlers[codec.cob_id] = take

    def _take(self, values: dict[str, float], time: float) -> None:
        state = self.state
        state.time = time
        for i in range(6):
            found = values.get(f"temperature_{i + 1}")
            if found is not None:
                self._temperatures[i] = found
        state.temperatures = [t for t in self._temperatures if not math.isnan(t)]
        if "voltage" in values:
            state.voltage = values["voltage"]
            state.alarms = int(values["alarms"])
            state.charge_enabled = bool(values["charge_enabled"])
            state.discharge_enabled = bool(values["discharge_enabled"])
        if "current" in values:
            state.current = values["current"]
        if "state_of_charge" in values:
            state.charge = values["state_of_charge"] / 100.0
            state.health = values["state_of_health"] / 100.0
            state.cycles = int(values["charge_cycles"])

    @property
    def warning(self) -> str:
        if self.state.alarms:
            return f"alarms {self.state.alarms:#06x}"
        if self.state.charge < 0.1:
            return f"{100.0 * self.state.charge:.0f} % left"
        return ""


class IoBoardDriver:
    """An IO board: its outputs by name, and what it says of them and of its inputs."""

    def __init__(self, bus: Bus, node: Node) -> None:
        self.node = node
        codecs = {
            frame.name.removeprefix(f"{node.name}_"): FrameCodec(frame)
            for frame in frames_of(bus, node)
        }
        self._outputs = next((c for c in codecs.values() if c.frame.producer == MASTER), None)
        self._report = next((c for c in codecs.values() if c.frame.producer == node.name), None)
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        if self._report is not None:
            self.handlers[self._report.cob_id] = self._take
        self.time = -math.inf
        self.reported: dict[str, float] = {}
        properties = dict(node.properties)
        self.outputs: dict[str, bool] = {}
        self._kind: dict[str, float] = {}
        if self._outputs is not None:
            for signal in self._outputs.frame.signals:
                if signal.choices:
                    self._kind[signal.name] = signal.choices[0][0]
                elif signal.length == 1:
                    self.outputs[signal.name] = bool(properties.get(f"{signal.name}_at_start"))

    def switch(self, name: str, on: bool) -> Message:
        """The frame that switches an output, the others as they are.  Raises ``KeyError``."""
        if name not in self.outputs or self._outputs is None:
            raise KeyError(name)
        self.outputs[name] = on
        values: dict[str, float] = {key: float(value) for key, value in self.outputs.items()}
        return Message(self._outputs.cob_id, self._outputs.encode_named({**values, **self._kind}))

    @property
    def inputs(self) -> int:
        return int(self.reported.get("inputs", 0))

    def state_of(self, name: str) -> bool | None:
        """What the board says of an output; ``None``: nothing yet."""
        found = self.reported.get(f"{name}_state")
        return None if found is None else bool(found)

    def _take(self, data: bytes, time: float) -> None:
        if self._report is not None:
            self.reported, self.time = self._report.named(data), time


PLUGINS: PluginTable[BatteryDriver] = PluginTable(
    "thorvaldc.batteries",
    BatteryDriver,
    {"thorvald_kc_battery": "thorvaldc.runtime.can_base.battery_and_io_drivers:KcBatteryDriver"},
)


def battery_driver(bus: Bus, node: Node) -> BatteryDriver | None:
    """The driver of a battery; ``None`` for a node that is none, or of an unknown kind."""
    found = driver_class(PLUGINS, node)
    return None if found is None else found(bus, node)
