"""The two-channel motor controller of the Thorvald: Roboteq FBL2360 with the robot's script.

CANopen framing, but not CiA 402: the PDOs carry variables of the script.  What is known of
it is followed (frames, scalings, flags, setup ids); what is not is chosen, and listed in
docs/simulated-bus.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from functools import partial
from typing import Any

from thorvaldc.simulation.bus.canopen_device import CanopenDevice, NmtState, Profile
from thorvaldc.simulation.bus.object_dictionary import Entry, Later, ObjectDictionary
from thorvaldc.simulation.bus.pdo import EVENT_DRIVEN, Pdo, PdoSet
from thorvaldc.simulation.bus.roboteq_channel import DRIVE, NOISE_RPM, Channel, ChannelSettings
from thorvaldc.simulation.bus.simulated_motors import MotorModel, MotorState
from thorvaldc.simulation.bus.wire import Wire

LOOP_PERIOD = 0.005
"""s of the script's loop."""
COMMAND_TIMEOUT = 0.5
"""s without a new sequence number after which the propulsion is stopped."""
HOME, DECOUPLED = 1, 2
MODES = (DRIVE, HOME, DECOUPLED)

PROPULSION_ENCODER, STEERING_ENCODER, ALIGNMENT, POWER_STAGE_OFF = 0x80, 0x40, 0x20, 0x10
STALL, HOMING_AT_MAXIMUM, ILLEGAL_COMMAND, NOT_OK = 0x08, 0x04, 0x02, 0x01
CONFIGURATION, VERSION, ENCODER = 1, 2, 3
HOMED, HOMING = 0x01, 0x02
"""Bits of the configuration in TPDO4."""

SETTINGS = {1: "direction", 2: "home_count", 3: "home_speed"}
"""Setup ids that are nonvolatile without power."""
SEARCH = 2.2 * math.pi
"""rad of the steering: how far it turns to find the home switch."""
EMCY_STALL, EMCY_ENCODER = 0x7121, 0x7305
MOTOR_ERROR = 0x81

VENDOR = 0x469
_STATIC_POWER = 24.0
"""W that it takes standing."""


class RoboteqController(CanopenDevice):
    """Propulsion and steering, or two propulsion motors, on one node.

    Its id cannot be written over the bus: ``become`` is what its maker's tool does.

    ``home_angle`` (rad) is where the steering's home switch really is; the setting
    `home_count` says what is counted there, so that a steering counts from straight ahead.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        node_id: int,
        channels: tuple[tuple[ChannelSettings, MotorModel], tuple[ChannelSettings, MotorModel]],
        *,
        profile: Profile | None = None,
        status_period: float = 0.1,
        identity_period: float = 1.0,
        cycle: float = 0.02,
        home_angle: float = 0.0,
        version: tuple[int, int, int] = (1, 0, 0),
        controller_type: int = 0,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        start = {"direction": 0, "home_count": 0, "home_speed": 500, **(nonvolatile or {})}
        super().__init__(
            name,
            wire,
            bitrate,
            node_id,
            profile or Profile(vendor=VENDOR, product=0x2360, revision=0x20, name="FBL2360"),
            seed=seed,
            nonvolatile=start,
        )
        self.channels = (Channel(*channels[0]), Channel(*channels[1]))
        self.home_angle = home_angle
        self.version = version
        self.controller_type = controller_type
        self.supply_voltage = 48.0
        self.temperature = 25
        self.power_stage_fault = False
        self.alignment_fault = False
        self.home_switch_works = True
        self._running = False
        self._cycles = (cycle, status_period, status_period, identity_period)
        self._restart()

    # -- start and stop --------------------------------------------------------------------

    def _restart(self) -> None:
        self.homed = False
        self.homing_at_maximum = False
        self.illegal_command = False
        self._stalled = False
        self._speeds = [0, 0]
        self._position = 0
        self._position_given = False
        self._steering_rpm = 0
        self._sequence: int | None = None
        self._commanded_at = -math.inf
        self._home_way = 0.0
        self._home_side: bool | None = None
        self._content = 0
        self._told = [0] * 8

    def ready(self) -> None:
        if not self._running:
            self._restart()
            for channel in self.channels:
                channel.start(self.now)
            self._running = True
        self.every(lambda: LOOP_PERIOD, self._loop, first=LOOP_PERIOD)
        for place in range(4):
            # They start at different times, as cycles do that nothing keeps together.
            first = self.random.uniform(0.0, self._cycle(place))
            self.every(partial(self._cycle, place), partial(self._report, place), first=first)

    def _cycle(self, place: int) -> float:
        return self.pdos.event_period(place) if self.pdos is not None else 0.0

    def _report(self, place: int) -> None:
        if self.state is NmtState.OPERATIONAL and self.pdos is not None:
            if place == 3:
                self._content = self._content % 3 + 1
            self.pdos.send_now(place)

    def stop(self) -> None:
        super().stop()
        self._running = False
        for channel in self.channels:
            channel.release(self.now)
            channel.mode = DRIVE

    def entered(self, state: NmtState) -> None:
        if state is not NmtState.OPERATIONAL:
            self._speeds = [0, 0]

    def build(self, objects: ObjectDictionary) -> None:
        """The script's variables: 9 to 16 are told to it, 1 to 8 are what it tells."""
        self._told = [0] * 8
        reports = (
            self._speeds_measured,
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
        for place in range(8):
            entry = Entry("i32", 0, "rw", write=partial(self._tell_script, place))
            objects.add(0x2005, place + 9, entry)
            objects.add(0x2106, place + 1, Entry("i32", read=reports[place]))

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        """Two variables in each of four PDOs either way."""

        def two(index: int, first: int) -> tuple[tuple[int, int, int], ...]:
            return (index, first, 32), (index, first + 1, 32)

        n = self.node_id
        received = [
            Pdo(k + 1, 0x200 + 0x100 * k + n, EVENT_DRIVEN, two(0x2005, 9 + 2 * k))
            for k in range(4)
        ]
        sent = [
            Pdo(
                k + 1,
                0x180 + 0x100 * k + n,
                EVENT_DRIVEN,
                two(0x2106, 1 + 2 * k),
                round(1000.0 * self._cycles[k]),
            )
            for k in range(4)
        ]
        return PdoSet(objects, received, sent, self.send)

    # -- commands -----------------------------------------------------------------------------

    def _tell_script(self, place: int, value: Any) -> Later | None:
        """A variable of the script is written; the second of two makes a command of them."""
        self._told[place] = value
        if place % 2:
            command = (self._rpdo1, self._rpdo2, self._rpdo3, self._rpdo4)[place // 2]
            command(self._told[place - 1], value)
        return None

    def _rpdo1(self, sequence: int, speed: int) -> None:
        if sequence != self._sequence:
            self._sequence, self._commanded_at = sequence, self.now
        self.illegal_command = abs(speed) > 1000
        if not self.illegal_command:
            self._speeds[0] = speed

    def _rpdo2(self, setup: int, value: int) -> None:
        first, second = self.channels
        self.illegal_command = False
        if setup in SETTINGS:
            self.keep({SETTINGS[setup]: value})
        elif setup in (4, 6) and value >= 0:
            channel = first if setup == 4 else second
            channel.max_rpm = min(float(value), channel.settings.max_rpm)
        elif setup in (5, 7) and value >= 0:
            (first if setup == 5 else second).acceleration = float(value)
        elif 8 <= setup <= 11 and 0 <= value <= 32767 and self.pdos is not None:
            self.pdos.set_event_period(setup - 8, value)
        else:
            self.illegal_command = True

    def _rpdo3(self, *modes: int) -> None:
        legal = MODES if self.channels[1].settings.steering else (DRIVE, DECOUPLED)
        self.illegal_command = any(mode not in legal for mode in modes)
        if self.illegal_command:
            return
        for place, (channel, mode) in enumerate(zip(self.channels, modes, strict=True)):
            if mode == channel.mode:
                continue
            channel.mode = mode
            self._speeds[place] = 0
            if mode == HOME and channel.settings.steering:
                self._home_way, self._home_side = 0.0, None
                self.homed = self.homing_at_maximum = False

    def _rpdo4(self, limit: int, value: int) -> None:
        self.illegal_command = abs(value) > 1000
        if self.illegal_command:
            return
        if self.channels[1].settings.steering:
            self._steering_rpm, self._position, self._position_given = limit, value, True
        else:
            self._speeds[1] = value

    # -- the loop --------------------------------------------------------------------------------

    def _loop(self) -> None:
        now = self.now
        for channel in self.channels:
            channel.measure(now)
        timed_out = now - self._commanded_at > COMMAND_TIMEOUT
        off = self.power_stage_fault or self._stalled
        for place, channel in enumerate(self.channels):
            if off or channel.mode == DECOUPLED:
                channel.release(now)
            elif channel.settings.steering:
                self._steer(channel, now)
            else:
                share = 0 if timed_out else self._speeds[place] / 1000.0
                forward = -1.0 if place == 0 and self.nonvolatile["direction"] == 1 else 1.0
                channel.turn(forward * share * channel.settings.max_rpm, now, LOOP_PERIOD)
        self._watch(now)

    def _steer(self, channel: Channel, now: float) -> None:
        if channel.mode == HOME:
            self._home(channel, now)
            return
        if not self._position_given:
            channel.motor.hold(channel.state.position, now)
            return
        goal = self._position / 1000.0 * channel.settings.limit
        top = min(self._steering_rpm or channel.max_rpm, channel.max_rpm)
        way = goal - channel.position
        reach = top * channel.radians_per_rpm * LOOP_PERIOD
        if abs(way) <= reach:
            channel.setpoint = 0.0
            channel.motor.hold(channel.encoder.joint_position(goal), now)
        else:
            # Slows down as it comes near, so that it does not run past.
            wanted = math.copysign(min(top, abs(way) * 8.0 / channel.radians_per_rpm), way)
            channel.turn(wanted, now, LOOP_PERIOD)

    def _home(self, channel: Channel, now: float) -> None:
        """Turn until the home switch changes, and count from there on."""
        side = self.home_switch_works and channel.state.position > self.home_angle
        speed = float(self.nonvolatile["home_speed"])
        if self._home_side is None:
            self._home_side = side
        elif side != self._home_side:
            at = self.home_angle
            counts = float(self.nonvolatile["home_count"])
            channel.encoder.set_zero(MotorState(at, 0.0, 0.0), counts)
            channel.measure(now)
            self.homed = True
            self._position, self._position_given = 0, True
            channel.mode = DRIVE
            return
        if self._home_way > SEARCH:
            self.homing_at_maximum = True
            channel.motor.hold(channel.state.position, now)
            return
        # From the one side the switch lies this way, from the other that; at a stop it
        # turns round.
        direction = -1.0 if side else 1.0
        channel.turn(direction * speed, now, LOOP_PERIOD)
        self._home_way += abs(speed) * channel.radians_per_rpm * LOOP_PERIOD

    def _watch(self, now: float) -> None:
        """Stalls and encoders that do not count."""
        for place, channel in enumerate(self.channels):
            searching = channel.mode == HOME
            if searching or not channel.stalled(now) or self._stalled:
                continue
            moving = abs(channel.state.velocity) > NOISE_RPM * channel.radians_per_rpm
            if moving:
                channel.encoder_fault = True
                self.emergency(EMCY_ENCODER, MOTOR_ERROR, bytes([place]))
            self._stalled = True
            if not moving:
                self.emergency(EMCY_STALL, MOTOR_ERROR, bytes([place]))

    # -- reports -----------------------------------------------------------------------------------

    def _speeds_measured(self) -> int:
        for channel in self.channels:
            channel.measure(self.now)
        return _words(*(channel.rpm for channel in self.channels))

    def _counts(self) -> int:
        second = self.channels[1]
        return second.counts if second.settings.steering else 0

    def _currents(self) -> int:
        return _words(*(10.0 * self._power(c) / self.supply_voltage for c in self.channels))

    def _powers(self) -> int:
        return _words(*(self._power(channel) for channel in self.channels))

    def _state(self) -> int:
        return _words(self.flags, self.temperature)

    def _supply(self) -> int:
        total = _STATIC_POWER + sum(self._power(channel) for channel in self.channels)
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
        """The first byte of TPDO3."""
        first, second = self.channels
        bits = (
            (PROPULSION_ENCODER, first.encoder_fault),
            (STEERING_ENCODER, second.encoder_fault),
            (ALIGNMENT, self.alignment_fault),
            (POWER_STAGE_OFF, self.power_stage_fault or self._stalled),
            (STALL, self._stalled),
            (HOMING_AT_MAXIMUM, self.homing_at_maximum),
            (ILLEGAL_COMMAND, self.illegal_command),
        )
        found = sum(bit for bit, on in bits if on)
        return found | NOT_OK if found & ~ILLEGAL_COMMAND else found

    def _power(self, channel: Channel) -> float:
        """W; the losses of a moving gear, and what the motor gives."""
        state = channel.state
        return abs(state.torque * state.velocity) + 4.0 * abs(state.velocity)


def _words(low: float, high: float) -> int:
    """Two signed words of 16 bits in a variable."""
    return _i16(low) & 0xFFFF | _i16(high) << 16


def _i16(value: float) -> int:
    return min(max(round(value), -0x8000), 0x7FFF)
