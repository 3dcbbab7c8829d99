"""Every state of the permission to move, and that each of its rules is needed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.chaos import invariants
from tests.chaos.schedule import Schedule
from tests.chaos.seed_runner import in_copy, run_here, run_schedule
from tests.runtime.counterexample import script
from tests.runtime.exploration import (
    CONFIGURATIONS,
    JOY,
    NAVIGATION,
    SMALL,
    Configuration,
    Violation,
    about_one_source,
    explore,
    small_classes,
)
from tests.slow import mostly_slow, one_quick_of
from thorvaldc.runtime.permission import DONE, SERVICE_STOP, Answer, Base, Permission, Rules, Step
from thorvaldc.runtime.se2 import ZERO_TWIST

PAGE = Path(__file__).parents[2] / "docs/explanation/safety.md"


def stated_counts() -> dict[str, tuple[int, int]]:
    rows = re.findall(r"^\| ([a-z ,]+) \| ([\d,]+) \| ([\d,]+) \|$", PAGE.read_text("utf-8"), re.M)
    return {name: (int(a.replace(",", "")), int(b.replace(",", ""))) for name, a, b in rows}


@pytest.mark.timeout(3600)  # up to 50 s of processor time
@pytest.mark.parametrize(
    "configuration",
    [SMALL, *(pytest.param(c, marks=pytest.mark.slow) for c in CONFIGURATIONS)],
    ids=lambda configuration: configuration.name,
)
def test_every_state_of_the_permission(configuration: Configuration) -> None:
    """The exploration ends, every property holds, and the page states what was explored."""
    exploration = explore(configuration)
    found = len(exploration.states), exploration.transitions
    assert stated_counts()[configuration.name] == found
    if configuration.sources == (JOY, NAVIGATION) and len(configuration.owners) == 1:
        # What tests/chaos checks: each source alone is as in the small exploration, whatever the
        # other one does.
        small = small_classes(configuration.automatic)
        for value in exploration.classes:
            assert {about_one_source(value, i) for i in (0, 1)} <= small


# -- each rule taken out is found -----------------------------------------------------------------


def _keep(name: str) -> Callable[..., Step]:
    """Returns an event that changes nothing."""
    return lambda self, value, *arguments, **named: (value, DONE)


def _publish_any(self: Rules, value: Permission, source: int, *twist: Any) -> Step:
    state = value.sources[source]._replace(owner=twist[2])
    sources = tuple(state if i == source else s for i, s in enumerate(value.sources))
    return publish(self, value._replace(sources=sources), source, *twist)


def _publish_before_arming(self: Rules, value: Permission, *twist: Any) -> Step:
    changed, answer = publish(self, value._replace(armed_at=-math.inf), *twist)
    refused = "is published by" in answer.refusal
    return value if refused else changed._replace(armed_at=value.armed_at), answer


def _arm_moving(self: Rules, value: Permission, *arguments: Any, **named: Any) -> Step:
    still = tuple(state._replace(twist=ZERO_TWIST) for state in value.sources)
    changed, answer = arm(self, value._replace(sources=still), *arguments, **named)
    if not changed.armed or value.armed:
        return value, answer
    states = zip(changed.sources, value.sources, strict=True)
    return changed._replace(sources=tuple(s._replace(twist=o.twist) for s, o in states)), answer


def _refused_arm_counts(self: Rules, value: Permission, *arguments: Any, **named: Any) -> Step:
    changed, answer = arm(self, value, *arguments, **named)
    return (changed._replace(arms_itself=True) if answer.refusal else changed), answer


def _disarm_for_now(self: Rules, value: Permission, reason: str = "") -> Step:
    return disarm(self, value, reason or "a person")


def _lock_alone(self: Rules, value: Permission, lock: int, *arguments: Any) -> Step:
    """Neither disarms nor demands zero at once."""
    changed, answer = set_lock(self, value, lock, *arguments)
    return value if answer.refusal else value._replace(locks=changed.locks), answer


def _release_of_all(self: Rules, value: Permission, lock: int, locked: bool, *more: Any) -> Step:
    return set_lock(self, value, lock, locked, more[0], more[1], not locked)


def _release_of_one_stop_frees_the_base(
    self: Rules, value: Permission, lock: int, locked: bool, *more: Any
) -> Step:
    changed, answer = set_lock(self, value, lock, locked, *more)
    stop = None if locked or lock == SERVICE_STOP else False
    return changed, answer if stop is None else answer._replace(stop=stop)


def _unnamed(self: Rules, value: Permission, now: float) -> list[str]:
    return list(value.locks[SERVICE_STOP].owners)


def _ended_programs_release(self: Rules, value: Permission, owner: str) -> Step:
    changed, answer = end_program(self, value, owner)
    locks = tuple(
        lock._replace(owners=tuple(name for name in lock.owners if name != owner))
        for lock in value.locks
    )
    return changed._replace(locks=locks), answer


def _twists_outlive_their_program(self: Rules, value: Permission, owner: str) -> Step:
    changed, answer = end_program(self, value, owner)
    return changed._replace(sources=value.sources), answer


def _zeros_outlive_a_gap(self: Rules, value: Permission, *arguments: Any, **named: Any) -> Step:
    changed, answer = void(self, value, *arguments, **named)
    states = zip(changed.sources, value.sources, strict=True)
    return changed._replace(sources=tuple(s._replace(twist=o.twist) for s, o in states)), answer


def _home_under_a_stop(self: Rules, value: Permission, time: float) -> Step:
    return value._replace(armed=False, disarmed_by=""), Answer(home=True, again=True)


def _begin_operated_cycle(self: Rules, value: Permission, now: float, base: Base) -> Step:
    return begin_cycle(self, value, now, base, operated=True)


begin_cycle = Rules.begin_cycle
publish, arm, disarm = Rules.publish, Rules.arm, Rules.disarm
set_lock, end_program, void = Rules.set_lock, Rules.end_program, Rules.void
RULES: dict[str, tuple[str, Any]] = {
    "a new source commands zero": ("begins", lambda self, source, twist: True),
    "an ineffective source commands zero": (
        "_ineffective",
        lambda self, value, *cycle: value.sources,
    ),
    "a source belongs to one program": ("publish", _publish_any),
    "a motion from before the arming is void": ("publish", _publish_before_arming),
    "nothing is armed that is moved": ("arm", _arm_moving),
    "a refused arming changes nothing": ("arm", _refused_arm_counts),
    "a person disarms": ("disarm", _keep("disarm")),
    "a person ends automatic arming": ("disarm", _disarm_for_now),
    "a base that holds disarms": ("hold", _keep("hold")),
    "a lock that is released soon counts": ("set_lock", _lock_alone),
    "a stop belongs to its programs": ("set_lock", _release_of_all),
    "each stop is released for itself": ("set_lock", _release_of_one_stop_frees_the_base),
    "whoever holds a stop is named": ("stopped_by", _unnamed),
    "a stop outlives its program": ("end_program", _ended_programs_release),
    "the twists of a program end with it": ("end_program", _twists_outlive_their_program),
    "a gap voids the commands": ("void", _keep("void")),
    "a zero before a gap is void": ("void", _zeros_outlive_a_gap),
    "a stopped robot does not home": ("home", _home_under_a_stop),
    "locks are active": ("active_locks", lambda self, value, now: ((), -1.0)),
    "a forgotten robot is disarmed": ("begin_cycle", _begin_operated_cycle),
}
AUTOMATIC = Configuration("automatic", SMALL.sources, automatic=True)
EXTENDED = Configuration(
    "extended", SMALL.sources, SMALL.locks, ("a", "b"), homes=True, forgets=True
)
NEEDED = {
    "a refused arming changes nothing": AUTOMATIC,
    "a person ends automatic arming": AUTOMATIC,
    "a source belongs to one program": EXTENDED,
    "a stop belongs to its programs": EXTENDED,
    "a stopped robot does not home": EXTENDED,
    "a forgotten robot is disarmed": EXTENDED,
}
"""What the rule concerns, where one source and one program are not enough."""


@pytest.mark.parametrize("rule", one_quick_of(4, RULES))
def test_each_rule_taken_out_is_found(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    violation = found(rule, monkeypatch)
    assert 1 <= len(violation.path) <= 9
    assert json.loads(script(violation))["robot"] == "differential_cia402"


def found(rule: str, monkeypatch: pytest.MonkeyPatch) -> Violation:
    monkeypatch.setattr(Rules, *RULES[rule])
    with pytest.raises(Violation) as violation:
        explore(NEEDED.get(rule, SMALL))
    return violation.value


REPLAYED = ["a new source commands zero", "an ineffective source commands zero"]


@pytest.mark.parametrize("rule", mostly_slow(REPLAYED))
def test_a_counterexample_is_a_mission_of_chaos(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mission moves the robot unasked without the rule, and does not with it."""
    with monkeypatch.context() as patch:
        mission = Schedule.from_json(script(found(rule, patch)))
        patch.setattr(invariants, "rules_are_whole", False)
        assert not in_copy(lambda: run_here(mission)).holds
    assert run_schedule(mission).holds
