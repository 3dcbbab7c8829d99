"""The driver stops joints behind topics by its commands, whatever their joint states say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from tests.examples import example_robot
from tests.model.stops import stop_bound
from tests.ros.virtual_topics import PERIOD, VirtualTopics
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.runtime.se2 import Twist

TOP = Twist(1.0, 0.0, 0.3)
STOPS: dict[str, Callable[[VirtualTopics], object]] = {
    "disarm": lambda rig: rig.driven.call("disarm"),
    "safety stop": lambda rig: rig.driven.call("safety_stop"),
    "stop lock": lambda rig: rig.driven.call("lock", name=rig.model.twist_locks[0].name),
    "nobody": lambda rig: None,
}


@pytest.mark.parametrize("share", [1.0, 1.5, 0.3, -1.0], ids=["same", "high", "low", "backwards"])
@pytest.mark.parametrize("how", STOPS)
def test_frozen_joint_states_sustain_no_motion(how: str, share: float) -> None:
    """The driver commanded a frozen speed for ever, and `disarm` and `safety_stop` changed nothing.

    Where nobody stops the robot, the joint states that do not change are a fault.
    """
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 2.0)
    last = rig.engine.read(rig.now)
    frozen = replace(last, speeds=[share * speed for speed in last.speeds])
    rig.change = lambda states: replace(frozen, time=states.time)
    rig.step()
    STOPS[how](rig)
    bound = stop_bound(rig.model, STOP_LOCK)
    noticed = 0.5 + PERIOD if how == "nobody" else 0.0
    start, before, speeds = rig.now, rig.wheels(), [rig.commanded]
    while rig.now < start + noticed + bound.time:
        rig.step()
        speeds.append(rig.commanded)
    assert not rig.driven.armed
    assert not any(rig.commanded)
    assert max(speed for _, speed in rig.wheels()) == 0.0
    ways = [abs(b - a) for (a, _), (b, _) in zip(before, rig.wheels(), strict=True)]
    assert sum(ways) / len(ways) <= bound.distance + noticed * TOP.vx
    for one, next_one in pairwise(speeds):
        assert all(b <= a + 1e-9 for a, b in zip(one, next_one, strict=True))


def test_a_fault_of_the_joint_states_needs_a_reset_and_an_arming() -> None:
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 1.0)
    rig.change = lambda states: None
    for _ in range(100):
        rig.step()
    fault = "no joint states on /engine/joint_states"
    assert rig.driven.state()["fault"] == fault
    assert rig.driven.arming_reasons(rig.driven.now)[0] == fault
    rig.change = lambda states: states
    rig.twist = Twist(0.0, 0.0, 0.0)
    for _ in range(150):
        rig.step()
    assert rig.driven.arming_reasons(rig.driven.now) == [fault]
    rig.driven.call("reset_faults")
    rig.drive(TOP, 1.0)
    assert max(rig.commanded) > 0.9
