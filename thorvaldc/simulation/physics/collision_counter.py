"""Counts the collisions of the robots in a MuJoCo scene."""

from __future__ import annotations

from collections.abc import Mapping

from thorvaldc.model import Robot
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

DRIVABLE = ("ground", "rail", "kerb")
"""First parts of the names of the geoms on which wheels may roll."""


class CollisionCounter:
    """Counts the collisions of each robot.

    ``collisions`` maps each robot name to the number of collisions.  A wheel may touch the ground,
    rails and kerbs.  Every other contact of a robot counts as a collision.  For example, a contact
    of the chassis with the ground is a collision.  A contact that lasts for several simulation
    steps counts as one collision.
    """

    def __init__(self, scene: MujocoScene, robots: Mapping[str, Robot]) -> None:
        import mujoco  # late: the user of the module chooses the OpenGL backend before

        self._scene = scene
        model = scene.model
        self.collisions = dict.fromkeys(robots, 0)
        owners: dict[int, str] = {}
        wheel_bodies: set[int] = set()
        for name, robot in robots.items():
            prefix = robot.prefix
            owners[scene.index("body", prefix + robot.links[0].name, robot)] = name
            # The body of a wheel is found by the spin joint, because MuJoCo may have fused the
            # wheel link into another body.
            joints = (scene.index("joint", prefix + w.spin_joint, robot) for w in robot.wheels)
            wheel_bodies |= {int(model.jnt_bodyid[joint]) for joint in joints}
        # Lists with one item for each geom of the MuJoCo scene.  ``_owner`` is the name of the
        # robot with the geom, or an empty text for a geom of the world.
        self._owner: list[str] = []
        self._is_wheel: list[bool] = []
        self._is_drivable: list[bool] = []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or ""
            self._owner.append(owners.get(int(model.body_rootid[body]), ""))
            self._is_wheel.append(body in wheel_bodies)
            self._is_drivable.append(body == 0 and name.split("/")[0] in DRIVABLE)
        self._pairs: list[list[int]] = []
        self._contacts: frozenset[tuple[int, int]] = frozenset()
        self._step = -1

    def update(self) -> None:
        """Counts the collisions that began since the last call of ``update``."""
        if self._scene.steps == self._step:
            return
        self._step = self._scene.steps
        pairs = self._scene.data.contact.geom.tolist()
        if pairs == self._pairs:
            return
        self._pairs = pairs
        contacts = frozenset(
            (a, b)
            for a, b in pairs
            if not (
                (self._is_wheel[a] and self._is_drivable[b])
                or (self._is_wheel[b] and self._is_drivable[a])
            )
        )
        for a, b in contacts - self._contacts:
            for name in {self._owner[a], self._owner[b]}:
                if name:
                    self.collisions[name] += 1
        self._contacts = contacts
