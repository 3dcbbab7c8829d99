"""The permission to move: one immutable value, and the rules that change it.

Each event is a pure function of a value, a method of ``Rules``: it returns the next value and an
answer, and reads no clock.  So every state can be explored (tests/runtime/exploration.py).  A robot
moves while all of this is true::

    armed        by a person, or by itself if no person has ended that; every stop disarms
    no fault     of a long gap in time
    selected     the source has the highest priority among those that are heard and not locked
    zero         the source has commanded zero since it was last ineffective

A source is ineffective in each control cycle in which it does not drive the robot, for whatever
reason: a source of a higher priority, a lock, a gap in time, silence, a robot that is disarmed.
Two kinds of sources (``TwistInput.first_command``) may begin with a motion: one with a ramp whose
stream begins after a silence, and one that resumes as with twist_mux.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Concatenate, Final, NamedTuple, ParamSpec

from thorvaldc.model import Robot, TwistInput, settings
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

THIS_PROGRAM: Final = "this program"
"""Owner of the stops and twist sources that are used in the process of the base driver."""
ENDED: Final = ", which has ended"
"""Added to the name of a program that has ended, as an owner of a stop."""
HOMING: Final = "homing the steering; the robot is armed when it has ended"
SERVICE_STOP: Final = 0
"""Index of the safety stop that the service engages, among the locks."""
_NEVER: Final = -math.inf
_LATELY: Final = -1e-3
_TOLERANCE: Final = 1e-9
"""Tolerance (s) for rounding errors in the check of a time-out, and relative for a first step."""
_MOTION: Final = Twist(1.0, 0.0, 0.0)


class SourceState(NamedTuple):
    """A twist source: the last twist of its program, also if it was refused, and its time (s).

    - ``twist``: ``None`` after a gap in time, until the source publishes again: what its program
      wants by now is unknown, also if it commanded zero before;
    - ``awaits``: reason why the source must command zero before it moves the robot, or empty.
    """

    twist: Twist | None = ZERO_TWIST
    time: float = _NEVER
    owner: str = ""
    awaits: str = ""

    @property
    def refusal(self) -> str:
        """Reason why the source moves nothing until it commands zero, or an empty text."""
        return f"{self.awaits}; command zero first" if self.awaits else ""

    @property
    def followed(self) -> Twist:
        """Twist that the robot follows if the source is selected."""
        return ZERO_TWIST if self.awaits or self.twist is None else self.twist


class LockState(NamedTuple):
    """A lock: the time (s) of its last message, and the programs that have set it."""

    time: float = _NEVER
    owners: tuple[str, ...] = ()


class Permission(NamedTuple):
    """The permission to move.  Only this file creates one.

    - ``arms_itself``: the robot arms itself when it may, as no person has disarmed it;
    - ``disarmed_by``: reason why the robot has disarmed itself, or an empty text;
    - ``arming_owner``: program whose arming waits for the end of the homing, or an empty text;
    - ``armed_at``: time (s) of the last arming; a motion that was commanded until then is void;
    - ``heard_at``: time (s) of the last arming or twist;
    - ``locks``: those of ``Rules.locks``; the first one is ``SERVICE_STOP``;
    - ``fault``: reason of a fault, which lasts until a reset;
    - ``void``: reason why commands without a source count only after a zero, given after the time
      ``void_at`` (s); or an empty text.
    """

    armed: bool
    arms_itself: bool
    sources: tuple[SourceState, ...]
    locks: tuple[LockState, ...]
    heard_at: float
    armed_at: float = _NEVER
    disarmed_by: str = ""
    arming_owner: str = ""
    fault: str = ""
    void: str = ""
    void_at: float = _NEVER

    @property
    def waiting_reason(self) -> str:
        """Reason why no motion is accepted at present although there is no fault."""
        if not self.armed:
            return self.disarmed_by or "disarmed"
        return f"{self.void}; command zero first" if self.void else ""


class Answer(NamedTuple):
    """What an event means for its sender and for the base.

    - ``refusal``: reason why the event is refused, or an empty text;
    - ``text``: result for the sender; ``note``: line in the list of events;
    - ``stop``: the safety stop of the base is engaged or released; ``None``: no change;
    - ``home``: the base homes its steering, or the event is refused; with ``again`` also what is
      homed;
    - ``arm``: the robot arms itself, if all other checks pass;
    - ``selected``: index of the source that has priority, -1 without one;
    - ``locked``: the locks that are active.
    """

    refusal: str = ""
    text: str = ""
    note: str = ""
    stop: bool | None = None
    home: bool = False
    again: bool = False
    arm: bool = False
    selected: int = -1
    locked: tuple[int, ...] = ()


DONE: Final = Answer()
Step = tuple[Permission, Answer]
P = ParamSpec("P")


class Base(NamedTuple):
    """What the base reports at the start of a control cycle.

    - ``ready``: it follows joint commands; ``disarming``: its reason to disarm, or an empty text;
    - ``homed``, ``homing``: no steering joint has to find its home position; one is finding it.
    """

    ready: bool = True
    homed: bool = True
    homing: bool = False
    disarming: str = ""


READY: Final = Base()


class Rules:
    """What does not change while a robot runs: its sources, locks and times; and the rules.

    The events are methods ``(value, ...) -> (value, answer)``.  A refused event leaves the value as
    it is.  A refused motion is noted all the same, since its source is heard.
    """

    def __init__(
        self,
        sources: Iterable[TwistInput] = (),
        locks: Iterable[TwistInput] = (),
        *,
        automatic: bool = False,
        arming_timeout: float = settings.ARMING_TIMEOUT,
        first_step: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.rank(tuple(sources))
        self.locks = (TwistInput(settings.SAFETY_STOP, "", settings.STOP_PRIORITY, 0.0), *locks)
        self.automatic, self.arming_timeout = automatic, arming_timeout
        self.first_step = first_step
        # Highest priority of a source that the lock blocks while the lock is active.
        self._barriers = [
            (k, lock.timeout, math.inf if lock.is_stop_lock else float(lock.priority))
            for k, lock in enumerate(self.locks)
        ]

    def rank(self, sources: tuple[TwistInput, ...]) -> None:
        self.sources = sources
        # Of two sources with the same priority, the first source in the robot file wins, as in
        # twist_mux.
        order = sorted(range(len(self.sources)), key=lambda i: -self.sources[i].priority)
        self._ranked = [(i, self.sources[i].priority, self.sources[i].timeout) for i in order]

    def start(self, armed: bool) -> Permission:
        """Returns the value of a robot that has just been started.

        A robot that is armed from the start stays so, however long no source is heard.
        """
        heard_at = math.inf if armed else _NEVER
        sources, locks = (SourceState(),) * len(self.sources), (LockState(),) * len(self.locks)
        return Permission(armed, self.automatic, sources, locks, heard_at)

    # -- what holds at a time (s) ------------------------------------------------------------------

    def is_heard(self, value: Permission, source: int, now: float) -> bool:
        """Checks whether a source has published a twist within its time-out, also a refused one."""
        return now - value.sources[source].time <= self.sources[source].timeout + _TOLERANCE

    def active_locks(self, value: Permission, now: float) -> tuple[tuple[int, ...], float]:
        """Returns the active locks, and the highest priority that they block.

        A lock is active while a program has set it, and after a silence longer than its time-out.
        """
        active: tuple[int, ...] = ()
        highest = -1.0
        for k, timeout, barrier in self._barriers:
            time, owners = value.locks[k]
            if owners or (timeout > 0.0 and now - time > timeout + _TOLERANCE):
                active, highest = (*active, k), max(highest, barrier)
        return active, highest

    def select(self, value: Permission, now: float, barrier: float) -> int:
        """Returns the source of the highest priority among those that are heard, also if it must
        command zero, and that no lock blocks; -1 without one."""
        for i, priority, timeout in self._ranked:
            if priority <= barrier:
                break
            if now - value.sources[i].time <= timeout + _TOLERANCE:
                return i
        return -1

    def requests(self, value: Permission, now: float) -> list[str]:
        """Returns the names of the sources that request motion, also where it is refused."""
        return [
            source.name
            for i, source in enumerate(self.sources)
            if value.sources[i].twist not in (ZERO_TWIST, None) and self.is_heard(value, i, now)
        ]

    def stops(self, value: Permission, now: float) -> list[int]:
        """Returns the active stop locks."""
        active, barrier = self.active_locks(value, now)
        return [k for k in active if self.locks[k].is_stop_lock] if barrier == math.inf else []

    def stopped_by(self, value: Permission, now: float) -> list[str]:
        """Returns who stops the robot: programs, and the silence of stop locks."""
        names: list[str] = []
        for k in self.stops(value, now):
            names += value.locks[k].owners or (f"the silence of `{self.locks[k].name}`",)
        return list(dict.fromkeys(names))

    def stop_text(self, lock: int) -> str:
        if lock == SERVICE_STOP:
            return "the safety stop is engaged"
        return f"the stop lock `{self.locks[lock].name}` is active"

    def arming_reasons(self, value: Permission, now: float) -> list[str]:
        """Returns the reasons against arming: stops, commanded motions, a fault."""
        reasons = [self.stop_text(k) for k in self.stops(value, now)]
        reasons += [f"`{name}` commands a motion" for name in self.requests(value, now)]
        return [*reasons, value.fault] if value.fault else reasons

    def begins(self, source: int, twist: Twist) -> bool:
        """Checks whether a source that was silent may begin with a motion.

        A ramp begins with at most the change of one step from rest, see ``first_ramp_step``.
        """
        first = self.sources[source].first_command
        linear, angular = (limit * (1.0 + _TOLERANCE) for limit in self.first_step)
        is_step = abs(twist.vx) <= linear and abs(twist.vy) <= linear and abs(twist.wz) <= angular
        return first == settings.ANY_FIRST or (first == settings.RAMP_FIRST and is_step)

    def _silence(self, value: Permission, source: int) -> str:
        """Returns why a source that is not heard does not begin with its motion."""
        own, (linear, angular) = self.sources[source], self.first_step
        heard = value.sources[source].time != _NEVER
        text = f"silent for more than {own.timeout:g} s" if heard else "not heard before"
        if own.first_command == settings.RAMP_FIRST:
            text += f", and its first step exceeds {linear:.3g} m/s or {angular:.3g} rad/s"
        return f"`{own.name}` was {text}"

    def resumes(self, source: int) -> bool:
        """Checks whether a source that was ineffective goes on with its motion, as in twist_mux."""
        return self.sources[source].first_command == settings.ANY_FIRST

    def class_of(self, value: Permission, now: float) -> Permission:
        """Returns the class of a value at the time ``now`` (s), a value at the time 0.

        Two values of a class behave alike.  Each age is cut at the thresholds that the rules
        compare, of a twist only matters whether it is zero, of a reason whether there is one, and
        programs that have ended are one.  Nothing matters of a source that is silent.
        """
        sources = [SourceState()] * len(value.sources)
        for i, (twist, _, owner, awaits) in enumerate(value.sources):
            if self.is_heard(value, i, now):
                if twist is not None:
                    twist = ZERO_TWIST if twist == ZERO_TWIST else _MOTION
                sources[i] = SourceState(twist, _LATELY, owner, "x" if awaits else "")
        locks = list(value.locks)
        for k, timeout, _ in self._barriers:
            time, owners = locks[k]
            names = sorted({ENDED if name.endswith(ENDED) else name for name in owners})
            fresh = timeout == 0.0 or now - time <= timeout + _TOLERANCE
            locks[k] = LockState(_LATELY if fresh else _NEVER, tuple(names))
        return value._replace(
            sources=tuple(sources),
            locks=tuple(locks),
            heard_at=_NEVER if self.automatic or self._is_forgotten(value, now) else _LATELY,
            armed_at=0.0 if value.armed_at >= now else _NEVER,
            disarmed_by="",
            fault="x" if value.fault else "",
            void="x" if value.void else "",
            void_at=0.0 if (value.void or value.fault) and value.void_at >= now else _NEVER,
        )

    # -- events ------------------------------------------------------------------------------------

    def publish(
        self, value: Permission, source: int, twist: Twist, time: float, owner: str = THIS_PROGRAM
    ) -> Step:
        """A program publishes a twist of a source, which is bound to it until it is silent."""
        state, name = value.sources[source], self.sources[source].name
        heard, awaits = self.is_heard(value, source, time), state.awaits
        if heard and state.owner != owner:
            return value, Answer(f"`{name}` is published by {state.owner}")
        if twist == ZERO_TWIST:
            awaits = ""
        elif time <= value.armed_at:
            awaits = "a motion was commanded before the base was armed"
        elif not heard:
            awaits = "" if self.begins(source, twist) else awaits or self._silence(value, source)
        states = list(value.sources)
        states[source] = state = SourceState(twist, time, owner, awaits)
        value = value._replace(sources=tuple(states), heard_at=max(value.heard_at, time))
        return value, Answer(state.refusal) if awaits else DONE

    def begin_cycle(
        self, value: Permission, now: float, base: Base = READY, operated: bool = False
    ) -> Step:
        """A control cycle begins.

        ``operated``: a function of this program commands the robot, also without a source.
        """
        (locked, barrier), note, arm = self.active_locks(value, now), "", False
        if value.armed:
            reason = base.disarming
            if stops := [k for k in locked if self.locks[k].is_stop_lock]:
                reason = self.stop_text(stops[0])
            elif not (reason or operated or self.automatic) and self._is_forgotten(value, now):
                reason = f"no source was heard for {self.arming_timeout:g} s"
            if reason:
                note = f"disarmed: {reason}"
                value = value._replace(armed=False, disarmed_by=note)
        elif value.arming_owner:
            if not base.homing:
                ended = "" if base.homed else "disarmed: the homing was ended"
                value, arm = value._replace(arming_owner="", disarmed_by=ended), base.homed
        elif value.arms_itself:
            # A homing moves the steering, so that it waits until somebody has commanded zero.
            heard = any(self.is_heard(value, i, now) for i in range(len(self.sources)))
            arm = base.ready if base.homed else operated or heard
        selected = self.select(value, now, barrier)
        sources = self._ineffective(value, now, selected, locked, barrier)
        void = value.void if selected < 0 else ""  # each source answers for itself
        if sources is not value.sources or void != value.void:
            value = value._replace(sources=sources, void=void)
        return value, Answer(note=note, arm=arm, selected=selected, locked=locked)

    def _is_forgotten(self, value: Permission, now: float) -> bool:
        return now - value.heard_at > self.arming_timeout

    def _ineffective(
        self, value: Permission, now: float, selected: int, locked: tuple[int, ...], barrier: float
    ) -> tuple[SourceState, ...]:
        """Requires zero of every source that does not drive the robot in this cycle.

        The source that drives it fulfils this if it commands zero now.
        """
        effective = selected if value.armed and not value.fault else -1
        states: list[SourceState] | None = None
        for i, state in enumerate(value.sources):
            awaits = state.awaits
            if i == effective and state.twist == ZERO_TWIST:
                awaits = ""
            elif i != effective and not awaits and not self.resumes(i):
                if self.sources[i].priority <= barrier:
                    names = " and ".join(f"`{self.locks[k].name}`" for k in locked)
                    awaits = f"the lock {names} was active"
                elif selected not in (-1, i):
                    awaits = f"`{self.sources[selected].name}` had priority"
                else:
                    awaits = "the robot was disarmed"
            if awaits != state.awaits and self.is_heard(value, i, now):
                states = states or list(value.sources)
                states[i] = state._replace(awaits=awaits)
        return value.sources if states is None else tuple(states)

    def arm(
        self,
        value: Permission,
        time: float,
        owner: str = THIS_PROGRAM,
        reasons: tuple[str, ...] = (),
        homed: bool = True,
        by_itself: bool = False,
    ) -> Step:
        """A program, or with ``by_itself`` the robot, lets the robot accept motion.

        ``reasons``: reasons of the base and of the program against it.  If the steering is not
        ``homed``, the arming waits for that.
        """
        if value.armed:
            return value, DONE
        arms_itself = value.arms_itself if by_itself else self.automatic
        if value.arming_owner:
            return value._replace(arms_itself=arms_itself), Answer(text=HOMING)
        reasons = (*reasons, *self.arming_reasons(value, time))
        if reasons:
            return value, Answer("; ".join(dict.fromkeys(reasons)))
        value = value._replace(arms_itself=arms_itself)
        if not homed:
            value = value._replace(arming_owner=owner)
            return value, Answer(text=HOMING, note="homing the steering", home=True)
        # Every source that is heard commands zero now, unless its twist is void.
        sources = tuple(s if s.twist is None else s._replace(awaits="") for s in value.sources)
        heard_at = max(value.heard_at, time)
        value = value._replace(armed=True, armed_at=time, heard_at=heard_at, sources=sources)
        return value._replace(void=""), Answer(note="armed")

    def disarm(self, value: Permission, reason: str = "") -> Step:
        """A person, or with a ``reason`` the robot, lets the robot accept no motion until it is
        armed.  If it is a person, automatic arming ends."""
        note = (reason or "disarmed") if value.armed else ""
        arms_itself = value.arms_itself and bool(reason)
        value = value._replace(armed=False, arms_itself=arms_itself, arming_owner="")
        return value._replace(disarmed_by=reason), Answer(note=note)

    def hold(self, value: Permission) -> Step:
        """The base does not follow joint commands, or the driver has a fault."""
        unchanged = not value.armed and not value.disarmed_by
        return value if unchanged else value._replace(armed=False, disarmed_by=""), DONE

    def home(self, value: Permission, time: float) -> Step:
        """A person homes all steering joints; the robot is disarmed."""
        if stops := self.stops(value, time):
            return value, Answer(self.stop_text(stops[0]))
        return value._replace(armed=False, disarmed_by=""), Answer(home=True, again=True)

    def set_lock(
        self,
        value: Permission,
        lock: int,
        locked: bool,
        time: float,
        owner: str = THIS_PROGRAM,
        force: bool = False,
    ) -> Step:
        """A program sets a lock, or releases it; with ``force``, for all programs.

        A stop begins at once: its lock may be released before the next cycle.
        """
        name, owners, note = self.locks[lock].name, value.locks[lock].owners, ""
        others = tuple(other for other in owners if other != owner)
        if not locked and not force and others and others == owners:
            return value, Answer(_stays_locked(name, others))
        if not locked and force and others:
            note = f"{owner} released by force `{name}` of {' and '.join(others)}"
        elif locked and self.locks[lock].is_stop_lock:
            value, (_, _, note, *_) = self.disarm(value, f"disarmed: {self.stop_text(lock)}")
        elif locked:
            states = list(value.sources)
            for i, source in enumerate(self.sources):
                if source.priority <= self.locks[lock].priority and not self.resumes(i):
                    awaits = states[i].awaits or f"the lock `{name}` was active"
                    states[i] = states[i]._replace(awaits=awaits)
            value = value._replace(sources=tuple(states))
        if locked:
            owners = owners if owner in owners else (*owners, owner)
        else:
            owners = () if force else others
        locks = list(value.locks)
        locks[lock] = LockState(time, owners)
        stop = bool(owners) if lock == SERVICE_STOP else None
        text = "" if locked else _stays_locked(name, owners)
        return value._replace(locks=tuple(locks)), Answer(text=text, note=note, stop=stop)

    def end_program(self, value: Permission, owner: str) -> Step:
        """A program has ended: its twists are void, and its stops stay engaged."""
        waits = value.arming_owner == owner
        ended = "not armed: the program that armed has ended during the homing"
        locks = [
            LockState(time, tuple(name + ENDED if name == owner else name for name in owners))
            for time, owners in value.locks
        ]
        value = value._replace(
            sources=tuple(SourceState() if s.owner == owner else s for s in value.sources),
            locks=tuple(locks),
            arming_owner="" if waits else value.arming_owner,
        )
        return value, Answer(note=ended) if waits else DONE

    def void(
        self, value: Permission, reason: str, time: float, fault: bool = False, every: bool = True
    ) -> Step:
        """All commands until a time are void, as after a gap in time; zero must come first.

        ``fault``: no motion is accepted before a reset.  ``every=False``: only the commands that
        have no source are void.
        """
        if every:
            # A silent source has another reason to command zero: its silence.
            sources = tuple(
                s._replace(twist=None, awaits=reason if self.is_heard(value, i, time) else s.awaits)
                for i, s in enumerate(value.sources)
            )
            value = value._replace(sources=sources)
        fault_reason = reason if fault else value.fault
        return value._replace(fault=fault_reason, void=reason, void_at=time), DONE

    def reset(self, value: Permission, time: float) -> Step:
        """A person resets the fault."""
        if value.fault:
            value = value._replace(fault="", void=value.fault, void_at=time)
        return value, DONE

    def command_zero(self, value: Permission, time: float) -> Step:
        """The newest command, of whatever source, is a zero twist."""
        ends = time > value.void_at and not value.fault
        return value._replace(void="") if ends else value, DONE


def _stays_locked(name: str, owners: tuple[str, ...]) -> str:
    """Returns the text about a stop that other programs hold, or an empty text."""
    if not owners:
        return ""
    there = "" if all(owner.endswith(ENDED) for owner in owners) else " there, or"
    return (
        f"`{name}` stays locked: the stop was set by {' and '.join(owners)}; release it{there} with"
        ' `force=true` (in JSON: "force": true)'
    )


class MotionPermission:
    """The permission of a running robot: the rules, and the present value."""

    def __init__(self, rules: Rules, armed: bool = True) -> None:
        self.rules = rules
        self.value = rules.start(armed)
        self.home: Callable[[bool], str] = lambda again: ""
        """Homes the steering of the base, see ``BaseHandle.home``."""

    @classmethod
    def of(cls, robot: Robot, arming: str = "", armed: bool = True) -> MotionPermission:
        """Returns the permission of a robot; ``arming`` replaces the setting of the robot file."""
        driver = robot.driver
        rules = Rules(
            robot.twist_sources,
            robot.twist_locks,
            automatic=(arming or driver.arming) == settings.AUTOMATIC,
            arming_timeout=driver.arming_timeout,
            first_step=settings.first_ramp_step(driver),
        )
        return cls(rules, armed)

    def step(
        self,
        event: Callable[Concatenate[Rules, Permission, P], Step],
        *arguments: P.args,
        **named: P.kwargs,
    ) -> Answer:
        """Changes the value by an event, such as ``Rules.arm``; the only way to change it."""
        value, answer = event(self.rules, self.value, *arguments, **named)
        if answer.home and (refusal := self.home(answer.again)):
            return Answer(refusal)
        self.value = value
        return answer

    def add_source(self, source: TwistInput) -> None:
        """Adds a twist source of this program, of another priority than the present sources."""
        self.rules.rank((*self.rules.sources, source))
        self.value = self.value._replace(sources=(*self.value.sources, SourceState()))
