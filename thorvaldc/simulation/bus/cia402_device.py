"""A simulated CANopen drive with the device profile CiA 402, for one or more motors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.can import canopen
from thorvaldc.model import Actuator
from thorvaldc.model.bus import FIRST_INDEX, STRIDE, motor_numbers
from thorvaldc.simulation.bus import cia402_motion
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.object_dictionary import DelayedWrite, Entry, ObjectDictionary
from thorvaldc.simulation.bus.process_data import Pdo, PdoSet
from thorvaldc.simulation.bus.simulated_device import DeviceSpecification
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel

# -- one motor -------------------------------------------------------------------------------------

# The control loop runs every 2 ms.  In each cycle, the control loop measures the position and
# speed, computes the next set-point (``cia402_motion``), and commands the motor.  A new value of an
# object dictionary entry takes effect in the next cycle of the control loop.  Device errors that
# the drive reports for the motor:
#
#     position modes   |set-point - position| > 0x6065 for longer than 0x6066 ms:   0x8611
#     velocity modes   |set-point - speed| > 10 % of the top speed for 0.3 s:        0x8400

BRAKE_TIME = 0.02
"""Time (s) that a brake requires to open."""
NO_WINDOW = 0xFFFFFFFF
"""Value of object 0x6065 that disables the supervision of the position."""
SERVO_LAG = 0.15
"""Accepted delay (s) of the speed of a loaded motor behind the commanded ramp."""
VELOCITY_ERROR_TIME = 0.3
"""Time (s) for which the speed may differ from the set-point by more than 10 % of the top speed."""
_MODES = tuple(canopen.Mode)
STANDING = 1e-3
"""Speed (rad/s) below which a motor reports the speed zero."""
INTERNAL_LIMIT, MODE_BIT = 1 << 11, 1 << 12
FOLLOWING_ERROR_BIT = 1 << 13
"""Bits of the status word.  Bit 12: set-point acknowledged, speed is zero, or target is used,
depending on the mode."""

FOLLOWING_ERROR, VELOCITY_ERROR, HOMING_FAILED, CONNECTION_ERROR = 0x8611, 0x8400, 0xFF01, 0x8130
"""Error codes in EMCY messages and in object 0x603F."""


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """Hardware and factory settings of a motor of a simulated CiA 402 drive.

    Speeds are in rad/s, accelerations in rad/s^2 and torques in N m, all at the joint behind the
    gear.

    * ``lower``, ``upper``: angles (rad) of the limit switches and default software limits, or
      ``None`` for a joint without limits.
    * ``zero``: true angle (rad) at which the encoder reads 0 after homing.  The angle is not
      0 if a limit switch or the encoder is mounted at a wrong angle.
    """

    gear_ratio: float
    encoder_pulses: int
    max_velocity: float
    max_acceleration: float
    max_torque: float
    lower: float | None = None
    upper: float | None = None
    brake: bool = False
    zero: float = 0.0


class Axis:
    """One motor of a simulated CiA 402 drive.

    The function ``report_error`` is called with the error code of each new device error.  After a
    reset of the device error, ``report_error`` is called with the error code 0.
    """

    def __init__(
        self, settings: AxisSettings, motor: MotorModel, report_error: Callable[[int], None]
    ) -> None:
        self.settings = settings
        self.motor = motor
        self.encoder = Encoder(settings.gear_ratio, settings.encoder_pulses)
        self._units = self.encoder.counts_per_radian
        """Number of position units per rad of the joint, and of speed units per rad/s."""
        self.states = cia402_motion.StateMachine()
        self.position = 0.0
        self.velocity = 0.0
        self.error_code = 0
        self.motion = cia402_motion.Motion()
        self.homing: cia402_motion.Homing | None = None
        self._report_error = report_error
        self._entries: dict[tuple[int, int], Entry] = {}
        self._joint_position = 0.0
        self._torque = 0.0
        self._brake_open_at = math.inf
        self._relaxed = False
        self._error_since: float | None = None
        self._lagged_speed = 0.0

    # -- objects ---------------------------------------------------------------------------

    def add_objects(self, objects: ObjectDictionary, base: int) -> None:
        """Adds the CiA 402 objects of the motor to the object dictionary.

        ``base`` is the first object index of the motor, which is 0x6000 for the first motor.
        """
        settings = self.settings
        self._entries = {}

        def add(index: int, entry: Entry, subindex: int = 0) -> None:
            self._entries[index, subindex] = objects.add(base + index, subindex, entry)

        def stored(index: int, kind: str, start: float, subindex: int = 0, low: int = 0) -> None:
            entry = Entry(kind, round(start), "rw", lower=low, stored=True)
            add(index, entry, subindex)

        units = self._units
        speed, acceleration = settings.max_velocity * units, settings.max_acceleration * units
        add(0x07, Entry("i16", 1, "rw", lower=0, upper=3, stored=True))
        add(0x3F, Entry("u16", read=lambda: self.error_code))
        add(0x40, Entry("u16", 0, "rw", write=self._control))
        add(0x41, Entry("u16", read=self.statusword))
        add(0x5A, Entry("i16", 2, "rw", lower=0, upper=6, stored=True))
        add(0x5C, Entry("i16", 1, "rw", lower=0, upper=1, stored=True))
        add(0x5E, Entry("i16", 2, "rw", lower=0, upper=2, stored=True))
        add(0x60, Entry("i8", 0, "rw", stored=True))
        add(0x61, Entry("i8", read=lambda: self.motion.mode))
        add(0x62, Entry("i32", read=lambda: round(self.motion.move.position * units)))
        add(0x64, Entry("i32", read=lambda: round(self.position * units)))
        stored(0x65, "u32", math.radians(10.0) * units)
        stored(0x66, "u16", 100)
        stored(0x67, "u32", math.radians(0.5) * units)
        stored(0x68, "u16", 10)
        add(0x6B, Entry("i32", read=lambda: round(self.motion.move.speed * units)))
        add(0x6C, Entry("i32", read=lambda: round(self.velocity * units)))
        stored(0x6D, "u16", min(0.02 * speed, 0xFFFF))
        add(0x77, Entry("i16", read=self._torque_permille))  # thousandths of the rated torque
        add(0x79, Entry("u32", 48000))
        add(0x7A, Entry("i32", 0, "rw"))
        add(0x7C, Entry("i32", 0, "rw", stored=True))
        objects.add(base + 0x7D, 0, Entry("u8", 2, "const"))
        for subindex, limit in ((1, settings.lower), (2, settings.upper)):
            start = 0 if limit is None else round(limit * units)
            add(0x7D, Entry("i32", start, "rw", stored=True), subindex)
        stored(0x7F, "u32", speed)
        stored(0x80, "u32", settings.max_velocity * settings.gear_ratio * 30.0 / math.pi)
        stored(0x81, "u32", speed)
        for index in (0x83, 0x84, 0x85, 0x9A, 0xC5):
            stored(index, "u32", acceleration, low=1)
        objects.add(base + 0x8F, 0, Entry("u8", 2, "const"))
        stored(0x8F, "u32", 4 * settings.encoder_pulses, 1, 1)
        stored(0x8F, "u32", 1, 2, 1)
        add(0x98, Entry("i8", 37, "rw", stored=True))
        objects.add(base + 0x99, 0, Entry("u8", 2, "const"))
        stored(0x99, "u32", 0.25 * speed, 1, 1)
        stored(0x99, "u32", 0.05 * speed, 2, 1)
        objects.add(base + 0xC2, 0, Entry("u8", 2, "const"))
        stored(0xC2, "u8", 20, 1, 1)
        add(0xC2, Entry("i8", -3, "rw", lower=-6, upper=0, stored=True), 2)
        add(0xF4, Entry("i32", read=self._following_error))
        add(0xFD, Entry("u32", read=lambda: self.switches[0] | self.switches[1] << 1))
        add(0xFF, Entry("i32", 0, "rw"))
        objects.add(base + 0x502, 0, Entry("u32", sum(1 << m - 1 for m in canopen.Mode), "const"))

    def number(self, index: int, subindex: int = 0) -> int:
        """Returns the value of an object dictionary entry of the motor.

        ``index`` is the object index relative to the first object index of the motor.
        """
        value: int = self._entries[index, subindex].value
        return value

    def _angle(self, index: int, subindex: int = 0) -> float:
        """Returns the value of an object dictionary entry as an angle (rad)."""
        return self.number(index, subindex) / self._units

    def _speed(self, index: int, subindex: int = 0) -> float:
        """Returns the value of an object as a joint speed (rad/s) or acceleration (rad/s^2)."""
        return self.number(index, subindex) / self._units

    def _torque_permille(self) -> int:
        limit = self.settings.max_torque
        return round(1000.0 * self._torque / limit) if limit else 0

    def _following_error(self) -> int:
        return round((self.motion.move.position - self.position) * self._units)

    @property
    def switches(self) -> tuple[bool, bool]:
        """States of the negative and the positive limit switch of the motor."""
        lower, upper = self.settings.lower, self.settings.upper
        low = lower is not None and self._joint_position <= lower
        return low, upper is not None and self._joint_position >= upper

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper software position limit (rad) of the motor from object 0x607D.

        The motor has no software position limits if the lower limit in object 0x607D is not less
        than the upper limit.
        """
        low, high = self._angle(0x7D, 1), self._angle(0x7D, 2)
        return (low, high) if low < high else (-math.inf, math.inf)

    # -- states ------------------------------------------------------------------------------

    def _control(self, word: Any) -> DelayedWrite | None:
        previous = self.states.state
        self.states.command(word, self.number(0x5A), self.number(0x5C))
        if previous is canopen.DriveState.FAULT and self.states.state is not previous:
            self.error_code = 0
            self._report_error(0)
        self.motion.control(word)
        return None

    def statusword(self) -> int:
        """Returns the status word (object 0x6041) of the motor.

        The status word contains the bits of the power state, the limits and the mode of operation.
        """
        motion, homing = self.motion, self.homing
        low, high = self.limits
        beyond = self.position < low - 1e-3 or self.position > high + 1e-3
        word = self.states.statusword()
        word |= canopen.TARGET_REACHED * motion.reached | INTERNAL_LIMIT * (
            motion.limited or beyond
        )
        if motion.mode == canopen.Mode.HOMING:
            if homing is not None:
                word |= (
                    canopen.HOMING_ATTAINED * homing.attained | canopen.HOMING_ERROR * homing.failed
                )
        elif motion.mode == canopen.Mode.PROFILE_POSITION:
            word |= MODE_BIT * motion.acknowledged
        elif motion.mode == canopen.Mode.PROFILE_VELOCITY:
            word |= MODE_BIT * (abs(self.velocity) < STANDING)
        elif motion.mode in (canopen.Mode.CYCLIC_POSITION, canopen.Mode.CYCLIC_VELOCITY):
            word |= MODE_BIT * (self.states.state is canopen.DriveState.OPERATION_ENABLED)
        if motion.mode in (canopen.Mode.PROFILE_POSITION, canopen.Mode.CYCLIC_POSITION):
            word |= FOLLOWING_ERROR_BIT * (self._error_since is not None)
        return word

    def fail(self, code: int) -> None:
        """Enters the drive state FAULT and reports the device error with the error code ``code``.

        The fault reaction option code (object 0x605E) defines how the motor stops.
        """
        if self.states.fault(self.number(0x5E)):
            self.error_code = code
            self._error_since = None
            self._report_error(code)

    def connection_lost(self) -> None:
        """Reacts to a loss of the connection to the master as object 0x6007 defines."""
        option = self.number(0x07)
        if not self.states.state.powered:
            return
        if option == 1:
            self.fail(CONNECTION_ERROR)
        elif option == 2:
            self.states.disable()
        elif option == 3:
            self.states.quick_stop(self.number(0x5A))

    def power_stage_off(self, now: float) -> None:
        """Switches the power stage of the drive off without a ramp."""
        self.states.disable()
        self._relax(now)

    def start(self, now: float) -> None:
        """Starts the motor after power-on.

        The encoder count is 0 at the present position of the joint.
        """
        self.error_code, self.homing = 0, None
        self.encoder.set_zero(self.motor.read(now))
        self.states = cia402_motion.StateMachine()
        self.states.state = canopen.DriveState.SWITCH_ON_DISABLED
        self._measure(now)
        self.motion = cia402_motion.Motion()
        self.motion.rest(self.position, self._mode())

    def stop(self, now: float) -> None:
        """Stops the motor after a loss of power."""
        self.states = cia402_motion.StateMachine()
        self._relax(now)

    # -- the loop ------------------------------------------------------------------------------

    def tick(self, now: float, dt: float) -> None:
        """Runs one cycle of the control loop.

        ``dt`` is the time (s) since the previous cycle of the control loop.
        """
        self._measure(now)
        motion = self.motion
        if not self.states.state.powered:
            self._relax(now)
            motion.rest(self.position, self._mode())
            motion.take_start()  # a start commanded without power does not count
            return
        if self._relaxed:
            self._relaxed = False
            self._brake_open_at = now + (BRAKE_TIME if self.settings.brake else 0.0)
            motion.rest(self.position, self._mode())
            self._stand(now)
        if now < self._brake_open_at:
            return
        if self.states.reaction is not None:
            self._react(now, dt)
            return
        if self.states.state is canopen.DriveState.QUICK_STOP_ACTIVE:
            return  # at rest, until the next control word
        if motion.mode != self._mode():
            motion.change(self._mode(), self.position, self.velocity)
            self.homing = None
            self._error_since = None
            self._stand(now)
        self._move(now, dt)

    def _measure(self, now: float) -> None:
        state = self.motor.read(now)
        self._joint_position, self._torque = state.position, state.torque
        self.position, self.velocity = self.encoder.measure(state)

    def _mode(self) -> int:
        """Returns the commanded CiA 402 mode of operation.

        Returns the present mode of operation if the drive does not support the commanded mode.
        """
        commanded = self.number(0x60)
        return commanded if commanded in _MODES else self.motion.mode

    def _bounds(self, acceleration: int = 0x83, deceleration: int = 0x84) -> cia402_motion.Bounds:
        top = self.settings.max_acceleration
        motor_speed = self.number(0x80) * math.pi / 30.0 / self.settings.gear_ratio
        return cia402_motion.Bounds(
            *self.limits,
            min(self._speed(0x7F), motor_speed, self.settings.max_velocity),
            min(self._speed(acceleration), top),
            min(self._speed(deceleration), top),
        )

    def _move(self, now: float, dt: float) -> None:
        """Computes the next set-point in the present mode of operation and commands the motor."""
        motion = self.motion
        if motion.mode == canopen.Mode.PROFILE_POSITION:
            bounds = self._bounds()
            bounds = bounds._replace(velocity=min(self._speed(0x81), bounds.velocity))
            motion.profile_position(self._angle(0x7A), bounds, dt)
            self._hold(now)
            motion.settle(self.position, self._angle(0x67), self.number(0x68) / 1000.0, dt)
            self._check_position(now)
        elif motion.mode == canopen.Mode.CYCLIC_POSITION:
            cycle = self.number(0xC2, 1) * 10.0 ** self.number(0xC2, 2)
            motion.cyclic_position(self._angle(0x7A), self._bounds(), cycle, dt)
            self._hold(now)
            self._check_position(now)
        elif motion.mode in (canopen.Mode.PROFILE_VELOCITY, canopen.Mode.CYCLIC_VELOCITY):
            profiled = motion.mode == canopen.Mode.PROFILE_VELOCITY
            bounds = self._bounds() if profiled else self._bounds(0xC5, 0xC5)
            goal = motion.velocity(self._speed(0xFF), self.position, bounds, dt)
            self.motor.turn(motion.move.speed, now)
            motion.reached = profiled and abs(goal - self.velocity) <= self._speed(0x6D)
            self._check_velocity(now, dt)
        elif motion.mode == canopen.Mode.HOMING:
            self._home(now, dt)

    def _home(self, now: float, dt: float) -> None:
        motion = self.motion
        if motion.take_start():
            self.homing = cia402_motion.Homing(self.number(0x98))
            motion.reached = False
        homing = self.homing
        if homing is None or not motion.start or homing.failed or motion.reached:
            return
        fast, slow = self._speed(0x99, 1), self._speed(0x99, 2)
        limit = min(self._speed(0x9A), self.settings.max_acceleration)
        speed = homing.speed(self.switches, self.velocity, fast, slow, dt)
        if homing.attained:
            # The zero position of the drive is the home position plus the home offset (object
            # 0x607C), as CiA 402 defines.
            state = self.motor.read(now)
            if homing.method not in cia402_motion.PRESENT_POSITION:
                state = state._replace(position=state.position + self.settings.zero)
            self.encoder.set_zero(state, -self._angle(0x7C) * self.encoder.counts_per_radian)
            self._measure(now)
            motion.move.position, motion.move.speed = self.position, 0.0
            motion.reached = True
            self._stand(now)
        elif homing.failed:
            motion.move.speed = 0.0
            self._stand(now)
            self._report_error(HOMING_FAILED)
        else:
            motion.move.speed = cia402_motion.ramp(motion.move.speed, speed, limit, dt)
            self.motor.turn(motion.move.speed, now)

    def _react(self, now: float, dt: float) -> None:
        """Slows the motor down on a ramp, and changes the power state when the motor is at rest."""
        reaction, motion = self.states.reaction, self.motion
        if reaction is None:
            return
        index = 0x85 if reaction.quick else 0x84
        motion.stop(min(self._speed(index), self.settings.max_acceleration), dt)
        self.motor.turn(motion.move.speed, now)
        if motion.move.speed == 0.0:
            self.states.stopped()
            motion.rest(self.position, motion.mode)
            if self.states.state.powered:
                self._stand(now)

    def _check_position(self, now: float) -> None:
        window = self.number(0x65)
        error = abs(self.motion.move.position - self.position)
        allowed = math.inf if window == NO_WINDOW else window / self._units
        self._check(error <= allowed, self.number(0x66) / 1000.0, FOLLOWING_ERROR, now)

    def _check_velocity(self, now: float, dt: float) -> None:
        speed = self.motion.move.speed
        self._lagged_speed += (speed - self._lagged_speed) * dt / (SERVO_LAG + dt)
        error = min(abs(speed - self.velocity), abs(self._lagged_speed - self.velocity))
        within = error <= 0.1 * self.settings.max_velocity
        self._check(within, VELOCITY_ERROR_TIME, VELOCITY_ERROR, now)

    def _check(self, within: bool, time: float, code: int, now: float) -> None:
        """Reports the device error with the error code ``code`` if a supervised value has exceeded
        its limit for ``time`` s.

        ``within`` is true if the supervised value is within the limit.
        """
        if within:
            self._error_since = None
        elif self._error_since is None:
            self._error_since = now
        elif now - self._error_since >= time:
            self.fail(code)

    def _hold(self, now: float) -> None:
        self.motor.hold(self.encoder.joint_position(self.motion.move.position), now)

    def _stand(self, now: float) -> None:
        """Holds the motor at the present position."""
        self.motor.hold(self.motor.read(now).position, now)

    def _relax(self, now: float) -> None:
        """Switches the motor off.  The brake of the motor closes, because it has no current."""
        if not self._relaxed:
            self._relaxed = True
            self.motor.release(now)


CONTROL_PERIOD = 0.002
"""Period of the control loop (s)."""
MOTION_ERROR = 0x20
"""Bit of the error register (object 0x1001) for a motion error."""


class Cia402Drive(CanopenDevice):
    """A simulated CiA 402 drive, whose motors start in the state SWITCH ON DISABLED.

    Object 0x6007 defines the reaction of the drive to a loss of the connection to the master.  The
    connection to the master is lost in three cases: a heartbeat that object 0x1016 defines is
    missing, the CAN controller is in bus-off, or the NMT state leaves OPERATIONAL while a motor is
    powered.

    ``control_period`` is the period of the control loop (s).  A longer period saves computing time
    in simulations of many hours.
    """

    control_period = CONTROL_PERIOD

    device_name = "CiA 402 drive"
    device_type = 0x00020192
    """Servo drive with the device profile 402."""

    def __init__(self, specification: DeviceSpecification) -> None:
        super().__init__(specification)
        node = specification.node
        self.equip(
            [
                (_axis_settings(specification, actuator, motor.direction), motor)
                for _, actuator, motor in specification.channels()
            ],
            [Pdo.of_frame(f, node.id) for f in specification.received if f.pdo is not None],
            [Pdo.of_frame(f, node.id) for f in specification.sent if f.pdo is not None],
            motor_numbers(specification.bus, node),
        )

    def equip(
        self,
        axes: Sequence[tuple[AxisSettings, MotorModel]],
        received: Sequence[Pdo],
        sent: Sequence[Pdo],
        numbers: Sequence[int] = (0,),
    ) -> None:
        """Connects the motors, and sets the factory settings of the RPDOs and TPDOs.

        The drive adds its node id to the CAN identifiers in the factory settings.  ``numbers`` has
        the number of each motor in the object dictionary: the objects of motor 0 begin at 0x6000,
        those of motor 1 at 0x6800.
        """
        self.axes = [Axis(settings, motor, self._report_error) for settings, motor in axes]
        self._numbers, self._received, self._sent = numbers, received, sent

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        if index >= len(self.axes):
            return None, None
        return self.axes[index].encoder, self.axes[index].motor

    def add_objects(self, objects: ObjectDictionary) -> None:
        for number, axis in zip(self._numbers, self.axes, strict=True):
            axis.add_objects(objects, FIRST_INDEX + STRIDE * number)

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        received, sent = (
            [pdo._replace(cob_id=pdo.cob_id + self.node_id) for pdo in pdos]
            for pdos in (self._received, self._sent)
        )
        return PdoSet(objects, received, sent, self.send)

    def initialised(self) -> None:
        for axis in self.axes:
            if axis.states.state is canopen.DriveState.NOT_READY:
                axis.start(self.now)
        self.every(lambda: self.control_period, self._tick, first=self.control_period)

    def stop(self) -> None:
        super().stop()
        for axis in self.axes:
            axis.stop(self.now)

    def nmt_state_changed(self, state: canopen.NmtState) -> None:
        if state is canopen.NmtState.INITIALISING:
            for axis in self.axes:
                axis.power_stage_off(self.now)
        elif state is not canopen.NmtState.OPERATIONAL:
            self._connection_lost()

    def communication_error(self) -> None:
        self._connection_lost()
        super().communication_error()

    def _connection_lost(self) -> None:
        for axis in self.axes:
            axis.connection_lost()

    def _tick(self) -> None:
        now = self.now
        for axis in self.axes:
            axis.tick(now, self.control_period)
        if self.pdos is not None and self.state is canopen.NmtState.OPERATIONAL:
            self.pdos.tick(now)

    def _report_error(self, code: int) -> None:
        if code:
            self.emergency(code, MOTION_ERROR)
        elif all(axis.error_code == 0 for axis in self.axes):
            self.emergency(0)


def _axis_settings(
    specification: DeviceSpecification, actuator: Actuator | None, direction: int
) -> AxisSettings:
    """``direction``: -1 if the drive counts against the joint."""
    if actuator is None:
        return AxisSettings(1.0, 1024, 1.0, 1.0, 0.0)
    joint = specification.robot.joint(actuator.joint)
    lower, upper = (joint.lower, joint.upper) if actuator.role == "steering" else (None, None)
    if direction < 0:
        lower, upper = (None if end is None else -end for end in (upper, lower))
    return AxisSettings(
        actuator.gear_ratio,
        actuator.encoder_ppr,
        actuator.max_velocity,
        actuator.max_acceleration,
        actuator.max_torque,
        lower,
        upper,
        brake=actuator.brake is not None,
        zero=direction * actuator.encoder_offset,
    )
