"""The parts of a module with given parameter values: links, joints, motors, wheel, sensor.

All values are in SI.  Names are those of the module document; ``RobotParts`` adds the prefix of
the instance.
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.diagnostics import Span
from thorvaldc.model.robot import Collision, Mesh, Scalar, Tread, Visual
from thorvaldc.model.spatial import Inertial, Pose, Vec3


class LinkPart(NamedTuple):
    """A link of a module; ``inertial`` is ``None`` if it has no mass."""

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    span: Span


class JointPart(NamedTuple):
    """A joint of a module; ``axis`` is a unit vector in the joint's frame.

    ``damping`` is the sum of the joint's own and its spring's; ``stiffness`` is 0 without spring.
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
    """A motor with its gear.

    ``motor_max_speed`` (rad/s) is the speed of the motor; the other limits apply at the joint.
    ``armature`` is the rotor's inertia at the joint, kg m^2.
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
    span: Span


class WheelPart(NamedTuple):
    """A wheel; ``radii`` are further radii by name, for tyres that roll on other surfaces."""

    link: str
    radius: float
    width: float
    radii: tuple[tuple[str, float], ...]
    friction: float
    rolling_resistance: float
    treads: tuple[Tread, ...]
    span: Span


class SensorPart(NamedTuple):
    type: str
    link: str
    properties: tuple[tuple[str, Scalar], ...]


class BatteryPart(NamedTuple):
    present: bool
    link: str
    properties: tuple[tuple[str, Scalar], ...]


class Hardware(NamedTuple):
    """A module with the values of its parameters.

    ``mount_pose`` is the pose of the mount in the first link.
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
