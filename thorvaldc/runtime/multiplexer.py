"""Selection of one of several sources of commanded twists, with the rules of ROS's twist_mux."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.robot import TwistInput
from thorvaldc.runtime.driver import MAX_TWIST, BaseDriver
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_TIME_TOLERANCE = 1e-9
"""Rounding error (s) of times that a time-out tolerates."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected source (empty: none), its twist, and the time (s) of its publication.

    ``locks``: names of the active locks.  Without a source the twist is zero.
    """

    source: str
    twist: Twist
    time: float
    locks: tuple[str, ...] = ()


class _Input:
    """A source or a lock, with its last value and the time of that."""

    def __init__(self, settings: TwistInput) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self.locked = False
        self.time = -math.inf

    def is_silent(self, now: float) -> bool:
        """Checks whether the last publication is older than the time-out (0: no time-out)."""
        timeout = self.settings.timeout
        return timeout > 0.0 and now - self.time > timeout + _TIME_TOLERANCE


class Multiplexer:
    """Sources with priorities and time-outs, and locks, in front of a driver.

    The robot follows the source of the highest priority whose last publication is not older than
    its time-out.  An active lock blocks the sources below its priority.  A lock with a time-out
    is also active while its last publication is older than that, and before its first one.
    (ROS's twist_mux has the same rules, except that here a lock stops the robot immediately
    and not after the driver's time-out.)

    Times are in s and monotonic; the multiplexer reads no clock.
    """

    def __init__(self, sources: Iterable[TwistInput], locks: Iterable[TwistInput]) -> None:
        self._sources = {s.name: _Input(s) for s in sources}
        self._locks = {lock.name: _Input(lock) for lock in locks}
        # By descending priority; of equal priorities the first one wins, as in twist_mux.
        self._ranked = sorted(self._sources.values(), key=lambda i: -i.settings.priority)
        self._last_time: float | None = None

    @classmethod
    def from_robot(cls, robot: Robot) -> Multiplexer:
        """Returns a multiplexer with the sources and locks of the robot file."""
        return cls(robot.twist_sources, robot.twist_locks)

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self._sources)

    @property
    def locks(self) -> tuple[str, ...]:
        return tuple(self._locks)

    def publish(self, source: str, twist: Twist, now: float) -> bool:
        """Publishes a source's twist at ``now``; it is valid for the time-out of the source.

        Returns ``False`` for a twist or a time that is not finite or too large; the previous twist
        of the source then stays valid until it times out.  Raises ``ParameterError`` for
        an unknown source.
        """
        publisher = self._find("source of twists", source, self._sources)
        if not (sum(map(abs, twist)) < MAX_TWIST and math.isfinite(now)):
            return False
        publisher.twist, publisher.time = twist, now
        return True

    def lock(self, name: str, locked: bool, now: float) -> None:
        """Publishes the state of a lock.  Raises ``ParameterError`` for an unknown lock."""
        publisher = self._find("lock", name, self._locks)
        publisher.locked, publisher.time = locked, now

    def active_locks(self, now: float) -> tuple[str, ...]:
        """Returns the names of the active locks."""
        return tuple(
            name for name, lock in self._locks.items() if lock.locked or lock.is_silent(now)
        )

    def select(self, now: float) -> Selection:
        """Selects the source that drives the robot at ``now``."""
        locks = self.active_locks(now)
        barrier = max((self._locks[name].settings.priority for name in locks), default=0)
        for source in self._ranked:
            if source.settings.priority < barrier:
                break
            if not source.is_silent(now) and source.time > -math.inf:
                return Selection(source.settings.name, source.twist, source.time, locks)
        return Selection("", ZERO_TWIST, now, locks)

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """Commands the selected twist; the driver's own time-out and limits stay in force.

        If no source is selected any more, the robot stops: with an active lock immediately, on the
        driver's ramp; otherwise when the driver's command times out.
        """
        selection = self.select(now)
        if selection.source:
            self._last_time = selection.time
            driver.command(selection.twist, selection.time)
        elif self._last_time is not None:
            driver.command(ZERO_TWIST, now if selection.locks else self._last_time)
        return selection

    @staticmethod
    def _find(kind: str, name: str, known: dict[str, _Input]) -> _Input:
        publisher = known.get(name)
        if publisher is None:
            hint = did_you_mean(name, list(known), f"known: {', '.join(known)}")
            raise ParameterError(f"there is no {kind} `{name}`; {hint}")
        return publisher
