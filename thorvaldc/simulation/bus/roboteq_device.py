"""The simulated two-channel motor controller of the Thorvald robot.

The real motor controller is a Roboteq FBL2360 that runs a script of the robot's maker.  The motor
controller uses CANopen, but not the device profile CiA 402.  The PDOs of the motor controller
contain variables of the script.  The simulated motor controller uses the same CAN frames, scalings,
status flags and setup ids as the real script.  The page docs/simulated-bus.md lists the behaviour
of the script that is not published and thus assumed.

Handling of one command of the master:

    master   RPDO1 sequence, speed -->
    script   (writes variables 9 and 10; the second write makes them a command)
             loop every 5 ms: measure, check time-out and stalls, command both motors
    script                                  --> TPDO1 speeds, counts (every cycle, free-running)

The script stops the propulsion motors if the sequence number of the commands does not change for
0.5 s.

Homing of a steering motor: the home switch reads 1 on one side of the home angle and 0 on the other
side.  The first reading of the home switch thus determines the direction in which the steering
motor searches the home angle.  The steering motor turns until the reading of the home switch
changes.  The encoder count is then set to the count of the home angle.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import partial
from typing import Any

from thorvaldc import model
from thorvaldc.can.canopen import RPDO, TPDO, NmtState
from thorvaldc.model import Actuator
from thorvaldc.model.sums import float_sum
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.object_dictionary import DelayedWrite, Entry, ObjectDictionary
from thorvaldc.simulation.bus.process_data import EVENT_DRIVEN, Pdo, PdoSet
from thorvaldc.simulation.bus.simulated_device import PARAMETERS, DeviceSpecification
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel, MotorState

# -- motor channels --------------------------------------------------------------------------------

# The controller measures and commands the speed of the motor in rpm.

STALL_TIME = 0.5
"""Time (s) at rest with a commanded speed after which the channel reports a stall."""
STALL_RPM = 30.0
"""Commanded speed (rpm) below which a motor at rest does not count as stalled."""
DRIVE = 0
"""Mode of a channel after power-on."""


@dataclass(frozen=True, slots=True)
class ChannelSettings:
    """Hardware settings of a motor channel of the Roboteq controller.

    ``steering`` is true for a steering motor, and false for a propulsion motor.  ``limit`` is the
    largest steering angle (rad) in both directions.
    """

    gear_ratio: float
    encoder_pulses: int
    max_rpm: float
    limit: float = math.pi
    steering: bool = False


class Channel:
    """A channel of the Roboteq controller with a motor and an encoder.

    ``position`` is the joint position (rad), and ``rpm`` is the speed of the motor (rpm).
    """

    def __init__(self, settings: ChannelSettings, motor: MotorModel) -> None:
        self.settings = settings
        self.motor = motor
        self.encoder = Encoder(settings.gear_ratio, settings.encoder_pulses)
        self.mode = DRIVE
        self.max_rpm = settings.max_rpm
        self.rpm = 0.0
        self.position = 0.0
        self.state = MotorState(0.0, 0.0, 0.0)
        self.encoder_error = False
        self._still_since: float | None = None
        self.setpoint = 0.0
        """Commanded motor speed (rpm)."""
        self.acceleration = 0.0
        """Acceleration limit (rpm per s), or 0 for the largest acceleration of the motor."""

    @property
    def radians_per_rpm(self) -> float:
        """Speed of the joint (rad/s) at a motor speed of 1 rpm."""
        return math.pi / 30.0 / self.settings.gear_ratio

    def start(self, now: float) -> None:
        """Starts the motor channel after power-on.

        The encoder count is 0 at the present position of the joint.
        """
        self.mode = DRIVE
        self.max_rpm, self.acceleration = self.settings.max_rpm, 0.0
        self.encoder_error, self._still_since, self.setpoint = False, None, 0.0
        self.encoder.set_zero(self.motor.read(now))
        self.measure(now)

    def measure(self, now: float) -> None:
        self.state = self.motor.read(now)
        self.position, velocity = self.encoder.measure(self.state)
        self.rpm = velocity / self.radians_per_rpm

    def turn(self, rpm: float, now: float, dt: float) -> None:
        """Commands a motor speed (rpm), limited by the speed limit of the motor channel.

        The motor model limits the acceleration of the motor.
        """
        setpoint = min(max(rpm, -self.max_rpm), self.max_rpm)
        if self.acceleration > 0.0:
            step = self.acceleration * dt
            setpoint = min(max(setpoint, self.setpoint - step), self.setpoint + step)
        self.setpoint = setpoint
        self.motor.turn(setpoint * self.radians_per_rpm, now)

    def stalled(self, now: float) -> bool:
        """Returns true if the measured motor speed is too low for longer than ``STALL_TIME``.

        The measured speed is too low if the motor does not follow the commanded speed, or if the
        encoder failed.
        """
        if abs(self.setpoint) < STALL_RPM or abs(self.rpm) > STALL_RPM / 2.0:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        return self._still_since is not None and now - self._still_since > STALL_TIME

    def release(self, now: float) -> None:
        self.setpoint = 0.0
        self.motor.release(now)


LOOP_PERIOD = 0.005
"""Period (s) of the loop of the script."""
COMMAND_TIMEOUT = 0.5
"""Time (s) without a new sequence number after which the script stops the propulsion motors."""
HOME, DECOUPLED = 1, 2
"""Modes of a channel that RPDO3 can set."""
MODES = (DRIVE, HOME, DECOUPLED)

PROPULSION_ENCODER, STEERING_ENCODER, ALIGNMENT, POWER_STAGE_OFF = 0x80, 0x40, 0x20, 0x10
STALL, HOMING_AT_MAXIMUM, ILLEGAL_COMMAND, NOT_OK = 0x08, 0x04, 0x02, 0x01
"""Flags in byte 0 of TPDO3."""
CONFIGURATION, VERSION, ENCODER = 1, 2, 3
"""Kinds of TPDO4, distinguished by byte 3.  The script sends all kinds in turn."""
HOMED, HOMING = 0x01, 0x02
"""Bits of the configuration byte in TPDO4."""

SETTINGS = {1: "direction", 2: "home_count", 3: "home_speed"}
"""Setup ids of values in non-volatile memory."""
APPROACH_GAIN = 8.0
"""Speed of a steering motor near the goal, divided by the distance from the goal (1/s)."""
SEARCH = 2.2 * math.pi
"""Distance (rad) after which the search for the home switch ends without success."""
EMCY_STALL, EMCY_ENCODER = 0x7121, 0x7305
MOTOR_ERROR = 0x81
"""Value of the error register with the bits "generic" and "manufacturer-specific"."""

_STATIC_POWER = 24.0
"""Electric power (W) of the controller at rest."""


class RoboteqController(CanopenDevice):
    """A simulated Roboteq motor controller with two motors on one CAN node.

    The motor controller drives a propulsion motor and a steering motor, or two propulsion motors.
    A master cannot change the node id over the bus.  The method ``change_node_id`` sets the node
    id, as the configuration tool of the manufacturer does.

    * ``home_angle``: true steering angle (rad) at the edge of the home switch.
    * ``home_count``: setting with the encoder count at the home switch.  If the home angle is set
      correctly, the encoder count is 0 when the wheel points straight ahead.
    * ``loop_period``: period (s) of the loop of the script.  A longer period saves computing time
      in simulations of many hours.
    """

    device_name = "FBL2360"
    loop_period = LOOP_PERIOD

    def __init__(self, specification: DeviceSpecification) -> None:
        memory = {PARAMETERS: {}, "direction": 0, "home_count": 0, "home_speed": 500}
        super().__init__(specification, memory)
        node = specification.node
        first, second = [
            Channel(_channel_settings(specification, channel, actuator), motor)
            for channel, actuator, motor in specification.channels()[:2]
        ]
        self.channels = first, second
        self.home_angle = 0.0
        for _, actuator, motor in specification.channels()[:2]:
            if actuator is not None and actuator.encoder_offset:
                self.home_angle = motor.direction * actuator.encoder_offset
        self.version = _version(specification.property("script_version"))
        self.controller_type = int(specification.property("script_type") or 0)
        self.supply_voltage = 48.0
        self.temperature = 25
        self.power_stage_error = False
        self.alignment_error = False
        self.home_switch_works = True
        self._running = False
        status_period = specification.period(TPDO[1] + node.id, 0.1)
        self._cycles = (
            specification.period(TPDO[0] + node.id, specification.bus.sync_period),
            status_period,
            status_period,
            specification.period(TPDO[3] + node.id, 1.0),
        )
        self._reset_state()

    # -- start and stop --------------------------------------------------------------------

    def _reset_state(self) -> None:
        self.homed = False
        self.homing_at_maximum = False
        self.illegal_command = False
        self._stalled = False
        self._speeds = [0, 0]
        self._position = 0
        self._position_commanded = False
        self._steering_rpm = 0
        self._sequence: int | None = None
        self._last_command = -math.inf
        self._command_timeout = COMMAND_TIMEOUT
        self._home_distance = 0.0
        self._home_reading: bool | None = None
        self._content = 0

    def initialised(self) -> None:
        if not self._running:
            self._reset_state()
            for channel in self.channels:
                channel.start(self.now)
            self._running = True
        self.every(lambda: self.loop_period, self._loop, first=self.loop_period)
        for index in range(4):
            # The cycles of the TPDOs have random phases, because the script does not synchronise
            # the TPDOs.
            first = self.random.uniform(0.0, self._cycle(index))
            self.every(partial(self._cycle, index), partial(self._send_tpdo, index), first=first)

    def _cycle(self, index: int) -> float:
        return self.pdos.sent[index].event_period if self.pdos is not None else 0.0

    def _send_tpdo(self, index: int) -> None:
        if self.state is NmtState.OPERATIONAL and self.pdos is not None:
            if index == 3:
                self._content = self._content % 3 + 1
            self.pdos.send_now(index)

    def stop(self) -> None:
        super().stop()
        self._running = False
        for channel in self.channels:
            channel.release(self.now)
            channel.mode = DRIVE

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        if index >= len(self.channels):
            return None, None
        return self.channels[index].encoder, self.channels[index].motor

    def lose_watchdog(self) -> None:
        """Keeps the propulsion motors at the last command when no new command arrives."""
        super().lose_watchdog()
        self._command_timeout = math.inf

    def nmt_state_changed(self, state: NmtState) -> None:
        if state is not NmtState.OPERATIONAL:
            self._speeds = [0, 0]

    def add_objects(self, objects: ObjectDictionary) -> None:
        """Adds the variables of the script to the object dictionary.

        The master reads variables 1 to 8 and writes variables 9 to 16.
        """
        self._variables = [0] * 8
        reports = (
            self._measured_speeds,
            self._counts,
            self._currents,
            self._powers,
            self._state,
            self._supply,
            lambda: self._content << 24,
            self._constant,
        )
        objects.add(0x2005, 0, Entry("u8", 16, "const"))
        objects.add(0x2106, 0, Entry("u8", 16, "const"))
        for number in range(8):
            entry = Entry("i32", 0, "rw", write=partial(self._write_variable, number))
            objects.add(0x2005, number + 9, entry)
            objects.add(0x2106, number + 1, Entry("i32", read=reports[number]))

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        """Returns four RPDOs and four TPDOs, with two variables in each PDO."""

        def variables(index: int, first: int) -> tuple[tuple[int, int, int], ...]:
            return (index, first, 32), (index, first + 1, 32)

        node = self.node_id
        received = [
            Pdo(k + 1, RPDO[k] + node, EVENT_DRIVEN, variables(0x2005, 9 + 2 * k)) for k in range(4)
        ]
        sent = [
            Pdo(
                k + 1,
                TPDO[k] + node,
                EVENT_DRIVEN,
                variables(0x2106, 1 + 2 * k),
                round(1000.0 * self._cycles[k]),
            )
            for k in range(4)
        ]
        return PdoSet(objects, received, sent, self.send)

    # -- commands -----------------------------------------------------------------------------

    def _write_variable(self, number: int, value: Any) -> DelayedWrite | None:
        """Handles a write of the master to a variable of the script.

        Each command consists of two variables of the script.  The command takes effect after the
        second variable is written.
        """
        self._variables[number] = value
        if number % 2:
            command = (self._rpdo1, self._rpdo2, self._rpdo3, self._rpdo4)[number // 2]
            command(self._variables[number - 1], value)
        return None

    def _rpdo1(self, sequence: int, speed: int) -> None:
        if sequence != self._sequence:
            self._sequence, self._last_command = sequence, self.now
        self.illegal_command = abs(speed) > 1000
        if not self.illegal_command:
            self._speeds[0] = speed

    def _rpdo2(self, setup: int, value: int) -> None:
        first, second = self.channels
        self.illegal_command = False
        if setup in SETTINGS:
            self.store({SETTINGS[setup]: value})
        elif setup in (4, 6) and value >= 0:
            channel = first if setup == 4 else second
            channel.max_rpm = min(float(value), channel.settings.max_rpm)
        elif setup in (5, 7) and value >= 0:
            (first if setup == 5 else second).acceleration = float(value)
        elif 8 <= setup <= 11 and 0 <= value <= 32767 and self.pdos is not None:
            self.pdos.sent[setup - 8].event.value = value
        else:
            self.illegal_command = True

    def _rpdo3(self, *modes: int) -> None:
        legal = MODES if self.channels[1].settings.steering else (DRIVE, DECOUPLED)
        self.illegal_command = any(mode not in legal for mode in modes)
        if self.illegal_command:
            return
        for index, (channel, mode) in enumerate(zip(self.channels, modes, strict=True)):
            if mode == channel.mode:
                continue
            channel.mode = mode
            self._speeds[index] = 0
            if mode == HOME and channel.settings.steering:
                self._home_distance, self._home_reading = 0.0, None
                self.homed = self.homing_at_maximum = False

    def _rpdo4(self, limit: int, value: int) -> None:
        self.illegal_command = abs(value) > 1000
        if self.illegal_command:
            return
        if self.channels[1].settings.steering:
            self._steering_rpm, self._position, self._position_commanded = limit, value, True
        else:
            self._speeds[1] = value

    # -- the loop --------------------------------------------------------------------------------

    def _loop(self) -> None:
        now = self.now
        for channel in self.channels:
            channel.measure(now)
        timed_out = now - self._last_command > self._command_timeout
        off = self.power_stage_error or self._stalled
        for index, channel in enumerate(self.channels):
            if off or channel.mode == DECOUPLED:
                channel.release(now)
            elif channel.settings.steering:
                self._steer(channel, now)
            else:
                share = 0 if timed_out else self._speeds[index] / 1000.0
                sign = -1.0 if index == 0 and self.nonvolatile["direction"] == 1 else 1.0
                channel.turn(sign * share * channel.settings.max_rpm, now, self.loop_period)
        self._check_stalls(now)

    def _steer(self, channel: Channel, now: float) -> None:
        if channel.mode == HOME:
            self._home(channel, now)
            return
        if not self._position_commanded:
            channel.motor.hold(channel.state.position, now)
            return
        goal = self._position / 1000.0 * channel.settings.limit
        top = min(self._steering_rpm or channel.max_rpm, channel.max_rpm)
        distance = goal - channel.position
        reach = top * channel.radians_per_rpm * self.loop_period
        if abs(distance) <= reach:
            channel.setpoint = 0.0
            channel.motor.hold(channel.encoder.joint_position(goal), now)
        else:
            # Near the target angle, the steering speed is proportional to the remaining angle, so
            # that the steering motor does not overshoot.
            speed = min(top, APPROACH_GAIN * abs(distance) / channel.radians_per_rpm)
            channel.turn(math.copysign(speed, distance), now, self.loop_period)

    def _home(self, channel: Channel, now: float) -> None:
        """Turns the steering motor until the reading of the home switch changes.

        The encoder count is then set to the count of the home angle.
        """
        reading = self.home_switch_works and channel.state.position > self.home_angle
        speed = float(self.nonvolatile["home_speed"])
        if self._home_reading is None:
            self._home_reading = reading
        elif reading != self._home_reading:
            counts = float(self.nonvolatile["home_count"])
            channel.encoder.set_zero(MotorState(self.home_angle, 0.0, 0.0), counts)
            channel.measure(now)
            self.homed = True
            self._position, self._position_commanded = 0, True
            channel.mode = DRIVE
            return
        if self._home_distance > SEARCH:
            self.homing_at_maximum = True
            channel.motor.hold(channel.state.position, now)
            return
        direction = -1.0 if reading else 1.0
        channel.turn(direction * speed, now, self.loop_period)
        self._home_distance += abs(speed) * channel.radians_per_rpm * self.loop_period

    def _check_stalls(self, now: float) -> None:
        """Reports a motor that is stalled or has an encoder that does not count."""
        for index, channel in enumerate(self.channels):
            searching = channel.mode == HOME
            if searching or not channel.stalled(now) or self._stalled:
                continue
            moving = abs(channel.state.velocity) > STALL_RPM * channel.radians_per_rpm
            if moving:
                channel.encoder_error = True
                self.emergency(EMCY_ENCODER, MOTOR_ERROR, bytes([index]))
            self._stalled = True
            if not moving:
                self.emergency(EMCY_STALL, MOTOR_ERROR, bytes([index]))

    # -- reports -----------------------------------------------------------------------------------

    def _measured_speeds(self) -> int:
        for channel in self.channels:
            channel.measure(self.now)
        return _words(*(channel.rpm for channel in self.channels))

    def _counts(self) -> int:
        second = self.channels[1]
        counts = round(second.position * second.encoder.counts_per_radian)
        return counts if second.settings.steering else 0

    def _currents(self) -> int:
        return _words(*(10.0 * self._power(c) / self.supply_voltage for c in self.channels))

    def _powers(self) -> int:
        return _words(*(self._power(channel) for channel in self.channels))

    def _state(self) -> int:
        return _words(self.flags, self.temperature)

    def _supply(self) -> int:
        total = _STATIC_POWER + float_sum(self._power(channel) for channel in self.channels)
        return _words(10.0 * total / self.supply_voltage, 10.0 * self.supply_voltage)

    def _constant(self) -> int:
        return int.from_bytes(self._constants(self._content), "little")

    def _constants(self, content: int) -> bytes:
        first, second = self.channels
        if content == CONFIGURATION:
            homing = second.settings.steering and second.mode == HOME
            return struct.pack("<I", HOMED * int(self.homed) | HOMING * int(homing))
        if content == VERSION:
            major, minor, patch = self.version
            return bytes([self.controller_type, patch, minor, major])
        return struct.pack("<HH", first.settings.encoder_pulses, second.settings.encoder_pulses)

    @property
    def flags(self) -> int:
        """Status flags in byte 0 of TPDO3."""
        first, second = self.channels
        bits = (
            (PROPULSION_ENCODER, first.encoder_error),
            (STEERING_ENCODER, second.encoder_error),
            (ALIGNMENT, self.alignment_error),
            (POWER_STAGE_OFF, self.power_stage_error or self._stalled),
            (STALL, self._stalled),
            (HOMING_AT_MAXIMUM, self.homing_at_maximum),
            (ILLEGAL_COMMAND, self.illegal_command),
        )
        flags = sum(bit for bit, is_set in bits if is_set)
        return flags | NOT_OK if flags & ~ILLEGAL_COMMAND else flags

    def _power(self, channel: Channel) -> float:
        """Returns the electric power (W) of a motor.

        The electric power of a motor is the mechanical power plus losses that are proportional to
        the motor speed.
        """
        state = channel.state
        return abs(state.torque * state.velocity) + 4.0 * abs(state.velocity)


def _channel_settings(
    specification: DeviceSpecification, channel: model.Channel, actuator: Actuator | None
) -> ChannelSettings:
    if actuator is None:
        return ChannelSettings(1.0, 1024, 3000.0, steering=channel.role == "steering")
    joint = specification.robot.joint(actuator.joint)
    limits = [abs(limit) for limit in (joint.lower, joint.upper) if limit is not None]
    return ChannelSettings(
        actuator.gear_ratio,
        actuator.encoder_ppr,
        actuator.motor_max_speed * 30.0 / math.pi,
        max(limits, default=math.pi),
        actuator.role == "steering",
    )


def _version(text: Any) -> tuple[int, int, int]:
    """Returns the three numbers of the script version in the robot file.

    If ``text`` is not a version, the function returns 1.0.0.
    """
    parts = str(text).split(".")
    if len(parts) == 3 and all(part.isdigit() and int(part) < 256 for part in parts):
        return int(parts[0]), int(parts[1]), int(parts[2])
    return 1, 0, 0


def _words(*numbers: float) -> int:
    """Packs two numbers as signed 16-bit words, limited to their range, into a 32-bit variable."""
    low, high = (min(max(round(number), -0x8000), 0x7FFF) for number in numbers)
    return low & 0xFFFF | high << 16
