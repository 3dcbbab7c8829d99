"""Finds the current rolling radius of wheels with several treads.

A wheel with several treads rolls on the tyre on the ground, and on a ring on a rail.
"""

from __future__ import annotations

from thorvaldc.model import Robot
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


class RollingRadii:
    """Finds the tread on which each wheel of a robot rolls.

    The contacts in the MuJoCo scene determine the tread on which a wheel rolls.
    """

    def __init__(self, robot: Robot, scene: MujocoScene) -> None:
        prefix = robot.prefix
        self._scene = scene
        self._tyres = [wheel.radius for wheel in robot.wheels]
        # (geom, wheel, radius in m) of the treads beside the tyres.
        self._treads = [
            (
                scene.index("geom", f"{prefix}{wheel.link}_{tread.name}", robot),
                i,
                wheel.radius_named(tread.name),
            )
            for i, wheel in enumerate(robot.wheels)
            for tread in wheel.treads
        ]

    def current(self) -> list[float]:
        """Returns the current rolling radius (m) of each wheel.

        The rolling radius of a wheel in the air is the radius of the tyre.
        """
        touching = set(self._scene.data.contact.geom.ravel().tolist())
        radii = list(self._tyres)
        for geom, wheel, radius in self._treads:
            if geom in touching:
                radii[wheel] = radius
        return radii
