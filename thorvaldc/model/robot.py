"""The intermediate model: a robot as frozen dataclasses, everything in SI.

Passes build it, backends and the runtime read it; nothing changes it.  Every
element carries the ``span`` in the source it came from.  Lists are in model
order: the order of the modules in the file, depth first, which every output
follows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model.bus import Bus, Channel, FrameDefinition, Node, ObjectValue, Scalar, Signal
from thorvaldc.model.element import Element
from thorvaldc.model.spatial import Inertial, Pose, Vec3

# The bus is part of the model; what it is made of stands in a file of its own.
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
    """Full edge lengths along x, y, z in m, centred on the frame."""

    size: Vec3


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Cylinder(Element):
    """Radius and full length in m, along z, centred on the frame."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sphere(Element):
    """Radius in m, centred on the frame."""

    radius: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeshShape(Element):
    """A mesh by its name in ``Robot.meshes``; ``scale`` per axis."""

    mesh: str
    scale: Vec3 = (1.0, 1.0, 1.0)


Shape = Box | Cylinder | Sphere | MeshShape


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mesh(Element):
    """A mesh file that goes along: ``name`` is its file name in the output.

    Only STL and OBJ occur here (what URDF readers and MuJoCo share); other
    formats are converted before.  ``data`` is left out of the JSON form.
    """

    name: str
    sha256: str
    data: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Visual(Element):
    """What is seen: ``pose`` in the link's frame, ``color`` RGBA in 0..1."""

    shape: Shape
    pose: Pose
    color: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Collision(Element):
    """What touches: ``pose`` in the link's frame."""

    shape: Shape
    pose: Pose


# -- the tree -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Link(Element):
    """A rigid body.  ``inertial`` is given in the link's frame; ``None``: massless.

    ``module`` is the path of the module that it came from, ``fl.steering``.
    """

    name: str
    module: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mimic(Element):
    """q = multiplier * q_joint + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Joint(Element):
    """``pose`` is that of the child link in the parent link at joint position 0.

    ``type`` is ``fixed``, ``revolute`` (limited), ``continuous`` or
    ``prismatic``; ``axis`` a unit vector in the child's frame.  Limits in rad
    or m (``None`` where there is none), ``effort`` in N m or N, ``velocity``
    in rad/s or m/s.  ``stiffness`` and ``spring_reference`` (the position at
    which the spring is at rest) describe a spring; ``damping`` and
    ``friction`` (Coulomb) the joint's losses; ``armature`` is the inertia of
    the motor at the joint.  ``role`` is ``steering``, ``propulsion``,
    ``suspension``, ``swivel``, ``wheel`` (a passive one) or empty.
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


# -- the base -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tread(Element):
    """A ring of a wheel beside its tyre, which rolls on something else: a rail.

    ``name`` is that of its radius in ``Wheel.radii``, ``center`` (m) its middle in the wheel's
    link, ``width`` (m) that between its flanges, which are ``flange`` (m) high; 0: none.
    """

    name: str
    center: Vec3
    width: float
    flange: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wheel(Element):
    """A wheel and its geometry in ``base_link`` with every joint at zero.

    ``x``, ``y`` (m): where the steering (or swivel) axis meets the ground; for
    a wheel that does not turn, its contact point.  ``heading`` (rad): the
    direction in which a positive joint speed rolls, at steering angle 0; at
    steering angle q it is ``heading + steering_sign * q``.  ``trail`` and
    ``lateral_offset`` (m): the contact point relative to that axis, along and
    to the left of the rolling direction.  ``radius`` and ``width`` in m;
    ``radii`` holds named alternatives (``floor``, ``rail``), ``treads`` those that are rings of
    their own.  ``load`` (N) is
    the static share of the weight.  ``contact_height`` (m) is how far the
    wheel's lowest point is above the ground (0 for a well-built robot).
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
        """The radius (m) of this name in ``radii``.

        The ordinary ``radius`` for ``None``, and for a name that this wheel does not have.
        """
        return dict(self.radii).get(name, self.radius) if name else self.radius


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Actuator(Element):
    """A motor with its gear on a joint; every limit is at the joint.

    ``role`` is ``propulsion`` (speed-controlled) or ``steering`` (position-
    controlled).  ``max_velocity`` rad/s, ``max_acceleration`` rad/s^2,
    ``max_torque`` N m, ``armature`` kg m^2 (rotor inertia times gear^2).
    ``motor_max_speed`` rad/s and ``encoder_ppr`` (pulses per revolution, four
    counts each) are at the motor shaft.  ``node`` and ``channel`` name the
    controller that drives it, or are ``None``.  Of a steering motor that was
    calibrated, ``encoder_offset`` (rad, at the joint) is the joint's position
    where its encoder reads 0: position = reading + offset.
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
    """``type``: ``lidar_2d``, ``gnss``, ``imu``, ``camera`` or another module's own.

    ``link`` is the frame in which it measures; ``properties`` in SI.
    """

    name: str
    module: str
    type: str
    link: str
    properties: tuple[tuple[str, Scalar], ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Battery(Element):
    """A battery enclosure; ``node`` is ``None`` where no battery is in it."""

    name: str
    module: str
    link: str
    node: str | None
    properties: tuple[tuple[str, Scalar], ...]
    span: Span


# -- the whole ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CalculatorChoice(Element):
    """The base calculator's plugin name and its options."""

    name: str = "general"
    options: tuple[tuple[str, Scalar], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriverSettings(Element):
    """``rate`` Hz of the control loop; ``command_timeout`` s; twist limits in SI.

    The limits are what the modules allow together or what the file says, at
    the robot: m/s, rad/s, m/s^2, rad/s^2.  ``noise`` holds what the file says of
    the odometry's errors, in SI, by the names of the estimator's ``Noise``.
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
    """Values that the robot can switch to while it drives.

    ``radii`` names those of the wheels (``None``: the ordinary ones; a wheel without
    such keeps its own); ``driver`` are the robot's settings with what the set changes.
    """

    name: str
    radii: str | None
    driver: DriverSettings
    span: Span


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TwistInput(Element):
    """A source of twists in front of the driver, or a lock that holds sources back.

    Of the sources that are being published the one of the highest ``priority`` (1..255)
    drives.  A lock holds back those below its priority.  ``timeout`` (s): silence after
    which a source is not published any more, and after which a lock holds (0: a silent
    lock stays as it is).  ``topic`` is its ROS topic, in the robot's name space.
    """

    name: str
    topic: str
    priority: int
    timeout: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Robot(Element):
    """A whole robot.  ``links[0]`` is ``base_link``, which lies on the ground.

    ``namespace`` prefixes names in outputs (empty: none).  ``urdf_extensions``
    are XML elements of the extras that only URDF can carry (``<gazebo>``).
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
        """The namespace with a slash, in front of every name in an output; or empty."""
        return f"{self.namespace}/" if self.namespace else ""

    def link(self, name: str) -> Link:
        """The link of that name; ``KeyError`` where there is none."""
        for link in self.links:
            if link.name == name:
                return link
        raise KeyError(name)

    def joint(self, name: str) -> Joint:
        """The joint of that name; ``KeyError`` where there is none."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise KeyError(name)

    def actuator_of(self, joint: str) -> Actuator | None:
        """The actuator on that joint, if any."""
        for actuator in self.actuators:
            if actuator.joint == joint:
                return actuator
        return None
