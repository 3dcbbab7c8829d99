"""Changes of facts about a robot that no single value of the model states, such as its size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts
from thorvaldc.tools.comparison.robot_difference import ValueChange

Fact = tuple[str, Any, str]  # label, value, unit


def fact_changes(before: Robot, after: Robot) -> Iterator[ValueChange]:
    """Yields the facts that differ between two robots, beginning with the size."""
    try:
        facts = [robot_facts(robot) for robot in (before, after)]
    except (LookupError, ArithmeticError, ValueError, RecursionError):
        # Somebody has changed a model.json so that its parts contradict each other.  The values of
        # the models are compared all the same.
        return
    # The model.json of a build has no meshes, so the extents of parts with meshes are unknown.
    has_size = facts[0].size.meshes_left_out == facts[1].size.meshes_left_out
    old, new = ({label: (value, unit) for label, value, unit in _facts(f, has_size)} for f in facts)
    for label in dict.fromkeys([*old, *new]):
        (a, unit), (b, _) = old.get(label, (None, "")), new.get(label, (None, ""))
        if not _is_same(a, b):
            yield ValueChange("robot", (), label, a, b, unit or new.get(label, (0, ""))[1])


def _facts(facts: RobotFacts, has_size: bool) -> Iterator[Fact]:
    size, stability, driving, slopes = facts.size, facts.stability, facts.driving, facts.slopes
    if has_size:
        yield "length, width, height", [size.length, size.width, size.height], "m"
        yield "ground clearance", size.ground_clearance, "m"
    yield "wheelbase", size.wheelbase, "m"
    yield "track", size.track, "m"
    yield "stands on its wheels", stability.stands, ""
    for direction, angle in stability.angles:
        yield f"tip-over {direction}", angle, "rad"
    yield "top speed forwards", driving.forwards, "m/s"
    yield "top speed sideways", driving.sideways, "m/s"
    if driving.turn is not None:
        yield "turning circle of the wheels", driving.turn.wheel_circle, "m"
        yield "yaw rate in the tightest turn", driving.turn.yaw_rate, "rad/s"
    if slopes is not None:
        yield "steepest slope forwards", slopes.forwards.steepest, "rad"
        yield "limit of the slope forwards", slopes.forwards.reason, ""
        yield "stops downhill forwards up to", slopes.forwards.stops, "rad"
        yield "stops downhill backwards up to", slopes.backwards.stops, "rad"
    if facts.standing is not None:
        yield "stands with its motors off up to", facts.standing.motors_off, "rad"
        yield "stands with its brakes closed up to", facts.standing.braked, "rad"
    yield "energy", facts.energy.energy, "J"
    yield "range at most", facts.energy.range_bound, "m"


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return all(map(_is_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-9)
    return bool(a == b)
