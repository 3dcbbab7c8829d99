"""A robot as rigid groups of links, connected by some of its joints."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.robot import Joint
from thorvaldc.model.spatial import (
    Pose,
    Vec3,
    quat_from_axis_angle,
    quat_multiply,
    quat_normalize,
    rotate,
    sub,
)
from thorvaldc.model.statics.joint_tree import JointTree


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
                q = quat_from_axis_angle(axis, positions[g - 1])
                shift = sub(origin, rotate(q, origin))
                transforms.append(
                    Pose(parent.apply(shift), quat_normalize(quat_multiply(parent.quat, q)))
                )
        return transforms, frames

    @staticmethod
    def lift(joint: Joint, frame: tuple[Vec3, Vec3], x: float, y: float) -> float:
        """Return how far a joint lifts a point that it carries, per rad or m.

        - ``frame``: origin and axis of the joint in the world.
        - ``x``, ``y``: the point in the world in m.
        """
        (ox, oy, _), (ax, ay, az) = frame
        return az if joint.type == "prismatic" else ax * (y - oy) - ay * (x - ox)
