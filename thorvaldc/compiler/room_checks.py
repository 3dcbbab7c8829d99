"""Checks that the modules of a robot have room: none is inside another one or in its way, none is
in the air or in the ground.

The bodies are the collision shapes, and modules that are mounted on each other may overlap. A body
is tested against the others where all joints are at 0, and along the travel of each joint that
steers, swivels or springs, with the other joints at 0.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from thorvaldc.diagnostics import Label, Report, millimetres
from thorvaldc.model import Box, Joint, Link, MeshShape, Pose, Robot, Vec3
from thorvaldc.model.spatial import add, dot, norm, quat_from_axis_angle, scale, sub
from thorvaldc.model.statics.convex_bodies import (
    ConvexBody,
    Overlap,
    bounds_of,
    overlap_along,
    overlap_of,
)
from thorvaldc.model.statics.ground_contacts import ON_GROUND
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.occupied_space import solids_of

TOLERANCE = 6e-3
"""Overlap (m) that is not reported, because the bodies are simpler than the parts.

Tyres are exact, and two wheels side by side on one axle may touch each other.
"""
TOUCHING = 1e-6
"""Overlap (m) of two tyres that touch each other."""
GAP = 0.02
"""Largest distance (m) of parts that touch each other: a flange or a clamp may not be described."""
MOST = 3
"""Number of modules inside which a module is reported."""
LARGEST_TURN = math.radians(10.0)
"""Largest angle between two positions of a joint at which bodies are compared."""
MOST_STEPS = 400
"""Largest number of positions of a joint, for thin bodies far from its axis."""
_MOVING = ("steering", "swivel", "suspension")
_WORDS: dict[Vec3, str] = {
    (1.0, 0.0, 0.0): "forwards",
    (-1.0, 0.0, 0.0): "backwards",
    (0.0, 1.0, 0.0): "to the left",
    (0.0, -1.0, 0.0): "to the right",
    (0.0, 0.0, 1.0): "up",
    (0.0, 0.0, -1.0): "down",
}


class _Travel(NamedTuple):
    """A joint that moves a body, with its axis in ``base_link`` and its limits."""

    joint: Joint
    axis: Vec3
    origin: Vec3
    lower: float
    upper: float

    def motion(self, position: float) -> Pose:
        """Returns the motion of a body from position 0 to another one."""
        if self.joint.type == "prismatic":
            return Pose(scale(position, self.axis))
        turn = Pose(quat=quat_from_axis_angle(self.axis, position))
        return Pose(sub(self.origin, turn.rotate(self.origin)), turn.quat)

    def positions(self, moved: ConvexBody, other: ConvexBody) -> Iterator[float]:
        """Yields positions, so near to each other that a body on its way misses no other one."""
        way, least = self.upper - self.lower, 1
        if self.joint.type != "prismatic":
            least = math.ceil(way / LARGEST_TURN)
            way *= min(self.distances(moved)[1], self.distances(other)[1])
        steps = math.ceil(way / (moved.thickness + other.thickness))
        steps = max(min(steps, MOST_STEPS), least, 1)
        yield from (self.lower + (self.upper - self.lower) * k / steps for k in range(steps + 1))

    def distances(self, body: ConvexBody) -> tuple[float, float]:
        """Returns the least and the largest distance (m) of a body from the axis, at most."""
        offset = sub(body.center, self.origin)
        distance = norm(sub(offset, scale(dot(offset, self.axis), self.axis)))
        return distance - body.reach, distance + body.reach


class _Part(NamedTuple):
    """A body of a link, the joints that move it, and the radius (m) that it reaches."""

    link: Link
    body: ConvexBody
    travels: tuple[_Travel, ...]
    reach: float


class _Meeting(NamedTuple):
    """Two parts that overlap, and the joint position at which they do."""

    first: _Part
    second: _Part
    are_tyres: bool
    overlap: Overlap
    travel: _Travel | None = None
    position: float = 0.0

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Tyres at rest come first, and overlaps at rest before those of moved joints."""
        is_at_rest = self.travel is None
        return self.are_tyres and is_at_rest, is_at_rest, self.overlap.depth


def check_room(robot: Robot, report: Report) -> None:
    """Runs the checks of this module and adds the diagnostics to the report.

    If the report has errors, only wheels that overlap are reported: a wrong number may cause the
    rest.
    """
    parts = list(_parts(robot))
    warnings = Report() if report.has_errors else report
    _check_overlaps(robot, parts, report, warnings)
    buried = _check_ground(robot, parts, warnings)
    if not any(d.code.name == "robot-size" for d in report):
        _check_touching(robot, parts, buried, warnings)


def _parts(robot: Robot) -> Iterator[_Part]:
    tree, links = tree_of(robot), {link.name: link for link in robot.links}
    for name, solids in solids_of(robot, with_visuals=False).items():
        travels = tuple(
            _travel(joint, tree.pose[joint.child])
            for joint in tree.joints_above(name)
            if joint.role in _MOVING and joint.type != "fixed"
        )
        for shape, pose, data in solids:
            body = ConvexBody(shape, tree.pose[name] * pose, data)
            reach = body.reach
            for travel in travels:
                if travel.joint.type == "prismatic":
                    reach += max(abs(travel.lower), abs(travel.upper))
                else:
                    reach += 2.0 * max(travel.distances(body)[1] - body.reach, 0.0)
            yield _Part(links[name], body, travels, reach)


def _travel(joint: Joint, pose: Pose) -> _Travel:
    lower = -math.pi if joint.lower is None else joint.lower
    upper = math.pi if joint.upper is None else joint.upper
    return _Travel(joint, pose.rotate(joint.axis), pose.xyz, lower, upper)


# -- modules inside each other ---------------------------------------------------------------


def _check_overlaps(robot: Robot, parts: list[_Part], report: Report, warnings: Report) -> None:
    """Reports the deepest overlap of each two modules of the robot file, of wheels as an error."""
    links = {link.name: link for link in robot.links}
    joined = {
        frozenset((links[joint.parent].module, links[joint.child].module)) for joint in robot.joints
    }
    wheels = {wheel.link for wheel in robot.wheels}
    deepest: dict[tuple[str, str], _Meeting] = {}
    # Without a limit, a thousand modules in one place would cause half a million diagnostics.
    counts: Counter[str] = Counter()
    for first, second in _near(parts, counts):
        modules = frozenset((first.link.module, second.link.module))
        if len(modules) == 1 or modules in joined:
            continue
        are_tyres = first.link.name in wheels and second.link.name in wheels
        meeting = _meeting(first, second, are_tyres)
        if meeting is None:
            continue
        names = _entry(first), _entry(second)
        known = deepest.get(names)
        counts[names[1]] += known is None
        if known is None or meeting.rank > known.rank:
            deepest[names] = meeting
    for meeting in deepest.values():
        if meeting.rank[0]:
            link, other = meeting.second.link, meeting.first.link
            report.add(
                "wheels-overlap",
                f"the wheels of `{other.module}` and `{link.module}` overlap",
                link.span,
                labels=[Label(other.span, "the other wheel")],
                hint="move one of the mounts",
            )
        else:
            _report_overlap(meeting, warnings)


def _entry(part: _Part) -> str:
    return part.link.module.partition(".")[0]


def _near(parts: list[_Part], counts: Counter[str]) -> Iterator[tuple[_Part, _Part]]:
    """Yields the pairs whose spheres overlap, each in the order of the model.

    The parts are sorted along x, and each is compared with those whose interval of x overlaps.
    Parts of modules with ``MOST`` diagnostics are left out from then on.
    """
    order = sorted(range(len(parts)), key=lambda k: parts[k].body.center[0] - parts[k].reach)
    active: list[int] = []
    for k in order:
        part = parts[k]
        if counts[_entry(part)] >= MOST:
            continue
        start = part.body.center[0] - part.reach
        active = [
            n
            for n in active
            if parts[n].body.center[0] + parts[n].reach > start and counts[_entry(parts[n])] < MOST
        ]
        for n in active:
            other = parts[n]
            distance = math.dist(part.body.center, other.body.center)
            if distance < part.reach + other.reach:
                yield (other, part) if n < k else (part, other)
        active.append(k)


def _meeting(first: _Part, second: _Part, are_tyres: bool) -> _Meeting | None:
    """Returns the overlap of two parts at rest or, without one, along the travel of a joint."""
    tolerance = TOUCHING if are_tyres else TOLERANCE
    apart = math.dist(first.body.center, second.body.center) > first.body.reach + second.body.reach
    if not apart:
        overlap = overlap_of(first.body, second.body, tolerance)
        if overlap.depth > tolerance:
            return _Meeting(first, second, are_tyres, overlap)
    deepest = None
    for moved, other in ((first, second), (second, first)):
        for travel in moved.travels:
            if travel in other.travels or not _may_meet(travel, moved.body, other.body):
                continue
            for position in travel.positions(moved.body, other.body):
                bodies = moved.body.moved(travel.motion(position)), other.body
                a, b = bodies if moved is first else bodies[::-1]
                overlap = overlap_of(a, b, TOLERANCE)
                if overlap.depth > max(TOLERANCE, deepest.overlap.depth if deepest else 0.0):
                    deepest = _Meeting(first, second, are_tyres, overlap, travel, position)
    return deepest


def _may_meet(travel: _Travel, moved: ConvexBody, other: ConvexBody) -> bool:
    """Returns whether a body may meet another one on its way, which is around or along an axis."""
    low, high = moved.extent(travel.axis)
    if travel.joint.type == "prismatic":
        low, high = low + min(travel.lower, 0.0), high + max(travel.upper, 0.0)
    else:
        near, far = travel.distances(moved)
        nearest, furthest = travel.distances(other)
        if nearest > far or furthest < near:
            return False
    lowest, highest = other.extent(travel.axis)
    return low < highest - TOLERANCE and lowest < high - TOLERANCE


def _report_overlap(meeting: _Meeting, report: Report) -> None:
    first, second = meeting.first.link, meeting.second.link
    label = [Label(first.span, f"`{first.module}` is mounted here")]
    depth = millimetres(meeting.overlap.depth)
    if meeting.travel is None:
        message = f"`{second.module}` is {depth} inside `{first.module}`"
        ways = [
            (overlap_along(meeting.first.body, meeting.second.body, way), word)
            for way, word in _WORDS.items()
        ]
        distance, word = min(ways)
        hint = f"move it at least {millimetres(distance)} {word}, or choose another place"
    else:
        joint, position = meeting.travel.joint, meeting.position
        at = (
            millimetres(position)
            if joint.type == "prismatic"
            else f"{math.degrees(position):.0f} deg"
        )
        message = f"`{second.module}` and `{first.module}` overlap by {depth}"
        message += f" when `{joint.name}` is at {at}"
        hint = "move one of them, or give the joint a narrower range"
    report.add("parts-overlap", message, second.span, labels=label, hint=hint)


# -- modules in the air and in the ground ----------------------------------------------------


def _check_touching(robot: Robot, parts: list[_Part], buried: set[str], report: Report) -> None:
    """Reports modules that touch nothing but what they carry, without the ``buried`` ones."""
    parents = {module.name: module.parent for module in robot.modules}

    def carries(module: str, other: str) -> bool:
        while other and other != module:
            other = parents.get(other, "")
        return other == module

    bodies: dict[str, list[ConvexBody]] = {}
    for part in parts:
        bodies.setdefault(part.link.module, []).append(part.body)
    links: dict[str, list[str]] = {}
    for link in robot.links:
        links.setdefault(link.module, []).append(link.name)

    @functools.cache
    def visible(module: str) -> list[ConvexBody]:
        return list(_visible_bodies(robot, links.get(module, [])))

    for module in robot.modules:
        if not module.mounted or not module.parent or module.name in buried:
            continue
        touched = functools.partial(_touches, bodies.get(module.name, []))
        if touched(bodies.get(module.parent, [])):
            continue
        own = visible(module.name)
        others = [name for name in links if not carries(module.name, name)]
        others.sort(key=lambda name: name != module.parent)  # the most probable one first
        if any(touched(bodies.get(name, [])) or _touches(own, visible(name)) for name in others):
            continue
        nearest = _nearest(own, [body for name in others for body in visible(name)])
        if nearest is not None:
            moves = ((nearest.depth * dot(nearest.direction, way), way) for way in _WORDS)
            ways = [f"{millimetres(s)} {_WORDS[way]}" for s, way in moves if s > 1e-3]
            report.add(
                "part-loose",
                f"`{module.name}` touches nothing: the nearest part is "
                f"{millimetres(-nearest.depth)} away",
                module.span,
                hint=f"move it {' and '.join(ways)}, or mount it on a part that reaches it",
            )


def _nearest(bodies: list[ConvexBody], others: list[ConvexBody]) -> Overlap | None:
    """Returns the overlap, of a negative depth, of the two bodies that are nearest."""
    pairs = [
        (math.dist(body.center, other.center) - body.reach - other.reach, k, n)
        for k, body in enumerate(bodies)
        for n, other in enumerate(others)
    ]
    nearest: Overlap | None = None
    for bound, k, n in sorted(pairs):
        if nearest is not None and bound >= -nearest.depth:
            break  # the spheres around the bodies are farther apart already
        overlap = overlap_of(others[n], bodies[k])
        if nearest is None or overlap.depth > nearest.depth:
            nearest = overlap
    return nearest


def _visible_bodies(robot: Robot, links: Iterable[str]) -> Iterator[ConvexBody]:
    """Yields the bodies of all solids of links, with boxes around meshes."""
    pose, solids = tree_of(robot).pose, solids_of(robot)
    for name in links:
        for shape, place, data in solids.get(name, ()):
            if isinstance(shape, MeshShape):
                bounds = bounds_of(shape, Pose(), data)
                if bounds is None:
                    continue
                lower, upper = bounds
                shape, place = Box(sub(upper, lower)), place * Pose(scale(0.5, add(lower, upper)))
            yield ConvexBody(shape, pose[name] * place)


def _touches(bodies: list[ConvexBody], others: list[ConvexBody]) -> bool:
    """Returns whether one of the bodies touches another one."""
    return any(
        math.dist(body.center, other.center) < body.reach + other.reach + GAP
        and overlap_of(other, body, -GAP, GAP).depth > -GAP
        for other in others
        for body in bodies
    )


def _check_ground(robot: Robot, parts: list[_Part], report: Report) -> set[str]:
    """Reports links below the ground, other than wheels.  Returns the paths of their modules."""
    pose = tree_of(robot).pose
    if not robot.wheels:
        return set()
    rolling, buried = {wheel.link for wheel in robot.wheels}, set()
    heights: dict[str, float] = {}
    for part in parts:
        if part.link.name not in rolling:
            lowest = part.body.furthest((0.0, 0.0, -1.0))[2]
            heights[part.link.name] = min(lowest, heights.get(part.link.name, lowest))
    for link in robot.links:
        if link.inertial is not None and link.inertial.mass > 0.0 and link.name in pose:
            heights.setdefault(link.name, pose[link.name].apply(link.inertial.com)[2])
        height = heights.get(link.name, 0.0)
        if height < -ON_GROUND:
            buried.add(link.module)
            report.add(
                "part-below-ground",
                f"link `{link.name}` reaches {millimetres(-height)} below the ground",
                link.span,
                hint="raise its mount, or turn it over",
            )
    return buried
