"""Driver of the Thorvald's motor controller, a Roboteq FBL2360 with the Thorvald script.

The Roboteq motor controller has two channels: one propulsion and one steering motor, or two
propulsion motors.  The Thorvald script on the Roboteq controller uses CANopen messages, but not the
drive profile CiA 402.  PDOs of the Thorvald script and the script variables that each PDO contains:

    RPDO 1  every cycle   sequence number, speed of channel 1
    RPDO 2  on request    number of a setting, value
    RPDO 3  on a change   mode of each channel: drive, home, decoupled
    RPDO 4  every cycle   speed, or top speed and angle, of channel 2
    TPDO 1  every cycle   measured speeds, steering angle
    TPDO 2  100 ms        currents and powers, which the driver does not use
    TPDO 3  100 ms        flags (device errors), temperature, voltage
    TPDO 4  slow          one of several constants in turn: configuration, version, encoders

The Thorvald script on the Roboteq controller does not confirm motor commands.  The Thorvald script
stops the wheels 0.5 s after the last motor command with a new sequence number.  A motor
that does not follow its commands is detected by its measured motion (``motion_supervision``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import ClassVar, Final

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus, Node, ObjectValue, Robot
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.runtime.mypyc_marks import mypyc_attr

# Operating modes of a channel of the Roboteq motor controller.
DRIVE: Final = 0
HOME: Final = 1
DECOUPLED: Final = 2
# Bits of the configuration word in TPDO 4.
HOMED: Final = 0x01
HOMING: Final = 0x02

MODE_REPEAT: Final = 1.0
"""Time (s) after which the modes are sent again, because the script does not report modes."""
_ROUNDING: Final = 1e-6
FAST_CONSTANTS: Final = 100
"""Period (ms) of TPDO 4 while the motors are off or homing; the normal period is seconds."""


@mypyc_attr(allow_interpreted_subclasses=True)
class RoboteqScriptController(MotorController):
    """Driver of a Roboteq motor controller with the Thorvald script."""

    powers_single_motors: ClassVar[bool] = True

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        self._sequence = 0
        self._modes: tuple[int, int] | None = None
        self._modes_sent_at = -math.inf
        self._fast_constants: bool | None = None
        self._flags: dict[str, float] = {}
        self._flags_at = -math.inf
        self._constants: dict[str, float] = {}
        self._home_commanded = False
        self._home_reports_from = -math.inf
        self._homing_failed = False
        self._stopping = False
        self._home_count = 0
        self._set_periods: dict[str, float] = {}
        """Periods (s) of reports that were set by ``setting_frame``, by frame name."""
        channels: list[Axis | None] = [self.axis_of(channel.name) for channel in node.channels]
        self._first, self._second = (*channels, None, None)[:2]
        for name, handler in (
            ("tpdo1", self._handle_motion),
            ("tpdo3", self._handle_state),
            ("tpdo4", self._handle_constant),
        ):
            if name in self.codecs:
                self.handlers[self.codecs[name].key] = handler
        self.supply_voltage = math.nan
        self.temperature = math.nan
        self._motion_signals = tuple(self._signals_of_axes())

    # -- reports -------------------------------------------------------------------------------

    def _signals_of_axes(self) -> Iterator[tuple[Axis, int | None, int | None]]:
        """Yields each motor axis with the indices of the position signal and the velocity signal in
        TPDO 1."""
        frame = self.codecs["tpdo1"].frame
        for axis in self.axes:
            signals = [(i, s) for i, s in enumerate(frame.signals) if s.joint == axis.joint]
            position = next((i for i, s in signals if s.unit == "rad"), None)
            velocity = next((i for i, s in signals if s.unit == "rad/s"), None)
            yield axis, position, velocity

    def _handle_motion(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo1"].decode(data)
        for axis, position, velocity in self._motion_signals:
            axis.update(
                time,
                values[position] if position is not None else 0.0,
                values[velocity] if velocity is not None else None,
            )

    def _handle_state(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo3"].decode_named(data)
        self.temperature = values.pop("temperature", math.nan)
        self.supply_voltage = values.pop("supply_voltage", math.nan)
        values.pop("supply_current", None)
        self._flags, self._flags_at = values, time

    def _handle_constant(self, data: bytes, time: float) -> None:
        values = self.codecs["tpdo4"].decode_named(data)
        self._constants.update(values)
        if "configuration" in values and time > self._home_reports_from:
            word = int(values["configuration"])
            if self._home_commanded and not word & HOMING and not word & HOMED:
                self._homing_failed = True
            self._set_homed(bool(word & HOMED) and not word & HOMING)

    def _set_homed(self, homed: bool) -> None:
        for axis in self.axes:
            if axis.steering and axis.homed != homed:
                axis.homed = homed
                axis.hold()

    # -- state -----------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        drives = self._modes == self._required_modes(Intent.FOLLOW)
        return drives and not self.problem and not self.power_loss

    @property
    def is_off(self) -> bool:
        return self._modes == (DECOUPLED, DECOUPLED)

    @property
    def problem(self) -> str:
        flagged = any(self._flags.values())
        if not (flagged or self._homing_failed or self.error_code):
            return ""  # the normal case, which is asked several times in each cycle
        problems = [
            name.replace("_", " ")
            for name, value in self._flags.items()
            if value and name not in ("controller_not_ok", "power_stage_off")
        ]
        if self._flags.get("controller_not_ok") and not problems and not self.power_loss:
            problems = ["controller not ok"]
        if self._homing_failed:
            problems.append("the home switch was not found")
        if self.error_code:
            problems.append(f"emergency {self.error_code:#06x}")
        return ", ".join(problems)

    @property
    def power_loss(self) -> str:
        # The power stage is also off after a motor stall, but a motor stall is reported as a device
        # error.
        if self._flags.get("power_stage_off") and not self._flags.get("stall"):
            return "the power stage is off"
        return ""

    @property
    def needs_restart(self) -> bool:
        return self.disobeyed or bool(self.problem)

    def identity_mismatch(self) -> str | None:
        """Compares the script version, the script type and the encoder pulses with the robot
        file."""
        reported = self._constants
        properties = dict(self.node.properties)
        if "version_major" not in reported or self._flags_at == -math.inf:
            return None
        parts = ("major", "minor", "patch")
        version = ".".join(f"{int(reported[f'version_{part}'])}" for part in parts)
        expected_version = str(properties.get("script_version", version))
        if version != expected_version:
            return f"its script has the version {version}, not {expected_version}"
        script_type, expected_type = int(reported["controller_type"]), properties.get("script_type")
        if expected_type is not None and script_type != expected_type:
            return f"its script has the type {script_type}, not {expected_type}"
        for axis in self.axes:
            name = f"{axis.channel}_encoder_ppr"
            if name not in self.codecs["tpdo4"].indices:
                continue
            if name not in reported:
                return None
            if int(reported[name]) != axis.actuator.encoder_ppr:
                return (
                    f"its {axis.channel} encoder is configured for {int(reported[name])} pulses, "
                    f"but the robot file has {axis.actuator.encoder_ppr}"
                )
        return None if "configuration" not in reported else ""

    def expected_objects(self) -> Iterator[ObjectValue]:
        """Yields all required objects but the event timers that ``setting_frame`` changes.

        Reports that come too rarely or too often are found without them.
        """
        settings = self.setting_names()
        return (
            entry
            for entry in super().expected_objects()
            if f"{entry.name.removesuffix('_event_timer')}_cycle_time" not in settings
        )

    def shortest_periods(self) -> Mapping[str, float]:
        frame = self.codecs["tpdo4"].frame if "tpdo4" in self.codecs else None
        if frame is None or frame.period is None:
            return self._set_periods
        fast = {frame.name: min(frame.period, FAST_CONSTANTS / 1000.0)}
        return {**self._set_periods, **fast}

    def handle_restart(self) -> None:
        super().handle_restart()
        self._modes, self._modes_sent_at, self._fast_constants = None, -math.inf, None
        self._flags, self._flags_at, self._constants = {}, -math.inf, {}
        self._homing_failed, self._home_commanded = False, False

    def discard_home(self, now: float) -> None:
        super().discard_home(now)
        self._home_reports_from = math.inf

    def allow_reset(self) -> None:
        self.error_code = 0
        self._homing_failed = False

    # -- commands ----------------------------------------------------------------------------------

    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        follows = intent is Intent.FOLLOW
        if intent is Intent.QUICK_STOP and not self._stopping:
            self.hold()
        self._stopping = intent is Intent.QUICK_STOP
        self._sequence = self._sequence % 0x7FFFFFFF + 1
        frames = [self._speed_frame("rpdo1", self._first, follows)]
        second = self._second
        if second is not None and not second.steering:
            frames.append(self._speed_frame("rpdo4", second, follows))
        elif (
            second is not None
            and second.homed
            and math.isfinite(second.position)
            and intent is not Intent.HOME
        ):
            # No steering angle is commanded before the homing, because the zero of the steering
            # angle is unknown, nor before the first report of the angle: a controller that keeps
            # its home can report that first.
            if intent is Intent.OFF or self.power_loss or not second.powered:
                # A joint that was turned by hand without power does not jump when power returns.
                second.hold()
            codec, top_speed = self.codecs["rpdo4"], second.actuator.max_velocity
            frames.append(codec.can_frame(codec.encode([top_speed, second.target])))
        return frames

    def _speed_frame(self, name: str, axis: Axis | None, follows: bool) -> CanFrame:
        codec = self.codecs[name]
        target = axis.target if axis is not None and follows else 0.0
        values = [
            self._sequence if signal.name == "sequence" else target
            for signal in codec.frame.signals
        ]
        return codec.can_frame(codec.encode(values))

    def occasional_frame(self, intent: Intent, now: float) -> CanFrame | None:
        """Returns a CAN frame with a new period of TPDO 4 or with the modes of the motor channels,
        or ``None``.

        The modes of the motor channels are sent after a change, and again after ``MODE_REPEAT``
        seconds.  The homing mode is sent only once, because a second frame with the homing mode
        would restart the homing.
        """
        fast = intent in (Intent.OFF, Intent.HOME)
        if fast is not self._fast_constants and "tpdo4" in self.codecs:
            self._fast_constants = fast
            period = self.codecs["tpdo4"].frame.period or 1.0
            milliseconds = FAST_CONSTANTS if fast else period * 1000.0
            return self.setting_frame("tpdo4_cycle_time", milliseconds)
        if intent is Intent.QUICK_STOP and self._modes is None:
            # The node may have restarted unseen, and has no torque then.  If it has not, a mode
            # without torque would let a wheel roll that is braking now.
            return None
        modes = self._required_modes(intent)
        homing = HOME in modes
        repeat = now - self._modes_sent_at > MODE_REPEAT and not homing
        if modes == self._modes and not repeat:
            return None
        if homing and modes != self._modes:
            self._home_commanded = True
            # After the start of a homing, reports in the next two periods of TPDO 4 may still
            # describe the previous homing.
            self._home_reports_from = now + 2.0 * FAST_CONSTANTS / 1000.0
            self._homing_failed = False
        self._modes, self._modes_sent_at = modes, now
        codec = self.codecs["rpdo3"]
        axes = (self._first, self._second)
        used = [mode for mode, axis in zip(modes, axes, strict=True) if axis is not None]
        return codec.can_frame(codec.encode([float(mode) for mode in used]))

    def _required_modes(self, intent: Intent) -> tuple[int, int]:
        """Returns the modes of both channels; a motor that is not powered is decoupled."""
        first, second = self._modes_of_powered(intent)
        axes = (self._first, self._second)
        off = [axis is not None and not axis.powered for axis in axes]
        return DECOUPLED if off[0] else first, DECOUPLED if off[1] else second

    def _modes_of_powered(self, intent: Intent) -> tuple[int, int]:
        if intent is Intent.FOLLOW:
            return DRIVE, DRIVE
        if intent is Intent.HOME:
            second = self._second
            if second is not None and second.steering and not second.homed:
                return DRIVE, HOME
            return DRIVE, DRIVE
        if intent is Intent.QUICK_STOP and self._modes is not None:
            # The motors keep the torque that they have, but a homing ends.
            first, steering = self._modes
            return first, DECOUPLED if steering == HOME else steering
        return DECOUPLED, DECOUPLED

    # -- settings ----------------------------------------------------------------------------------

    def set_zero_frame(self) -> CanFrame | None:
        """Returns the CAN frame that defines the present steering angle as zero.

        The Thorvald script stores the zero of the steering angle as an encoder count (home count),
        but does not report the home count.  The new home count of the steering encoder is computed
        from the last home count that the driver has sent.  The driver assumes that the home count
        of the steering encoder is 0 before the first change.
        """
        steering = next((axis for axis in self.axes if axis.steering), None)
        if steering is None or "home_count" not in self.setting_names():
            return None
        signals = self.codecs["tpdo1"].frame.signals
        scale = next(s.scale for s in signals if s.joint == steering.joint and s.unit == "rad")
        self._home_count -= round(steering.position / scale)
        return self.setting_frame("home_count", self._home_count)

    def setting_names(self) -> tuple[str, ...]:
        if "rpdo2" not in self.codecs:
            return ()
        signal = self.codecs["rpdo2"].frame.signals[0]
        return tuple(name for _, name in signal.choices)

    def _check_bound(self, name: str, value: float) -> None:
        """Raises ``ValueError`` for a value that makes a stop longer than the robot file promises.

        The script brakes with its acceleration limit, so that the limit must not be below that of
        the robot file.  Speeds are in rpm and accelerations in rpm/s, at the motor shaft.
        """
        steering = "_steering_" in name
        axis = next((axis for axis in self.axes if axis.steering is steering), None)
        if axis is None or not name.startswith("max_"):
            return
        rpm = axis.actuator.gear_ratio * 60.0 / (2.0 * math.pi)
        if name.endswith("_acceleration"):
            least = axis.actuator.max_acceleration * rpm
            if value < (1.0 - _ROUNDING) * least:
                raise ValueError(f"{name} is {value:g}; it must be at least {least:.0f} rpm/s")
        elif value > (1.0 + _ROUNDING) * (most := axis.actuator.max_velocity * rpm):
            raise ValueError(f"{name} is {value:g}; it must be at most {most:.0f} rpm")

    def setting_frame(self, name: str, value: float) -> CanFrame:
        if name not in self.setting_names():
            return super().setting_frame(name, value)
        codec = self.codecs["rpdo2"]
        number = next(raw for raw, known in codec.frame.signals[0].choices if known == name)
        if not math.isfinite(value) or not -(2**31) <= round(value) < 2**31:
            raise ValueError(f"{name} cannot be {value:g}")
        self._check_bound(name, value)
        report = self.codecs.get(name.removesuffix("_cycle_time"))
        if report is not None and value >= 1.0:
            self._set_periods[report.frame.name] = value / 1000.0
        return codec.can_frame(codec.encode([float(number), round(value)]))
