"""The tree of links and joints: order, parents, link poses and inertia of subtrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Joint, Link, Robot
from thorvaldc.model.spatial import Inertial, Pose, add, combine, quat_from_axis_angle


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
                raised = Pose(add(pose.xyz, (0.0, 0.0, lift)), pose.quat)
                bodies.append(inertial.transformed(raised))
        return combine(bodies)


@once_per_model
def tree_of(robot: Robot) -> JointTree:
    """Return the joint tree of a robot with all joints at position 0. Do not change it."""
    return JointTree(robot.links, robot.joints)


def _joint_motion(joint: Joint, position: float) -> Pose:
    """Return the pose of a joint's child link relative to its pose at joint position 0."""
    x, y, z = joint.axis
    if joint.type == "prismatic":
        return Pose((position * x, position * y, position * z))
    return Pose(quat=quat_from_axis_angle(joint.axis, position))
