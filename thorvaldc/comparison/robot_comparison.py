"""Compares two robots: modules, properties of the robot, and every value of the model.

First every value of the model that differs is found.  Then each of them is put in one of three
places: a change of a module, a change of a property, or a list of derived values.  A value that
this module does not know becomes a change of a property with the name of the field, so that nothing
is lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from thorvaldc.comparison import module_changes, robot_difference
from thorvaldc.comparison.module_changes import Outline
from thorvaldc.comparison.robot_difference import Difference, LeafDifference, ValueChange
from thorvaldc.model import Fleet, Robot

# Fields of links and joints that a reader wants to see.  The others (shapes, poses, inertias)
# follow from parameters of modules, or are many numbers for one change.
_SHOWN_LINK_FIELDS = ("mass",)
_SHOWN_JOINT_FIELDS = ("type", "role", "lower", "upper", "effort", "velocity", "mimic")
# Fields of frames that follow from node ids, and from the frames before on the bus.
_DERIVED_FRAME_FIELDS = (
    *(
        "cob_id",
        "consumers",
        "response_time",
        "signals",
        "mapping",
        "description",
        robot_difference.ORDER,
    ),
)
_ELEMENTS = ("wheels", "actuators", "sensors", "batteries", "joint_servos")


def compare_robots(
    before: Robot,
    after: Robot,
    before_modules: Outline | None = None,
    after_modules: Outline | None = None,
) -> robot_difference.RobotDifference:
    """Returns the differences between two robots.

    ``before_modules``, ``after_modules``: the modules of the robot files with their types and
    parameters.  If one of them is missing, as for a build, the names and the places of the modules
    are taken from the models.
    """
    if before_modules is None or after_modules is None:
        before_modules, after_modules = (
            module_changes.outline_of_model(before),
            module_changes.outline_of_model(after),
        )
    renames = module_changes.find_renames(before_modules, after_modules)
    old = module_changes.renamed_document(
        robot_difference.model_document(before), renames, before_modules
    )
    new = robot_difference.model_document(after)
    leaves = tuple(robot_difference.leaf_differences(old, new))
    changes = tuple(module_changes.changes_of(before_modules, after_modules, renames))
    shown: list[tuple[LeafDifference, ValueChange]] = []
    derived: list[LeafDifference] = []
    kinds = {change.name: change.kinds for change in changes}
    for leaf in leaves:
        if _is_covered_by_module(leaf, kinds.get(_module_of(leaf, old, new), ())):
            continue
        if leaf.is_rounding or is_derived(leaf):
            derived.append(leaf)
        else:
            shown.append((leaf, _value_change(leaf)))
    values = (
        *robot_difference.fact_changes(before, after),
        *_collapsed(change for _, change in shown),
    )
    types = tuple(module_changes.type_changes(before_modules, after_modules))
    return robot_difference.RobotDifference(
        before.name, after.name, changes, values, tuple(derived), types, leaves
    )


def compare_fleets(
    before: Fleet,
    after: Fleet,
    modules: Sequence[dict[str, Outline]] = ({}, {}),
) -> robot_difference.FleetDifference:
    """Returns the differences between two fleets.

    ``modules``: the modules of the robots of each fleet, by the name of the robot in the fleet.
    """
    old, new = (robot_difference.model_document(fleet) for fleet in (before, after))
    robots = []
    for name in old["placements"]:
        if name == robot_difference.ORDER or name not in new["placements"]:
            continue
        pair = [_robot_of(fleet, name) for fleet in (before, after)]
        outlines = [side.get(name) for side in modules]
        robots.append((name, compare_robots(pair[0], pair[1], *outlines)))
        for side in (old, new):
            side["placements"][name].pop("robot")
    leaves = tuple(robot_difference.leaf_differences(old, new))
    values = tuple(_collapsed(_value_change(leaf) for leaf in leaves))
    return robot_difference.FleetDifference(before.name, after.name, values, tuple(robots), leaves)


def compare_models(
    before: Robot | Fleet,
    after: Robot | Fleet,
    modules: Sequence[dict[str, Outline]] = ({}, {}),
) -> Difference | None:
    """Returns the differences between two robots or two fleets, or ``None`` for one of each.

    ``modules``: the modules of each model, as for ``compare_fleets``; a robot has an empty name.
    """
    if isinstance(before, Robot) and isinstance(after, Robot):
        return compare_robots(before, after, *(side.get("") for side in modules))
    if isinstance(before, Fleet) and isinstance(after, Fleet):
        return compare_fleets(before, after, modules)
    return None


def _robot_of(fleet: Fleet, name: str) -> Robot:
    return next(p.robot for p in fleet.placements if p.name == name)


def _module_of(leaf: LeafDifference, old: Any, new: Any) -> str:
    """Returns the module in the robot file that an element of the model belongs to."""
    for document in (new, old):
        if leaf.path[0] == "modules":
            return module_changes.top_module(leaf.path[1])
        element, module = document, ""
        for key in leaf.path:
            element = element.get(key) if isinstance(element, dict) else None
            if not isinstance(element, dict):
                break
            if isinstance(element.get("module"), str):
                module = element["module"]
            elif isinstance(element.get("producer"), str):
                # A frame belongs to the module of its node; that to a node has it as consumer.
                module = _module_of_frame(element, document)
        if module:
            return module_changes.top_module(module)
    return ""


def _module_of_frame(frame: dict[str, Any], document: Any) -> str:
    nodes = {
        name: node["module"]
        for bus in document["buses"].values()
        if isinstance(bus, dict)
        for name, node in bus["nodes"].items()
        if name != robot_difference.ORDER
    }
    names = [frame["producer"], *frame["consumers"]]
    return next((nodes[name] for name in names if name in nodes), "")


def _is_covered_by_module(leaf: LeafDifference, kinds: Sequence[str]) -> bool:
    """Returns whether the change of a module states a difference of one of its elements.

    ``kinds``: kinds of the change of the module.
    """
    path = leaf.path
    if path[0] == "modules":
        # The change of the module states it, or there is a value elsewhere that follows from it.
        return bool(kinds)
    is_bus_element = path[0] == "buses" and path[2:3] in (("nodes",), ("frames",))
    if not (path[0] in ("links", "joints", *_ELEMENTS) or is_bus_element):
        return False
    if robot_difference.ADDED in kinds or robot_difference.REMOVED in kinds:
        return True
    # The links of another module type are other bodies; its wheels and motors can be compared.
    is_whole_element = len(path) == (4 if is_bus_element else 2)
    is_name_of_joint = path[0] == "wheels" and path[-1].endswith("_joint")
    return robot_difference.EXCHANGED in kinds and (
        path[0] in ("links", "joints") or is_whole_element or is_name_of_joint
    )


def is_derived(leaf: LeafDifference) -> bool:
    """Returns whether a value follows from others, or says little to a reader."""
    path = leaf.path
    if path[-1] == robot_difference.ORDER and path[0] not in ("twist_sources", "twist_locks"):
        return True
    match path:
        case ("links", _, *rest):
            return not rest or rest[-1] not in _SHOWN_LINK_FIELDS
        case ("joints", _, *rest):
            return not rest or rest[0] not in _SHOWN_JOINT_FIELDS
        case ("wheels" | "actuators" | "sensors" | "batteries", _, "module" | "link", *_):
            return True
        case ("inertial", "inertia") | ("modules", _, "masses" | "parent", *_):
            return True
        case ("meshes", *_):
            return True
        case ("buses", _, "frames", _):
            return True
        case ("buses", _, "frames", _, field, *_):
            return field in _DERIVED_FRAME_FIELDS
        case ("buses", _, "nodes", _, "objects", *_):
            return True
    return False


def _value_change(leaf: LeafDifference) -> ValueChange:
    path = leaf.path
    section, rest = "robot", path
    subjects: tuple[str, ...] = ()
    match path:
        case ("driver" | "ros" | "calculator" | "world" as first, *others):
            section, rest = first, tuple(others)
        case ("inertial", *others):
            rest = tuple(others)
        case ("buses", bus, "nodes" | "frames" as first, element, *others):
            section, subjects, rest = f"bus {bus}", (element,), tuple(others)
            if not others and first == "frames":
                rest = ("frame",)
        case ("buses", bus, *others):
            section, rest = f"bus {bus}", tuple(others)
        case ("modules", element, *others):
            section, subjects, rest = "module types", (element,), tuple(others)
        case (str() as first, element, *others) if len(path) > 1:
            section, subjects, rest = first, (element,), tuple(others)
    before, after = leaf.before, leaf.after
    return ValueChange(
        section.replace("_", " "),
        subjects,
        robot_difference.field_label(rest),
        before,
        after,
        robot_difference.field_unit(path),
    )


def _collapsed(changes: Iterable[ValueChange]) -> Iterator[ValueChange]:
    """Yields one change for several elements with the same change."""
    groups: dict[str, list[ValueChange]] = {}
    for change in changes:
        key = repr((change.section, change.label, change.before, change.after))
        groups.setdefault(
            key if change.kind == robot_difference.CHANGED else repr(change), []
        ).append(change)
    for group in groups.values():
        first = group[0]
        subjects = tuple(subject for change in group for subject in change.subjects)
        yield ValueChange(
            first.section, subjects, first.label, first.before, first.after, first.unit
        )
