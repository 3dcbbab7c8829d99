"""Friction and rolling resistance under each wheel: ground zones, and wheels on ice."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.model import Robot, Zone
from thorvaldc.model.scenario import WheelFault
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


class GroundZones:
    """Sets the coefficients of each wheel by the zone under its centre.

    If zones overlap, the last one counts; an active ``ice`` fault of the wheel overrides its
    friction.  ``restore`` gives all wheels their own coefficients again.
    """

    def __init__(
        self, robot: Robot, scene: MujocoScene, zones: Sequence[Zone], ice: Sequence[WheelFault]
    ) -> None:
        self._zones = [
            _Rectangle(zone)
            for zone in zones
            if not (zone.friction is zone.rolling_resistance is None)
        ]
        self._ice = ice
        self._wheels: list[_WheelGround] = []
        if self._zones or ice:
            self._wheels = [_WheelGround(robot, scene, i) for i in range(len(robot.wheels))]

    def update(self, now: float) -> None:
        """Applies the coefficients at the wheels' positions and at the time ``now`` (s)."""
        for wheel in self._wheels:
            friction = resistance = None
            if self._zones:
                x, y = wheel.position()
                for rectangle in self._zones:
                    if rectangle.contains(x, y):
                        friction = rectangle.zone.friction
                        resistance = rectangle.zone.rolling_resistance
            for fault in self._ice:
                if fault.wheel == wheel.name and fault.start <= now < fault.end:
                    friction = fault.value
            wheel.apply(friction, resistance)

    def restore(self) -> None:
        """Gives all wheels their own coefficients again."""
        for wheel in self._wheels:
            wheel.apply(None, None)


class _Rectangle:
    """The rectangle of a zone with its sine and cosine computed once."""

    def __init__(self, zone: Zone) -> None:
        self.zone = zone
        self._x, self._y, _ = zone.pose.xyz
        yaw = zone.pose.rpy()[2]
        self._cos, self._sin = math.cos(yaw), math.sin(yaw)
        self._half_x, self._half_y = (edge / 2 for edge in zone.size)

    def contains(self, x: float, y: float) -> bool:
        """Reports if a point of the ground (m) is in the zone."""
        dx, dy = x - self._x, y - self._y
        return (
            abs(self._cos * dx + self._sin * dy) <= self._half_x
            and abs(self._cos * dy - self._sin * dx) <= self._half_y
        )


class _WheelGround:
    """The entries of MuJoCo's model that describe the contact of one wheel with the ground.

    Rolling resistance is a friction loss (N m) of the wheel's joint: coefficient * load at
    rest * radius.
    """

    def __init__(self, robot: Robot, scene: MujocoScene, number: int) -> None:
        wheel = robot.wheels[number]
        joint = scene.index("joint", robot.prefix + wheel.spin_joint, robot)
        model = scene.model
        # The body that the joint turns: MuJoCo may have fused the wheel's own link into it.
        self._body = int(model.jnt_bodyid[joint])
        self._dof = int(model.jnt_dofadr[joint])
        first = int(model.body_geomadr[self._body])
        self._geoms = [
            geom
            for geom in range(first, first + int(model.body_geomnum[self._body]))
            if int(model.geom_contype[geom]) or int(model.geom_conaffinity[geom])
        ]
        self.name = wheel.name
        self._data, self._model = scene.data, model
        self._own_frictions = [model.geom_friction[geom].copy() for geom in self._geoms]
        self._own_loss = float(model.dof_frictionloss[self._dof])
        self._load_radius = wheel.load * wheel.radius
        self._own_resistance = wheel.rolling_resistance
        self._applied: tuple[float | None, float | None] = (None, None)

    def position(self) -> tuple[float, float]:
        """Returns the position (m) of the wheel at the last step."""
        x, y, _ = self._data.xpos[self._body].tolist()
        return x, y

    def apply(self, friction: float | None, resistance: float | None) -> None:
        """Sets the coefficients; ``None`` means the wheel's own one."""
        if (friction, resistance) == self._applied:
            return
        self._applied = (friction, resistance)
        for geom, own in zip(self._geoms, self._own_frictions, strict=True):
            # Torsional friction (m) is proportional to sliding friction (mu * width / 4).
            ratio = 1.0 if friction is None else friction / own[0] if own[0] else 0.0
            self._model.geom_friction[geom, :2] = own[:2] * ratio
        added = 0.0 if resistance is None else resistance - self._own_resistance
        loss = self._own_loss + added * self._load_radius
        self._model.dof_frictionloss[self._dof] = max(loss, 0.0)
