"""Faults of joints behind topics: the reactions in virtual time, for the page docs/faults.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from tests.examples import example_robot
from tests.ros.virtual_topics import PERIOD, VirtualTopics
from thorvaldc.model import Robot
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.ros.parameters import default_silence
from thorvaldc.runtime.motion_supervision import SHORTEST, FollowLimits
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.promised_times import rest_after
from thorvaldc.tools.fault_matrix.fault_cases import DRIVING, MOVING_PHASES, STOPPING
from thorvaldc.tools.fault_matrix.fault_matrix import reaction_text
from thorvaldc.tools.fault_matrix.fault_reaction import AT_REST, STOPS, Reaction

ROBOT = "4wd4ws_wide"
HEADINGS = ("fault", *MOVING_PHASES, "promised")
OBSERVED = 3.0  # s
Injection = Callable[[VirtualTopics], None]


class TopicFault(NamedTuple):
    """A fault; ``detection``: longest time (s) until the driver stops the robot."""

    name: str
    inject: Injection
    detection: float


def lost(seconds: float) -> Injection:
    """Returns the loss of all joint states for some time."""

    def inject(rig: VirtualTopics) -> None:
        end = rig.now + seconds + 1e-6
        rig.change = lambda states: states if states.time > end else None

    return inject


def frozen(rig: VirtualTopics) -> None:
    last = rig.engine.read(rig.now)
    rig.change = lambda states: replace(last, time=states.time)


def wrong(rig: VirtualTopics) -> None:
    rig.change = lambda states: replace(states, speeds=[math.nan] * len(states.speeds))


def is_reset(rig: VirtualTopics) -> None:
    rig.offset -= 5.0


def is_silent(rig: VirtualTopics) -> None:
    rig.twist = None


def is_disarmed(rig: VirtualTopics) -> None:
    rig.driven.call("disarm")


def robot() -> Robot:
    return example_robot(ROBOT)


def faults(robot: Robot) -> Iterator[TopicFault]:
    timeout = robot.driver.command_timeout
    silence = default_silence(robot)
    yield TopicFault("no joint states", lost(math.inf), silence + 2 * PERIOD)
    longer = silence + 0.05
    yield TopicFault(f"no joint states for {longer:.1f} s", lost(longer), silence + 2 * PERIOD)
    yield TopicFault("joint states that are not numbers", wrong, silence + 2 * PERIOD)
    limits = FollowLimits()
    speed = robot.driver.max_linear_velocity / max(w.radius for w in robot.wheels)
    frozen_for = max(SHORTEST, limits.excess / (limits.share * speed))
    yield TopicFault("frozen joint states", frozen, frozen_for + 3 * PERIOD)
    yield TopicFault("the simulation is reset", is_reset, 2 * PERIOD)
    yield TopicFault("client hangs", is_silent, timeout + 2 * PERIOD)
    yield TopicFault("a person disarms the robot", is_disarmed, 2 * PERIOD)


def react(robot: Robot, fault: TopicFault, phase: str) -> Reaction:
    """Tries a fault at the top speed, or 0.1 s after zero was commanded."""
    rig = VirtualTopics(robot)
    twist = Twist(robot.driver.max_linear_velocity, 0.0, 0.0)
    rig.drive(twist, 2.0)
    if phase == STOPPING:
        rig.twist = ZERO_TWIST
        for _ in range(5):
            rig.step()
    start, before = rig.now, rig.wheels()
    speed = max(v for _, v in before)
    fault.inject(rig)
    name, after, rest, error, unasked = "continues", None, None, 0.0, 0.0
    while rig.now < start + OBSERVED:
        rig.step()
        wheels = rig.wheels()
        fastest = max(v for _, v in wheels)
        pairs = zip(wheels, rig.commanded, strict=True)
        error = max(error, *(abs(v - commanded) for (_, v), commanded in pairs))
        unasked = max(unasked, fastest - speed)
        found = reaction_of(rig, phase)
        if found in STOPS and name not in STOPS:
            after = rig.now - start
        name = found if found in STOPS else name
        if fastest > AT_REST:
            rest = None
        elif rest is None:
            paths = [a - b for (a, _), (b, _) in zip(wheels, before, strict=True)]
            rest = rig.now - start, sum(map(abs, paths)) / len(paths)
    time, path = rest or (None, None)
    return Reaction(name, after, rig.driven.state()["fault"], time, path, speed, unasked, error)


def reaction_of(rig: VirtualTopics, phase: str) -> str:
    if rig.driven.state()["fault"]:
        return "fault"
    if not rig.driven.armed:
        return "disarmed"
    if phase == DRIVING and rig.driven.driver.state.commanded_twist == ZERO_TWIST:
        return "stops"
    return "continues"


def rows() -> Iterator[tuple[TopicFault, dict[str, Reaction], list[str]]]:
    """Yields each fault with its reactions by phase and the promises that they break."""
    model = robot()
    for fault in faults(model):
        reactions = {phase: react(model, fault, phase) for phase in MOVING_PHASES}
        limit = fault.detection
        longest, farthest = rest_after(model, limit, STOP_LOCK)
        broken = []
        for phase, reaction in reactions.items():
            if reaction.rest_time is None or reaction.rest_distance is None:
                broken.append(f"{fault.name}, {phase}: the wheels still turn")
            elif reaction.rest_time > longest or reaction.rest_distance > farthest:
                broken.append(f"{fault.name}, {phase}: {reaction_text(reaction)}")
            if reaction.unasked > 1e-9:
                broken.append(f"{fault.name}, {phase}: {reaction.unasked} m/s faster")
        if (reactions[DRIVING].after or math.inf) > limit + 1e-6:
            broken.append(f"{fault.name}: no reaction within {limit} s")
        yield fault, reactions, broken


def cells() -> Iterator[tuple[str, ...]]:
    """Yields the cells of the table on the page.  Raises ``ValueError`` for a broken promise."""
    model = robot()
    for fault, reactions, broken in rows():
        if broken:
            raise ValueError("; ".join(broken))
        longest, farthest = rest_after(model, fault.detection, STOP_LOCK)
        promised = f"{fault.detection:.2f} s, {longest:.1f} s, {farthest:.2f} m"
        yield fault.name, *(reaction_text(r) for r in reactions.values()), promised
