"""The intermediate model of a robot: frozen dataclasses, all values in SI.

The compiler builds it; backends and the runtime read it.  ``span`` is the position in the source
file from which an element comes.  Lists are in model order: the order of the modules in
the file, depth first.  All outputs keep this order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model.bus import Bus, Channel, FrameDefinition, Node, ObjectValue, Scalar, Signal
from thorvaldc.model.element import Element
from thorvaldc.model.spatial import Inertial, Pose, Vec3

# The classes of the bus are in bus.py; they are a part of the model, so they are exported here too.
__all__ = [
    "Actuator",
    "Battery",
    "Box",
    "Bus",
    "CalculatorChoice",
    "Channel",
    "Collision",
    "Cylinder",
    "DriverSettings",
    "FrameDefinition",
    "Joint",
    "Link",
    "Mesh",
    "MeshShape",
    "Mimic",
    "Node",
    "ObjectValue",
    "ParameterSet",
    "Robot",
    "Scalar",
    "Sensor",
    "Shape",
    "Signal",
    "Sphere",
    "Tread",
    "TwistInput",
    "Visual",
    "Wheel",
]


# -- geometry -----------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Box(Element):
    """A box, centred on the frame; ``size`` has the full edge lengths along x, y, z in m."""

    size: Vec3


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Cylinder(Element):
    """A cylinder along z, centred on the frame; radius and full length in m."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sphere(Element):
    """A sphere, centred on the frame; radius in m."""

    radius: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeshShape(Element):
    """A mesh of ``Robot.meshes`` by its name; ``scale`` has a factor for each axis."""

    mesh: str
    scale: Vec3 = (1.0, 1.0, 1.0)


Shape = Box | Cylinder | Sphere | MeshShape


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mesh(Element):
    """A mesh file of a build; ``name`` is its file name there.

    It is an STL or an OBJ file: URDF readers and MuJoCo both read these.  The compiler converts
    other formats.  The JSON form omits ``data``.
    """

    name: str
    sha256: str
    data: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Visual(Element):
    """A visual shape; ``pose`` is in the link frame, ``color`` is RGBA in 0..1."""

    shape: Shape
    pose: Pose
    color: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Collision(Element):
    """A collision shape; ``pose`` is in the link frame."""

    shape: Shape
    pose: Pose


# -- links and joints -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Link(Element):
    """A rigid body.  ``inertial`` is in the link frame; ``None``: massless.

    ``module`` is the path of its module instance, such as ``fl.steering``.
    """

    name: str
    module: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mimic(Element):
    """A joint that follows another one: q = multiplier * q_joint + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Joint(Element):
    """A joint; ``pose`` is that of the child link in the parent link at joint position 0.

    ``type`` is ``fixed``, ``revolute`` (limited), ``continuous`` or ``prismatic``; ``axis`` is a
    unit vector in the child link frame.  ``lower`` and ``upper`` are the position limits in rad or
    m (``None``: no limit), ``effort`` the largest torque or force in N m or N, ``velocity`` the
    largest speed in rad/s or m/s.  ``stiffness`` (N m/rad or N/m) and ``spring_reference`` (the
    joint position at which the spring is relaxed) describe a spring.  ``damping`` (viscous, N m
    s/rad or N s/m) and ``friction`` (Coulomb, N m or N) are the losses.  ``armature`` is the
    inertia of the motor at the joint (kg m^2).  ``role`` is ``steering``, ``propulsion``,
    ``suspension``, ``swivel``, ``wheel`` (without a motor) or empty.
    """

    name: str
    module: str
    type: str
    parent: str
    child: str
    pose: Pose
    span: Span
    axis: Vec3 = (0.0, 0.0, 1.0)
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    spring_reference: float = 0.0
    armature: float = 0.0
    mimic: Mimic | None = None
    role: str = ""


# -- wheels and devices -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tread(Element):
    """A ring of a wheel beside its tyre, which rolls on rails.

    ``name`` is the name of its radius in ``Wheel.radii``.  ``center`` (m) is its centre in the
    wheel's link frame, ``width`` (m) the distance between its flanges, ``flange`` (m) their height
    (0: no flanges).
    """

    name: str
    center: Vec3
    width: float
    flange: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wheel(Element):
    """A wheel and its geometry in ``base_link``, with every joint at 0.

    ``x``, ``y`` (m): the intersection of the steering (or swivel) axis with the ground; for a
    wheel without such an axis, its contact point.  ``heading`` (rad): the rolling direction for a
    positive joint speed at steering angle 0; at steering angle q it is ``heading + steering_sign *
    q``.  ``trail`` and ``lateral_offset`` (m): the contact point relative to (``x``, ``y``), along
    the rolling direction and to the left of it.  ``radius`` and ``width`` in m; ``radii`` has
    named alternatives (``floor``, ``rail``), ``treads`` the rings for them.  ``friction`` is the
    coefficient of friction, ``rolling_resistance`` that of rolling resistance.  ``load`` (N) is
    the static wheel load.  ``contact_height`` (m) is the height of the wheel's lowest point above
    the ground (0 if it stands on the ground).
    """

    name: str
    module: str
    link: str
    spin_joint: str
    steering_joint: str | None
    swivel_joint: str | None
    suspension_joint: str | None
    driven: bool
    x: float
    y: float
    heading: float
    steering_sign: float
    trail: float
    lateral_offset: float
    radius: float
    width: float
    radii: tuple[tuple[str, float], ...]
    friction: float
    rolling_resistance: float
    load: float
    contact_height: float
    span: Span
    treads: tuple[Tread, ...] = ()

    @property
    def steered(self) -> bool:
        return self.steering_joint is not None

    def radius_named(self, name: str | None) -> float:
        """Return the radius (m) of this name in ``radii``.

        Returns ``radius`` for ``None`` and for a name that this wheel does not have.
        """
        return dict(self.radii).get(name, self.radius) if name else self.radius


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Actuator(Element):
    """A motor with its gear on a joint; the limits are those at the joint.

    ``role`` is ``propulsion`` (speed control) or ``steering`` (position control).
    ``max_velocity`` in rad/s, ``max_acceleration`` in rad/s^2, ``max_torque`` in N m, ``armature``
    in kg m^2 (rotor inertia times the square of the gear ratio).  ``motor_max_speed`` (rad/s) and
    ``encoder_ppr`` (pulses per revolution, four counts each) are at the motor shaft.  ``node`` and
    ``channel`` name the motor controller and its channel, or are ``None``.  ``encoder_offset``
    (rad, at the joint) comes from the calibration of a steering motor: joint position = encoder
    reading + offset.
    """

    name: str
    module: str
    joint: str
    role: str
    gear_ratio: float
    motor_max_speed: float
    encoder_ppr: int
    max_velocity: float
    max_acceleration: float
    max_torque: float
    armature: float
    node: str | None
    channel: str | None
    span: Span
    encoder_offset: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sensor(Element):
    """A sensor; ``link`` is its measurement frame, ``properties`` are in SI.

    ``type`` is ``lidar_2d``, ``gnss``, ``imu``, ``camera`` or another word of the module type.
    """

    name: str
    module: str
    type: str
    link: str
    properties: tuple[tuple[str, Scalar], ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Battery(Element):
    """A battery enclosure; ``node`` is its battery on the bus, ``None`` if it is empty."""

    name: str
    module: str
    link: str
    node: str | None
    properties: tuple[tuple[str, Scalar], ...]
    span: Span


# -- settings and the robot ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CalculatorChoice(Element):
    """The name of the base calculator (a plug-in) and its options."""

    name: str = "general"
    options: tuple[tuple[str, Scalar], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriverSettings(Element):
    """Settings of the base driver.

    ``rate`` (Hz) is that of the control loop; ``command_timeout`` in s.  The limits of the twist
    come from the robot file, or from the limits of the modules: m/s, rad/s, m/s^2, rad/s^2.
    ``noise`` has the standard deviations for the odometry that the robot file sets, in SI, by the
    names of the fields of the runtime's ``Noise``.
    """

    rate: float
    command_timeout: float
    max_linear_velocity: float
    max_angular_velocity: float
    max_linear_acceleration: float
    max_angular_acceleration: float
    noise: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ParameterSet(Element):
    """A named set of parameters that the driver can select while the robot drives.

    ``radii`` is the name of the wheel radii (``None``: ``Wheel.radius``; a wheel without radii of
    this name keeps ``radius``).  ``driver`` has all settings: those of the robot with the
    changes of this set.
    """

    name: str
    radii: str | None
    driver: DriverSettings
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TwistInput(Element):
    """A source of commanded twists for the multiplexer, or a lock that blocks sources.

    Among the active sources, the one with the highest ``priority`` (1..255) commands the robot.  A
    lock blocks the sources with a lower priority.  A source becomes inactive after ``timeout`` s
    without a message.  A lock locks after ``timeout`` s without a message (0: it keeps its last
    state).  ``topic`` is its ROS topic, in the name space of the robot.
    """

    name: str
    topic: str
    priority: int
    timeout: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Robot(Element):
    """A whole robot.  ``links[0]`` is ``base_link``, which lies on the ground.

    ``namespace`` is the prefix of names in outputs (empty: no prefix).  ``inertial`` is the
    inertia of the whole robot in ``base_link``, with every joint at 0.  ``urdf_extensions`` are
    XML elements of the extras that only URDF has, such as ``<gazebo>``.
    """

    name: str
    namespace: str
    description: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    wheels: tuple[Wheel, ...]
    actuators: tuple[Actuator, ...]
    sensors: tuple[Sensor, ...]
    batteries: tuple[Battery, ...]
    buses: tuple[Bus, ...]
    meshes: tuple[Mesh, ...]
    calculator: CalculatorChoice
    driver: DriverSettings
    inertial: Inertial
    span: Span
    urdf_extensions: tuple[str, ...] = ()
    parameter_sets: tuple[ParameterSet, ...] = ()
    twist_sources: tuple[TwistInput, ...] = ()
    twist_locks: tuple[TwistInput, ...] = ()

    @property
    def prefix(self) -> str:
        """The prefix of every name in an output: the name space and a slash, or empty."""
        return f"{self.namespace}/" if self.namespace else ""

    def link(self, name: str) -> Link:
        """Return the link of this name.  Raises ``KeyError``."""
        for link in self.links:
            if link.name == name:
                return link
        raise KeyError(name)

    def joint(self, name: str) -> Joint:
        """Return the joint of this name.  Raises ``KeyError``."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise KeyError(name)

    def actuator_of(self, joint: str) -> Actuator | None:
        """Return the actuator on a joint, ``None`` if it has none."""
        for actuator in self.actuators:
            if actuator.joint == joint:
                return actuator
        return None
