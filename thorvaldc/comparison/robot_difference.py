"""The differences between two robots or two fleets, as values of the model and in robot terms.

Every difference is one of values in the JSON form of the models, which contains every field, so
that no difference is lost, also in a field that the rest of the comparison does not know.  Source
spans are left out: they are positions in a file and not a property of the robot.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from thorvaldc.diagnostics.html_view import HtmlView
from thorvaldc.model import Fleet, Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts
from thorvaldc.model.facts.stability import DIRECTIONS
from thorvaldc.model.model_json import to_json

ValuePath = tuple[str, ...]


class _Absent:
    def __repr__(self) -> str:
        return "ABSENT"


ABSENT: Final = _Absent()
"""Placeholder for the value of an element that one of the two models does not have."""


class LeafDifference(NamedTuple):
    """A value that differs between two models.

    - ``path``: names of the fields and elements from the root of the model to the value, for
      example ``("wheels", "fl_wheel", "radius")``.
    - ``before``, ``after``: values in the JSON form, or ``ABSENT``.  An element that only one model
      has is one difference, with the whole element as its value.
    """

    path: ValuePath
    before: Any
    after: Any

    @property
    def text_path(self) -> str:
        return ".".join(self.path)

    @property
    def is_rounding(self) -> bool:
        """True for numbers that differ by less than 1e-9 of their size."""
        return _differ_by_rounding(self.before, self.after)


def model_document(model: Robot | Fleet) -> dict[str, Any]:
    """Returns the model in its JSON form, with mappings by name instead of lists of elements.

    The key ``order`` of a mapping that was a list contains the names in the order of the list.
    """
    document = _keyed(json.loads(to_json(model))["model"])
    return dict(document)


def leaf_differences(before: Any, after: Any, path: ValuePath = ()) -> Iterator[LeafDifference]:
    """Yields the differences of two documents of ``model_document``, in the order of the model."""
    if isinstance(before, dict) or isinstance(after, dict):
        # A list of elements is a mapping; an empty list has no elements to tell this from.
        before, after = ({} if side == [] else side for side in (before, after))
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            inner = (*path, key)
            if key == ORDER:
                yield from _order_difference(before, after, inner)
            elif key not in before or key not in after:
                yield LeafDifference(inner, before.get(key, ABSENT), after.get(key, ABSENT))
            else:
                yield from leaf_differences(before[key], after[key], inner)
    elif type(before) is not type(after) or before != after:
        yield LeafDifference(path, before, after)


ORDER = "(order)"
"""Key of the order of the elements in a mapping that was a list of elements."""


def _order_difference(
    before: dict[str, Any], after: dict[str, Any], path: ValuePath
) -> Iterator[LeafDifference]:
    """Yields a difference if the elements that both models have are in another order."""
    common = [
        [name for name in side.get(ORDER, ()) if name in other]
        for side, other in ((before, after), (after, before))
    ]
    if common[0] != common[1]:
        yield LeafDifference(path, common[0], common[1])


def _keyed(value: Any) -> Any:
    """Replaces lists of elements by mappings of names to elements, and removes source spans."""
    if isinstance(value, dict):
        return {key: _keyed(item) for key, item in value.items() if key != "span"}
    if not isinstance(value, list) or not value:
        return value
    names = element_names(value)
    if names is None:
        return value
    elements = [item[1] if isinstance(item, list) else item for item in value]
    by_name = {name: _keyed(item) for name, item in zip(names, elements, strict=True)}
    return {**by_name, ORDER: names}


def element_names(items: list[Any]) -> list[str] | None:
    """Returns a unique name for each element of a list.

    Returns ``None`` for a list of plain values, which is compared as a whole.
    """
    if all(isinstance(i, list) and len(i) == 2 and isinstance(i[0], str) for i in items):
        names = [item[0] for item in items]
    elif all(isinstance(item, dict) for item in items):
        names = [_name_of(item, number) for number, item in enumerate(items)]
        if len(set(names)) < len(names):
            names = [str(number) for number in range(len(items))]
    else:
        return None
    return names if len(set(names)) == len(names) and ORDER not in names else None


def _name_of(item: dict[str, Any], number: int) -> str:
    if "subindex" in item:
        return f"0x{item['index']:04X}:{item['subindex']}"
    for key in ("name", "joint"):
        if isinstance(item.get(key), str):
            return str(item[key])
    return str(number)


def _differ_by_rounding(before: Any, after: Any) -> bool:
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        size = max((abs(v) for v in (*before, *after) if isinstance(v, float)), default=0.0)
        return all(
            a == b
            or (isinstance(a, float) and isinstance(b, float) and abs(a - b) <= 1e-9 * size + 1e-12)
            for a, b in zip(before, after, strict=True)
        )
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) <= 1e-9 * max(abs(before), abs(after)) + 1e-12
    return False


ADDED, REMOVED, CHANGED = "added", "removed", "changed"
RENAMED, MOVED, EXCHANGED = "renamed", "moved", "exchanged"


@dataclass(frozen=True)
class ValueChange:
    """A property of the robot that differs.

    Attributes
    ----------
    section : part of the robot: ``robot``, ``wheels``, ``drives``, ``buses`` ...
    subjects : names of the elements with this change.  Empty for the robot itself.
    label : name of the property, such as ``radius``.  Empty if whole elements were added or
        removed.
    before, after : values in SI units or texts.  ``ABSENT`` for an element that one robot lacks.
    unit : SI unit of the values, or an empty text.
    """

    section: str
    subjects: tuple[str, ...]
    label: str
    before: Any
    after: Any
    unit: str = ""

    @property
    def kind(self) -> str:
        """``added``, ``removed`` or ``changed``."""
        if self.before is ABSENT:
            return ADDED
        return REMOVED if self.after is ABSENT else CHANGED


@dataclass(frozen=True)
class ModuleChange:
    """A module that was added, removed, renamed, moved, exchanged or given other parameters.

    Attributes
    ----------
    kinds : ``added``, ``removed``, or some of ``renamed``, ``exchanged``, ``moved``, ``changed``.
    name : path of the module, such as ``fl`` or ``fl.drive``; of the robot after the change,
        except for a removed module.
    old_name : path of the module before the change.
    old_type, type : module types, empty if they are unknown.
    old_place, place : where the module is mounted, such as ``frame.front_left``.
    parameters : parameters with other values.
    """

    kinds: tuple[str, ...]
    name: str
    old_name: str
    old_type: str
    type: str
    old_place: str
    place: str
    parameters: tuple[ValueChange, ...] = ()


@dataclass(frozen=True)
class RobotDifference(HtmlView):
    """The differences of two robots, in robot terms and as values of the model.

    Attributes
    ----------
    before, after : names of the robots.
    modules : changes of modules, in the order of the robot file.
    values : changes of properties of the robot and its elements.
    derived : values of the model that follow from the changes above, or that are of little
        interest: shapes, poses, frame identifiers, rounding.
    types : changes in the documents of module types that both robots use.  They are causes of other
        changes; a change without an effect, such as that of a description, is no difference.
    leaves : every value of the model that differs.  Each of them is in ``values``, in ``derived``,
        or belongs to an element of a module in ``modules``.
    entries : entries of the robot files that differ, with the paths of units and of ``--set``.
    """

    html_view = "thorvaldc.comparison.difference_text:difference_html"

    before: str
    after: str
    modules: tuple[ModuleChange, ...]
    values: tuple[ValueChange, ...]
    derived: tuple[LeafDifference, ...]
    types: tuple[ValueChange, ...]
    leaves: tuple[LeafDifference, ...]
    entries: tuple[LeafDifference, ...] = ()

    @property
    def is_equal(self) -> bool:
        return not (self.leaves or self.modules)


@dataclass(frozen=True)
class FleetDifference:
    """The differences of two fleets.

    Attributes
    ----------
    values : robots added, removed and placed elsewhere, and changes of the world.
    robots : differences of the robots with the same name in both fleets.
    leaves : every value of the fleet, without its robots, that differs.
    """

    before: str
    after: str
    values: tuple[ValueChange, ...]
    robots: tuple[tuple[str, RobotDifference], ...]
    leaves: tuple[LeafDifference, ...]

    @property
    def is_equal(self) -> bool:
        return not self.leaves and all(difference.is_equal for _, difference in self.robots)


Difference = RobotDifference | FleetDifference


_LABELS = {
    "com": "centre of mass",
    "max_velocity": "speed limit",
    "max_acceleration": "acceleration limit",
    "max_torque": "torque limit",
    "max_linear_velocity": "speed limit",
    "max_angular_velocity": "turning limit",
    "max_linear_acceleration": "acceleration limit",
    "max_angular_acceleration": "turning acceleration limit",
    "max_linear_deceleration": "deceleration of a stop",
    "max_angular_deceleration": "turning deceleration of a stop",
    "encoder_ppr": "encoder pulses",
    "x": "x position",
    "y": "y position",
    "xyz": "position",
    "quat": "orientation (quaternion)",
    "motor_max_speed": "motor speed limit",
}
"""Labels that differ from the name of the field with spaces, for a reader who knows robots and not
the model."""

_SILENT = ("inertial", "properties", "options", "driver")
"""Fields whose names say nothing to a reader."""


def field_label(path: ValuePath) -> str:
    """Returns the label of a field with the path ``path`` in its element."""
    words = [_LABELS.get(name, name.replace("_", " ")) for name in path if name not in _SILENT]
    if words and path[-1] == ORDER:
        words[-1] = "order"
    return " ".join(words)


def field_unit(path: ValuePath) -> str:
    """Returns the SI unit of a value of the model or of a fact, or an empty text."""
    for root in (Robot, Fleet, RobotFacts):
        if path[0] in si.field_types(root):
            quantity = si.quantity_at(root, path)
            return quantity.unit if quantity else ""
    return ""


# -- facts that no single value of the model states, such as the size --------------------------

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
    "rolling resistance": "energy.rolling_force",
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
