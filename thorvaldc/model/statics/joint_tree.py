"""The tree of links and joints: order, parents, link poses, inertia of subtrees, rigid groups and
passive joints.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model import Inertial, Joint, Link, Pose, Robot, Vec3, Wheel, spatial
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.sums import float_sum


class JointTree:
    """The links and joints of a robot as a tree, with the pose of every link in ``base_link``.

    The root of the joint tree is ``links[0]``. The order of the links is depth first, and the child
    links of a link have the order of the model.

    - ``positions``: joint positions in rad or m by joint name, 0 for a joint without a value.
    - ``order``: names of the connected links, depth first, with each parent before its children.
    - ``parent_joint``: maps a link name to the joint above the link.
    - ``children``: maps a link name to the joints below the link.
    - ``pose``: maps a link name to the pose of the link in ``base_link``.
    - ``moving``: the movable joints, depth first. The movable joints have the numbers 1, 2, 3 and
      so on, and the number 0 means the base.
    - ``carrier``: maps a link name to the number of the nearest movable joint above the link. All
      links with the same nearest movable joint move as one rigid body.
    - ``moving_parent``: the nearest movable joint above each movable joint, as a number.
    """

    def __init__(
        self,
        links: Sequence[Link],
        joints: Sequence[Joint],
        positions: Mapping[str, float] | None = None,
    ) -> None:
        self.links = {link.name: link for link in links}
        self.joints = {joint.name: joint for joint in joints}
        self.parent_joint = {joint.child: joint for joint in joints}
        self.children: dict[str, list[Joint]] = {}
        for joint in joints:
            self.children.setdefault(joint.parent, []).append(joint)
        root = links[0].name
        self.order = [root]
        self.pose = {root: Pose()}
        self.carrier = {root: 0}
        self.moving: list[Joint] = []
        self.moving_parent = [0]
        stack = list(reversed(self.children.get(root, ())))
        while stack:
            joint = stack.pop()
            self.order.append(joint.child)
            pose = self.pose[joint.parent] * joint.pose
            position = positions.get(joint.name, 0.0) if positions else 0.0
            if position != 0.0:
                pose = pose * _joint_motion(joint, position)
            self.pose[joint.child] = pose
            carrier = self.carrier[joint.parent]
            if joint.type != "fixed":
                self.moving.append(joint)
                self.moving_parent.append(carrier)
                carrier = len(self.moving)
            self.carrier[joint.child] = carrier
            stack += reversed(self.children.get(joint.child, ()))

    def at(self, positions: Mapping[str, float]) -> JointTree:
        """Return the joint tree of the same robot at other joint positions."""
        return JointTree(list(self.links.values()), list(self.joints.values()), positions)

    def joints_above(self, link: str) -> list[Joint]:
        """Return the joints between a link and the root link, beginning at the link."""
        joints: list[Joint] = []
        while link in self.parent_joint:
            joint = self.parent_joint[link]
            joints.append(joint)
            link = joint.parent
        return joints

    def links_below(self, link: str) -> list[str]:
        """Return the names of a link and all links below it, level by level."""
        names = [link]
        for name in names:
            names.extend(joint.child for joint in self.children.get(name, ()))
        return names

    def inertial(self, names: Sequence[str] | None = None, lift: float = 0.0) -> Inertial:
        """Return the mass and inertia of several links as one body.

        The sum does not include links that are not connected to the root link.

        - ``names``: names of the links, or ``None`` for all links.
        - ``lift``: height in m by which all links are raised in ``base_link``.
        """
        bodies = []
        for name in names if names is not None else self.links:
            inertial = self.links[name].inertial
            if inertial is not None and name in self.pose:
                pose = self.pose[name]
                raised = Pose(spatial.add(pose.xyz, (0.0, 0.0, lift)), pose.quat)
                bodies.append(inertial.transformed(raised))
        return spatial.combine(bodies)


@once_per_model
def tree_of(robot: Robot) -> JointTree:
    """Return the joint tree of a robot with all joints at position 0. Do not change it."""
    return JointTree(robot.links, robot.joints)


def _joint_motion(joint: Joint, position: float) -> Pose:
    """Return the pose of a joint's child link relative to its pose at joint position 0."""
    x, y, z = joint.axis
    if joint.type == "prismatic":
        return Pose((position * x, position * y, position * z))
    return Pose(quat=spatial.quat_from_axis_angle(joint.axis, position))


def lift(joint: Joint, frame: tuple[Vec3, Vec3], x: float, y: float) -> float:
    """Return the lift in m of a point below a joint for a motion of the joint by 1 rad or 1 m.

    It is also the moment (N m) or the force (N) on the joint of an upward force of 1 N at the
    point.

    - ``frame``: origin and axis of the joint.
    - ``x``, ``y``: the point in m, in the frame of ``frame``.
    """
    (ox, oy, _), (ax, ay, az) = frame
    return az if joint.type == "prismatic" else ax * (y - oy) - ay * (x - ox)


def lift_of(tree: JointTree, joint: Joint, x: float, y: float) -> float:
    """Return the ``lift`` of a point in ``base_link``."""
    pose = tree.pose[joint.child]
    return lift(joint, (pose.xyz, pose.rotate(joint.axis)), x, y)


class RigidGroups:
    """The links of a robot in groups that move as one body.

    The group number 0 contains the base link. The group number g > 0 is carried by ``joints[g-1]``.
    The other joints of the robot keep their positions in ``tree``.

    - ``parent``: number of the group that carries each group.
    - ``frames``: origin and axis of the joint above each group, in ``base_link``.
    - ``mass``, ``com``: mass of each group in kg, and its centre of mass in ``base_link`` in m.
    """

    def __init__(self, tree: JointTree, joints: Sequence[Joint]) -> None:
        """Divide the links of a joint tree. ``joints`` has the order of ``tree.moving``."""
        self.joints = list(joints)
        number = {joint.name: g for g, joint in enumerate(joints, 1)}
        self._tree = tree
        self._group_of_carrier = [0] * (len(tree.moving) + 1)
        self.parent = [0] * (len(joints) + 1)
        for j, joint in enumerate(tree.moving, 1):
            parent = self._group_of_carrier[tree.moving_parent[j]]
            self._group_of_carrier[j] = number.get(joint.name, parent)
            if joint.name in number:
                self.parent[number[joint.name]] = parent
        self.frames: list[tuple[Vec3, Vec3]] = [((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
        for joint in joints:
            pose = tree.pose[joint.child]
            self.frames.append((pose.xyz, pose.rotate(joint.axis)))
        mass = [0.0] * len(self.parent)
        moment = [(0.0, 0.0, 0.0)] * len(self.parent)
        for name in tree.order:
            inertial = tree.links[name].inertial
            if inertial is not None:
                g = self.group_of(name)
                x, y, z = tree.pose[name].apply(inertial.com)
                mx, my, mz = moment[g]
                m = inertial.mass
                mass[g] += m
                moment[g] = (mx + m * x, my + m * y, mz + m * z)
        self.mass = mass
        self.com: list[Vec3] = [
            (p[0] / m, p[1] / m, p[2] / m) if m > 0.0 else (0.0, 0.0, 0.0)
            for m, p in zip(mass, moment, strict=True)
        ]
        self.total_mass = float_sum(mass)

    def group_of(self, link: str) -> int:
        """Return the number of the group to which a link belongs."""
        return self._group_of_carrier[self._tree.carrier[link]]

    def path_of(self, group: int) -> list[int]:
        """Return the numbers of the groups from a group up to the base, without the base."""
        path = []
        while group:
            path.append(group)
            group = self.parent[group]
        return path

    def place(
        self, base: Pose, positions: Sequence[float]
    ) -> tuple[list[Pose], list[tuple[Vec3, Vec3]]]:
        """Return the motion of each group, and origin and axis of the joint above it in the world.

        The motion is the transform from the group's place in ``base_link``, with all joints at
        their positions in the tree, to its place in the world.

        - ``base``: pose of ``base_link`` in the world.
        - ``positions``: positions of the joints in rad or m, from those in the tree.
        """
        transforms = [base]
        frames: list[tuple[Vec3, Vec3]] = [(base.xyz, (0.0, 0.0, 1.0))]
        for g in range(1, len(self.parent)):
            parent = transforms[self.parent[g]]
            origin, axis = self.frames[g]
            frames.append((parent.apply(origin), parent.rotate(axis)))
            if self.joints[g - 1].type == "prismatic":
                x, y, z = axis
                d = positions[g - 1]
                transforms.append(Pose(parent.apply((d * x, d * y, d * z)), parent.quat))
            else:
                q = spatial.quat_from_axis_angle(axis, positions[g - 1])
                shift = spatial.sub(origin, spatial.rotate(q, origin))
                transforms.append(
                    Pose(
                        parent.apply(shift),
                        spatial.quat_normalize(spatial.quat_multiply(parent.quat, q)),
                    )
                )
        return transforms, frames


# -- coordinates of the joints that nothing drives: rockers, suspensions, pendulums --------------
#
# A joint is passive if no motor and no servo moves it. Couplings reduce the number of coordinates:
# a joint with a leader moves with it, q = ratio q_leader + offset, and a chain of couplings ends at
# a joint without a leader. The position of that joint is the coordinate of the whole group.

_ON_AXIS = 1e-4  # m
_VERTICAL = 1e-6
SHORTEST_LEVER = 0.05
"""Lever (m) of a wheel about a hinge below which the hinge carries the wheel as a fixed joint."""
_LEANING = 0.05
"""Sine of the angle from the vertical from which an axis counts as that of a hinge."""
OF_EXTRA = "extras."
"""Start of the module name of links and joints of extras, see ``compiler.extras``."""


class Member(NamedTuple):
    """A joint whose position is ``ratio`` times a coordinate plus ``offset`` (rad or m)."""

    joint: Joint
    ratio: float
    offset: float


class Coordinate(NamedTuple):
    """The common position of a passive joint and of the joints that are coupled to it.

    ``members`` begins with the leader, whose ratio is 1 and whose offset is 0.
    """

    members: tuple[Member, ...]

    @property
    def is_sprung(self) -> bool:
        """Whether a spring acts on one of the joints."""
        return any(member.joint.stiffness > 0.0 for member in self.members)

    def limits(self) -> tuple[float, float]:
        """Return the interval of the coordinate in which all joints are within their limits.

        The lower end is above the upper one if there is no such interval.
        """
        low, high = -math.inf, math.inf
        for joint, ratio, offset in self.members:
            ends = []
            for limit, infinite in ((joint.lower, -math.inf), (joint.upper, math.inf)):
                ends.append(((infinite if limit is None else limit) - offset) / ratio)
            low, high = max(low, min(ends)), min(high, max(ends))
        return low, high


def held_joints(robot: Robot) -> frozenset[str]:
    """Return the names of the joints of a robot that motors and servos hold."""
    return frozenset(
        [actuator.joint for actuator in robot.actuators]
        + [servo.joint for servo in robot.joint_servos]
    )


def follow(joint: Joint, joints: dict[str, Joint]) -> Member | None:
    """Return the leader at the end of the couplings of a joint, with ratio and offset to it.

    Returns the joint itself if it has no leader, and ``None`` if its couplings form a cycle, have
    the ratio 0 or name an unknown joint.
    """
    ratio, offset = 1.0, 0.0
    passed = set()
    while joint.mimic is not None:
        passed.add(joint.name)
        leader = joints.get(joint.mimic.joint)
        if leader is None or leader.name in passed or joint.mimic.multiplier == 0.0:
            return None
        offset += ratio * joint.mimic.offset
        ratio *= joint.mimic.multiplier
        joint = leader
    return Member(joint, ratio, offset)


def coupled_joints(joint: Joint, joints: dict[str, Joint]) -> list[Member]:
    """Return a joint and the joints that move with it, with their ratios to its position."""
    own = follow(joint, joints)
    if own is None:
        return [Member(joint, 1.0, 0.0)]
    members = []
    for other in joints.values():
        leader = follow(other, joints)
        if leader is not None and leader.joint.name == own.joint.name:
            members.append(Member(other, leader.ratio / own.ratio, 0.0))
    return members


def coordinates_of(
    tree: JointTree, wheels: Sequence[Wheel], stopped: Collection[str], *, sprung: bool
) -> list[Coordinate]:
    """Return the coordinates of the passive joints of a robot, in the order of its joints.

    The joints about which wheels spin, steer and swivel are left out, and joints whose motion
    neither lifts nor lowers anything. The joints of extras are left out because their own
    controllers hold them, but for ``hinges``. With ``sprung`` false, joints with springs are left
    out too.

    - ``stopped``: names of joints that something holds, such as motors.
    """
    immobile = {
        *stopped,
        *(w.spin_joint for w in wheels if tree.joints[w.spin_joint].type == "continuous"),
        *(n for w in wheels for n in (w.steering_joint, w.swivel_joint) if n),
    }
    free = {
        joint.name
        for wheel in wheels
        for joint in hinges(tree, wheel.link, immobile)
        if abs(lift_of(tree, joint, *wheel.contact_point)) > SHORTEST_LEVER
    }
    groups: dict[str, list[Member]] = {}
    stopped_groups = set()
    for joint in tree.moving:
        leader = follow(joint, tree.joints)
        if leader is None:
            continue
        root, ratio, offset = leader
        groups.setdefault(root.name, [])
        member = Member(joint, ratio, offset)
        if joint is root:
            groups[root.name].insert(0, member)
        else:
            groups[root.name].append(member)
        is_held = joint.module.startswith(OF_EXTRA) and joint.name not in free
        if joint.name in immobile or is_held:
            stopped_groups.add(root.name)
    coordinates = []
    carried = {name for wheel in wheels for name in _joints_above(tree, wheel.link)}
    for name, members in groups.items():
        coordinate = Coordinate(tuple(members))
        if name in stopped_groups or members[0].joint.type == "fixed":
            continue
        if coordinate.is_sprung and not sprung:
            continue
        if all(_is_indifferent(tree, m.joint, m.joint.name in carried) for m in members):
            continue
        coordinates.append(coordinate)
    return coordinates


def hinges(tree: JointTree, link: str, stopped: Collection[str]) -> list[Joint]:
    """Return the joints of extras above a link that turn about another axis than the vertical, such
    as the pitch of a drawbar, from the link to the base.

    The joint about which the link itself rolls is left out.

    - ``stopped``: names of joints that something holds.
    """
    return [
        joint
        for k, joint in enumerate(tree.joints_above(link))
        if joint.module.startswith(OF_EXTRA)
        and joint.type in ("revolute", "continuous")
        and not (k == 0 and joint.type == "continuous")
        and joint.name not in stopped
        and math.hypot(*tree.pose[joint.child].rotate(joint.axis)[:2]) > _LEANING
    ]


def _joints_above(tree: JointTree, link: str) -> list[str]:
    return [joint.name for joint in tree.joints_above(link)]


def _is_indifferent(tree: JointTree, joint: Joint, carries_wheel: bool) -> bool:
    """Return whether the motion of a joint keeps the height of every mass and wheel."""
    pose = tree.pose[joint.child]
    axis = pose.rotate(joint.axis)
    if joint.type == "prismatic":
        return abs(axis[2]) < _VERTICAL and not carries_wheel
    if math.hypot(axis[0], axis[1]) < _VERTICAL:
        return True
    if carries_wheel:
        return False
    body = tree.inertial(tree.links_below(joint.child))
    return (
        body.mass <= 0.0
        or spatial.norm(spatial.cross(spatial.sub(body.com, pose.xyz), axis)) < _ON_AXIS
    )
