r"""Computes the position and speed set-points of a simulated CiA 402 drive.

The drive computes a new set-point every 2 ms.  Set-point in each mode of operation:

* Profile position: the set-point moves to the target position with a trapezoidal speed profile
  (``setpoint_trajectory``).
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

from thorvaldc.can.cia402 import CHANGE_IMMEDIATELY, NEW_SET_POINT, Mode
from thorvaldc.simulation.bus.setpoint_trajectory import Move, ramp

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
        start = bool(word & NEW_SET_POINT)
        if start and not self.start:
            self._start_pending = True
        if not start:
            self.acknowledged = self._next_goal is not None
        self.start = start
        self.halt = bool(word & HALT)
        self._relative, self._immediately = bool(word & RELATIVE), bool(word & CHANGE_IMMEDIATELY)

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
        if self.halt and self.mode == Mode.PROFILE_VELOCITY:
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
