"""The intermediate model of a robot: frozen dataclasses with all values in SI units.

The compiler builds the robot model from the robot file. The backends and the runtime read the robot
model. The field ``span`` is the position of the element in the YAML file. Every list in the robot
model has the order of the modules in the robot file, depth first. All output files keep the order
of the robot model.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.diagnostics import DiagnosticError, Span
from thorvaldc.diagnostics.html_view import HtmlView
from thorvaldc.model import quantities as si
from thorvaldc.model.bus import Bus, Scalar
from thorvaldc.model.robot_computer import Computer
from thorvaldc.model.ros2_driver import Ros2Driver
from thorvaldc.model.settings import (
    DEFAULT_SETTINGS,
    CalculatorChoice,
    DriverSettings,
    ParameterSet,
    RosSettings,
    TwistInput,
)
from thorvaldc.model.shapes import Collision, Mesh, Visual
from thorvaldc.model.spatial import Inertial, Pose, Vec3

# -- modules: the types of the module library that the robot consists of ----------------


@dataclass(frozen=True, slots=True)
class SourcedMass:
    """The mass of all parts of a module whose numbers have the same source.

    - ``mass``: mass in kg.
    - ``source``: source of the numbers as in the module file, such as ``datasheet: VLP-16``, or
      empty if the module file states no source.
    """

    mass: si.Kilograms
    source: str


@dataclass(frozen=True, slots=True)
class Purchase:
    """What a module costs and how long its delivery takes, as far as the files state it.

    - ``price``: price of one module in ``currency``, or ``None``.
    - ``currency``: code of ISO 4217, such as ``EUR``; empty without a price.
    - ``supplier``: name of the supplier, or empty.
    - ``lead_time``: time from order to delivery in s, or ``None``.
    """

    price: si.Money | None
    currency: str
    supplier: str
    lead_time: si.Seconds | None


NOT_STATED = Purchase(None, "", "", None)


@dataclass(frozen=True, slots=True)
class Module:
    """A module of the robot: one use of a module type that is not an assembly.

    - ``name``: path of the module, such as ``fl.steering``.
    - ``type``: name of the module type, such as ``steering/standard``.
    - ``parent``: path of the module that carries it, or empty for the root module and for a module
      that is not mounted.
    - ``mounted``: true if the module is a body of the robot. A module that is only wired, such as a
      motor controller without a mount, has no links and no mass.
    - ``masses``: mass by source, in the order of the module file.
    - ``purchase``: price, supplier and lead time.
    """

    name: str
    type: str
    parent: str
    mounted: bool
    masses: tuple[SourcedMass, ...]
    span: Span
    purchase: Purchase = NOT_STATED


# -- links and joints -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Link:
    """A rigid body.

    - ``name``: name of the link and of its frame, such as ``fl_steering_fork``.
    - ``module``: path of the module that the link belongs to, such as ``fl.steering``.
    - ``inertial``: mass and inertia in the link frame, or ``None`` for a link without mass.
    - ``visuals``, ``collisions``: shapes for pictures and for contacts, in the link frame.
    """

    name: str
    module: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    span: Span

    def __repr__(self) -> str:
        mass = f"{self.inertial.mass:.4g} kg" if self.inertial is not None else "no mass"
        return f"<Link {self.name}: {mass}>"


@dataclass(frozen=True, slots=True)
class Mimic:
    """A mimic joint, whose position depends on another joint: q = multiplier * q_joint + offset."""

    joint: str
    multiplier: si.Number
    offset: si.JointPosition


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint between two links.

    - ``name``: name of the joint, such as ``fl_steering_joint``.
    - ``module``: path of the module that the joint belongs to, such as ``fl.steering``.
    - ``type``: ``fixed``, ``revolute`` (with position limits), ``continuous`` or ``prismatic``.
    - ``pose``: pose of the child link in the parent link at joint position 0.
    - ``axis``: joint axis as a unit vector in the child link frame.
    - ``lower``, ``upper``: position limits in rad or m, or ``None`` for a joint without limits.
    - ``effort``: largest torque in N m or largest force in N.
    - ``velocity``: largest speed in rad/s or m/s.
    - ``damping``: viscous friction in N m s/rad or N s/m.
    - ``friction``: Coulomb friction in N m or N.
    - ``stiffness``: stiffness of the joint spring in N m/rad or N/m.
    - ``spring_reference``: joint position at which the spring is relaxed.
    - ``armature``: inertia of the motor at the joint in kg m^2.
    - ``role``: ``steering``, ``propulsion``, ``suspension``, ``swivel``, ``wheel`` (a wheel joint
      without a motor), or empty.
    - ``mimic``: the joint on which the position depends, or ``None``.
    """

    name: str
    module: str
    type: str
    parent: str
    child: str
    pose: Pose
    span: Span
    axis: Vec3 = (0.0, 0.0, 1.0)
    lower: si.JointPosition | None = None
    upper: si.JointPosition | None = None
    effort: si.JointEffort | None = None
    velocity: si.JointVelocity | None = None
    damping: si.JointDamping = 0.0
    friction: si.JointEffort = 0.0
    stiffness: si.JointStiffness = 0.0
    spring_reference: si.JointPosition = 0.0
    armature: si.KilogramSquareMetres = 0.0
    mimic: Mimic | None = None
    role: str = ""

    def __repr__(self) -> str:
        return f"<Joint {self.name}: {self.type}, {self.parent} to {self.child}>"


@dataclass(frozen=True, slots=True)
class JointServo:
    """A servo on a joint of an extra, such as an arm.

    The controllers of the arm command it; the base driver does not.

    - ``joint``: name of the joint.
    - ``interface``: ``position`` or ``velocity``, the value that the servo is commanded.
    - ``initial``: position of the joint in rad or m at which the servo starts.
    """

    joint: str
    interface: str
    initial: si.JointPosition
    span: Span


# -- wheels and devices -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Tread:
    """A ring beside the tyre of a wheel, with which the wheel rolls on rails.

    - ``name``: name of the rolling radius of the ring in ``Wheel.radii``.
    - ``center``: centre of the ring in the link frame of the wheel, in m.
    - ``width``: distance between the flanges in m.
    - ``flange``: height of the flanges in m, 0 for a ring without flanges.
    """

    name: str
    center: si.Position
    width: si.Metres
    flange: si.Metres


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel of the robot, with positions and angles in ``base_link`` when every joint is at
    position 0.

    - ``module``, ``link``: path of the module, and name of the link that rolls.
    - ``spin_joint``: name of the joint about the axle.
    - ``steering_joint``, ``swivel_joint``, ``suspension_joint``: names of joints between the frame
      and the wheel, or ``None``.
    - ``driven``: true if a motor turns the wheel.
    - ``x``, ``y``: intersection of the steering axis or swivel axis with the ground, in m. For a
      wheel without a steering or swivel axis, ``x`` and ``y`` are the position of the wheel's
      contact point.
    - ``heading``: rolling direction in rad for a positive joint speed at steering angle 0. At the
      steering angle q, the wheel rolls in the direction ``heading + steering_sign * q``.
    - ``trail``: distance in m from (``x``, ``y``) to the contact point, along the rolling
      direction.
    - ``lateral_offset``: distance in m from (``x``, ``y``) to the contact point, to the left of the
      rolling direction.
    - ``radius``, ``width``: rolling radius and width of the wheel in m.
    - ``radii``: other rolling radii in m by name, such as ``floor`` or ``rail``.
    - ``treads``: rings of the wheel that roll with one of the radii in ``radii``.
    - ``friction``: coefficient of friction.
    - ``rolling_resistance``: coefficient of rolling resistance.
    - ``load``: static wheel load in N.
    - ``contact_height``: height of the lowest point of the wheel above the ground in m, 0 for a
      wheel that stands on the ground.
    """

    name: str
    module: str
    link: str
    spin_joint: str
    steering_joint: str | None
    swivel_joint: str | None
    suspension_joint: str | None
    driven: bool
    x: si.Metres
    y: si.Metres
    heading: si.Radians
    steering_sign: si.Number
    trail: si.Metres
    lateral_offset: si.Metres
    radius: si.Metres
    width: si.Metres
    radii: tuple[tuple[str, si.Metres], ...]
    friction: si.Number
    rolling_resistance: si.Number
    load: si.Newtons
    contact_height: si.Metres
    span: Span
    treads: tuple[Tread, ...] = ()

    def __repr__(self) -> str:
        kinds = [kind for kind in ("driven", "steered") if getattr(self, kind)]
        return f"<Wheel {self.name}: {', '.join([*kinds, f'radius {self.radius:g} m'])}>"

    @property
    def steered(self) -> bool:
        """Whether a motor steers the wheel; a swivelling wheel of a caster is not steered."""
        return self.steering_joint is not None

    @property
    def contact_point(self) -> tuple[float, float]:
        """The contact point (x, y in m) in ``base_link`` on level ground, with all joints at 0."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return (
            self.x + c * self.trail - s * self.lateral_offset,
            self.y + s * self.trail + c * self.lateral_offset,
        )

    def radius_named(self, name: str | None) -> float:
        """Return the rolling radius of the wheel in m that has the name ``name`` in ``radii``.

        Returns ``radius`` if ``name`` is ``None`` or if the wheel has no radius with this name.
        """
        return dict(self.radii).get(name, self.radius) if name else self.radius


@dataclass(frozen=True, slots=True)
class Brake:
    """A spring-applied brake of a motor: current opens it, and without current it is closed.

    - ``torque``: holding torque at the joint in N m.
    - ``closing_time``: time in s from the loss of current until the brake holds.
    """

    torque: si.NewtonMetres
    closing_time: si.Seconds


MAX_STEERING_OFFSET = math.radians(45.0)
"""Largest plausible ``Actuator.encoder_offset`` (rad).

A larger steering offset is an error of the homing, which a calibration cannot correct.
"""


@dataclass(frozen=True, slots=True)
class Actuator:
    """A motor with its gear on a joint.

    - ``name``, ``module``: name of the motor, and path of the module that it belongs to.
    - ``role``: ``propulsion`` (the motor controls the speed) or ``steering`` (the motor controls
      the position).
    - ``max_velocity``: largest speed of the joint in rad/s.
    - ``max_acceleration``: largest acceleration of the joint in rad/s^2.
    - ``max_torque``: largest torque on the joint in N m.
    - ``armature``: inertia of the rotor times the square of the gear ratio, in kg m^2.
    - ``motor_max_speed``: largest speed of the motor shaft in rad/s.
    - ``encoder_ppr``: encoder pulses per revolution of the motor shaft. The position of a motor
      encoder has four counts per pulse.
    - ``node``, ``channel``: names of the motor controller and its channel, or ``None`` for a motor
      without a controller on a bus.
    - ``encoder_offset``: joint position minus encoder reading in rad, from the calibration of a
      steering motor.
    - ``gear_ratio``: revolutions of the motor shaft per revolution of the joint.
    - ``back_driving_torque``: torque at the joint in N m below which the joint does not turn while
      the motor has no power, from the friction of motor and gear.
    - ``brake``: brake of the motor, or ``None`` for a motor without a brake.
    - ``inverted``: true if the joint turns in its negative direction when the motor controller
      counts positive. The scales of the CAN signals contain this sign.
    """

    name: str
    module: str
    joint: str
    role: str
    gear_ratio: si.Number
    motor_max_speed: si.RadiansPerSecond
    encoder_ppr: int
    max_velocity: si.RadiansPerSecond
    max_acceleration: si.RadiansPerSecond2
    max_torque: si.NewtonMetres
    armature: si.KilogramSquareMetres
    node: str | None
    channel: str | None
    span: Span
    encoder_offset: si.Radians = 0.0
    back_driving_torque: si.NewtonMetres = 0.0
    brake: Brake | None = None
    inverted: bool = False

    @property
    def pulses_per_joint_turn(self) -> float:
        """Number of encoder pulses per turn of the joint."""
        return self.encoder_ppr * self.gear_ratio


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor of the robot.

    - ``type``: ``lidar_2d``, ``gnss``, ``imu``, ``camera`` or another word of the module type.
    - ``link``: name of the link whose frame is the measurement frame.
    - ``properties``: values of the sensor in SI units, by name.
    - ``ros2_driver``: its driver on the real robot, or ``None`` if the module states none.
    """

    name: str
    module: str
    type: str
    link: str
    properties: tuple[tuple[str, Scalar], ...]
    span: Span
    ros2_driver: Ros2Driver | None = None


PARALLEL, SEPARATE = "parallel", "separate"
"""Values of ``Robot.battery_connection``."""


@dataclass(frozen=True, slots=True)
class Battery:
    """A battery enclosure of the robot.

    - ``module``, ``link``: path of the module, and name of the link of the enclosure.
    - ``node``: name of the battery's node on the bus, or ``None`` for an enclosure without a
      battery.
    - ``properties``: values of the battery in SI units, by name.
    """

    name: str
    module: str
    link: str
    node: str | None
    properties: tuple[tuple[str, Scalar], ...]
    span: Span

    @property
    def voltage(self) -> float | None:
        """Nominal voltage in V, or ``None`` if the module states none."""
        return stated_number(self.properties, "voltage")

    @property
    def capacity(self) -> float | None:
        """Capacity in A s, or ``None`` if the module states none."""
        return stated_number(self.properties, "capacity")


def stated_number(properties: Iterable[tuple[str, Scalar]], name: str) -> float | None:
    """Return a property of a module that is a number, or ``None``."""
    value = dict(properties).get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return value * 1.0


# -- the robot --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Robot(HtmlView):
    """A whole robot.

    - ``name``: name of the robot.
    - ``description``: text of the robot file, for people.
    - ``namespace``: prefix of names in outputs, or empty for names without a prefix.
    - ``links``: rigid bodies of the robot. The first link is ``base_link``, whose origin lies on
      the ground.
    - ``joints``: joints between the links; each link but the first is the child of one joint.
    - ``wheels``: wheels that touch the ground.
    - ``actuators``: motors with their gears.
    - ``sensors``: sensors, with the links whose frames they measure in.
    - ``batteries``: battery enclosures.
    - ``buses``: CAN buses with their nodes and frame definitions.
    - ``meshes``: mesh files of the links.
    - ``calculator``: base calculator and its options.
    - ``driver``: settings of the base driver.
    - ``parameter_sets``: named settings that the driver can select while the robot drives.
    - ``twist_sources``, ``twist_locks``: inputs of the twist multiplexer.
    - ``inertial``: inertia of the whole robot in ``base_link`` when every joint is at position 0.
    - ``joint_servos``: servos on joints of extras.
    - ``urdf_extensions``: XML elements from extras that only URDF can express, such as
      ``<gazebo>``.
    - ``ros``: settings of the ROS 2 package.
    - ``modules``: the modules with their types, without the assemblies.
    - ``design_slope``: steepest slope in rad for which the robot is designed, or ``None`` if the
      robot file states none.
    - ``battery_connection``: ``parallel`` if the batteries are one source, ``separate`` if each
      supplies its own modules, or ``None`` if the robot file states neither.
    - ``computer``: the computer on the robot, or ``None`` if the robot file does not describe it.
    """

    html_view = "thorvaldc.model.facts.fact_page:robot_html"

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
    joint_servos: tuple[JointServo, ...] = ()
    ros: RosSettings = DEFAULT_SETTINGS
    modules: tuple[Module, ...] = ()
    design_slope: si.Radians | None = None
    battery_connection: str | None = None
    computer: Computer | None = None

    def __repr__(self) -> str:
        wheels = f"{len(self.wheels)} wheel{'' if len(self.wheels) == 1 else 's'}"
        return f"<Robot {self.name}: {wheels}, {self.inertial.mass:.1f} kg>"

    @property
    def prefix(self) -> str:
        """The prefix of every name in an output file: the name space of the robot and a slash, or
        an empty text."""
        return f"{self.namespace}/" if self.namespace else ""

    @property
    def common_source(self) -> tuple[Battery, ...]:
        """The batteries that supply the whole robot: the only battery, or several in parallel.

        Their nominal voltages are equal; their currents, capacities and energies add up. Empty if
        the robot has no battery, or if each of its batteries may supply other modules.
        """
        present = tuple(battery for battery in self.batteries if battery.node is not None)
        return present if len(present) == 1 or self.battery_connection == PARALLEL else ()

    def link(self, name: str) -> Link:
        """Return the link of the robot with the name ``name``.

        Raises ``KeyError`` if the robot has no link with this name.
        """
        for link in self.links:
            if link.name == name:
                return link
        raise KeyError(name)

    def joint(self, name: str) -> Joint:
        """Return the joint of the robot with the name ``name``.

        Raises ``KeyError`` if the robot has no joint with this name.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise KeyError(name)

    def actuator_of(self, joint: str) -> Actuator | None:
        """Return the actuator on a joint, or ``None`` for a joint without an actuator."""
        for actuator in self.actuators:
            if actuator.joint == joint:
                return actuator
        return None

    def require_bus(self) -> None:
        """Raise ``DiagnosticError`` (``bus-missing``) if the robot has no CAN bus."""
        if not self.buses:
            raise DiagnosticError(
                "bus-missing",
                f"{self.name} has no devices, and so no bus",
                self.span,
                hint="give its motors controllers; the assembly `assembly/steered_drive` contains"
                " one",
            )


def wheel_joints(robot: Robot) -> tuple[dict[str, int], dict[str, int]]:
    """Returns the drive joints and the steering joints of a robot, in the order of the wheels.

    The joints are mappings from the joint name to the index of the first wheel on the joint.  Two
    wheels may share a steering joint or a drive joint.
    """
    drives: dict[str, int] = {}
    steering: dict[str, int] = {}
    for i, wheel in enumerate(robot.wheels):
        if wheel.driven:
            drives.setdefault(wheel.spin_joint, i)
        if wheel.steering_joint is not None:
            steering.setdefault(wheel.steering_joint, i)
    return drives, steering
