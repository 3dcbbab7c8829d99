"""Selects one of several sources of commanded twists, with the rules of the ROS node twist_mux."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from thorvaldc.diagnostics import did_you_mean
from thorvaldc.model import Robot, TwistInput
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.driver import MAX_TWIST, BaseDriver
from thorvaldc.runtime.pace import Gap, gap_text
from thorvaldc.runtime.permission import READY, THIS_PROGRAM, Answer, Base, MotionPermission, Rules
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_NEVER: Final = -math.inf


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


class Multiplexer:
    """Selects among twist sources with priorities and time-outs, and locks that block sources.

    The robot follows the source with the highest priority among the sources whose last twist is not
    older than the source's time-out.  An active lock blocks all twist sources of the same or a
    lower priority.  A lock is active while a program has set it.  A lock with a time-out is also
    active before its first message, and while its last message is older than the time-out.  An
    active stop lock (``TwistInput.is_stop_lock``) blocks all twist sources, whatever their priority
    is.

    A source that does not drive the robot, for whatever reason, must publish a zero twist before it
    moves the robot, see ``permission``.  It keeps its rank meanwhile: the robot stands, and follows
    no source of a lower priority.

    The multiplexer follows the rules of the ROS node twist_mux with three exceptions.  twist_mux
    requires no zero twist (ADR 22).  A lock of the multiplexer stops the robot immediately; a lock
    of twist_mux stops the robot only after the driver's time-out.  A lock of twist_mux does not
    block a source of its own priority; the compiler accepts no such source.

    A source is bound to the program that publishes it, until the source times out or ``release`` is
    called.  A lock is released only by the program that has locked it.

    All times are monotonic times in s from the caller, because the multiplexer does not read a
    clock.  ``owner`` is the name of the program that publishes.
    """

    def __init__(self, permission: MotionPermission) -> None:
        """Takes the permission of the driver, ``BaseDriver.permission``."""
        self._permission = permission
        self._has_driven = False
        self._last_time = _NEVER
        self._gap_time = _NEVER
        self._index_names()

    def _index_names(self) -> None:
        rules = self._permission.rules
        self._sources = {source.name: i for i, source in enumerate(rules.sources)}
        # The lock `safety_stop`, and not the stop of the service, which has the same name.
        self._locks = {lock.name: k for k, lock in enumerate(rules.locks)}

    @classmethod
    def from_robot(cls, robot: Robot) -> Multiplexer:
        """Returns a multiplexer without a driver, of a robot that is armed."""
        return cls(MotionPermission.of(robot))

    def add_source(self, settings: TwistInput) -> None:
        """Adds a twist source of this program, of another priority than the present sources."""
        self._permission.add_source(settings)
        self._index_names()

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self._sources)

    @property
    def locks(self) -> tuple[str, ...]:
        return tuple(self._locks)

    def publish(self, source: str, twist: Twist, now: float, owner: str = THIS_PROGRAM) -> str:
        """Publishes a commanded twist of a source at the time ``now`` (s).

        The published twist is valid until the time-out of the source.  A twist that is not finite
        or too large, or of a source that another program publishes, is refused and changes nothing.
        A motion is also refused if a zero twist must come first; the source stands then.

        Returns the reason if the twist is refused, or an empty text.  Raises ``ParameterError`` if
        the robot has no twist source with this name.
        """
        number = self._find("source of twists", source, self._sources)
        if not (float_sum(map(abs, twist)) < MAX_TWIST and math.isfinite(now)):
            return "the twist is too large"
        return self._permission.step(Rules.publish, number, twist, now, owner).refusal

    def release(self, owner: str) -> Answer:
        """Voids the twists of a program that has ended, and releases its sources.

        The robot ramps to rest at once if the program has driven it.  The locks of the program stay
        active.
        """
        return self._permission.step(Rules.end_program, owner)

    def notice_gap(self, driver: BaseDriver, now: float) -> None:
        """Voids all published twists if the time since the last control cycle is a gap.

        Must be called before requests are read that have waited during the gap.
        """
        if driver.gap_at(now) is Gap.NONE or now == self._gap_time:
            return
        self._gap_time = now
        self._permission.step(
            Rules.void, gap_text(now - driver.state.time, driver.base.awaited[0]), now
        )

    def requests(self, now: float) -> list[str]:
        """Returns the names of the sources that request motion, also where it is refused."""
        return self._permission.rules.requests(self._permission.value, now)

    def awaited_zeros(self, now: float) -> dict[str, str]:
        """Returns the sources that command a motion and must command zero, with the reasons."""
        states = self._permission.value.sources
        requests = {name: states[self._sources[name]].awaits for name in self.requests(now)}
        return {name: awaits for name, awaits in requests.items() if awaits}

    def holders(self, now: float) -> dict[str, str]:
        """Returns the program to which each source is bound, without the free sources."""
        value = self._permission.value
        return {
            name: value.sources[i].owner
            for name, i in self._sources.items()
            if self._permission.rules.is_heard(value, i, now)
        }

    def lock(
        self,
        name: str,
        locked: bool,
        now: float,
        owner: str = THIS_PROGRAM,
        *,
        force: bool = False,
    ) -> Answer:
        """Publishes the state of a lock at the time ``now`` (s).

        ``force`` also releases the lock of other programs.  The text of the answer names those that
        keep it locked; the release is refused if only they have set it.  Raises ``ParameterError``
        if the robot has no lock with this name.
        """
        number = self._find("lock", name, self._locks)
        return self._permission.step(Rules.set_lock, number, locked, now, owner, force)

    def active_locks(self, now: float) -> tuple[str, ...]:
        """Returns the names of the locks that are active at the time ``now`` (s)."""
        rules = self._permission.rules
        active, _ = rules.active_locks(self._permission.value, now)
        return tuple(dict.fromkeys(rules.locks[k].name for k in active))

    def select(self, now: float) -> Selection:
        """Selects the twist source that drives the robot at the time ``now`` (s)."""
        rules, value = self._permission.rules, self._permission.value
        locks, barrier = rules.active_locks(value, now)
        return self._selection(rules.select(value, now, barrier), locks, now)

    def _selection(self, number: int, locks: tuple[int, ...], now: float) -> Selection:
        rules = self._permission.rules
        names = tuple(dict.fromkeys(rules.locks[k].name for k in locks))
        if number < 0:
            return Selection("", ZERO_TWIST, now, names)
        state = self._permission.value.sources[number]
        return Selection(rules.sources[number].name, state.followed, state.time, names)

    def feed(
        self, driver: BaseDriver, now: float, base: Base = READY, operated: bool = False
    ) -> Answer:
        """Selects a twist source and sends its twist to ``driver`` as a command.

        ``base``, ``operated``: see ``Rules.begin_cycle``.

        The command time-out and the limits of the driver still apply.  If no source is selected
        after a source has driven the robot, the robot stops.  With an active lock, the driver
        immediately ramps the twist down to zero, and also after the program has ended that drove
        the robot.
        """
        self.notice_gap(driver, now)
        answer = self._permission.step(Rules.begin_cycle, now, base, operated)
        driver.source_refusal = ""
        if answer.selected >= 0:
            state = self._permission.value.sources[answer.selected]
            driver.source_refusal = state.refusal
            self._has_driven, self._last_time = True, state.time
            driver.command(state.followed, state.time)
        elif self._has_driven:
            driver.command(ZERO_TWIST, now if answer.locked else self._last_time)
        return answer

    @staticmethod
    def _find(kind: str, name: str, known: dict[str, int]) -> int:
        number = known.get(name)
        if number is None:
            hint = did_you_mean(name, list(known), f"known: {', '.join(known)}")
            raise ParameterError(f"there is no {kind} `{name}`; {hint}")
        return number
