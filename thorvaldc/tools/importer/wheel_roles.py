"""Recognises the wheels, steering axes and casters of a description by geometry and by drive.

A wheel is a round part that turns about a horizontal axis and reaches the ground.  The ground is at
the lowest point of the driven wheels.  The nearest upright joint above a wheel steers it, or lets
it swivel.  A round part on the ground that nothing turns about one horizontal axis is a ball.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.compiler.descriptions.wheel_rules import RoundShape, tyre_of
from thorvaldc.compiler.robot_checks import WHEEL_OFF_GROUND
from thorvaldc.compiler.shapes.mesh_formats import mesh_triangles
from thorvaldc.diagnostics import Report, Span, millimetres, plain
from thorvaldc.model import Box, Cylinder, Joint, MeshShape, Pose, Shape, Sphere, Vec3
from thorvaldc.model.spatial import add, dot, norm, scale, sub
from thorvaldc.tools.importer.foreign_robot import ForeignRobot

UP: Vec3 = (0.0, 0.0, 1.0)
_PARALLEL = 0.99  # cosine of 8 deg
_HORIZONTAL, _UPRIGHT = 0.3, 0.7  # share of the z axis in the direction of a joint axis
_BESIDE = 1e-4  # m, of the middle of a wheel beside its axis, which is rounding
_NEAR_GROUND = 0.005  # m, beside a tenth of the radius
_CLEARANCE = 0.05  # m, of the lowest part below the wheels, if nothing states which are wheels
_KINDS = {
    "mecanum wheels": re.compile(r"(?i)mecanum"),
    "tracks": re.compile(r"(?i)(^|[^a-z])tracks?([^a-z]|$)|crawler|caterpillar|bunker"),
    "omnidirectional wheels with rollers": re.compile(r"(?i)omni_?wheel|wheel_?omni|omni_?drive"),
}


class Tyre(NamedTuple):
    """A round part: its size in m, and its centre in the frame of the link that turns."""

    radius: float
    width: float
    center: Vec3
    span: Span
    is_round: bool = False  # a sphere
    is_mesh: bool = False


@dataclass
class Roles:
    """What the joints and links of a robot are for.

    - ``wheels``: tyres by the name of the joint about which the wheel spins.
    - ``driven``, ``steering``, ``swivels``: names of joints.
    - ``balls``: tyres of ball casters, by the name of their link.
    - ``rigid``: joints that move in the file, and are fixed in the robot.
    """

    wheels: dict[str, Tyre] = field(default_factory=dict)
    driven: dict[str, None] = field(default_factory=dict)
    steering: dict[str, None] = field(default_factory=dict)
    swivels: dict[str, None] = field(default_factory=dict)
    balls: dict[str, Tyre] = field(default_factory=dict)
    rigid: list[Joint] = field(default_factory=list)


def recognise(robot: ForeignRobot, report: Report) -> Roles | None:
    """Returns the roles, or reports why the robot cannot be imported."""
    if _is_unsupported(robot, report):
        return None
    description = robot.description
    above = {joint.child: joint for joint in description.joints.values()}
    tyres = dict(_turning_parts(robot, report))
    stated = [name for name in tyres if name in robot.velocity_joints]
    lowest = {name: _lowest(robot, description.joints[name].child, t) for name, t in tyres.items()}
    if not lowest:
        _report_none(robot, report)
        return None
    ground = min(lowest[name] for name in stated or lowest)
    if not stated and ground > _lowest_point(robot) + _CLEARANCE:
        _report_none(robot, report)  # such as a base without wheels, with a turning part above
        return None
    roles = Roles()
    for name, tyre in tyres.items():
        if abs(lowest[name] - ground) < _NEAR_GROUND + 0.1 * tyre.radius:
            roles.wheels[name] = tyre
    for name in roles.wheels:
        joint = _moving_joint_above(description.joints[name].parent, above)
        if joint is not None and _upright(robot, joint) and joint.type != "prismatic":
            is_free = joint.type == "continuous" and joint.name not in {
                **robot.position_joints,
                **robot.velocity_joints,
            }
            is_caster = is_free and name not in robot.velocity_joints
            (roles.swivels if is_caster else roles.steering)[joint.name] = None
    _choose_driven(robot, roles, above, report)
    _find_balls(robot, roles, ground, report)
    _stand(robot, roles, ground, report)
    if len(roles.wheels) + len(roles.balls) < 2 or not roles.driven:
        _report_none(robot, report)
        return None
    known = {*roles.wheels, *roles.steering, *roles.swivels}
    _report_dragged(robot, roles, ground, report)
    roles.rigid = [
        joint
        for joint in description.joints.values()
        if joint.type != "fixed" and joint.name not in known and joint.child not in roles.balls
    ]
    return roles


def _is_unsupported(robot: ForeignRobot, report: Report) -> bool:
    """Reports a robot whose wheels or tracks the model does not have."""
    description = robot.description
    names = {link.name: link.span for link in description.links.values()}
    names |= {joint.name: joint.span for joint in description.joints.values()}
    names |= robot.controller_types | {description.name: Span(description.file)}
    names |= {path.name: Span(description.file) for path in robot.mesh_files.values()}
    for what, pattern in _KINDS.items():
        for name, span in names.items():
            if pattern.search(name):
                report.add(
                    "import-no-base",
                    f"`{name.strip()}` suggests {what}, which are not supported yet",
                    span,
                    hint="wheels that roll in one direction, steered or not, can be imported",
                )
                return True
    return False


def _report_none(robot: ForeignRobot, report: Report) -> None:
    report.add(
        "import-no-base",
        f"`{robot.description.file}` has no driven wheels: no round part turns about a horizontal"
        " axis and reaches the ground",
        Span(robot.description.file),
        hint="a wheel is a cylinder, a sphere or a mesh below a `continuous` joint",
    )


# -- round parts --------------------------------------------------------------------------


def _turning_parts(robot: ForeignRobot, report: Report) -> Iterator[tuple[str, Tyre]]:
    """Yields the joints with a horizontal axis that turn a round part without end."""
    description = robot.description
    for joint in description.joints.values():
        turns = joint.type == "continuous" or (
            joint.type == "revolute"
            and (joint.upper or 0.0) - (joint.lower or 0.0) > math.tau - 0.01
        )
        is_driven = joint.type == "revolute" and joint.name in robot.velocity_joints
        if not turns and not is_driven:
            continue
        axis = description.poses[joint.child].rotate(joint.axis)
        bodies = [description.links[n].inertial for n in description.rigid_part(joint.child)]
        has_mass = any(body is not None and body.mass > 0.0 for body in bodies)
        if abs(axis[2]) > _HORIZONTAL or not has_mass:
            continue  # a wheel without mass stands for others, as that of a bicycle model
        tyre = _primitive(robot, joint, report) or _mesh_tyre(robot, joint)
        if tyre is not None:
            yield joint.name, tyre


def _primitive(robot: ForeignRobot, joint: Joint, report: Report) -> Tyre | None:
    tyre = tyre_of(robot.description, joint)
    if joint.name in robot.velocity_joints and (tyre is None or not tyre.collides):
        tyre = _stated_tyre(robot, joint) or tyre
    if tyre is None:
        return None
    shape = tyre.shape
    width = shape.length if isinstance(shape, Cylinder) else 2.0 * shape.radius
    is_round = isinstance(shape, Sphere)
    center = scale(dot(tyre.pose.xyz, joint.axis), joint.axis)
    beside = norm(sub(tyre.pose.xyz, center))
    if beside > _BESIDE:
        text = f"the shape of the wheel at `{joint.name}` is {millimetres(beside)} beside its axis"
        report.add("import-assumed", f"{text}: it is moved to the axis", tyre.span)
    return Tyre(shape.radius, width, center, tyre.span, is_round)


def _stated_tyre(robot: ForeignRobot, joint: Joint) -> RoundShape | None:
    """Returns the largest cylinder about any axis parallel to that of a driven joint."""
    description = robot.description
    cylinders = [
        RoundShape(placed.shape, pose * placed.pose, placed.collides, placed.span)
        for name, pose in description.rigid_part(joint.child).items()
        for placed in description.shapes(description.links[name])
        if isinstance(placed.shape, Cylinder)
    ]
    parallel = [c for c in cylinders if abs(dot(c.pose.rotate(UP), joint.axis)) > _PARALLEL]
    return max(parallel, key=lambda c: (c.collides, c.shape.radius), default=None)


def _mesh_tyre(robot: ForeignRobot, joint: Joint) -> Tyre | None:
    """Returns the cylinder about the axis of a joint around the meshes that the joint turns."""
    description = robot.description
    shapes = [
        (placed, pose)
        for name, pose in description.rigid_part(joint.child).items()
        for placed in description.shapes(description.links[name])
        if isinstance(placed.shape, MeshShape)
    ]
    solid = [entry for entry in shapes if entry[0].collides] or shapes
    radius, low, high = 0.0, math.inf, -math.inf
    for placed, pose in solid:
        for point in _points(robot, placed.shape):
            point = (pose * placed.pose).apply(point)
            along = dot(point, joint.axis)
            radius = max(radius, norm(sub(point, scale(along, joint.axis))))
            low, high = min(low, along), max(high, along)
    if radius < 1e-6 or high - low < 1e-6:
        return None
    stated = [f for f in description.facts if f.kind == "wheel radius" and joint.name in f.names]
    span = solid[0][0].span
    center = scale((low + high) / 2.0, joint.axis)
    for fact in stated:
        # A mesh includes lugs and rims; the radius that rolls is stated.
        if abs(float(fact.value) - radius) < 0.1 * radius:
            return Tyre(float(fact.value), high - low, center, fact.span)
    return Tyre(radius, high - low, center, span, is_mesh=True)


def _points(robot: ForeignRobot, shape: Shape) -> Iterator[Vec3]:
    """Yields points whose hull contains a shape."""
    if isinstance(shape, MeshShape) and shape.mesh in robot.meshes:
        mesh, (sx, sy, sz) = robot.meshes[shape.mesh], shape.scale
        corners = {p for triangle in mesh_triangles(mesh.name, mesh.data) for p in triangle}
        yield from ((sx * x, sy * y, sz * z) for x, y, z in corners)
        return
    if isinstance(shape, Box):
        half = scale(0.5, shape.size)
    elif isinstance(shape, Cylinder):
        half = (shape.radius, shape.radius, shape.length / 2.0)
    elif isinstance(shape, Sphere):
        half = (shape.radius, shape.radius, shape.radius)
    else:
        return
    for x in (-half[0], half[0]):
        for y in (-half[1], half[1]):
            yield from ((x, y, z) for z in (-half[2], half[2]))


def _lowest(robot: ForeignRobot, link: str, tyre: Tyre) -> float:
    """Returns the height of the lowest point of an upright wheel in the frame of the root."""
    return robot.description.poses[link].apply(tyre.center)[2] - tyre.radius


def _lowest_point(robot: ForeignRobot) -> float:
    """Returns the height of the lowest shape in the frame of the root; meshes by their points."""
    description = robot.description
    return min(
        (description.poses[link.name] * placed.pose).apply(point)[2]
        for link in description.links.values()
        for placed in description.shapes(link)
        for point in _points(robot, placed.shape)
    )


# -- joints above a wheel, and balls -------------------------------------------------------


def _moving_joint_above(link: str, above: dict[str, Joint]) -> Joint | None:
    while link in above:
        joint = above[link]
        if joint.type != "fixed":
            return joint
        link = joint.parent
    return None


def _upright(robot: ForeignRobot, joint: Joint) -> bool:
    return abs(robot.description.poses[joint.child].rotate(joint.axis)[2]) > _UPRIGHT


def _choose_driven(
    robot: ForeignRobot, roles: Roles, above: dict[str, Joint], report: Report
) -> None:
    """Chooses the driven wheels: the stated ones, or else all that do not swivel."""
    joints = robot.description.joints
    stated = [name for name in roles.wheels if name in robot.velocity_joints]
    candidates: list[str] = []
    for name, tyre in roles.wheels.items():
        upper = _moving_joint_above(joints[name].parent, above)
        if not tyre.is_round and (upper is None or upper.name not in roles.swivels):
            candidates.append(name)
    roles.driven = dict.fromkeys(stated or candidates)
    if not stated and candidates:
        shown = ", ".join(f"`{name}`" for name in candidates)
        report.add(
            "import-assumed",
            f"no file states which wheels have motors: {shown} are driven",
            joints[candidates[0]].span,
            hint="name the parameter file of the controllers after the description",
        )


def _find_balls(robot: ForeignRobot, roles: Roles, ground: float, report: Report) -> None:
    """Finds ball casters: spheres and parts called casters that reach the ground, and do not roll
    in one direction only."""
    description = robot.description
    for name, tyre in list(roles.wheels.items()):
        if tyre.is_round and name not in roles.driven:
            del roles.wheels[name]
            joint = description.joints[name]
            swivel = _moving_joint_above(
                joint.parent, {j.child: j for j in description.joints.values()}
            )
            if swivel is not None:
                roles.swivels.pop(swivel.name, None)
            roles.balls[joint.child] = tyre
    wheel_links = {
        inner for name in roles.wheels for inner in description.rigid_part(_child(robot, name))
    }
    roots = {*description.links} - {joint.child for joint in description.joints.values()}
    for name, link in description.links.items():
        if name in roots or name in wheel_links or name in roles.balls:
            continue
        for placed in description.shapes(link):
            is_ball = isinstance(placed.shape, Sphere) or re.search(r"(?i)cast[eo]r|ball", name)
            if not is_ball or link.inertial is None or link.inertial.mass <= 0.0:
                continue
            ball = _ball(robot, description.poses[name] * placed.pose, placed.shape, placed.span)
            if ball is None or abs(ball.center[2] - ball.radius - ground) > _NEAR_GROUND:
                continue
            center = description.poses[name].inverse().apply(ball.center)
            roles.balls[name] = ball._replace(center=center)
            if not isinstance(placed.shape, Sphere):
                text = f"`{name}` is no sphere: it is a ball of radius {plain(ball.radius, 4)} m"
                report.add("import-assumed", text, placed.span)
            break


def _stand(robot: ForeignRobot, roles: Roles, ground: float, report: Report) -> None:
    """Makes the sizes that no shape states such that all wheels stand on the ground."""
    links = [(roles.wheels, name, _child(robot, name)) for name in roles.wheels]
    links += [(roles.balls, name, name) for name in roles.balls]
    for tyres, name, link in links:
        tyre = tyres[name]
        gap = _lowest(robot, link, tyre) - ground
        if abs(gap) <= WHEEL_OFF_GROUND:
            continue
        place = f"the wheel at `{name}` ends {millimetres(abs(gap))} " + (
            "above the ground" if gap > 0.0 else "below the other wheels"
        )
        if tyre.is_mesh or tyres is roles.balls:
            radius = tyre.radius + gap
            width = tyre.width if tyre.is_mesh else 2.0 * radius
            tyres[name] = tyre._replace(radius=radius, width=width)
            sizes = f"{plain(radius, 4)} m, not {plain(tyre.radius, 4)} m"
            text = f"{place}: its radius is taken as {sizes}"
            report.add("import-assumed", text, tyre.span)
        else:
            hint = "correct its radius, or the height of its joint"
            report.add("wheel-off-ground", place, tyre.span, hint=hint)


def _report_dragged(robot: ForeignRobot, roles: Roles, ground: float, report: Report) -> None:
    """Reports links that stand on the ground and do not roll."""
    description = robot.description
    rolling = {*roles.balls}
    for name in roles.wheels:
        rolling |= {*description.rigid_part(_child(robot, name))}
    for name, link in description.links.items():
        for placed in description.shapes(link) if name not in rolling else ():
            pose = description.poses[name] * placed.pose
            heights = [pose.apply(point)[2] for point in _points(robot, placed.shape)]
            if placed.collides and heights and min(heights) < ground + WHEEL_OFF_GROUND:
                text = f"link `{name}` reaches the ground and does not roll: the robot drags it"
                report.add("import-assumed", text, placed.span)
                break


def _child(robot: ForeignRobot, joint: str) -> str:
    return robot.description.joints[joint].child


def _ball(robot: ForeignRobot, pose: Pose, shape: Shape, span: Span) -> Tyre | None:
    """Returns the ball in the frame of the root that touches the ground below a shape."""
    if isinstance(shape, Sphere):
        return Tyre(shape.radius, 2.0 * shape.radius, pose.xyz, span, True)
    points = [pose.apply(point) for point in _points(robot, shape)]
    if not points:
        return None
    low, high = (tuple(f(p[k] for p in points) for k in range(3)) for f in (min, max))
    radius = min(b - a for a, b in zip(low, high, strict=True)) / 2.0
    x, y = ((high[k] + low[k]) / 2.0 for k in (0, 1))
    return Tyre(radius, 2.0 * radius, add((x, y, low[2]), (0.0, 0.0, radius)), span, True)
