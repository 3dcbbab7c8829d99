"""A robot as an SDF model: links, joints, sensors and the systems that drive its joints.

Rigid groups.  All links that fixed joints connect become one SDF link, which has the name of the
uppermost of them.  The other links are frames (``<frame>``) of the SDF link.  Gazebo would give a
link without mass the mass of 1 kg, so that only groups can have the mass of the model.

Contact of tyres.  The data of a tyre are in ``Wheel``: radius, width, friction, and the rings
(``treads``) that roll on rails.  No shape rolls correctly in every physics engine:

- The cylinder of the tyre is the first collision shape of the wheel's link.  It is the true shape,
  for tools that check distances, and is in the URDF.
- A soft contact (MuJoCo) needs an ellipsoid that is enlarged by half of the penetration, see
  ``wheel_contact.contact_ellipsoid``.
- A rigid contact (DART, the engine of Gazebo) needs a sphere, see ``rigid_contact_shapes``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from thorvaldc import model as ir
from thorvaldc.backends import ros2_parts, sdf_extra_sensors
from thorvaldc.backends.ros2_controllers import CONTROLLER_FILE
from thorvaldc.backends.xml_writer import Element, numbers
from thorvaldc.model import joint_topics
from thorvaldc.model.number_origins import derived
from thorvaldc.model.sensor_numbers import ray_count, sensor_numbers
from thorvaldc.model.spatial import clean, clean3, combine, quat_from_z_to
from thorvaldc.model.statics.joint_tree import JointTree, tree_of
from thorvaldc.model.statics.standing_pose import solve_statics, spin_axis
from thorvaldc.model.statics.wheel_contact import rolling_sphere

SENSORS = {
    "lidar_2d": "gpu_lidar",
    "lidar_3d": "gpu_lidar",
    "imu": "imu",
    "gnss": "navsat",
    "camera": "camera",
}
"""Sensor types of SDF by the sensor types of the model; other sensors have no counterpart."""
CAMERA = ir.Pose.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, -math.pi / 2, math.pi / 2))
"""The frame of an SDF camera in the optical frame: an SDF camera looks along x with z up, the
optical frame looks along z with y down."""

Numbers = Mapping[str, float]
GZ_ROS2_CONTROL = ("gz_ros2_control-system", "gz_ros2_control::GazeboSimROS2ControlPlugin")
"""File and class of the plug-in of ros2_control for Gazebo."""
POSITION_GAIN = 0.5
"""Share of the position error that a joint with a position interface makes up in one step of the
controller manager. The default of the plug-in, 0.1, steers with a delay of 0.2 s at 50 Hz."""
STEERING_FREQUENCY = 50.0
"""Natural frequency (rad/s) of the position control of a steering joint, which is critically
damped. Its delay is 0.04 s; at 100 rad/s, changes of the target still make wheels slip a little."""


def add_robot(
    parent: Element,
    robot: ir.Robot,
    pose: ir.Pose | None,
    meshes: str = "../meshes",
    share: str | None = None,
) -> Element:
    """Add a robot as a model, at the pose ``pose`` of its ``base_link`` in the world.

    - ``meshes``: folder of the mesh files, relative to the file.
    - ``share``: shared folder of the ROS package for a model that ros2_control drives, or ``None``
      for a model with a controller of Gazebo on each driven joint.
    """
    return _RobotWriter(robot, meshes, share).write(parent, pose)


class _RobotWriter:
    """Writes the model of one robot.

    - ``groups``: rigid groups of links by the name of the uppermost link, in the order of the tree.
    - ``group_of``: name of the uppermost link of the group of each link.
    """

    def __init__(self, robot: ir.Robot, meshes: str, share: str | None) -> None:
        self.robot = robot
        self.meshes = meshes
        self.share = share
        self.prefix = robot.prefix
        self.tree = tree_of(robot)
        self.wheels = {wheel.link: wheel for wheel in robot.wheels}
        self.extra_sensors = sdf_extra_sensors.extra_sensors(robot)
        self.group_of: dict[str, str] = {}
        self.groups: dict[str, list[ir.Link]] = {}
        for name in self.tree.order:
            joint = self.tree.parent_joint.get(name)
            fixed = joint is not None and joint.type == "fixed"
            top = self.group_of[joint.parent] if joint is not None and fixed else name
            self.group_of[name] = top
            self.groups.setdefault(top, []).append(self.tree.links[name])

    def write(self, parent: Element, pose: ir.Pose | None) -> Element:
        robot = self.robot
        model = parent.add("model", name=robot.namespace or robot.name)
        model.set(canonical_link=self.prefix + robot.links[0].name)
        if pose is not None:
            add_pose(model, pose)
        for top, links in self.groups.items():
            self._add_link(model, top, links)
        for links in self.groups.values():
            for link in links[1:]:
                self._add_frame(model, link)
        for joint in self.tree.moving:
            self._add_joint(model, joint)
        self._add_systems(model)
        return model

    def _in_group(self, link: str) -> ir.Pose:
        """Return the pose of a link in the uppermost link of its group."""
        poses = self.tree.pose
        return (poses[self.group_of[link]].inverse() * poses[link]).clean()

    # -- links ------------------------------------------------------------------

    def _add_link(self, model: Element, top: str, links: list[ir.Link]) -> None:
        element = model.add("link", name=self.prefix + top)
        joint = self.tree.parent_joint.get(top)
        if joint is not None:
            parent = self.group_of[joint.parent]
            pose = self._in_group(joint.parent) * joint.pose
            add_pose(element, pose, self.prefix + parent)
        bodies = [
            link.inertial.transformed(self._in_group(link.name))
            for link in links
            if link.inertial is not None
        ]
        if bodies:
            body = (bodies[0] if len(bodies) == 1 else combine(bodies)).clean()
            inertial = element.add("inertial").fill(pose=(*body.com, 0.0, 0.0, 0.0), mass=body.mass)
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            inertial.add("inertia").fill(**dict(zip(names, body.inertia, strict=True)))
        for link in links:
            self._add_shapes(element, link)
        for sensor in self.robot.sensors:
            if self.group_of[sensor.link] == top:
                at = self._in_group(sensor.link)
                add_sensor(element, sensor, at, self.prefix)
        for extra in self.extra_sensors:
            if self.group_of[extra.link] == top:
                sdf_extra_sensors.add_extra_sensor(
                    element, extra, self._in_group(extra.link), self.prefix
                )

    def _add_shapes(self, element: Element, link: ir.Link) -> None:
        at = self._in_group(link.name)
        for i, visual in enumerate(link.visuals):
            part = element.add("visual", name=f"{link.name}_visual_{i}")
            add_pose(part, at * visual.pose)
            add_geometry(part, visual.shape, self.meshes)
            add_material(part, visual.color)
            if visual.color[3] < 1.0:
                part.fill(transparency=clean(1.0 - visual.color[3]))
        wheel = self.wheels.get(link.name)
        shapes: tuple[ir.Collision, ...] = link.collisions
        if wheel is not None:
            shapes = rigid_contact_shapes(self.tree, wheel)
        for i, collision in enumerate(shapes):
            part = element.add("collision", name=f"{link.name}_collision_{i}")
            add_pose(part, at * collision.pose)
            add_geometry(part, collision.shape, self.meshes)
            if wheel is not None:
                ode = part.add("surface").add("friction").add("ode")
                ode.fill(mu=wheel.friction, mu2=wheel.friction)

    def _add_frame(self, model: Element, link: ir.Link) -> None:
        top = self.prefix + self.group_of[link.name]
        frame = model.add("frame", name=self.prefix + link.name, attached_to=top)
        add_pose(frame, self._in_group(link.name))

    # -- joints -----------------------------------------------------------------

    def _add_joint(self, model: Element, joint: ir.Joint) -> None:
        kind = "prismatic" if joint.type == "prismatic" else "revolute"
        element = model.add("joint", name=self.prefix + joint.name, type=kind)
        parent = self.prefix + self.group_of[joint.parent]
        element.fill(parent=parent, child=self.prefix + joint.child)
        axis = element.add("axis").fill(xyz=joint.axis)
        axis.add("limit").fill(
            lower="-1e16" if joint.lower is None else joint.lower,
            upper="1e16" if joint.upper is None else joint.upper,
            effort=joint.effort,
            velocity=joint.velocity,
        )
        dynamics = {
            "damping": joint.damping,
            "friction": clean(joint.friction + self._rolling_friction(joint)),
            "spring_stiffness": joint.stiffness,
            "spring_reference": joint.spring_reference if joint.stiffness else 0.0,
        }
        if any(dynamics.values()):
            axis.add("dynamics").fill(**dynamics)

    def _rolling_friction(self, joint: ir.Joint) -> float:
        """Return the torque in N m by which the static load resists the rolling of a wheel."""
        wheel = self.wheels.get(joint.child)
        if wheel is None or wheel.spin_joint != joint.name:
            return 0.0
        return wheel.rolling_resistance * wheel.load * wheel.radius

    # -- systems ----------------------------------------------------------------

    def _add_systems(self, model: Element) -> None:
        """Add the systems of Gazebo that drive the joints and publish states and odometry."""
        rate = self.robot.driver.rate
        add_system(model, "odometry-publisher", "OdometryPublisher").fill(
            odom_frame=ros2_parts.WORLD_FRAME,
            robot_base_frame=self.prefix + self.robot.links[0].name,
            odom_topic=self.prefix + ros2_parts.TRUE_ODOMETRY,
            odom_publish_frequency=rate,
            dimensions=3,
        )
        if self.share is not None:
            self._add_ros2_control(model, self.share)
            return
        states = add_system(model, "joint-state-publisher", "JointStatePublisher")
        # By default, Gazebo publishes the states after each step, 1000 times a second.
        states.fill(topic=self.prefix + ros2_parts.JOINT_STATES, update_rate=rate)
        for joint in self.tree.moving:
            states.fill(joint_name=self.prefix + joint.name)
        topics = dict(joint_topics.command_topics(self.robot))
        motors: list[ir.Actuator | ir.JointServo] = [
            *self.robot.actuators,
            *self.robot.joint_servos,
        ]
        for motor in motors:
            self._add_controller(model, motor, self.prefix + topics[motor.joint])

    def _add_ros2_control(self, model: Element, share: str) -> None:
        """Add the plug-in that runs a controller manager of ros2_control inside Gazebo.

        The plug-in reads the interfaces of the joints from the URDF that robot_state_publisher
        has, see ``ros2_control``.
        """
        plugin = model.add("plugin", filename=GZ_ROS2_CONTROL[0], name=GZ_ROS2_CONTROL[1])
        plugin.fill(
            parameters=f"{share}/{CONTROLLER_FILE}", position_proportional_gain=POSITION_GAIN
        )
        if self.robot.namespace:
            plugin.add("ros").fill(namespace=f"/{self.robot.namespace}")

    def _add_controller(
        self, model: Element, motor: ir.Actuator | ir.JointServo, topic: str
    ) -> None:
        joint = motor.joint
        name = self.prefix + joint
        interface = motor.interface if isinstance(motor, ir.JointServo) else _controlled_by(motor)
        if interface == "velocity":
            system = add_system(model, "joint-controller", "JointController")
            system.fill(joint_name=name, topic=topic)
            return
        system = add_system(model, "joint-position-controller", "JointPositionController")
        system.fill(joint_name=name, topic=topic)
        if isinstance(motor, ir.JointServo):
            # The controller asks for the speed that reaches the target within one step, up to the
            # largest speed of the joint; so the joint holds weights without a deviation.
            system.fill(use_velocity_commands=True, initial_position=motor.initial)
            speed = self.tree.joints[joint].velocity
            if speed:
                system.fill(cmd_max=speed, cmd_min=-speed)
            return
        # With velocity commands, the joint makes up each new target, 50 times a second, at the full
        # torque of its motor, and the reaction moves the robot sideways on its wheels: the odometry
        # of 1WD1WS is off by 3 % of the path. The limit of the joint bounds the speed.
        inertia = solve_statics(self.robot).inertias[joint]
        system.fill(
            p_gain=clean(inertia * STEERING_FREQUENCY**2),
            i_gain=0,
            d_gain=clean(2.0 * inertia * STEERING_FREQUENCY),
            cmd_max=motor.max_torque,
            cmd_min=-motor.max_torque,
        )


def _controlled_by(actuator: ir.Actuator) -> str:
    return "velocity" if actuator.role == "propulsion" else "position"


def rigid_contact_shapes(tree: JointTree, wheel: ir.Wheel) -> tuple[ir.Collision, ...]:
    """Return the shapes of a wheel for rigid contacts, in the link frame of the wheel.

    The first one is the sphere of the tyre, whose lowest point lies on the rolling circle when
    every joint is at position 0. A cylinder has two contact points in DART and rolls on one of its
    edges: a robot with steered wheels 0.16 m wide turns on the spot by 8 % too slowly or 14 % too
    fast, which depends on the version. The others are the cylinders of the rings that roll on
    rails.
    """
    axis = spin_axis(tree, wheel)
    tilt = tree.pose[wheel.link].rotate(axis)[2]
    sphere = rolling_sphere(wheel.radius, axis, tilt)
    turned = quat_from_z_to(axis)
    rings = (
        ir.Collision(ir.Cylinder(wheel.radius_named(t.name), t.width), ir.Pose(t.center, turned))
        for t in wheel.treads
    )
    return (ir.Collision(ir.Sphere(sphere.radius), ir.Pose(sphere.center)), *rings)


# -- sensors ---------------------------------------------------------------------------


def add_sensor(link: Element, sensor: ir.Sensor, pose: ir.Pose, prefix: str) -> None:
    """Add a sensor to an SDF link. ``pose`` is the pose of the measurement frame in the link.

    ``ros2_parts`` has the topics of the sensor. A sensor of a type without a counterpart in SDF
    is left out.
    """
    kind = SENSORS.get(sensor.type)
    if kind is None:
        return
    values = sensor_numbers(sensor)
    element = link.add("sensor", name=prefix + sensor.name, type=kind)
    add_pose(element, pose * CAMERA if kind == "camera" else pose)
    element.fill(always_on=True, update_rate=values["rate"])
    first, *others = (prefix + topic for topic, _, _ in ros2_parts.sensor_topics(sensor))
    # A lidar publishes scans on its topic, and points on the topic ``points`` below it.
    element.fill(topic=first.removesuffix("/points"), gz_frame_id=prefix + sensor.link)
    if kind == "camera":
        _add_camera(element, values, others[0])
    elif kind == "gpu_lidar":
        _add_lidar(element, values, sensor.type)
    elif kind == "imu":
        _add_imu(element, values)
    else:
        _add_navsat(element, values)


def _add_lidar(element: Element, values: Numbers, kind: str) -> None:
    lidar = element.add("lidar")
    scan = lidar.add("scan")
    _add_scan(scan.add("horizontal"), values["field_of_view"], ray_count(values))
    if kind == "lidar_3d":
        height, layers = values["vertical_field_of_view"], int(values["layers"])
        _add_scan(scan.add("vertical"), height, layers)
    lidar.add("range").fill(min=values["minimum_range"], max=values["range"])
    if values["range_noise"]:
        noise = lidar.add("noise")
        noise.fill(type="gaussian", mean=0, stddev=values["range_noise"])


def _add_scan(element: Element, angle: float, samples: int) -> None:
    element.fill(samples=samples, min_angle=clean(-angle / 2), max_angle=clean(angle / 2))


def _add_camera(element: Element, values: Numbers, info_topic: str) -> None:
    angle = values["horizontal_field_of_view"]
    camera = element.add("camera").fill(camera_info_topic=info_topic, horizontal_fov=angle)
    width, height = int(values["image_width"]), int(values["image_height"])
    camera.add("image").fill(width=width, height=height)
    camera.add("clip").fill(near=0.05, far=100)


def _add_imu(element: Element, values: Numbers) -> None:
    """Add an IMU. A noise density d gives the standard deviation d sqrt(rate) of a sample."""
    imu = element.add("imu")
    samples = math.sqrt(values["rate"])
    for group, name in (
        ("angular_velocity", "gyro_noise"),
        ("linear_acceleration", "accelerometer_noise"),
    ):
        deviation = clean(values[name] * samples)
        if deviation:
            part = imu.add(group)
            for axis in "xyz":
                _add_noise(part.add(axis), deviation)


def _add_navsat(element: Element, values: Numbers) -> None:
    if values["accuracy"]:
        sensing = element.add("navsat").add("position_sensing")
        for axis in ("horizontal", "vertical"):
            _add_noise(sensing.add(axis), values["accuracy"])


def _add_noise(element: Element, deviation: float) -> None:
    element.add("noise", type="gaussian").fill(mean=0, stddev=deviation)


# -- elements that several parts of an SDF file contain --------------------------------


def add_system(parent: Element, library: str, name: str) -> Element:
    return parent.add(
        "plugin", filename=f"gz-sim-{library}-system", name=f"gz::sim::systems::{name}"
    )


def add_pose(parent: Element, pose: ir.Pose, relative_to: str | None = None) -> None:
    values = (*clean3(pose.xyz), *clean3(pose.rpy()))
    if any(values) or relative_to is not None:
        parent.add("pose", relative_to=relative_to).text = numbers(values)


def add_geometry(parent: Element, shape: ir.Shape, meshes: str) -> None:
    geometry = parent.add("geometry")
    match shape:
        case ir.Box(size):
            geometry.add("box").fill(size=size)
        case ir.Cylinder(radius, length):
            geometry.add("cylinder").fill(radius=radius, length=length)
        case ir.MeshShape(mesh, scale):
            scaled = None if scale == (1.0, 1.0, 1.0) else scale
            geometry.add("mesh").fill(uri=f"{meshes}/{derived(mesh, scale)}", scale=scaled)
        case _:
            geometry.add("sphere").fill(radius=shape.radius)


def add_material(visual: Element, color: tuple[float, float, float, float]) -> None:
    visual.add("material").fill(ambient=color, diffuse=color)
