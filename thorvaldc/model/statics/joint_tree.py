"""The joint tree of a robot, walked once: order, parents, rigid lumps, link poses."""

from __future__ import annotations

from collections.abc import Mapping

from thorvaldc.model import Joint, Pose, Robot
from thorvaldc.model.spatial import quat_from_axis_angle


class Tree:
    """Links by index in ``robot.links``, depth first from ``links[0]``.

    ``order`` lists the links, parents first, children in model order; ``above`` has
    the joint over each link (``None`` for the root) and ``child`` the link under
    each joint by its name.  ``moving`` lists the movable joints in that order,
    counted from 1; ``lump`` tells which of them carries a link (0: the base) and
    ``moving_parent`` which of them carries another.  ``poses`` are the links'
    poses in ``base_link`` at the given joint positions (rad or m).
    """

    def __init__(self, robot: Robot, positions: Mapping[str, float] | None = None) -> None:
        self.robot = robot
        links = robot.links
        self.index = {link.name: i for i, link in enumerate(links)}
        self.joint = {joint.name: joint for joint in robot.joints}
        below: dict[str, list[Joint]] = {}
        for joint in robot.joints:
            below.setdefault(joint.parent, []).append(joint)
        self.child = {joint.name: self.index[joint.child] for joint in robot.joints}
        self.order: list[int] = [0]
        self.above: list[Joint | None] = [None] * len(links)
        self.lump = [0] * len(links)
        self.moving: list[Joint] = []
        self.moving_parent = [0]
        todo = list(reversed(below.get(links[0].name, ())))
        while todo:
            joint = todo.pop()
            i = self.child[joint.name]
            self.order.append(i)
            self.above[i] = joint
            lump = self.lump[self.index[joint.parent]]
            if joint.type != "fixed":
                self.moving.append(joint)
                self.moving_parent.append(lump)
                lump = len(self.moving)
            self.lump[i] = lump
            todo += reversed(below.get(joint.child, ()))
        self.poses = self._poses(positions or {})

    def _poses(self, positions: Mapping[str, float]) -> list[Pose]:
        poses = [Pose()] * len(self.robot.links)
        for i in self.order[1:]:
            joint = self.above[i]
            if joint is None:
                continue
            pose = poses[self.index[joint.parent]] * joint.pose
            q = positions.get(joint.name, 0.0)
            if q != 0.0:
                pose = pose * joint_motion(joint, q)
            poses[i] = pose
        return poses

    def at(self, positions: Mapping[str, float]) -> Tree:
        """The same tree with poses at other joint positions; absent ones are 0."""
        return Tree(self.robot, positions) if positions else self


def joint_motion(joint: Joint, position: float) -> Pose:
    """Pose of the child relative to its place at position 0, in the child's frame."""
    x, y, z = joint.axis
    if joint.type == "prismatic":
        return Pose((position * x, position * y, position * z))
    return Pose(quat=quat_from_axis_angle(joint.axis, position))
