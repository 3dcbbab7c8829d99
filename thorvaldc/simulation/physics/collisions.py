"""What touches what in a scene: collisions, and not wheels on the ground."""

from __future__ import annotations

from collections.abc import Mapping

from thorvaldc.model import Robot
from thorvaldc.simulation.physics.mujoco_base import MujocoScene

DRIVABLE = ("ground", "rail", "kerb")
"""Kinds of things that wheels may roll on."""


class Contacts:
    """Counts how often each robot comes to touch what it must not.

    That is anything but ground, rails and kerbs with a wheel, and these with another part.
    Parts that stay in touch count once.
    """

    def __init__(self, scene: MujocoScene, robots: Mapping[str, Robot]) -> None:
        import mujoco

        self._scene = scene
        model = scene.model
        self.collisions = dict.fromkeys(robots, 0)
        owner: dict[int, str] = {}
        wheels: set[int] = set()
        for name, robot in robots.items():
            prefix = robot.prefix
            owner[scene.index("body", prefix + robot.links[0].name, robot)] = name
            # A wheel is what its joint turns; its own link may be welded to that.
            joints = (scene.index("joint", prefix + w.spin_joint, robot) for w in robot.wheels)
            wheels |= {int(model.jnt_bodyid[joint]) for joint in joints}
        # By geom: whose it is (empty: the world's), and whether it may touch the other kind.
        self._owner: list[str] = []
        self._rolls: list[bool] = []
        self._drivable: list[bool] = []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or ""
            self._owner.append(owner.get(int(model.body_rootid[body]), ""))
            self._rolls.append(body in wheels)
            self._drivable.append(body == 0 and name.split("/")[0] in DRIVABLE)
        self._touching: frozenset[tuple[int, int]] = frozenset()
        self._step = -1

    def look(self) -> None:
        """Count what touches now and did not at the last look."""
        if self._scene.steps == self._step:
            return
        self._step = self._scene.steps
        found = frozenset(
            (a, b)
            for a, b in self._scene.data.contact.geom.tolist()
            if not (
                (self._rolls[a] and self._drivable[b]) or (self._rolls[b] and self._drivable[a])
            )
        )
        for a, b in found - self._touching:
            for name in {self._owner[a], self._owner[b]}:
                if name:
                    self.collisions[name] += 1
        self._touching = found


class Rings:
    """On which of their rings wheels roll: on the tyre, or beside it on a rail."""

    def __init__(self, robot: Robot, scene: MujocoScene) -> None:
        prefix = robot.prefix
        self._scene = scene
        self._tyres = [wheel.radius for wheel in robot.wheels]
        # (geom, wheel, radius) of the rings beside the tyres.
        self._rings = [
            (
                scene.index("geom", f"{prefix}{wheel.link}_{tread.name}", robot),
                i,
                wheel.radius_named(tread.name),
            )
            for i, wheel in enumerate(robot.wheels)
            for tread in wheel.treads
        ]

    def radii(self) -> list[float]:
        """Radius (m) of what each wheel rolls on now; of one in the air, of its tyre."""
        touching = set(self._scene.data.contact.geom.ravel().tolist())
        found = list(self._tyres)
        for geom, wheel, radius in self._rings:
            if geom in touching:
                found[wheel] = radius
        return found
