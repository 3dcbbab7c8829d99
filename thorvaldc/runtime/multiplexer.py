"""Selects one of several sources of commanded twists, with the rules of the ROS node twist_mux."""

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
"""Tolerance (s) for rounding errors in the check of a time-out."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected twist source and its commanded twist.

    - ``source``: name of the selected source, or empty if no source is selected.
    - ``twist``: twist of the selected source, or zero if no source is selected.
    - ``time``: time (s) at which the source published the twist.
    - ``locks``: names of the locks that are active.
    """

    source: str
    twist: Twist
    time: float
    locks: tuple[str, ...] = ()


class _Input:
    """A twist source or a lock, with its last published value and the time of publication."""

    def __init__(self, settings: TwistInput) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self.locked = False
        self.time = -math.inf

    def is_silent(self, now: float) -> bool:
        """Checks whether the source or lock has published nothing for longer than its time-out.

        A source or lock with a time-out of 0 s never times out.
        """
        timeout = self.settings.timeout
        return timeout > 0.0 and now - self.time > timeout + _TIME_TOLERANCE


class Multiplexer:
    """Selects among twist sources with priorities and time-outs, and locks that block sources.

    The robot follows the source with the highest priority among the sources whose last twist is not
    older than the source's time-out.  An active lock blocks all twist sources of the same or a
    lower priority.  A lock is active while its last published state is ``True``.  A lock with a
    time-out is also active before its first publication, and while its last publication is older
    than the time-out.  An active stop lock (``TwistInput.is_stop_lock``) blocks all twist sources,
    whatever their priority is.

    The multiplexer follows the rules of the ROS node twist_mux with two exceptions.  A lock of the
    multiplexer stops the robot immediately; a lock of twist_mux stops the robot only after the
    driver's time-out.  A lock of twist_mux does not block a source of its own priority; the
    compiler accepts no such source.

    All times are monotonic times in s from the caller, because the multiplexer does not read a
    clock.
    """

    def __init__(self, sources: Iterable[TwistInput], locks: Iterable[TwistInput]) -> None:
        self._sources = {s.name: _Input(s) for s in sources}
        self._locks = {lock.name: _Input(lock) for lock in locks}
        # Highest priority of a source that the lock blocks while the lock is active.
        self._barriers = {
            name: math.inf if lock.settings.is_stop_lock else float(lock.settings.priority)
            for name, lock in self._locks.items()
        }
        # Twist sources in the order of descending priority.  Of two sources with the same priority,
        # the first source in the robot file wins, as in twist_mux.
        self._ranked = sorted(self._sources.values(), key=lambda i: -i.settings.priority)
        self._last_time: float | None = None

    @classmethod
    def from_robot(cls, robot: Robot) -> Multiplexer:
        """Returns a multiplexer with the twist sources and locks of the robot file."""
        return cls(robot.twist_sources, robot.twist_locks)

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self._sources)

    @property
    def locks(self) -> tuple[str, ...]:
        return tuple(self._locks)

    def publish(self, source: str, twist: Twist, now: float) -> bool:
        """Publishes a commanded twist of a source at the time ``now`` (s).

        The published twist is valid until the time-out of the source.

        Returns ``False`` if the twist or the time is not finite or too large.  If a twist is
        rejected, the previous twist of the source stays valid until its time-out.  Raises
        ``ParameterError`` if the robot has no twist source with this name.
        """
        publisher = self._find("source of twists", source, self._sources)
        if not (sum(map(abs, twist)) < MAX_TWIST and math.isfinite(now)):
            return False
        publisher.twist, publisher.time = twist, now
        return True

    def lock(self, name: str, locked: bool, now: float) -> None:
        """Publishes the state of a lock at the time ``now`` (s).

        Raises ``ParameterError`` if the robot has no lock with this name.
        """
        publisher = self._find("lock", name, self._locks)
        publisher.locked, publisher.time = locked, now

    def active_locks(self, now: float) -> tuple[str, ...]:
        """Returns the names of the locks that are active at the time ``now`` (s)."""
        return tuple(
            name for name, lock in self._locks.items() if lock.locked or lock.is_silent(now)
        )

    def select(self, now: float) -> Selection:
        """Selects the twist source that drives the robot at the time ``now`` (s)."""
        locks = self.active_locks(now)
        barrier = max((self._barriers[name] for name in locks), default=-1.0)
        for source in self._ranked:
            if source.settings.priority <= barrier:
                break
            if not source.is_silent(now) and source.time > -math.inf:
                return Selection(source.settings.name, source.twist, source.time, locks)
        return Selection("", ZERO_TWIST, now, locks)

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """Selects a twist source and sends its twist to ``driver`` as a command.

        The command time-out and the limits of the driver still apply.  If no source is selected
        after a source has driven the robot, the robot stops.  With an active lock, the driver
        immediately ramps the twist down to zero.  Without an active lock, the robot stops when the
        last command times out.
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
