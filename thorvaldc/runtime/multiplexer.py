"""Which of several sources of twists drives the robot, as ROS's twist_mux chooses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.robot import TwistInput
from thorvaldc.runtime.driver import BEYOND, BaseDriver
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class Selection:
    """What drives at an instant: ``source`` (empty: none), its twist, when it was published (s).

    ``locks`` are those that hold.  Without a source the twist is zero.
    """

    source: str
    twist: Twist
    time: float
    locks: tuple[str, ...] = ()


class _Input:
    """A source or a lock, what it said last and when."""

    def __init__(self, settings: TwistInput) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self.locked = False
        self.at = -math.inf

    def silent(self, now: float) -> bool:
        timeout = self.settings.timeout
        return timeout > 0.0 and now - self.at > timeout + _SLACK


class Multiplexer:
    """Sources with priority and time-out, and locks, in front of a driver.

    The source of the highest priority that is being published drives; one that was silent
    for longer than its time-out is not.  A lock that holds keeps back the sources below
    its priority; one with a time-out holds also where it was silent for longer, and
    until it is heard for the first time.  (ROS's twist_mux does the same, except that
    here a lock stops the robot at once and not after the driver's time-out.)

    Times are in s and monotonic; everything depends on them alone.
    """

    def __init__(self, sources: Iterable[TwistInput], locks: Iterable[TwistInput]) -> None:
        self._sources = {s.name: _Input(s) for s in sources}
        self._locks = {lock.name: _Input(lock) for lock in locks}
        # Highest first; of equal ones the first, as twist_mux has it.
        self._ranked = sorted(self._sources.values(), key=lambda i: -i.settings.priority)
        self._last: float | None = None

    @classmethod
    def from_robot(cls, robot: Robot) -> Multiplexer:
        """With the sources and locks that the robot's file gives it."""
        return cls(robot.twist_sources, robot.twist_locks)

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self._sources)

    @property
    def locks(self) -> tuple[str, ...]:
        return tuple(self._locks)

    def publish(self, source: str, twist: Twist, now: float) -> bool:
        """A source's twist, from ``now`` on for at most its time-out.

        ``False`` for a twist or a time that is not finite, or beyond all bounds: the source's
        twist before stays until it times out.  Raises ``ParameterError`` for a source
        that there is not.
        """
        found = self._find("source of twists", source, self._sources)
        if not (sum(map(abs, twist)) < BEYOND and math.isfinite(now)):
            return False
        found.twist, found.at = twist, now
        return True

    def lock(self, name: str, locked: bool, now: float) -> None:
        """A lock says that it holds, or does not.  Raises ``ParameterError`` if there is none."""
        found = self._find("lock", name, self._locks)
        found.locked, found.at = locked, now

    def holding(self, now: float) -> tuple[str, ...]:
        """The locks that hold."""
        return tuple(name for name, lock in self._locks.items() if lock.locked or lock.silent(now))

    def select(self, now: float) -> Selection:
        """Who drives at ``now``."""
        holding = self.holding(now)
        barrier = max((self._locks[name].settings.priority for name in holding), default=0)
        for source in self._ranked:
            if source.settings.priority < barrier:
                break
            if not source.silent(now) and source.at > -math.inf:
                return Selection(source.settings.name, source.twist, source.at, holding)
        return Selection("", ZERO_TWIST, now, holding)

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """Command what is selected; the driver's own time-out and limits stay in force.

        Where nothing is selected any more the robot is to stop: at once, by the driver's
        ramps, if a lock holds; else the driver finds that its command is too old.
        """
        found = self.select(now)
        if found.source:
            self._last = found.time
            driver.command(found.twist, found.time)
        elif self._last is not None:
            driver.command(ZERO_TWIST, now if found.locks else self._last)
        return found

    @staticmethod
    def _find(what: str, name: str, known: dict[str, _Input]) -> _Input:
        found = known.get(name)
        if found is None:
            hint = did_you_mean(name, list(known), f"known: {', '.join(known)}")
            raise ParameterError(f"there is no {what} `{name}`; {hint}")
        return found
