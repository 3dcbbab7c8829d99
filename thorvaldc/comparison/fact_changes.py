"""Changes of facts about a robot that no single value of the model states, such as its size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from thorvaldc.comparison.field_names import field_unit
from thorvaldc.comparison.robot_difference import ValueChange
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts
from thorvaldc.model.facts.stability import DIRECTIONS

_SIZES = {
    "length, width, height": ("size.length", "size.width", "size.height"),
    "ground clearance": ("size.ground_clearance",),
}
_FACTS = {
    "wheelbase": "size.wheelbase",
    "track": "size.track",
    "stands on its wheels": "stability.stands",
    **{f"tip-over {direction}": f"stability.angles.{direction}" for direction in DIRECTIONS},
    "top speed forwards": "driving.forwards",
    "top speed sideways": "driving.sideways",
    "turning circle of the wheels": "driving.turn.wheel_circle",
    "yaw rate in the tightest turn": "driving.turn.yaw_rate",
    "steepest slope forwards": "slopes.forwards.steepest",
    "limit of the slope forwards": "slopes.forwards.reason",
    "stops downhill forwards up to": "slopes.forwards.stops",
    "stops downhill backwards up to": "slopes.backwards.stops",
    "stands with its motors off up to": "standing.motors_off",
    "stands with its brakes closed up to": "standing.braked",
    "energy": "energy.energy",
    "range at most": "energy.range_bound",
}
"""Labels of facts and the paths of their values in ``RobotFacts``."""


def fact_changes(before: Robot, after: Robot) -> Iterator[ValueChange]:
    """Yields the facts that differ between two robots, beginning with the size."""
    try:
        old, new = (robot_facts(robot) for robot in (before, after))
    except (LookupError, ArithmeticError, ValueError, RecursionError):
        # Somebody has changed a model.json so that its parts contradict each other.  The values of
        # the models are compared all the same.
        return
    shown: dict[str, tuple[str, ...]] = {label: (path,) for label, path in _FACTS.items()}
    # The model.json of a build has no meshes, so the extents of parts with meshes are unknown.
    if old.size.meshes_left_out == new.size.meshes_left_out:
        shown = _SIZES | shown
    for label, paths in shown.items():
        a, b = ([_value(facts, path) for path in paths] for facts in (old, new))
        if not _is_same(a, b):
            a, b = (values if len(paths) > 1 else values[0] for values in (a, b))
            yield ValueChange("robot", (), label, a, b, field_unit(tuple(paths[0].split("."))))


def _value(facts: RobotFacts, path: str) -> Any:
    """Returns the value of a fact, or ``None`` if the robot has no such fact."""
    value: Any = facts
    for name in path.split("."):
        if value is not None:
            value = dict(value)[name] if isinstance(value, tuple) else getattr(value, name)
    return value


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return all(map(_is_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-9)
    return bool(a == b)
