"""The tree of links and joints: order, parents, link poses, inertia of subtrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thorvaldc.model.robot import Joint, Link
from thorvaldc.model.spatial import Inertial, Pose, add, combine, quat_from_axis_angle


class JointTree:
    """Links and joints below ``links[0]``, with the pose of every link in ``base_link``.

    ``order`` lists the names of the connected links depth first, parents first, children in model
    order.  ``parent_joint`` maps a link to the joint above it, ``children`` a link to
    the joints below it.  ``pose`` maps a link to its pose at the given joint
    ``positions`` (rad or m; a joint that is not named is at 0).

    ``moving`` lists the movable joints in depth-first order; they are counted from 1, and
    0 is the base.  ``carrier`` maps a link to the number of the nearest movable joint
    above it: links with the same carrier move as one rigid body.  ``moving_parent[j]``
    is the carrier of movable joint ``j`` itself.
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
        """Return the tree of the same links and joints at other joint positions."""
        return JointTree(list(self.links.values()), list(self.joints.values()), positions)

    def joints_above(self, link: str) -> list[Joint]:
        """Return the joints from a link up to the root, nearest first."""
        joints: list[Joint] = []
        while link in self.parent_joint:
            joint = self.parent_joint[link]
            joints.append(joint)
            link = joint.parent
        return joints

    def links_below(self, link: str) -> list[str]:
        """Return a link and all its descendants, level by level."""
        names = [link]
        for name in names:
            names.extend(joint.child for joint in self.children.get(name, ()))
        return names

    def inertial(self, names: Sequence[str] | None = None, lift: float = 0.0) -> Inertial:
        """Return the inertia of links as one body, in ``base_link`` raised by ``lift`` m.

        ``names`` are the links (default: all).  Links that are not connected to the root do
        not count.
        """
        bodies = []
        for name in names if names is not None else self.links:
            inertial = self.links[name].inertial
            if inertial is not None and name in self.pose:
                pose = self.pose[name]
                raised = Pose(add(pose.xyz, (0.0, 0.0, lift)), pose.quat)
                bodies.append(inertial.transformed(raised))
        return combine(bodies)


def _joint_motion(joint: Joint, position: float) -> Pose:
    """Return the pose of the child link relative to its pose at joint position 0."""
    x, y, z = joint.axis
    if joint.type == "prismatic":
        return Pose((position * x, position * y, position * z))
    return Pose(quat=quat_from_axis_angle(joint.axis, position))
