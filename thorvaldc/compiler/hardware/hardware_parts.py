"""Data classes for the hardware of a module: links, joints, motors, wheel, sensor and battery.

All physical quantities are in SI units.  Links, joints and motors have the names that the module
document contains.  The class ``RobotParts`` adds the name of the module instance as a prefix.
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.diagnostics import Span
from thorvaldc.model.module import NOT_STATED, Purchase
from thorvaldc.model.robot import Brake, Collision, Mesh, Scalar, SourcedMass, Tread, Visual
from thorvaldc.model.spatial import Inertial, Pose, Vec3


class LinkPart(NamedTuple):
    """A link (rigid body) of a module.

    ``inertial`` is ``None`` for a link without mass.  ``masses`` are the masses of its parts.
    """

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    masses: tuple[SourcedMass, ...]
    span: Span


class JointPart(NamedTuple):
    """A joint between two links of a module.

    ``axis`` is the axis of the joint, as a unit vector in the joint frame.  ``damping`` is the
    damping of the joint plus the damping of the spring.  ``stiffness`` is the stiffness of the
    spring, or 0 without a spring.
    """

    name: str
    type: str
    role: str
    parent: str
    child: str
    pose: Pose
    axis: Vec3
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    damping: float
    friction: float
    stiffness: float
    span: Span


class MotorPart(NamedTuple):
    """A motor of a module, with the gear between motor and joint.

    ``motor_max_speed`` is the maximum speed of the motor shaft (rad/s).  ``max_velocity`` (rad/s),
    ``max_acceleration`` (rad/s^2) and ``max_torque`` (N m) are the limits of the motor at the
    joint, behind the gear.  ``armature`` is the inertia of the rotor as seen at the joint (kg m^2).
    ``back_driving_torque`` (N m) is at the joint, too.
    """

    name: str
    joint: str
    role: str
    gear_ratio: float
    encoder_ppr: int
    motor_max_speed: float
    max_velocity: float
    max_acceleration: float
    max_torque: float
    armature: float
    back_driving_torque: float
    brake: Brake | None
    span: Span


class WheelPart(NamedTuple):
    """A wheel.

    ``radii`` contains the additional radii (m) of a double wheel, by name.  The tyres of a double
    wheel have different radii and roll on different surfaces.
    """

    link: str
    radius: float
    width: float
    radii: tuple[tuple[str, float], ...]
    friction: float
    rolling_resistance: float
    treads: tuple[Tread, ...]
    span: Span


class SensorPart(NamedTuple):
    """A sensor of a module with its type, link and properties."""

    type: str
    link: str
    properties: tuple[tuple[str, Scalar], ...]


class BatteryPart(NamedTuple):
    """A battery enclosure.  ``present`` is false if the battery enclosure is empty."""

    present: bool
    link: str
    properties: tuple[tuple[str, Scalar], ...]


class Hardware(NamedTuple):
    """Links, joints, motors and devices of a module for given parameter values.

    ``mount_pose`` is the pose in the first link's frame where the module is mounted.
    """

    links: tuple[LinkPart, ...]
    joints: tuple[JointPart, ...]
    motors: tuple[MotorPart, ...]
    wheel: WheelPart | None
    sensor: SensorPart | None
    battery: BatteryPart | None
    mount_pose: Pose
    meshes: tuple[Mesh, ...]
    height_above_ground: float | None
    purchase: Purchase = NOT_STATED
