r"""Set-points, homing and power state machine of a simulated CiA 402 drive.

The drive computes a new set-point every 2 ms.  Set-point in each mode of operation:

* Profile position: the set-point moves to the target position with a trapezoidal speed profile
  (``Move``).
* Profile velocity and cyclic velocity: the speed changes on a ramp to the target speed.
* Cyclic position: the master sends a target position in each cycle, and object 0x60C2 has the
  duration of the cycle.  The position set-point moves at constant speed and reaches the target
  position after one cycle.  The motor thus moves smoothly, although the target position changes
  only every 20 ms.

The motor speed is limited near a position limit, so that the drive can stop before the position
limit.  The highest speed v at the distance d from the position limit is v = sqrt(2 a d), where a is
the deceleration.

The mode profile position uses a handshake with bit 4 of the control word (new set-point) and bit 12
of the status word (set-point acknowledged):

    control word bit 4   ____/-------\______
    status word bit 12   ______/-------\____     acknowledged until bit 4 is 0 again
    status word bit 10   ------\__________/--    target reached
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.can import canopen

# -- speed ramps and trapezoidal moves -------------------------------------------------------------

# A trapezoidal move ends at rest at the target position.  This diagram shows a trapezoidal move
# with the top speed v and with equal acceleration and deceleration a:
#
#     speed ^      v ____________
#           |       /            \
#           |     /                \            braking distance from speed s: s^2 / (2 a)
#           |   /                    \
#           +--+----------------------+--> time
#
# The speed limit s in a step is the highest speed from which the drive can still stop at the goal.
# The speed changes in time steps of dt, so that the braking distance is the sum s dt + (s - a dt)
# dt + ... = s^2 / (2 a) + s dt/2.  The speed limit s makes the braking distance equal to the
# distance d to the target position.  Solution of the quadratic equation for the speed limit s:
#
#     s = sqrt((a dt/2)^2 + 2 a d) - a dt/2


def ramp(speed: float, goal: float, acceleration: float, dt: float) -> float:
    """Returns the speed after a ramp from ``speed`` towards ``goal`` for ``dt`` s."""
    step = acceleration * dt
    return min(max(goal, speed - step), speed + step)


class Move:
    """The set-point of a trapezoidal move that ends at rest and may start at any speed.

    ``position`` is the position of the set-point (rad), and ``speed`` is the speed of the set-point
    (rad/s).
    """

    def __init__(self, position: float, speed: float = 0.0) -> None:
        self.position = position
        self.speed = speed

    def step(
        self, goal: float, velocity: float, acceleration: float, deceleration: float, dt: float
    ) -> bool:
        """Computes the set-point after a time step of ``dt`` s.

        All limits of speed and acceleration must be positive.  Returns true if the set-point has
        reached the target position.
        """
        distance = goal - self.position
        half = deceleration * dt / 2.0
        allowed = math.sqrt(half * half + 2.0 * deceleration * abs(distance)) - half
        speed_goal = math.copysign(min(velocity, allowed), distance)
        braking = abs(speed_goal) < abs(self.speed) or speed_goal * self.speed < 0.0
        self.speed = ramp(self.speed, speed_goal, deceleration if braking else acceleration, dt)
        step = self.speed * dt
        if abs(distance) <= max(abs(step), 1e-9) and abs(self.speed) <= deceleration * dt * 1.01:
            self.position, self.speed = goal, 0.0
            return True
        self.position += step
        return False


RELATIVE, HALT = 1 << 6, 1 << 8
"""Bits of the control word."""

TO_NEGATIVE_STOP, TO_POSITIVE_STOP = -1, -2
NEGATIVE_SWITCH, POSITIVE_SWITCH = 17, 18
PRESENT_POSITION = (35, 37)
SEARCH = 2.5 * math.pi
"""rad: the search for the home position fails after twice this distance."""
STALL_TIME = 0.1
"""Time (s) at rest after which the drive assumes a mechanical stop."""


class Bounds(NamedTuple):
    """Limits of the position, speed and acceleration of a set-point.

    Positions are in rad, speeds in rad/s, and accelerations in rad/s^2.
    """

    lower: float
    upper: float
    velocity: float
    acceleration: float
    deceleration: float


class Motion:
    """The position and speed set-points of a motor in each mode of operation.

    * ``reached``: bit 10 of the status word, the target is reached.
    * ``limited``: bit 11 of the status word, the target is beyond a limit.
    * ``acknowledged``: bit 12 of the status word, the set-point is acknowledged.
    """

    def __init__(self) -> None:
        self.mode = 0
        self.move = Move(0.0)
        self.reached = False
        self.limited = False
        self.acknowledged = False
        self.start = False
        """Bit 4 of the control word."""
        self.halt = False
        self._relative = False
        self._immediately = False
        self._start_pending = False
        self._goal = 0.0
        self._next_goal: float | None = None
        self._settled = 0.0
        """Time (s) for which the position has been in the window around the target."""
        self._target = math.nan
        self._rate = 0.0

    def control(self, word: int) -> None:
        """Handles the bits of the CiA 402 control word that depend on the mode of operation."""
        start = bool(word & canopen.NEW_SET_POINT)
        if start and not self.start:
            self._start_pending = True
        if not start:
            self.acknowledged = self._next_goal is not None
        self.start = start
        self.halt = bool(word & HALT)
        self._relative, self._immediately = (
            bool(word & RELATIVE),
            bool(word & canopen.CHANGE_IMMEDIATELY),
        )

    def rest(self, position: float, mode: int) -> None:
        """Stops the set-point at ``position`` (rad) and discards pending target positions."""
        self.mode = mode
        self.move = Move(position)
        self.reached = self.limited = False
        self._goal, self._next_goal, self._target = position, None, math.nan

    def change(self, mode: int, position: float, velocity: float) -> None:
        """Changes the mode of operation while the motor turns."""
        self.rest(position, mode)
        self.move.speed = velocity

    def take_start(self) -> bool:
        """Returns true if bit 4 of the control word changed from 0 to 1 since the last call."""
        pending, self._start_pending = self._start_pending, False
        return pending

    # -- modes ---------------------------------------------------------------------------------

    def stop(self, deceleration: float, dt: float) -> None:
        """Reduces the speed set-point towards 0 on a ramp, for a time step of ``dt`` s."""
        self.move.speed = ramp(self.move.speed, 0.0, deceleration, dt)
        self.move.position += self.move.speed * dt
        self.limited = False

    def profile_position(self, target: float, bounds: Bounds, dt: float) -> None:
        """Computes the set-point in the mode profile position, for a time step of ``dt`` s.

        The target position ``target`` (rad) takes effect after bit 4 of the control word changes
        from 0 to 1.
        """
        if self.take_start():
            start = self._goal if self._relative else 0.0
            self._next_goal = start + target
            self.acknowledged = True
        arrived = self.move.position == self._goal and self.move.speed == 0.0
        if self._next_goal is not None and (arrived or self._immediately):
            goal, self._next_goal = self._next_goal, None
            self._goal = min(max(goal, bounds.lower), bounds.upper)
            self.limited = self._goal != goal
            self.reached, self._settled = False, 0.0
            self.acknowledged = self.start
        if self.halt:
            self.move.speed = ramp(self.move.speed, 0.0, bounds.deceleration, dt)
            self.move.position += self.move.speed * dt
            self.reached = self.move.speed == 0.0
            return
        self.move.step(self._goal, bounds.velocity, bounds.acceleration, bounds.deceleration, dt)

    def settle(self, position: float, window: float, time: float, dt: float) -> None:
        """Sets ``reached`` after the motor has been near the target position for ``time`` s.

        ``window`` is the largest allowed distance (rad) from the target position.
        """
        if self.halt:
            return
        close = abs(self._goal - position) <= window
        self._settled = self._settled + dt if close and self._next_goal is None else 0.0
        self.reached = self._settled > 0.0 and self._settled >= time

    def velocity(self, target: float, position: float, bounds: Bounds, dt: float) -> float:
        """Computes the speed set-point in the modes profile velocity and cyclic velocity.

        ``dt`` is the time step (s) of the control loop.  Returns the speed set-point (rad/s) at the
        end of the speed ramp.
        """
        if self.halt and self.mode == canopen.Mode.PROFILE_VELOCITY:
            target = 0.0
        allowed = min(max(target, -bounds.velocity), bounds.velocity)
        room = (bounds.upper - position) if allowed > 0.0 else (position - bounds.lower)
        if allowed and room < math.inf:
            top = math.sqrt(2.0 * bounds.deceleration * room) if room > 0.0 else 0.0
            allowed = math.copysign(min(abs(allowed), top), allowed)
        self.limited = allowed != target
        slower = abs(allowed) < abs(self.move.speed)
        rate = bounds.deceleration if slower else bounds.acceleration
        self.move.speed = ramp(self.move.speed, allowed, rate, dt)
        self.move.position = position
        return allowed

    def cyclic_position(self, target: float, bounds: Bounds, cycle: float, dt: float) -> None:
        """Computes the set-point in the mode cyclic position, for a time step of ``dt`` s.

        The position set-point moves at constant speed and reaches the target position ``target``
        (rad) after ``cycle`` s.
        """
        allowed = min(max(target, bounds.lower), bounds.upper)
        if allowed != self._target:
            self._target = allowed
            distance = abs(allowed - self.move.position)
            self._rate = min(distance / max(cycle, dt), bounds.velocity)
            too_far = distance > bounds.velocity * max(cycle, dt) * 1.001
            self.limited = allowed != target or too_far
        step = self._rate * dt
        change = min(max(allowed - self.move.position, -step), step)
        self.move.position += change
        self.move.speed = change / dt


class Homing:
    """A search for the home position of a motor.

    At the end of the homing search, either ``attained`` or ``failed`` is true.  The supported
    homing methods of CiA 402 are:

    * 17 and 18: the home position is the edge of the negative (17) or positive (18) limit switch.
      The motor moves fast to the limit switch or home switch, and then slowly off the switch.
    * 35 and 37: the home position is the present position.
    * -1 and -2 (manufacturer-specific): the home position is the negative (-1) or positive (-2)
      mechanical stop.
    """

    def __init__(self, method: int) -> None:
        self.method = method
        self.attained = method in PRESENT_POSITION
        self.failed = not self.attained and method not in (
            TO_NEGATIVE_STOP,
            TO_POSITIVE_STOP,
            NEGATIVE_SWITCH,
            POSITIVE_SWITCH,
        )
        self._backing = False
        """True after the motor has reached the limit switch and moves off the switch."""
        self._stalled = 0.0
        """Time (s) for which the motor has been at rest."""
        self._distance = 0.0
        """Distance (rad) of the commanded motion since the start of the search."""

    def speed(
        self, switches: tuple[bool, bool], velocity: float, fast: float, slow: float, dt: float
    ) -> float:
        """Returns the speed (rad/s) of the homing search for the next ``dt`` s.

        ``switches`` are the states of the negative and the positive limit switch.  ``velocity`` is
        the measured speed (rad/s) of the motor.
        """
        if self.attained or self.failed:
            return 0.0
        negative = self.method in (TO_NEGATIVE_STOP, NEGATIVE_SWITCH)
        direction = -1.0 if negative else 1.0
        if self.method in (TO_NEGATIVE_STOP, TO_POSITIVE_STOP):
            speed = direction * slow
            standing = abs(velocity) < 0.1 * slow and self._distance > 0.2 * slow
            self._stalled = self._stalled + dt if standing else 0.0
            self.attained = self._stalled >= STALL_TIME
        else:
            on_switch = switches[0] if negative else switches[1]
            self.attained = self._backing and not on_switch
            self._backing = self._backing or on_switch
            speed = -direction * slow if self._backing else direction * fast
        self._distance += abs(speed) * dt
        self.failed = not self.attained and self._distance > 2.0 * SEARCH
        return 0.0 if self.attained or self.failed else speed


# -- power state machine ---------------------------------------------------------------------------

# The control word changes the state of the drive, and the status word reports the state of the
# drive. ``thorvaldc.can.canopen`` has a diagram of the drive states.  Bits of the CiA 402
# control word:
#
#     bit 0 switch on   bit 1 enable voltage   bit 2 quick stop (active low)
#     bit 3 enable operation   bit 7 fault reset (rising edge)

SWITCH_ON, ENABLE_VOLTAGE, QUICK_STOP, ENABLE_OPERATION, FAULT_RESET = 0x01, 0x02, 0x04, 0x08, 0x80
QUICK_STOP_INACTIVE = 1 << 5
"""Bit 5 of the status word, which is 0 while a quick stop is commanded."""


class Reaction(NamedTuple):
    """A speed ramp that stops the motor, and the drive state after the ramp.

    If ``quick`` is true, the motor stops with the quick stop deceleration (object 0x6085).  If
    ``quick`` is false, the motor stops with the profile deceleration (object 0x6084).
    """

    quick: bool
    next_state: canopen.DriveState


class StateMachine:
    """The CiA 402 power state machine of one motor.

    ``reaction`` is the stop ramp that is in progress, or ``None``.  The user of the state machine
    calls ``stopped`` when the motor is at rest after a stop ramp.
    """

    def __init__(self) -> None:
        self.state = canopen.DriveState.NOT_READY
        self.reaction: Reaction | None = None
        self._control_word = 0

    def statusword(self) -> int:
        word = self.state.value | canopen.REMOTE
        if self.state is not canopen.DriveState.NOT_READY:
            word |= canopen.VOLTAGE_ENABLED
        if self.state in (canopen.DriveState.SWITCH_ON_DISABLED, canopen.DriveState.FAULT):
            word |= QUICK_STOP_INACTIVE if self._control_word & QUICK_STOP else 0
        return word

    def command(self, word: int, quick_stop_option: int, disable_option: int) -> None:
        """Handles a received CiA 402 control word.

        ``quick_stop_option`` is the value of object 0x605A, and ``disable_option`` is the value of
        object 0x605C.
        """
        reset = bool(word & FAULT_RESET) and not self._control_word & FAULT_RESET
        self._control_word = word
        state = self.state
        if state is canopen.DriveState.FAULT:
            if reset:
                self.state = canopen.DriveState.SWITCH_ON_DISABLED
            return
        if state in (canopen.DriveState.NOT_READY, canopen.DriveState.FAULT_REACTION_ACTIVE):
            return
        if not word & ENABLE_VOLTAGE:
            self.disable()
        elif not word & QUICK_STOP:
            if state is canopen.DriveState.OPERATION_ENABLED:
                self.quick_stop(quick_stop_option)
            elif state is not canopen.DriveState.QUICK_STOP_ACTIVE:
                self.disable()
        elif not word & SWITCH_ON:
            if state is not canopen.DriveState.QUICK_STOP_ACTIVE:
                self._enter(canopen.DriveState.READY_TO_SWITCH_ON)
        elif not word & ENABLE_OPERATION:
            self._switch_on(disable_option)
        else:
            self._enable()

    def _switch_on(self, disable_option: int) -> None:
        if self.state is canopen.DriveState.READY_TO_SWITCH_ON:
            self._enter(canopen.DriveState.SWITCHED_ON)
        elif self.state is canopen.DriveState.OPERATION_ENABLED and self.reaction is None:
            if disable_option == 1:
                self.reaction = Reaction(False, canopen.DriveState.SWITCHED_ON)
            else:
                self._enter(canopen.DriveState.SWITCHED_ON)

    def _enable(self) -> None:
        if self.state in (
            canopen.DriveState.READY_TO_SWITCH_ON,
            canopen.DriveState.SWITCHED_ON,
            canopen.DriveState.OPERATION_ENABLED,
        ):
            self._enter(canopen.DriveState.OPERATION_ENABLED)
        elif self.state is canopen.DriveState.QUICK_STOP_ACTIVE:
            reaction = self.reaction
            if reaction is None or reaction.next_state is canopen.DriveState.QUICK_STOP_ACTIVE:
                self._enter(canopen.DriveState.OPERATION_ENABLED)

    def disable(self) -> None:
        """Switches the power stage of the drive off without a stop ramp."""
        if self.state is not canopen.DriveState.FAULT:
            self._enter(canopen.DriveState.SWITCH_ON_DISABLED)

    def quick_stop(self, option: int) -> None:
        """Starts a quick stop of the motor.

        ``option`` is the quick stop option code (object 0x605A):

        * 0: the power stage is switched off without a ramp.
        * 1 and 2: the motor stops on a ramp, and then the power stage is switched off.
        * 5 and 6: the motor stops on a ramp, and the state remains QUICK STOP ACTIVE.

        The option codes 1 and 5 use the profile deceleration, and the option codes 2 and 6 use the
        quick stop deceleration.
        """
        if self.state is not canopen.DriveState.OPERATION_ENABLED:
            return
        if option == 0:
            self.disable()
            return
        stays = option >= 5
        next_state = (
            canopen.DriveState.QUICK_STOP_ACTIVE if stays else canopen.DriveState.SWITCH_ON_DISABLED
        )
        self.state = canopen.DriveState.QUICK_STOP_ACTIVE
        self.reaction = Reaction(option not in (1, 5), next_state)

    def fault(self, option: int) -> bool:
        """Enters the drive state FAULT.

        ``option`` is the value of object 0x605E, which defines whether the motor stops on a ramp
        first.  Returns ``False`` if the drive is in the state FAULT already.
        """
        if self.state in (canopen.DriveState.FAULT, canopen.DriveState.FAULT_REACTION_ACTIVE):
            return False
        if self.state.powered and option != 0:
            self.state = canopen.DriveState.FAULT_REACTION_ACTIVE
            self.reaction = Reaction(option != 1, canopen.DriveState.FAULT)
        else:
            self._enter(canopen.DriveState.FAULT)
        return True

    def stopped(self) -> None:
        """Enters the drive state that follows a stop ramp, after the motor has stopped."""
        if self.reaction is not None:
            self._enter(self.reaction.next_state)

    def _enter(self, state: canopen.DriveState) -> None:
        self.state = state
        self.reaction = None
