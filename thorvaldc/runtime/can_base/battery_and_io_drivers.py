"""Drivers of batteries and IO boards on the CAN bus, and the supervision of the batteries."""

from __future__ import annotations

import abc
import enum
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Battery, Bus, Node, Robot
from thorvaldc.model.bus import MASTER
from thorvaldc.model.plugins import PluginTable
from thorvaldc.model.settings import BatterySettings
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.can_base.motor_controller import driver_class, node_codecs, required_driver
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

_KC_TEMPERATURES = 6


@dataclass(slots=True)
class BatteryState:
    """Newest reported state of a battery.

    The value NaN means that the battery has not reported the quantity yet.

    - ``time``: time (s) of the newest report;
    - ``voltage``: voltage in V;
    - ``current``: current in A, positive while the battery discharges;
    - ``charge``, ``health``: state of charge and state of health, 0 to 1;
    - ``cycles``: number of charge cycles;
    - ``alarms``: alarm bits that the manufacturer of the battery defines;
    - ``charge_enabled``, ``discharge_enabled``: ``True`` if the battery allows a current in this
      direction;
    - ``temperatures``: temperatures in degrees Celsius.
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

    @property
    def source(self) -> dict[str, float]:
        """Voltage (V), current (A) and state of charge (0 to 1) by name."""
        return {"voltage": self.voltage, "current": self.current, "charge": self.charge}


class BatteryDriver(abc.ABC):
    """Decodes the CAN frames that a battery sends; it sends nothing.

    A Python package can add one with the entry-point group ``thorvaldc.batteries``
    (docs/batteries.md).
    """

    def __init__(self, bus: Bus, node: Node) -> None:
        self.node = node
        self.codecs = node_codecs(bus, node)
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        """Handlers by key of a frame; called once in a cycle with its newest data and time (s)."""
        self.state = BatteryState()

    @property
    def charge_time(self) -> float:
        """Time (s) of the newest report of the state of charge."""
        return self.state.time

    @property
    @abc.abstractmethod
    def warning(self) -> str:
        """Problem that the battery reports, such as an alarm, or an empty text.

        The state of charge is judged by ``BatterySupervision``.
        """

    @property
    def problem(self) -> str:
        """``warning``, or that a report is impossible: no battery supplies a robot with 0 V."""
        if self.state.voltage <= 0.0:
            return f"reports a voltage of {self.state.voltage:g} V"
        return self.warning


class KcBatteryDriver(BatteryDriver):
    """Driver of the KC battery, which broadcasts three different CAN frames."""

    def __init__(self, bus: Bus, node: Node) -> None:
        super().__init__(bus, node)
        self._temperatures = [math.nan] * _KC_TEMPERATURES
        self._charge_time = -math.inf
        for codec in self.codecs.values():
            self._add_handler(codec)

    def _add_handler(self, codec: FrameCodec) -> None:
        def handle(data: bytes, time: float) -> None:
            self._update(codec.decode_named(data), time)

        self.handlers[codec.key] = handle

    def _update(self, values: dict[str, float], time: float) -> None:
        state = self.state
        state.time = time
        for i in range(_KC_TEMPERATURES):
            temperature = values.get(f"temperature_{i + 1}")
            if temperature is not None:
                self._temperatures[i] = temperature
        state.temperatures = [t for t in self._temperatures if not math.isnan(t)]
        if "voltage" in values:
            state.voltage = values["voltage"]
            state.alarms = int(values["alarms"])
            state.charge_enabled = bool(values["charge_enabled"])
            state.discharge_enabled = bool(values["discharge_enabled"])
        if "current" in values:
            state.current = values["current"]
        if "state_of_charge" in values:
            self._charge_time = time
            state.charge = values["state_of_charge"] / 100.0
            state.health = values["state_of_health"] / 100.0
            state.cycles = int(values["charge_cycles"])

    @property
    def charge_time(self) -> float:
        return self._charge_time

    @property
    def warning(self) -> str:
        if self.state.alarms:
            return f"alarms {self.state.alarms:#06x}"
        # The voltage is in the same frame as the state of the switches.
        if not math.isnan(self.state.voltage) and not self.state.discharge_enabled:
            return "discharge is not enabled"
        return ""


class IoBoardDriver:
    """Driver of an IO board, which switches outputs by name and decodes the reports of the IO
    board."""

    def __init__(self, bus: Bus, node: Node) -> None:
        self.node = node
        codecs = node_codecs(bus, node).values()
        self._command = next((c for c in codecs if c.frame.producer == MASTER), None)
        self._report = next((c for c in codecs if c.frame.producer == node.name), None)
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        if self._report is not None:
            self.handlers[self._report.key] = self._handle_report
        self.time = -math.inf
        """Time (s) of the newest report."""
        properties = dict(node.properties)
        self.outputs: dict[str, bool] = {}
        """Commanded state of each output by name."""
        self._constants: dict[str, float] = {}
        if self._command is not None:
            for signal in self._command.frame.signals:
                if signal.choices:
                    self._constants[signal.name] = signal.choices[0][0]
                elif signal.length == 1:
                    self.outputs[signal.name] = bool(properties.get(f"{signal.name}_at_start"))

    def switch(self, name: str, on: bool) -> CanFrame:
        """Returns the CAN frame that switches the output ``name`` on or off.

        The other outputs of the IO board keep their states.  Raises ``KeyError`` if the IO board
        has no output ``name``.
        """
        if name not in self.outputs or self._command is None:
            raise KeyError(name)
        self.outputs[name] = on
        values: dict[str, float] = {key: float(value) for key, value in self.outputs.items()}
        data = self._command.encode_named({**values, **self._constants})
        return self._command.can_frame(data)

    def _handle_report(self, data: bytes, time: float) -> None:
        if self._report is not None:
            self._report.decode(data)  # a malformed report is no sign of life
            self.time = time


PLUGINS: PluginTable[BatteryDriver] = PluginTable(
    "thorvaldc.batteries",
    BatteryDriver,
    {
        "thorvald_kc_battery": "thorvaldc.runtime.can_base.battery_and_io_drivers:KcBatteryDriver",
    },
)


def battery_driver(robot: Robot, bus: Bus, node: Node) -> BatteryDriver | None:
    """Returns the battery driver for a node, or ``None`` for a device that is no battery.

    Raises ``DiagnosticError`` (``bus-driver-unknown``) if no driver supports the protocol of a
    battery of the robot: without its driver, nothing would notice that it is empty.
    """
    is_battery = any(battery.node == node.name for battery in robot.batteries)
    driver = (required_driver if is_battery else driver_class)(PLUGINS, node)
    return None if driver is None else driver(bus, node)


# -- judges the batteries, and limits or stops the robot while their charge is low --------------
#
# Level of a battery, from its state of charge and the thresholds of the robot file:
#
#     charge   100 %           warn         limit          stop          0 %
#                |--------------|-------------|--------------|------------|
#     level           OK             WARN          LIMIT          STOP
#     speed          100 %          100 %        ``speed``         0
#
# The battery with the worst level determines the level of the robot, because the model does not
# tell which battery supplies which motor.  Batteries in parallel supply all motors together: the
# charge of their common supply has a level of its own, and the charge of one of them is at most a
# warning.  A battery that has sent no state of charge for ``SILENCE_LIMIT`` seconds has the level
# LIMIT, and after ``BatterySettings.silence`` the level STOP, also in parallel: nothing tells
# whether it still supplies its share of the current.  A battery that does not allow a discharge
# current, or that reports alarms, is a warning and a reason not to arm the robot.
#
# A level becomes worse after ``WORSE_TIME`` seconds, so that a single wrong report changes nothing.
# A level becomes better when the charge is by ``HYSTERESIS`` above the threshold.

SILENCE_LIMIT = 1.0
"""Time (s) without a state of charge after which the speed is limited."""
INTERVAL = 0.1
"""Time (s) between two judgements, which is the period of the reports of the KC battery."""
WORSE_TIME = 1.0
"""Time (s) for which a worse level must last."""
HYSTERESIS = 0.02
"""Distance (0 to 1) of the charge above a threshold at which the level becomes better."""
SUPPLY = "supply"
"""Name of the common supply of several batteries in parallel."""


class BatteryLevel(enum.IntEnum):
    """Reaction to the state of a battery; see the docstring of this module."""

    OK = 0
    WARN = 1
    LIMIT = 2
    STOP = 3


class _Judgement:
    """Level of a battery or of the supply, its reason, and the time since which it is worse."""

    def __init__(self, now: float) -> None:
        self.level = BatteryLevel.OK
        self.reason = ""
        self.first_seen = now
        self.worse_since = math.inf


class BatterySupervision:
    """Level of all batteries on the buses of a robot.

    A robot without a battery on its buses always has the level ``OK``.

    - ``level``: worst level of all batteries;
    - ``reason``: reason of the level with the name of the battery, empty at the level ``OK``.
    """

    def __init__(
        self,
        settings: BatterySettings,
        batteries: Sequence[BatteryDriver],
        source: Sequence[Battery] = (),
    ) -> None:
        """``source``: the batteries that supply the robot together, see ``Robot.common_source``."""
        self.settings = settings
        self.batteries = batteries
        capacities = {battery.node: battery.capacity for battery in source}
        supplying = [b for b in batteries if b.node.name in capacities]
        # The state of a supply with a battery that is on no bus is not known.
        self._supplying = supplying if len(supplying) == len(capacities) else []
        self._capacities = [capacities[battery.node.name] or 0.0 for battery in self._supplying]
        self.has_several = len(self._supplying) > 1
        """``True`` if several batteries are the common source of the robot."""
        self._now = -math.inf
        self.level = BatteryLevel.OK
        self.reason = ""
        self._judgements: dict[str, _Judgement] = {}
        self._due = -math.inf

    @property
    def speed_share(self) -> float:
        """Share (0 to 1) of the top speeds of the robot at the present level."""
        if self.level is BatteryLevel.STOP:
            return 0.0
        return self.settings.speed if self.level is BatteryLevel.LIMIT else 1.0

    @property
    def supply(self) -> BatteryState | None:
        """State of the common source of the robot, or ``None``; NaN while a battery is silent.

        The currents add up, the voltage is the mean.  The state of charge is the mean by capacity,
        or that of the emptiest battery if a module does not state its capacity.
        """
        if not self._supplying:
            return None
        states = [battery.state for battery in self._supplying]
        charges = [state.charge for state in states]
        time = min(battery.charge_time for battery in self._supplying)
        if self._now - time > SILENCE_LIMIT or any(map(math.isnan, charges)):
            return BatteryState(time)
        charge = min(charges)
        if all(self._capacities):
            left = float_sum(map(operator.mul, self._capacities, charges))
            charge = left / float_sum(self._capacities)
        voltage = float_sum(state.voltage for state in states) / len(states)
        return BatteryState(time, voltage, float_sum(state.current for state in states), charge)

    def update(self, now: float) -> BatteryLevel:
        """Judges the newest reports of all batteries at the time ``now`` (s).

        The batteries are judged once in ``INTERVAL``, because their charge changes slowly.
        """
        self._now = now
        if now < self._due:
            return self.level
        self._due = now + INTERVAL
        self.level, self.reason = BatteryLevel.OK, ""
        worst = BatteryLevel.WARN if self.has_several else BatteryLevel.STOP
        for battery in self.batteries:
            self._judge(battery.node.name, battery.charge_time, battery.state.charge, worst)
        if self.has_several and (supply := self.supply) is not None:
            self._judge(SUPPLY, now, supply.charge, BatteryLevel.STOP)
        for name, judgement in self._judgements.items():
            if judgement.level > self.level:
                self.level, self.reason = judgement.level, f"{name}: {judgement.reason}"
        return self.level

    def problem(self, name: str) -> str:
        """Returns why the level of a battery or of ``SUPPLY`` is not ``OK``, or an empty text."""
        judgement = self._judgements.get(name)
        return judgement.reason if judgement is not None and judgement.level else ""

    def warnings(self) -> list[str]:
        """Returns the reason of each battery whose level is not ``OK``, and its own warnings."""
        warnings = [f"{n}: {reason}" for n in self._judgements if (reason := self.problem(n))]
        return warnings + [f"{b.node.name}: {b.problem}" for b in self.batteries if b.problem]

    def arming_reasons(self, now: float) -> Iterator[str]:
        """Yields the reasons against arming the robot at the time ``now`` (s)."""
        for battery in self.batteries:
            state, name = battery.state, battery.node.name
            if now - battery.charge_time > SILENCE_LIMIT or math.isnan(state.charge):
                yield f"{name}: no reports of its charge"
            elif not self.has_several:
                yield from self._too_low_to_arm(name, state.charge)
            if battery.problem:
                yield f"{name}: {battery.problem}"
        if self.has_several and (supply := self.supply) is not None:
            yield from self._too_low_to_arm(SUPPLY, supply.charge)

    # -- inside --------------------------------------------------------------------------------

    def _too_low_to_arm(self, name: str, charge: float) -> Iterator[str]:
        if charge < self.settings.arm:
            percent, limit = 100.0 * charge, 100.0 * self.settings.arm
            yield f"{name}: {percent:.0f} % left, less than {limit:.0f} %"

    def _judge(self, name: str, time: float, charge: float, worst: BatteryLevel) -> None:
        """``time``: time (s) of the report; ``worst``: worst level by charge, not by silence."""
        now, judgement = self._now, self._judgements.setdefault(name, _Judgement(self._now))
        silence = now - max(time, judgement.first_seen)
        if silence > SILENCE_LIMIT:
            level = BatteryLevel.LIMIT
            if silence > self.settings.silence:
                level = BatteryLevel.STOP
            judgement.level, judgement.worse_since = max(level, judgement.level), math.inf
            judgement.reason = f"no reports of its charge for {silence:.0f} s"
            return
        if math.isnan(charge):
            return  # the first report is still awaited
        level = min(self._level(charge), worst)
        if level > judgement.level:
            judgement.worse_since = min(judgement.worse_since, now)
            if now - judgement.worse_since < WORSE_TIME:
                return
        elif level < judgement.level:
            level = max(level, min(self._level(charge - HYSTERESIS), worst))
        judgement.level, judgement.worse_since = level, math.inf
        judgement.reason = f"{100.0 * charge:.0f} % left"

    def _level(self, charge: float) -> BatteryLevel:
        settings = self.settings
        if charge < settings.stop:
            return BatteryLevel.STOP
        if charge < settings.limit:
            return BatteryLevel.LIMIT
        return BatteryLevel.WARN if charge < settings.warn else BatteryLevel.OK
