"""Sets the friction and rolling resistance of each wheel for ground zones and ice."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.model import Robot, Zone
from thorvaldc.model.scenario import WheelFault
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


class GroundZones:
    """Sets the friction and rolling resistance of each wheel from the zone under the wheel.

    The ground zone under the centre of a wheel determines the friction and the rolling resistance
    of the wheel.  If ground zones overlap, the last ground zone in the YAML file applies.  An
    active ``ice`` fault of a wheel overrides the friction of the zone.
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
        """Sets the coefficients of all wheels for the current positions of the wheels.

        The ``ice`` faults that are active at the time ``now`` (s) apply.
        """
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
        """Restores the original friction and rolling resistance of all wheels."""
        for wheel in self._wheels:
            wheel.apply(None, None)


class _Rectangle:
    """The rectangle on the ground that a ground zone covers.

    The sine and cosine of the yaw angle of the ground zone are computed only once.
    """

    def __init__(self, zone: Zone) -> None:
        self.zone = zone
        self._x, self._y, _ = zone.pose.xyz
        yaw = zone.pose.rpy()[2]
        self._cos, self._sin = math.cos(yaw), math.sin(yaw)
        self._half_x, self._half_y = (edge / 2 for edge in zone.size)

    def contains(self, x: float, y: float) -> bool:
        """Returns true if the point (``x``, ``y``) in m is inside the ground zone."""
        dx, dy = x - self._x, y - self._y
        return (
            abs(self._cos * dx + self._sin * dy) <= self._half_x
            and abs(self._cos * dy - self._sin * dx) <= self._half_y
        )


class _WheelGround:
    """The entries of the MuJoCo model that describe the contact of one wheel with the ground.

    Rolling resistance is modelled as a friction loss (N m) of the spin joint.  The friction loss
    is the coefficient of rolling resistance times the wheel load at rest (N) times the wheel
    radius (m).
    """

    def __init__(self, robot: Robot, scene: MujocoScene, number: int) -> None:
        wheel = robot.wheels[number]
        joint = scene.index("joint", robot.prefix + wheel.spin_joint, robot)
        model = scene.model
        # The body of the wheel is found by the spin joint, because MuJoCo may have fused the wheel
        # link into another body.
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
        """Returns the position (x, y) in m of the wheel at the last simulation step."""
        x, y, _ = self._data.xpos[self._body].tolist()
        return x, y

    def apply(self, friction: float | None, resistance: float | None) -> None:
        """Sets the coefficients of friction and rolling resistance of the wheel.

        If a coefficient is ``None``, the original coefficient of the wheel applies.
        """
        if (friction, resistance) == self._applied:
            return
        self._applied = (friction, resistance)
        for geom, own in zip(self._geoms, self._own_frictions, strict=True):
            # The coefficient of torsional friction (m) is mu * width / 4, with the coefficient of
            # sliding friction mu and the wheel width.  The torsional friction is thus proportional
            # to the coefficient of sliding friction mu.
            ratio = 1.0 if friction is None else friction / own[0] if own[0] else 0.0
            self._model.geom_friction[geom, :2] = own[:2] * ratio
        added = 0.0 if resistance is None else resistance - self._own_resistance
        loss = self._own_loss + added * self._load_radius
        self._model.dof_frictionloss[self._dof] = max(loss, 0.0)
