"""The Thorvald's motor controller: Roboteq FBL2360 with the robot's script.

Two channels, propulsion and steering or two propulsions.  CANopen framing, not CiA 402.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from thorvaldc.model.bus import Bus, Node, ObjectValue
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.can_base.motor_controller import (
    STANDING,
    Axis,
    Intent,
    Message,
    MotorController,
)

DRIVE, HOME, DECOUPLED = 0, 1, 2
REPEAT = 1.0
"""s after which a mode is told again: nothing tells whether it was heard."""
QUICK = 100
"""ms between two frames of constants while the script is looked at, in place of seconds."""
STOP_TIME = 2.0
"""s after which a stopped controller gets no torque, whatever it tells."""
STRAY_TIME = 0.5
"""s by which a motor may be late to do what it is told: the script confirms nothing."""
STRAY_CONFIRMED = 0.1
"""s for which a wheel's speed must be none of those: a bump is over sooner."""
STRAY_SHARE, STRAY_SPEED, STRAY_ANGLE = 0.5, 0.3, 0.2
"""Of the speeds told in that time and rad/s, whichever is more; rad of a steering that stands."""
HOMED, HOMING = 0x01, 0x02
"""Bits of the configuration in TPDO4."""
_CHECKED = (0x1017, 0x1018)


class RoboteqScript(MotorController):
    """Speaks with the script.  What it tells of itself late, its homing, is asked for faster."""

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        self._sequence = 0
        self._modes: tuple[int, int] | None = None
        self._told_at = -math.inf
        self._fast: bool | None = None
        self._flags: dict[str, float] = {}
        self._flags_at = -math.inf
        self._constants: dict[str, float] = {}
        self._home_asked = False
        self._home_from = -math.inf
        self._homing_failed = False
        self._stopped_at: float | None = None
        self._home_count = 0
        self._astray: dict[str, float] = {}
        self._told_speeds: dict[str, deque[tuple[float, float]]] = {}
        channels: list[Axis | None] = [self.axis_of(channel.name) for channel in node.channels]
        self._first, self._second = (*channels, None, None)[:2]
        for name, take in (
            ("tpdo1", self._motion),
            ("tpdo2", self._currents),
            ("tpdo3", self._state),
            ("tpdo4", self._constant),
        ):
            if name in self.codecs:
                self.handlers[self.codecs[name].cob_id] = take
        self.supply_voltage = math.nan
        self.temperature = math.nan
        self._tpdo1_axes = tuple(self._readings())

    # -- reports -------------------------------------------------------------------------------

    def _readings(self) -> Iterator[tuple[Axis, int | None, int | None]]:
        """Each axis with the places of its position and its speed in TPDO1."""
        frame = self.codecs["tpdo1"].frame
        for axis in self.axes:
            own = [(i, s) for i, s in enumerate(frame.signals) if s.joint == axis.joint]
            position = next((i for i, s in own if s.unit == "rad"), None)
            velocity = next((i for i, s in own if s.unit == "rad/s"), None)
            yield axis, position, velocity

    def _motion(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo1"].decode(data)
        for axis, position, velocity in self._tpdo1_axes:
            axis.measured(
                time,
                values[position] if position is not None else 0.0,
                values[velocity] if velocity is not None else None,
            )

    def _currents(self, data: bytes, time: float) -> None:
        """Of interest to a display; decoded where it is asked for."""

    def _state(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo3"].named(data)
        self.temperature = values.pop("temperature", math.nan)
        self.supply_voltage = values.pop("supply_voltage", math.nan)
        values.pop("supply_current", None)
        self._flags, self._flags_at = values, time

    def _constant(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo4"].named(data)
        self._constants.update(values)
        if "configuration" in values and time > self._home_from:
            word = int(values["configuration"])
            if self._home_asked and not word & HOMING and not word & HOMED:
                self._homing_failed = True
            self._set_homed(bool(word & HOMED) and not word & HOMING)

    def _set_homed(self, homed: bool) -> None:
        for axis in self.axes:
            if axis.steering and axis.homed != homed:
                axis.homed = homed
                axis.target = axis.position

    # -- what it says of itself ------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        wanted = (DRIVE, DRIVE)
        return self._modes == wanted and not self.problem and not self.unpowered

    @property
    def is_off(self) -> bool:
        return self._modes == (DECOUPLED, DECOUPLED)

    @property
    def problem(self) -> str:
        said = [
            name.replace("_", " ")
            for name, value in self._flags.items()
            if value and name not in ("controller_not_ok", "power_stage_off")
        ]
        if self._flags.get("controller_not_ok") and not said and not self.unpowered:
            said = ["controller not ok"]
        if self._homing_failed:
            said.append("the home switch was not found")
        said += [
            f"the {axis.channel} does not do what it is told"
            for axis in self.axes
            if axis.time - self._astray.get(axis.channel, math.inf) > STRAY_TIME
        ]
        if self.error_code:
            said.append(f"emergency {self.error_code:#06x}")
        return ", ".join(said)

    @property
    def unpowered(self) -> str:
        flags = self._flags
        if flags.get("power_stage_off") and not flags.get("stall"):
            return "the power stage is off"
        return ""

    @property
    def needs_restart(self) -> bool:
        return bool(self.problem)

    def identity(self) -> str | None:
        """The script's version and type, and the encoders that it counts with."""
        seen = self._constants
        properties = dict(self.node.properties)
        if "version_major" not in seen or self._flags_at == -math.inf:
            return None
        found = ".".join(f"{int(seen[f'version_{p}'])}" for p in ("major", "minor", "patch"))
        wanted = str(properties.get("script_version", found))
        if found != wanted:
            return f"its script has the version {found}, not {wanted}"
        kind, of_file = int(seen["controller_type"]), properties.get("script_type")
        if of_file is not None and kind != of_file:
            return f"its script is of type {kind}, not {of_file}"
        for axis in self.axes:
            name = f"{axis.channel}_encoder_ppr"
            if name not in self.codecs["tpdo4"].places:
                continue
            if name not in seen:
                return None
            if int(seen[name]) != axis.actuator.encoder_ppr:
                return (
                    f"its {axis.channel} encoder is set up for {int(seen[name])} pulses, "
                    f"the robot's file says {axis.actuator.encoder_ppr}"
                )
        return None if "configuration" not in seen else ""

    def objects(self) -> Iterator[ObjectValue]:
        """Who made it, and its heartbeat; its PDOs are fixed by the script."""
        for entry in self.node.objects:
            if entry.index in _CHECKED and entry.value is not None:
                yield entry

    def restarted(self) -> None:
        super().restarted()
        self._modes, self._told_at, self._fast = None, -math.inf, None
        self._flags, self._flags_at, self._constants = {}, -math.inf, {}
        self._homing_failed, self._home_asked = False, False

    def home_again(self, now: float) -> None:
        super().home_again(now)
        self._home_from = math.inf

    def allow_reset(self) -> None:
        self.error_code = 0
        self._homing_failed = False

    def _watch(self, follows: bool, now: float) -> None:
        """Since when each motor has done something else than it is told.

        A wheel may do whatever it was told within ``STRAY_TIME``: it ramps, and is late.
        """
        for axis in self.axes:
            if not follows:
                self._astray.pop(axis.channel, None)
                self._told_speeds.pop(axis.channel, None)
                continue
            since = axis.time
            if axis.steering:
                off = abs(axis.position - axis.target) > STRAY_ANGLE
                strays = off and abs(axis.velocity) < STANDING
            else:
                told = self._told_speeds.setdefault(axis.channel, deque())
                told.append((now, axis.target))
                while told[0][0] < now - STRAY_TIME:
                    told.popleft()
                speeds = [speed for _, speed in told]
                least, most = min(speeds), max(speeds)
                low = least - max(STRAY_SHARE * abs(least), STRAY_SPEED)
                high = most + max(STRAY_SHARE * abs(most), STRAY_SPEED)
                strays = not low <= axis.velocity <= high
                since -= STRAY_TIME - STRAY_CONFIRMED  # it was late already
            if strays:
                self._astray.setdefault(axis.channel, since)
            else:
                self._astray.pop(axis.channel, None)

    # -- commands ----------------------------------------------------------------------------------

    def cyclic(self, intent: Intent, now: float) -> list[Message]:
        follows = intent is Intent.FOLLOW
        if intent is not Intent.QUICK_STOP:
            self._stopped_at = None
        elif self._stopped_at is None:
            self._stopped_at = now
            self.hold()
        self._watch(follows and self._modes == (DRIVE, DRIVE), now)
        self._sequence = self._sequence % 0x7FFFFFFF + 1
        messages = [self._speed("rpdo1", self._first, follows)]
        second = self._second
        if second is not None and not second.steering:
            messages.append(self._speed("rpdo4", second, follows))
        elif second is not None and second.homed and intent is not Intent.HOME:
            # A position means nothing to a steering that does not know where it is.
            if intent is Intent.OFF:
                second.target = second.position
            codec, top = self.codecs["rpdo4"], second.actuator.max_velocity
            messages.append(Message(codec.cob_id, codec.encode([top, second.target])))
        return messages

    def _speed(self, name: str, axis: Axis | None, follows: bool) -> Message:
        codec = self.codecs[name]
        target = axis.target if axis is not None and follows else 0.0
        values = [
            self._sequence if signal.name == "sequence" else target
            for signal in codec.frame.signals
        ]
        return Message(codec.cob_id, codec.encode(values))

    def sporadic(self, intent: Intent, now: float) -> Message | None:
        """The modes, when they change and now and then; how often constants are wanted."""
        looking = intent in (Intent.OFF, Intent.HOME)
        if looking is not self._fast and "tpdo4" in self.codecs:
            self._fast = looking
            period = self.codecs["tpdo4"].frame.period or 1.0
            return self.setting("tpdo4_cycle_time", QUICK if looking else period * 1000.0)
        modes = self._wanted(intent, now)
        homing = HOME in modes
        if modes != self._modes or (now - self._told_at > REPEAT and not homing):
            if homing and modes != self._modes:
                self._home_asked = True
                # What it said of its homing before is not about this one.
                self._home_from = now + 2.0 * QUICK / 1000.0
                self._homing_failed = False
            self._modes, self._told_at = modes, now
            codec = self.codecs["rpdo3"]
            axes = (self._first, self._second)
            kept = [mode for mode, axis in zip(modes, axes, strict=True) if axis is not None]
            return Message(codec.cob_id, codec.encode([float(mode) for mode in kept]))
        return None

    def _wanted(self, intent: Intent, now: float) -> tuple[int, int]:
        if intent is Intent.FOLLOW:
            return DRIVE, DRIVE
        if intent is Intent.HOME:
            second = self._second
            if second is not None and second.steering and not second.homed:
                return DRIVE, HOME
            return DRIVE, DRIVE
        if intent is Intent.QUICK_STOP and self._modes is not None:
            # First to rest.  One that does not tell how fast it is has had time for it.
            since = now if self._stopped_at is None else self._stopped_at
            if not self.standing and now - since < STOP_TIME:
                return self._modes
        return DECOUPLED, DECOUPLED

    def zero_here(self) -> Message | None:
        """The home count in force is that which was set last, 0 before: it cannot be asked for."""
        steering = next((axis for axis in self.axes if axis.steering), None)
        if steering is None or "home_count" not in self.settings():
            return None
        signals = self.codecs["tpdo1"].frame.signals
        scale = next(s.scale for s in signals if s.joint == steering.joint and s.unit == "rad")
        self._home_count -= round(steering.position / scale)
        return self.setting("home_count", self._home_count)

    def settings(self) -> tuple[str, ...]:
        if "rpdo2" not in self.codecs:
            return ()
        signal = self.codecs["rpdo2"].frame.signals[0]
        return tuple(name for _, name in signal.choices)

    def setting(self, name: str, value: float) -> Message:
        if name not in self.settings():
            return super().setting(name, value)
        codec = self.codecs["rpdo2"]
        number = next(raw for raw, known in codec.frame.signals[0].choices if known == name)
        if not math.isfinite(value) or not -(2**31) <= round(value) < 2**31:
            raise ValueError(f"{name} cannot be {value:g}")
        return Message(codec.cob_id, codec.encode([float(number), round(value)]))
