"""Selects one of several sources of commanded twists, with the rules of the ROS node twist_mux."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, TypeVar

from thorvaldc.diagnostics import did_you_mean
from thorvaldc.model import Robot, TwistInput
from thorvaldc.model.settings import ZERO_FIRST
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.driver import MAX_TWIST, BaseDriver
from thorvaldc.runtime.pace import Gap, gap_text
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.service_table import THIS_PROGRAM, OwnedStop

_TIME_TOLERANCE: Final = 1e-9
"""Tolerance (s) for rounding errors in the check of a time-out."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected twist source and its commanded twist.

    - ``source``: name of the selected source, or empty if no source is selected.
    - ``twist``: twist of the selected source, or zero if no source is selected or if the selected
      source must command zero first.
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
        self.time = -math.inf

    def is_silent(self, now: float) -> bool:
        """Checks whether the source or lock has published nothing for longer than its time-out.

        A source or lock with a time-out of 0 s never times out.
        """
        timeout = self.settings.timeout
        return timeout > 0.0 and now - self.time > timeout + _TIME_TOLERANCE


class _Lock(_Input):
    """A lock with the programs that have locked it."""

    def __init__(self, settings: TwistInput) -> None:
        super().__init__(settings)
        self.stop = OwnedStop()


class _Source(_Input):
    """A twist source.

    - ``twist``: last accepted twist, published at ``time``;
    - ``owner``: program that publishes the source;
    - ``attempt``: last twist that the owner has published, also if it was refused;
    - ``attempt_time``: time (s) of the last attempt of the owner, from which the time-out counts;
    - ``awaits_zero``: reason why a zero twist must come first, or an empty text.
    """

    def __init__(self, settings: TwistInput) -> None:
        super().__init__(settings)
        self.twist = ZERO_TWIST
        self.owner = ""
        self.attempt = ZERO_TWIST
        self.attempt_time = -math.inf
        self.awaits_zero = ""

    def holder(self, now: float) -> str:
        """Returns the program to which the source is bound, or an empty text."""
        return self.owner if self.is_heard(now) else ""

    def is_heard(self, now: float) -> bool:
        """Checks whether the source has published a twist, also a refused one, within its
        time-out."""
        return now - self.attempt_time <= self.settings.timeout + _TIME_TOLERANCE

    def is_active(self, now: float) -> bool:
        """Checks whether the source takes its rank: it is heard, and its twist is valid or it must
        command zero first."""
        if self.awaits_zero:
            return self.is_heard(now)
        return self.time > -math.inf and not self.is_silent(now)

    @property
    def refusal(self) -> str:
        """Reason why the source moves nothing until it commands zero, or an empty text."""
        return f"{self.awaits_zero}; command zero first" if self.awaits_zero else ""

    def await_zero(self, reason: str) -> None:
        """Requires a zero twist because of ``reason``, unless the first command may be any."""
        if self.settings.first_command == ZERO_FIRST:
            self.awaits_zero = self.awaits_zero or reason


_AnyInput = TypeVar("_AnyInput", bound=_Input)


class Multiplexer:
    """Selects among twist sources with priorities and time-outs, and locks that block sources.

    The robot follows the source with the highest priority among the sources whose last twist is not
    older than the source's time-out.  An active lock blocks all twist sources of the same or a
    lower priority.  A lock is active while its last published state is ``True``.  A lock with a
    time-out is also active before its first publication, and while its last publication is older
    than the time-out.  An active stop lock (``TwistInput.is_stop_lock``) blocks all twist sources,
    whatever their priority is.

    A source must publish a zero twist before it moves the robot

    - if it is new: its first twist, or its first one after its time-out or after another program;
    - if it takes over from a source of a higher priority that has fallen silent;
    - after a gap in time (module ``pace``), which voids all published twists.

    The first two do not apply to a source whose ``first_command`` is ``any``.  A source that must
    publish zero keeps its rank: the robot stands, and follows no source of a lower priority.

    The multiplexer follows the rules of the ROS node twist_mux with three exceptions.  twist_mux
    requires no zero twist (ADR 22).  A lock of the multiplexer stops the robot immediately; a lock
    of twist_mux stops the robot only after the driver's time-out.  A lock of twist_mux does not
    block a source of its own priority; the compiler accepts no such source.

    A source is bound to the program that publishes it, until the source times out or ``release`` is
    called.  A lock is released only by the program that has locked it.

    All times are monotonic times in s from the caller, because the multiplexer does not read a
    clock.  ``owner`` is the name of the program that publishes.
    """

    def __init__(self, sources: Iterable[TwistInput], locks: Iterable[TwistInput]) -> None:
        self._sources = {s.name: _Source(s) for s in sources}
        self._locks = {lock.name: _Lock(lock) for lock in locks}
        # Highest priority of a source that the lock blocks while the lock is active.
        self._barriers = {
            name: math.inf if lock.settings.is_stop_lock else float(lock.settings.priority)
            for name, lock in self._locks.items()
        }
        # Twist sources in the order of descending priority.  Of two sources with the same priority,
        # the first source in the robot file wins, as in twist_mux.
        self._ranked = sorted(self._sources.values(), key=lambda i: -i.settings.priority)
        self._driving: _Source | None = None
        """Source that was selected last."""
        self._last_time = -math.inf
        self._gap_time = -math.inf
        self._armed_at = -math.inf

    @classmethod
    def from_robot(cls, robot: Robot) -> Multiplexer:
        """Returns a multiplexer with the twist sources and locks of the robot file."""
        return cls(robot.twist_sources, robot.twist_locks)

    def add_source(self, settings: TwistInput) -> None:
        """Adds a twist source of this program, of another priority than the present sources."""
        self._sources[settings.name] = _Source(settings)
        self._ranked = sorted(self._sources.values(), key=lambda i: -i.settings.priority)

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self._sources)

    @property
    def locks(self) -> tuple[str, ...]:
        return tuple(self._locks)

    def publish(self, source: str, twist: Twist, now: float, owner: str = THIS_PROGRAM) -> str:
        """Publishes a commanded twist of a source at the time ``now`` (s).

        The published twist is valid until the time-out of the source.  A twist is refused if it is
        not finite or too large, if another program publishes the source, or if a zero twist must
        come first; the previous twist of the source then stays valid until its time-out.

        Returns the reason if the twist is refused, or an empty text.  Raises ``ParameterError`` if
        the robot has no twist source with this name.
        """
        publisher = self._find("source of twists", source, self._sources)
        if not (float_sum(map(abs, twist)) < MAX_TWIST and math.isfinite(now)):
            return "the twist is too large"
        holder = publisher.holder(now)
        if holder not in ("", owner):
            return f"`{source}` is published by {holder}"
        if not holder:
            publisher.await_zero(f"`{source}` was not heard before")
        publisher.owner, publisher.attempt, publisher.attempt_time = owner, twist, now
        if twist == ZERO_TWIST:
            publisher.awaits_zero = ""
        elif now <= self._armed_at:
            publisher.awaits_zero = "a motion was commanded before the base was armed"
        if publisher.awaits_zero:
            return publisher.refusal
        publisher.twist, publisher.time = twist, now
        return ""

    def release(self, owner: str) -> None:
        """Voids the twists of a program that has ended, and releases its sources.

        The robot ramps to rest at once if the program has driven it.  The locks of the program stay
        active.
        """
        for lock in self._locks.values():
            lock.stop.note_end(owner)
        for source in self._sources.values():
            if source.owner == owner:
                source.owner, source.time, source.attempt_time = "", -math.inf, -math.inf

    def notice_gap(self, driver: BaseDriver, now: float) -> None:
        """Voids all published twists if the time since the last control cycle is a gap.

        Must be called before requests are read that have waited during the gap.
        """
        if driver.gap_at(now) is Gap.NONE or now == self._gap_time:
            return
        self._gap_time = now
        self.void(gap_text(now - driver.state.time))

    def void(self, reason: str) -> None:
        """Voids all published twists; each source must publish a zero twist before it moves the
        robot again.

        ``reason``: reason that the operator sees, such as ``no control cycle for 120 ms``.
        """
        for source in self._sources.values():
            source.time, source.awaits_zero = -math.inf, reason

    def accept_motion(self, now: float) -> None:
        """Accepts motion of all sources without a zero twist, as the base is armed at ``now`` (s).

        The caller must have checked that no source requests motion, see ``requests``.  A source
        that has published a motion until ``now`` must publish a zero twist first.
        """
        self._armed_at = now
        for source in self._sources.values():
            source.awaits_zero = ""

    def requests(self, now: float) -> list[str]:
        """Returns the names of the sources that request motion, also where it is refused."""
        return [
            name
            for name, source in self._sources.items()
            if source.holder(now) and source.attempt != ZERO_TWIST
        ]

    @property
    def last_heard(self) -> float:
        """Time (s) of the last twist of any source, also if it was refused."""
        return max((s.attempt_time for s in self._sources.values()), default=-math.inf)

    def awaited_zeros(self, now: float) -> dict[str, str]:
        """Returns the sources that are heard and must command zero, with the reasons."""
        return {
            name: source.awaits_zero
            for name, source in self._sources.items()
            if source.awaits_zero and source.is_heard(now)
        }

    def holders(self, now: float) -> dict[str, str]:
        """Returns the program to which each source is bound, without the free sources."""
        holders = {name: source.holder(now) for name, source in self._sources.items()}
        return {name: holder for name, holder in holders.items() if holder}

    def lock(
        self,
        name: str,
        locked: bool,
        now: float,
        owner: str = THIS_PROGRAM,
        *,
        force: bool = False,
    ) -> None:
        """Publishes the state of a lock at the time ``now`` (s).

        ``force`` also releases the lock of other programs.  Raises ``ParameterError`` if the robot
        has no lock with this name, or if another program has locked it.
        """
        publisher = self._find("lock", name, self._locks)
        publisher.time = now
        if locked:
            publisher.stop.engage(owner)
        elif reason := publisher.stop.release(owner, force):
            raise ParameterError(f"`{name}` stays locked: {reason}")

    def lock_owners(self, name: str) -> tuple[str, ...]:
        """Returns the programs that have locked a lock."""
        return self._find("lock", name, self._locks).stop.owners

    def active_locks(self, now: float) -> tuple[str, ...]:
        """Returns the names of the locks that are active at the time ``now`` (s)."""
        return tuple(
            name for name, lock in self._locks.items() if lock.stop.engaged or lock.is_silent(now)
        )

    def active_stop_locks(self, now: float) -> tuple[str, ...]:
        """Returns the names of the stop locks that are active at the time ``now`` (s)."""
        return tuple(
            name for name in self.active_locks(now) if self._locks[name].settings.is_stop_lock
        )

    def select(self, now: float) -> Selection:
        """Selects the twist source that drives the robot at the time ``now`` (s)."""
        locks = self.active_locks(now)
        source = self._highest(now, locks)
        if source is None:
            return Selection("", ZERO_TWIST, now, locks)
        name = source.settings.name
        if source.awaits_zero:
            return Selection(name, ZERO_TWIST, source.attempt_time, locks)
        return Selection(name, source.twist, source.time, locks)

    def _highest(self, now: float, locks: tuple[str, ...]) -> _Source | None:
        """Returns the active source with the highest priority that no lock blocks."""
        barrier = max((self._barriers[name] for name in locks), default=-1.0)
        for source in self._ranked:
            if source.settings.priority <= barrier:
                break
            if source.is_active(now):
                return source
        return None

    def _note_takeover(self, now: float) -> None:
        """Requires zero of a source that moves when a source of a higher priority falls silent."""
        source, last = self._highest(now, self.active_locks(now)), self._driving
        if source is None or source is last:
            return
        self._driving = source
        if last is None or last.settings.priority <= source.settings.priority:
            return
        if not last.is_active(now) and source.twist != ZERO_TWIST:
            source.await_zero(f"`{last.settings.name}` has fallen silent")

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """Selects a twist source and sends its twist to ``driver`` as a command.

        The command time-out and the limits of the driver still apply.  If no source is selected
        after a source has driven the robot, the robot stops.  With an active lock, the driver
        immediately ramps the twist down to zero, and also after the program has ended that drove
        the robot.
        """
        self.notice_gap(driver, now)
        self._note_takeover(now)
        selection = self.select(now)
        source = self._sources.get(selection.source)
        driver.source_refusal = source.refusal if source is not None else ""
        if selection.source:
            self._last_time = selection.time
            driver.command(selection.twist, selection.time)
        elif self._driving is not None:
            driver.command(ZERO_TWIST, now if selection.locks else self._last_time)
        return selection

    @staticmethod
    def _find(kind: str, name: str, known: dict[str, _AnyInput]) -> _AnyInput:
        publisher = known.get(name)
        if publisher is None:
            hint = did_you_mean(name, list(known), f"known: {', '.join(known)}")
            raise ParameterError(f"there is no {kind} `{name}`; {hint}")
        return publisher
