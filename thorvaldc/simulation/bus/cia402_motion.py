"""Set-points of a CiA 402 drive in its modes of operation.  Everything in rad, rad/s and s."""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.simulation.bus.setpoint_trajectory import Move, ramp

PROFILE_POSITION, PROFILE_VELOCITY, HOMING, CYCLIC_POSITION, CYCLIC_VELOCITY = 1, 3, 6, 8, 9
MODES = (PROFILE_POSITION, PROFILE_VELOCITY, HOMING, CYCLIC_POSITION, CYCLIC_VELOCITY)

TO_NEGATIVE_STOP, TO_POSITIVE_STOP = -1, -2
NEGATIVE_SWITCH, POSITIVE_SWITCH = 17, 18
HERE = (35, 37)
SEARCH = 2.5 * math.pi
"""rad: how far a drive looks for its home position before it gives up."""
STALL_TIME = 0.1


class Bounds(NamedTuple):
    """What a set-point keeps to; all but ``lower`` are not negative."""

    lower: float
    upper: float
    velocity: float
    acceleration: float
    deceleration: float


class Motion:
    """The set-point and what the control word asks of it.

    ``reached`` and ``acknowledged`` are bits 10 and 12 of the status word, ``limited``
    bit 11: what was asked for is more than is allowed.
    """

    def __init__(self) -> None:
        self.mode = 0
        self.move = Move(0.0)
        self.reached = False
        self.limited = False
        self.acknowledged = False
        self.start = False
        self.halt = False
        self._relative = False
        self._immediately = False
        self._asked = False
        self._goal = 0.0
        self._next: float | None = None
        self._settled = 0.0
        self._target = math.nan
        self._rate = 0.0

    def control(self, word: int) -> None:
        """The bits of the control word that belong to the mode."""
        start = bool(word & 0x10)
        if start and not self.start:
            self._asked = True
        if not start:
            self.acknowledged = self._next is not None
        self.start = start
        self.halt = bool(word & 0x100)
        self._relative, self._immediately = bool(word & 0x40), bool(word & 0x20)

    def rest(self, position: float, mode: int) -> None:
        """Stand at ``position`` in ``mode``, with no set-point left over."""
        self.mode = mode
        self.move = Move(position)
        self.reached = self.limited = False
        self._goal, self._next, self._target = position, None, math.nan

    def change(self, mode: int, position: float, velocity: float) -> None:
        """Another mode, at speed."""
        self.rest(position, mode)
        self.move.speed = velocity

    def take_start(self) -> bool:
        """Whether bit 4 has risen since it was asked for last."""
        asked, self._asked = self._asked, False
        return asked

    # -- modes ---------------------------------------------------------------------------------

    def stop(self, deceleration: float, dt: float) -> None:
        """On the way to rest."""
        self.move.speed = ramp(self.move.speed, 0.0, deceleration, dt)
        self.move.position += self.move.speed * dt
        self.limited = False

    def profile_position(self, target: float, bounds: Bounds, dt: float) -> None:
        if self.take_start():
            start = self._goal if self._relative else 0.0
            self._next = start + target
            self.acknowledged = True
        arrived = self.move.position == self._goal and self.move.speed == 0.0
        if self._next is not None and (arrived or self._immediately):
            wanted, self._next = self._next, None
            self._goal = min(max(wanted, bounds.lower), bounds.upper)
            self.limited = self._goal != wanted
            self.reached, self._settled = False, 0.0
            self.acknowledged = self.start
        if self.halt:
            self.move.speed = ramp(self.move.speed, 0.0, bounds.deceleration, dt)
            self.move.position += self.move.speed * dt
            self.reached = self.move.speed == 0.0
            return
        self.move.step(self._goal, bounds.velocity, bounds.acceleration, bounds.deceleration, dt)

    def settle(self, position: float, window: float, time: float, dt: float) -> None:
        """Reached is what stays in the window for the time."""
        if self.halt:
            return
        close = abs(self._goal - position) <= window
        self._settled = self._settled + dt if close and self._next is None else 0.0
        self.reached = self._settled > 0.0 and self._settled >= time

    def velocity(self, wanted: float, position: float, bounds: Bounds, dt: float) -> float:
        """Profile and cyclic velocity.  Returns the speed that the ramp leads to."""
        if self.halt and self.mode == PROFILE_VELOCITY:
            wanted = 0.0
        allowed = min(max(wanted, -bounds.velocity), bounds.velocity)
        room = (bounds.upper - position) if allowed > 0.0 else (position - bounds.lower)
        if allowed and room < math.inf:
            most = math.sqrt(2.0 * bounds.deceleration * room) if room > 0.0 else 0.0
            allowed = math.copysign(min(abs(allowed), most), allowed)
        self.limited = allowed != wanted
        slower = abs(allowed) < abs(self.move.speed)
        rate = bounds.deceleration if slower else bounds.acceleration
        self.move.speed = ramp(self.move.speed, allowed, rate, dt)
        self.move.position = position
        return allowed

    def cyclic_position(self, target: float, bounds: Bounds, cycle: float, dt: float) -> None:
        """Straight from one target to the next in the time between two of them."""
        allowed = min(max(target, bounds.lower), bounds.upper)
        if allowed != self._target:
            self._target = allowed
            way = abs(allowed - self.move.position)
            self._rate = min(way / max(cycle, dt), bounds.velocity)
            self.limited = allowed != target or way > bounds.velocity * max(cycle, dt) * 1.001
        step = self._rate * dt
        way = min(max(allowed - self.move.position, -step), step)
        self.move.position += way
        self.move.speed = way / dt


class Homing:
    """A search for the home position.  ``attained`` or ``failed`` is its end.

    Methods of CiA 402: 17 and 18 (the negative, the positive limit switch: to it fast,
    off it slowly), 35 and 37 (where it stands); -1 and -2 are this drive's own: the
    negative, the positive mechanical stop.
    """

    def __init__(self, method: int) -> None:
        self.method = method
        self.attained = method in HERE
        self.failed = not self.attained and method not in (
            TO_NEGATIVE_STOP,
            TO_POSITIVE_STOP,
            NEGATIVE_SWITCH,
            POSITIVE_SWITCH,
        )
        self._backing = False
        self._stalled = 0.0
        self._way = 0.0

    def speed(
        self, switches: tuple[bool, bool], velocity: float, fast: float, slow: float, dt: float
    ) -> float:
        """The speed to search with; ``switches``: the negative and the positive limit switch."""
        if self.attained or self.failed:
            return 0.0
        negative = self.method in (TO_NEGATIVE_STOP, NEGATIVE_SWITCH)
        way = -1.0 if negative else 1.0
        if self.method in (TO_NEGATIVE_STOP, TO_POSITIVE_STOP):
            wanted = way * slow
            standing = abs(velocity) < 0.1 * slow and self._way > 0.2 * slow
            self._stalled = self._stalled + dt if standing else 0.0
            self.attained = self._stalled >= STALL_TIME
        else:
            on = switches[0] if negative else switches[1]
            self.attained = self._backing and not on
            self._backing = self._backing or on
            wanted = -way * slow if self._backing else way * fast
        self._way += abs(wanted) * dt
        self.failed = not self.attained and self._way > 2.0 * SEARCH
        return 0.0 if self.attained or self.failed else wanted
