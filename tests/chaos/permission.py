"""Which motion the clients have asked for, by rules that do not use the driver's own decisions.

A motion is permitted while all of this is true.  The rules are those of docs/driving.md:

- The driver was armed after it became ready, and no fault, stop, restart or long gap came since.
- The twist was sent by the connection that holds its source, and it is fresh.
- The source has commanded zero since the last control cycle in which it did not drive the robot,
  whatever the cause was.  A ramp may begin with its first step after a silence.
- No stop lock with a higher priority is set, and none was set since the driver was armed.

The rules are permissive where the outcome depends on the order within a control cycle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from thorvaldc.model import Robot
from thorvaldc.model.settings import RAMP_FIRST, first_ramp_step
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SHORT_GAP = 2.5
"""Periods between two control cycles above which waiting commands are void."""
ARM_TIME = 0.1
"""s in which the driver processes a request to arm."""
HOMING_TIME = 40.0
"""s after which the driver has homed the steering for a request to arm."""
RANK_OF_STOP = "safety_stop"


@dataclass
class _Source:
    """A twist source with its last accepted twist."""

    priority: int
    timeout: float
    client: str = ""
    twist: Twist = ZERO_TWIST
    time: float = -math.inf
    attempt: float = -math.inf
    """Time (s) of the last twist of the holder, also if it was void."""
    awaits_zero: bool = False
    ramps: bool = False

    def is_held(self, now: float) -> bool:
        return now - self.attempt <= self.timeout + 1e-6

    def is_fresh(self, now: float) -> bool:
        return now - self.time <= self.timeout + 1e-6


@dataclass
class Permission:
    """The permitted motion, from what was sent to the driver and when.

    - ``needs_arming``: the robot file requires the service ``arm``; without it, the robot arms
      itself when it is ready, no stop lock is set, and every source is silent or at zero.
    - ``long_gap``: time (s) between two control cycles from which on the driver must be reset.
    """

    robot: Robot
    period: float
    needs_arming: bool = True
    long_gap: float = 0.25
    armed: bool = False
    must_reset: bool = False
    zero_first: bool = True
    sources: dict[str, _Source] = field(default_factory=dict)
    locks: dict[str, set[str]] = field(default_factory=dict)
    """Connections that have set each active lock, by name of the lock."""
    living: set[str] = field(default_factory=set)
    flooding: set[str] = field(default_factory=set)
    """Connections that have sent more than the driver reads at once; their twists may be too old to
    hold a source."""
    _arming_until: float = -math.inf
    _disarmed_by_person: bool = False
    _arming_client: str = ""
    """Connection whose request to arm homes the steering first."""
    _awaits_homing: bool = False
    _moves_before_arming: bool = False
    _void_at: float = -math.inf
    _last_motion: float = -math.inf
    _last_cycle: float = -math.inf

    def __post_init__(self) -> None:
        self._stops = {lock.name for lock in self.robot.twist_locks if lock.is_stop_lock}
        self.driver_restarted()

    # -- what happens ----------------------------------------------------------------------------

    def driver_restarted(self) -> None:
        self.sources = {
            s.name: _Source(s.priority, s.timeout or math.inf, ramps=s.first_command == RAMP_FIRST)
            for s in self.robot.twist_sources
        }
        self.locks = {}
        self.living = set()
        self._last_cycle = math.nan
        self._disarmed_by_person = False
        self.disarm()

    def disarm(self) -> None:
        self.armed, self.must_reset, self.zero_first = False, True, True
        self._arming_until = -math.inf

    def cycle_starts(self, now: float) -> None:
        """Judges the time since the last control cycle."""
        gap = now - self._last_cycle
        self._last_cycle = now
        if gap > SHORT_GAP * self.period + 1e-6:
            self._void()
        if gap >= self.long_gap:
            self.disarm()

    def cycle_ends(
        self, now: float, drives: bool, starts: bool, awaits_homing: bool = False
    ) -> None:
        """``drives``, ``starts``: the base is ready or drives; it is in its start-up.

        ``awaits_homing``: the base homes the steering when it is armed.
        """
        self._awaits_homing = awaits_homing
        self._note_ineffective(now)
        if starts:
            self.must_reset = False
        arms_itself = not self.needs_arming and not self._disarmed_by_person
        if not drives:
            self.armed, self.zero_first, self._void_at = False, True, now
        elif self._arming_until >= now:
            self._arming_until = -math.inf
            self.armed, self.must_reset = True, False
            self.zero_first, self._void_at = self._moves_before_arming, now
            for source in self.sources.values():
                source.awaits_zero = False
        elif arms_itself and not self._stops & self.locks.keys() and not self._is_moving(now):
            self.armed, self.must_reset = True, False
        if drives and not self._is_moving(now):
            self.zero_first = False

    def _is_moving(self, now: float) -> bool:
        """Checks whether a fresh twist that was sent at ``now`` (s) or before is a motion."""
        return any(
            s.is_fresh(now) and s.time <= now and s.twist != ZERO_TWIST
            for s in self.sources.values()
        )

    def _note_ineffective(self, now: float) -> None:
        """Every source that commands a motion and does not drive must command zero first."""
        selected = self._selected(now) if self.armed else None
        for source in self.sources.values():
            if source is not selected and source.twist != ZERO_TWIST:
                source.awaits_zero = True

    def _void(self) -> None:
        for source in self.sources.values():
            source.time, source.awaits_zero = -math.inf, True

    def sends_twist(self, client: str, source: str, twist: Twist, now: float) -> None:
        entry = self.sources.get(source)
        if entry is None or not all(map(math.isfinite, twist)):
            return
        other = entry.client not in ("", client) and entry.client in self.living - self.flooding
        if other and entry.is_held(now):
            return
        if not entry.is_held(now - self.period):  # the driver compares the times of two cycles
            entry.awaits_zero = not (entry.ramps and self._is_first_step(twist))
        entry.client, entry.attempt = client, now
        if twist == ZERO_TWIST:
            entry.awaits_zero = False
        elif entry.awaits_zero:
            return
        if client in self.flooding and entry.is_fresh(now) and entry.twist.speed > twist.speed:
            return  # it waits behind the flood
        entry.twist, entry.time = twist, now
        if twist != ZERO_TWIST:
            self._last_motion = now
        elif self._selected(now) is entry:
            self.zero_first = False

    def _is_first_step(self, twist: Twist) -> bool:
        linear, angular = first_ramp_step(self.robot.driver)
        return max(abs(twist.vx), abs(twist.vy)) <= linear and abs(twist.wz) <= angular

    def sends_late_zero(self, source: str, now: float) -> None:
        """Notes a zero twist that may wait behind a flood of motions, which count first."""
        entry = self.sources[source]
        entry.awaits_zero = self.zero_first = False
        entry.attempt = now
        if not entry.is_fresh(now):
            entry.twist, entry.time = ZERO_TWIST, now

    def calls(self, client: str, service: str, arguments: dict[str, object], now: float) -> None:
        if service == "arm" and self.armed and not self.must_reset:
            return  # nothing changes
        if service == "arm":
            waits = HOMING_TIME if self._awaits_homing else ARM_TIME
            self._arming_until = now + waits if self.needs_arming else -math.inf
            self._arming_client = client
            # A motion that comes after the request may be its first motion.
            self._moves_before_arming = self._is_moving(now - self.period)
            self._disarmed_by_person = False
        elif service == "disarm":
            self.armed, self._arming_until = False, -math.inf
            self._disarmed_by_person = True
        elif service in ("safety_stop", "lock"):
            name = str(arguments.get("name", RANK_OF_STOP))
            if service == "safety_stop":
                self.disarm()
            if arguments.get("locked", True):
                if name in self._stops:
                    self.armed, self._arming_until = False, -math.inf
                self.locks.setdefault(name, set()).add(client)
            else:
                self._release(name, client, bool(arguments.get("force")))
        elif service == "release_safety_stop":
            self._release(RANK_OF_STOP, client, bool(arguments.get("force")))

    def _release(self, name: str, client: str, force: bool) -> None:
        owners = self.locks.get(name, set())
        owners.clear() if force else owners.discard(client)
        if not owners:
            self.locks.pop(name, None)

    def connects(self, client: str) -> None:
        self.living.add(client)

    def disconnects(self, client: str) -> None:
        """Voids the twists of a connection that was closed."""
        self.living.discard(client)
        if self._arming_client == client and self._awaits_homing:
            self._arming_until = -math.inf
        for source in self.sources.values():
            if source.client == client:
                source.time = source.attempt = -math.inf

    # -- what is permitted -------------------------------------------------------------------------

    def _selected(self, now: float) -> _Source | None:
        priorities = {lock.name: lock.priority for lock in self.robot.twist_locks}
        barrier = max((priorities.get(name, 255) for name in self.locks), default=-1)
        fresh = [s for s in self.sources.values() if s.is_fresh(now)]
        best = max(fresh, key=lambda s: s.priority, default=None)
        if best is None or best.priority < barrier or RANK_OF_STOP in self.locks:
            return None
        return best

    def twist(self, now: float) -> Twist:
        """Returns the permitted twist at the time ``now`` (s)."""
        timeout = self.robot.driver.command_timeout
        if self.zero_first and now - max(self._void_at, self._last_motion) > timeout:
            self.zero_first = False
        if not self.armed or self.must_reset or self.zero_first:
            return ZERO_TWIST
        source = self._selected(now)
        return ZERO_TWIST if source is None or source.awaits_zero else source.twist


def wheel_speed(robot: Robot, twist: Twist, linear: float, angular: float) -> float:
    """Returns the speed (m/s) of the fastest wheel for a twist within the driver's limits.

    ``linear``, ``angular``: limits of the driver in m/s and rad/s.
    """
    if all(wheel.steering_joint is None for wheel in robot.wheels):
        twist = Twist(twist.vx, 0.0, twist.wz)  # the wheels cannot roll sideways
    scale = 1.0
    if twist.speed > linear:
        scale = linear / twist.speed
    if abs(twist.wz) * scale > angular:
        scale = angular / abs(twist.wz)
    vx, vy, wz = (scale * part for part in twist)
    fastest = 0.0
    for wheel in robot.wheels:
        if not wheel.driven:
            continue
        forward, sideways = vx - wz * wheel.y, vy + wz * wheel.x
        steered = wheel.steering_joint is not None
        fastest = max(fastest, math.hypot(forward, sideways) if steered else abs(forward))
    return fastest
