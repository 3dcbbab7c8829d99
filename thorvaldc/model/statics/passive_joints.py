"""The coordinates of the joints that nothing drives: rockers, suspensions, pendulums.

A joint is passive if no motor and no servo moves it. Couplings reduce the number of coordinates: a
joint with a leader moves with it, q = ratio q_leader + offset, and a chain of couplings ends at a
joint without a leader. The position of that joint is the coordinate of the whole group.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

from thorvaldc.model.robot import Joint, Robot, Wheel
from thorvaldc.model.spatial import cross, norm, sub
from thorvaldc.model.statics.joint_tree import JointTree

_ON_AXIS = 1e-4  # m
_VERTICAL = 1e-6
_OF_EXTRA = "extras."
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
    controllers hold them. With ``sprung`` false, joints with springs are left out too.

    - ``stopped``: names of joints that something holds, such as motors.
    """
    immobile = {
        *stopped,
        *(n for w in wheels for n in (w.spin_joint, w.steering_joint, w.swivel_joint) if n),
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
        if joint.name in immobile or joint.module.startswith(_OF_EXTRA):
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
    return body.mass <= 0.0 or norm(cross(sub(body.com, pose.xyz), axis)) < _ON_AXIS
