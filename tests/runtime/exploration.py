"""Every state that the permission to move can reach, breadth first, with a judge of its own.

The states are those of ``thorvaldc.runtime.permission``: the explorer calls its ``step``, and keeps
one value of each class (``Rules.class_of``).  Time is abstract: an age is within or beyond the
threshold that the rules compare, and may cross it at any moment.  Beside each value stands a judge,
which notes what has happened and does not use the rules.  From the value it takes the last twist of
each source, and whether the source is heard::

    armed       by an arming since the last stop
    by_itself   the robot may arm itself: no person has ended it
    zeros       sources that have commanded zero since they last did not drive, or began a ramp
    voided      sources that have published nothing since a gap in time
    holders     who holds which stop

What must hold is in ``_Explorer.judge_motion`` and beside each event.  A counterexample is the
shortest one, and ``counterexample.script`` writes it as a mission for tests/chaos.
"""

from __future__ import annotations

import functools
import gc
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from thorvaldc.model import TwistInput
from thorvaldc.model.settings import SAFETY_STOP
from thorvaldc.runtime.permission import (
    ENDED,
    SERVICE_STOP,
    THIS_PROGRAM,
    Answer,
    Base,
    LockState,
    MotionPermission,
    Permission,
    Rules,
    SourceState,
)
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

NOW = 0.0
"""Time (s) of every event: the times in a class of values are relative to it."""
FAST, STEP = Twist(1.0, 0.0, 0.0), Twist(0.05, 0.0, 0.0)
FIRST_STEP = (0.075, 0.1)

JOY = TwistInput("teleop_joy", "teleop_joy/cmd_vel", 100, 0.5)
NAVIGATION = TwistInput("auto_nav", "auto_nav/cmd_vel", 10, 0.5, "ramp")
RESUMING = TwistInput("auto_nav", "auto_nav/cmd_vel", 10, 0.5, "any")
STOP_LOCK = TwistInput(SAFETY_STOP, "safety_stop/lock", 255, 0.0)
PAUSE_LOCK = TwistInput("auto_nav_pause", "auto_nav/pause", 50, 0.0)
TIMED_LOCK = TwistInput("gate", "gate/lock", 50, 0.5)


@dataclass(frozen=True)
class Configuration:
    """What is explored together: sources, locks, programs, and kinds of arming."""

    name: str
    sources: tuple[TwistInput, ...]
    locks: tuple[TwistInput, ...] = (STOP_LOCK,)
    owners: tuple[str, ...] = ("a",)
    automatic: bool = False
    homes: bool = False
    faults: bool = True
    forgets: bool = False

    def rules(self) -> Rules:
        return Rules(self.sources, self.locks, automatic=self.automatic, first_step=FIRST_STEP)


SMALL = Configuration("one source", (NAVIGATION,), (STOP_LOCK, PAUSE_LOCK))
CONFIGURATIONS = (
    Configuration(
        "two sources, all events",
        (JOY, NAVIGATION),
        (STOP_LOCK, PAUSE_LOCK),
        homes=True,
        forgets=True,
    ),
    Configuration("a source that resumes", (JOY, RESUMING), (STOP_LOCK, PAUSE_LOCK)),
    Configuration(
        "two programs, a timed lock",
        (NAVIGATION,),
        (STOP_LOCK, TIMED_LOCK),
        ("a", "b"),
        faults=False,
    ),
    Configuration("two programs that home", (NAVIGATION,), (STOP_LOCK,), ("a", "b"), homes=True),
    Configuration(
        "two sources, two programs", (JOY, NAVIGATION), (STOP_LOCK,), ("a", "b"), faults=False
    ),
    Configuration(
        "automatic arming",
        (JOY, NAVIGATION),
        (STOP_LOCK, PAUSE_LOCK),
        automatic=True,
        homes=True,
        faults=False,
    ),
)


class Judge(NamedTuple):
    """What has happened, as far as it matters for who may move the robot."""

    armed: bool = False
    by_itself: bool = False
    pending: str = ""
    zeros: frozenset[int] = frozenset()
    voided: frozenset[int] = frozenset()
    holders: frozenset[tuple[int, str]] = frozenset()
    base_stopped: bool = False


class Violation(AssertionError):
    """A property does not hold, after the events of ``path``."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.path: tuple[str, ...] = ()


State = tuple[Permission, Judge]
Successor = tuple[str, Permission, Judge]
Action = Callable[[Permission, Judge], Iterator[tuple[Permission, Judge]]]


@dataclass
class Exploration:
    """The explored states; ``transitions`` counts those that change the state, and those that do
    not."""

    states: dict[State, tuple[State, str] | None]
    transitions: int

    @property
    def classes(self) -> set[Permission]:
        return {value for value, _ in self.states}


def explore(configuration: Configuration, limit: int = sys.maxsize) -> Exploration:
    """Explores until no state is new.  Raises ``Violation`` with its shortest path of events."""
    # The states contain no cycles, and a garbage collection looks at all of them.
    collects = gc.isenabled()
    gc.disable()
    try:
        return _Explorer(configuration).run(limit)
    finally:
        if collects:
            gc.enable()


class _Explorer:
    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self.rules = configuration.rules()
        self.actions: list[tuple[str, Action]] = list(self._actions())
        self._stoppers = functools.cache(self._stoppers_of)

    def run(self, limit: int) -> Exploration:
        rules, actions = self.rules, self.actions
        # Most events lead to a value that other events have led to: its class is computed once.
        # Of equal classes and of equal judges one object is kept: states are compared by identity.
        classes: dict[Permission, Permission] = {}
        judges: dict[Judge, Judge] = {}

        @functools.cache
        def class_of(value: Permission) -> Permission:
            of_value = rules.class_of(value, NOW)
            return classes.setdefault(of_value, of_value)

        begin = Judge(by_itself=rules.automatic)
        judges[begin] = begin
        first = class_of(rules.start(armed=False)), begin
        states: dict[State, tuple[State, str] | None] = {first: None}
        seen = {(id(first[0]), id(begin))}
        queue, transitions = [first], 0
        while queue:
            following: list[State] = []
            for state in queue:
                value, judge = state
                for name, action in actions:
                    try:
                        for changed, noted in action(value, judge):
                            transitions += 1
                            if changed is value:
                                if noted is judge:
                                    continue
                                new_class = value
                            else:
                                new_class = class_of(changed)
                            new_judge = judge if noted is judge else judges.setdefault(noted, noted)
                            key = id(new_class), id(new_judge)
                            if key not in seen:
                                seen.add(key)
                                new = new_class, new_judge
                                states[new] = state, name
                                following.append(new)
                    except Violation as violation:
                        violation.path = (*_path(states, state), name)
                        raise
                if len(states) > limit:
                    raise OverflowError(f"{len(states)} states of {self.configuration.name}")
            queue = following
        return Exploration(states, transitions)

    # -- events ------------------------------------------------------------------------------------

    def _actions(self) -> Iterator[tuple[str, Action]]:
        configuration, rules = self.configuration, self.rules
        yield "a cycle", self._cycle(Base())
        for i, source in enumerate(configuration.sources):
            for owner in configuration.owners:
                for twist, word in ((ZERO_TWIST, "zero"), (STEP, "a step"), (FAST, "a motion")):
                    yield f"{owner} publishes {word}: {source.name}", self._publish(i, twist, owner)
            yield f"{source.name} falls silent", self._falls_silent(i)
        for owner in configuration.owners:
            for k, lock in enumerate(rules.locks):
                name = "the safety stop" if k == SERVICE_STOP else lock.name
                yield f"{owner} sets {name}", self._set(k, owner)
                yield f"{owner} releases {name}", self._release(k, owner, False)
                yield f"{owner} releases {name} by force", self._release(k, owner, True)
            yield f"{owner} arms", self._arm(owner, homed=True)
            if configuration.homes:
                yield f"{owner} arms and homes", self._arm(owner, homed=False)
            yield f"{owner} ends", self._end(owner)
        for k, lock in enumerate(rules.locks):
            if lock.timeout:
                yield f"{lock.name} falls silent", self._lock_silent(k)
        yield "a person disarms", self._disarm
        yield "the base holds", self._hold
        yield "a gap in time", self._void(fault=False)
        if configuration.faults:
            yield "a long gap in time", self._void(fault=True)
            yield "a person resets", self._plain(lambda value: rules.reset(value, NOW))
            void = "commands without a source are void"
            yield void, self._plain(lambda value: rules.void(value, "gap", NOW, every=False))
            yield "zero is commanded", self._plain(lambda value: rules.command_zero(value, NOW))
        if configuration.homes:
            yield "a person homes", self._home
            yield "a cycle while it homes", self._cycle(Base(ready=False, homing=True))
            yield "a cycle before the homing", self._cycle(Base(ready=False, homed=False))
        yield "a cycle with an empty battery", self._cycle(Base(disarming="battery"))
        yield "time passes", _passes
        if configuration.forgets:
            yield "five minutes pass", _is_forgotten

    @staticmethod
    def _plain(event: Callable[[Permission], tuple[Permission, Answer]]) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            yield event(value)[0], judge

        return act

    def _publish(self, i: int, twist: Twist, owner: str) -> Action:
        zero, ramps = twist == ZERO_TWIST, self.rules.sources[i].first_command == "ramp"

        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, answer = self.rules.publish(value, i, twist, NOW, owner)
            owned = value.sources[i].owner not in ("", owner)
            check(owned == ("is published by" in answer.refusal), "who publishes a source?")
            if owned:
                check(changed is value, "a refused twist of another program changes something")
            else:
                if i in judge.voided:
                    judge = judge._replace(voided=judge.voided - {i})
                begins = twist == STEP and ramps and value.sources[i].time == -math.inf
                if (zero or (begins and value.armed_at < NOW)) and i not in judge.zeros:
                    judge = judge._replace(zeros=judge.zeros | {i})
            yield changed, judge

        return act

    def _is_stop(self, k: int) -> bool:
        return self.rules.locks[k].is_stop_lock

    def _set(self, k: int, owner: str) -> Action:
        priority = self.rules.locks[k].priority
        blocked = {i for i, s in enumerate(self.rules.sources) if s.priority <= priority}

        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, answer = self.rules.set_lock(value, k, True, NOW, owner)
            check(not answer.refusal, "a stop is refused")
            if self._is_stop(k):
                judge = judge._replace(armed=False, pending="")
            judge = judge._replace(
                holders=judge.holders | {(k, owner)}, zeros=judge.zeros - blocked
            )
            yield self._named(changed, judge, answer)

        return act

    def _release(self, k: int, owner: str, force: bool) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, answer = self.rules.set_lock(value, k, False, NOW, owner, force)
            gone = {held for held in judge.holders if held[0] == k and (force or held[1] == owner)}
            if answer.refusal:
                check(changed is value, "a refused release changes something")
                check(not gone, "a release by a holder is refused")
            elif gone:
                judge = judge._replace(holders=judge.holders - gone)
            left = {name for lock, name in judge.holders if lock == k}
            told = answer.refusal or answer.text
            check(all(name in told for name in left), f"a holder of {left} is not named: {told}")
            yield self._named(changed, judge, answer)

        return act

    def _named(self, value: Permission, judge: Judge, answer: Answer) -> State:
        """Whoever stops the robot is named, and nobody else; so the base is stopped."""
        if answer.stop is not None:
            judge = judge._replace(base_stopped=answer.stop)
        service = any(k == SERVICE_STOP for k, _ in judge.holders)
        check(judge.base_stopped == service, "the base is stopped, and nobody stops it")
        holders = {name for k, name in judge.holders if self._is_stop(k)}
        named, stopped = self._stoppers(value)
        check(named == holders, f"{sorted(holders)} stop the robot, named are {sorted(named)}")
        check(stopped == bool(holders), "a stop is no reason against arming")
        return value, judge

    def _stoppers_of(self, value: Permission) -> tuple[frozenset[str], bool]:
        """Returns who is named as stopping the robot, and whether a stop is active."""
        names = self.rules.stopped_by(value, NOW)
        named = frozenset(ENDED if name.endswith(ENDED) else name for name in names)
        return named, bool(self.rules.stops(value, NOW))

    def _end(self, owner: str) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, _ = self.rules.end_program(value, owner)
            gone = {i for i, source in enumerate(value.sources) if source.owner == owner}
            pending = "" if judge.pending == owner else judge.pending
            holders = frozenset((k, ENDED if n == owner else n) for k, n in judge.holders)
            yield (
                changed,
                judge._replace(
                    pending=pending,
                    zeros=judge.zeros - gone,
                    voided=judge.voided - gone,
                    holders=holders,
                ),
            )

        return act

    def _arm(self, owner: str, homed: bool) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, answer = self.rules.arm(value, NOW, owner, homed=homed)
            if answer.refusal:
                check(changed is value, "a refused arming changes something")
                yield value, judge
                return
            if answer.home:
                yield value, judge  # the base refuses
                judge = judge._replace(pending=owner)
            if not value.armed:
                judge = judge._replace(by_itself=self.rules.automatic)
            yield changed, self._armed(value, changed, judge)

        return act

    def _armed(self, value: Permission, changed: Permission, judge: Judge) -> Judge:
        if not changed.armed or value.armed:
            return judge
        stops = [name for k, name in judge.holders if self._is_stop(k)]
        check(not stops, f"the robot is armed while {stops} stop it")
        heard = {i for i, s in enumerate(value.sources) if s.time > -math.inf}
        heard -= judge.voided
        moving = [i for i in heard if value.sources[i].twist != ZERO_TWIST]
        check(not moving, "the robot is armed while a motion is commanded")
        return judge._replace(armed=True, pending="", zeros=judge.zeros | heard)

    def _home(self, value: Permission, judge: Judge) -> Iterator[State]:
        changed, answer = self.rules.home(value, NOW)
        stops = [name for k, name in judge.holders if self._is_stop(k)]
        check(bool(answer.refusal) == bool(stops), "a stopped robot homes")
        if answer.refusal:
            check(changed is value, "a refused homing changes something")
            yield value, judge
        else:
            yield changed, judge._replace(armed=False)

    def _disarm(self, value: Permission, judge: Judge) -> Iterator[State]:
        yield (
            self.rules.disarm(value)[0],
            judge._replace(armed=False, by_itself=False, pending=""),
        )

    def _hold(self, value: Permission, judge: Judge) -> Iterator[State]:
        yield self.rules.hold(value)[0], judge._replace(armed=False)

    def _void(self, fault: bool) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, _ = self.rules.void(value, "gap", NOW, fault)
            voided = frozenset(i for i, s in enumerate(value.sources) if s.time > -math.inf)
            yield changed, judge._replace(zeros=frozenset(), voided=voided)

        return act

    def _falls_silent(self, i: int) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            if value.sources[i].time > -math.inf:
                sources = list(value.sources)
                sources[i] = SourceState()
                left = judge._replace(zeros=judge.zeros - {i}, voided=judge.voided - {i})
                yield value._replace(sources=tuple(sources)), left

        return act

    @staticmethod
    def _lock_silent(k: int) -> Action:
        def act(value: Permission, judge: Judge) -> Iterator[State]:
            locks = list(value.locks)
            locks[k] = LockState(-math.inf, locks[k].owners)
            yield value._replace(locks=tuple(locks)), judge

        return act

    def _cycle(self, base: Base) -> Action:
        rules = self.rules

        def act(value: Permission, judge: Judge) -> Iterator[State]:
            changed, answer = rules.begin_cycle(value, NOW, base)
            forgotten = not rules.automatic and value.heard_at == -math.inf
            if judge.armed and (base.disarming or forgotten):
                judge = judge._replace(armed=False)
            judge = self.judge_motion(changed, answer, judge)
            pending = judge.pending
            if pending and not base.homing:
                judge = judge._replace(pending="")
            if not answer.arm:
                yield changed, judge
                return
            # The robot arms itself, if its base passes all checks.
            check(judge.by_itself or bool(pending), "the robot arms itself, unasked")
            yield rules.disarm(changed, "refused")[0] if base.homed else changed, judge
            armed, answer = rules.arm(changed, NOW, homed=base.homed, by_itself=True)
            if not answer.refusal:
                if answer.home:
                    judge = judge._replace(pending=THIS_PROGRAM)
                yield armed, self._armed(changed, armed, judge)

        return act

    def judge_motion(self, value: Permission, answer: Answer, judge: Judge) -> Judge:
        """A robot moves in a cycle only while it is armed, nobody holds it, and the source of the
        highest priority that is heard has commanded zero since it last did not drive."""
        rules = self.rules
        barrier = -1.0
        for k, lock in enumerate(rules.locks):
            silent = lock.timeout > 0.0 and value.locks[k].time == -math.inf
            if silent or any(held == k for held, _ in judge.holders):
                barrier = max(barrier, math.inf if lock.is_stop_lock else float(lock.priority))
        if barrier == math.inf and judge.armed:
            judge = judge._replace(armed=False)
        heard = [i for i, state in enumerate(value.sources) if state.time > -math.inf]
        heard = [i for i in heard if rules.sources[i].priority > barrier]
        drives = max(heard, key=lambda i: rules.sources[i].priority, default=-1)
        effective = drives if judge.armed and not value.fault else -1
        selected = answer.selected
        if selected >= 0 and value.armed and not value.fault:
            state = value.sources[selected]
            if state.twist != ZERO_TWIST and not state.awaits:
                name = rules.sources[selected].name
                check(judge.armed, "the robot moves, and nobody has armed it since its stop")
                check(selected == effective, f"{name} moves the robot, and may not")
                zero = selected in judge.zeros or rules.sources[selected].first_command == "any"
                check(zero, f"{name} moves the robot, and has not commanded zero")
        zeros = judge.zeros & {effective}
        stands = effective >= 0 and value.sources[effective].twist == ZERO_TWIST
        if stands and effective not in judge.voided:
            zeros |= {effective}
        return judge if zeros == judge.zeros else judge._replace(zeros=zeros)


def check(holds: bool, text: str) -> None:
    if not holds:
        raise Violation(text)


def _passes(value: Permission, judge: Judge) -> Iterator[State]:
    """What has happened at this instant is past."""
    yield value._replace(armed_at=-math.inf, void_at=-math.inf), judge


def _is_forgotten(value: Permission, judge: Judge) -> Iterator[State]:
    if all(state.time == -math.inf for state in value.sources):
        yield value._replace(heard_at=-math.inf, armed_at=-math.inf, void_at=-math.inf), judge


def _path(states: dict[State, tuple[State, str] | None], state: State) -> tuple[str, ...]:
    names: list[str] = []
    while (origin := states[state]) is not None:
        state, name = origin
        names.append(name)
    return tuple(reversed(names))


# -- the values of a running robot ----------------------------------------------------------------


@functools.cache
def small_classes(automatic: bool) -> frozenset[Permission]:
    """Returns what the explored values say about one source, see ``about_one_source``.

    A source above the lock, and one that always commands zero first, have the same values.
    """
    small = Configuration("", SMALL.sources, SMALL.locks, automatic=automatic, homes=True)
    return frozenset(about_one_source(value, 0) for value in explore(small).classes)


def about_one_source(value: Permission, source: int) -> Permission:
    """Returns what the class of a value says about one source; all programs are one.

    It says nothing of what other sources change too: commands without a source, and when any
    source was heard.
    """
    state = value.sources[source]
    return value._replace(
        sources=(state._replace(owner=_anybody(state.owner)),),
        locks=tuple(
            lock._replace(owners=tuple(sorted({_anybody(name) for name in lock.owners})))
            for lock in value.locks
        ),
        arming_owner=_anybody(value.arming_owner),
        heard_at=-math.inf,
        void="",
        void_at=-math.inf,
    )


def check_explored(permission: MotionPermission, now: float) -> None:
    """Raises ``Violation`` if the value of a running robot is in no class that was explored.

    Its locks are those of ``SMALL``.
    """
    rules = permission.rules
    value = rules.class_of(permission.value, now)
    for source in range(len(rules.sources)):
        about = about_one_source(value, source)
        check(about in small_classes(rules.automatic), f"this was not explored: {about}")


def _anybody(owner: str) -> str:
    return owner if owner in ("", ENDED) else "a"


if __name__ == "__main__":
    for configuration in (SMALL, *CONFIGURATIONS):
        if sys.argv[1:] and configuration.name not in sys.argv[1:]:
            continue
        start = time.process_time()
        result = explore(configuration)
        print(
            f"| {configuration.name} | {len(result.states):,} | {result.transitions:,} |", end=" "
        )
        print(f"{time.process_time() - start:.1f} s", flush=True)
