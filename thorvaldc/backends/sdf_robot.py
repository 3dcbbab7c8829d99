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

from thorvaldc.backends.gazebo_topics import JOINT_STATES, TRUE_ODOMETRY, joint_commands
from thorvaldc.backends.ros2_controllers import CONTROLLER_FILE
from thorvaldc.backends.sdf_elements import add_geometry, add_pose, add_system
from thorvaldc.backends.sdf_sensors import add_sensor
from thorvaldc.backends.xml_writer import Element, number, numbers
from thorvaldc.model import (
    Actuator,
    Collision,
    Cylinder,
    Joint,
    JointServo,
    Link,
    Pose,
    Robot,
    Sphere,
    Wheel,
)
from thorvaldc.model.spatial import clean, combine, quat_from_z_to
from thorvaldc.model.statics.joint_tree import JointTree, tree_of
from thorvaldc.model.statics.standing_pose import spin_axis
from thorvaldc.model.statics.wheel_contact import rolling_sphere

GZ_ROS2_CONTROL = ("gz_ros2_control-system", "gz_ros2_control::GazeboSimROS2ControlPlugin")
"""File and class of the plug-in of ros2_control for Gazebo."""
POSITION_GAIN = 0.5
"""Share of the position error that a joint with a position interface makes up in one step of the
controller manager. The default of the plug-in, 0.1, steers with a delay of 0.2 s at 50 Hz."""


def add_robot(
    parent: Element,
    robot: Robot,
    pose: Pose | None,
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

    def __init__(self, robot: Robot, meshes: str, share: str | None) -> None:
        self.robot = robot
        self.meshes = meshes
        self.share = share
        self.prefix = robot.prefix
        self.tree = tree_of(robot)
        self.wheels = {wheel.link: wheel for wheel in robot.wheels}
        self.group_of: dict[str, str] = {}
        self.groups: dict[str, list[Link]] = {}
        for name in self.tree.order:
            joint = self.tree.parent_joint.get(name)
            fixed = joint is not None and joint.type == "fixed"
            top = self.group_of[joint.parent] if joint is not None and fixed else name
            self.group_of[name] = top
            self.groups.setdefault(top, []).append(self.tree.links[name])

    def write(self, parent: Element, pose: Pose | None) -> Element:
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

    def _in_group(self, link: str) -> Pose:
        """Return the pose of a link in the uppermost link of its group."""
        poses = self.tree.pose
        return (poses[self.group_of[link]].inverse() * poses[link]).clean()

    # -- links ------------------------------------------------------------------

    def _add_link(self, model: Element, top: str, links: list[Link]) -> None:
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
            inertial = element.add("inertial")
            inertial.add("pose").text = numbers((*body.com, 0.0, 0.0, 0.0))
            inertial.add("mass").text = number(body.mass)
            inertia = inertial.add("inertia")
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            for name, value in zip(names, body.inertia, strict=True):
                inertia.add(name).text = number(value)
        for link in links:
            self._add_shapes(element, link)
        for sensor in self.robot.sensors:
            if self.group_of[sensor.link] == top:
                at = self._in_group(sensor.link)
                add_sensor(element, sensor, at, self.prefix)

    def _add_shapes(self, element: Element, link: Link) -> None:
        at = self._in_group(link.name)
        for i, visual in enumerate(link.visuals):
            part = element.add("visual", name=f"{link.name}_visual_{i}")
            add_pose(part, at * visual.pose)
            add_geometry(part, visual.shape, self.meshes)
            material = part.add("material")
            for name in ("ambient", "diffuse"):
                material.add(name).text = numbers(visual.color)
            if visual.color[3] < 1.0:
                part.add("transparency").text = number(clean(1.0 - visual.color[3]))
        wheel = self.wheels.get(link.name)
        shapes: tuple[Collision, ...] = link.collisions
        if wheel is not None:
            shapes = rigid_contact_shapes(self.tree, wheel)
        for i, collision in enumerate(shapes):
            part = element.add("collision", name=f"{link.name}_collision_{i}")
            add_pose(part, at * collision.pose)
            add_geometry(part, collision.shape, self.meshes)
            if wheel is not None:
                friction = part.add("surface").add("friction")
                ode = friction.add("ode")
                for name in ("mu", "mu2"):
                    ode.add(name).text = number(wheel.friction)

    def _add_frame(self, model: Element, link: Link) -> None:
        top = self.prefix + self.group_of[link.name]
        frame = model.add("frame", name=self.prefix + link.name, attached_to=top)
        add_pose(frame, self._in_group(link.name))

    # -- joints -----------------------------------------------------------------

    def _add_joint(self, model: Element, joint: Joint) -> None:
        kind = "prismatic" if joint.type == "prismatic" else "revolute"
        element = model.add("joint", name=self.prefix + joint.name, type=kind)
        element.add("parent").text = self.prefix + self.group_of[joint.parent]
        element.add("child").text = self.prefix + joint.child
        axis = element.add("axis")
        axis.add("xyz").text = numbers(joint.axis)
        limit = axis.add("limit")
        for name, value in (
            ("lower", joint.lower),
            ("upper", joint.upper),
            ("effort", joint.effort),
            ("velocity", joint.velocity),
        ):
            if value is not None:
                limit.add(name).text = number(value)
            elif name in ("lower", "upper"):
                limit.add(name).text = "-1e16" if name == "lower" else "1e16"
        dynamics = {
            "damping": joint.damping,
            "friction": clean(joint.friction + self._rolling_friction(joint)),
            "spring_stiffness": joint.stiffness,
            "spring_reference": joint.spring_reference if joint.stiffness else 0.0,
        }
        if any(dynamics.values()):
            part = axis.add("dynamics")
            for name, value in dynamics.items():
                part.add(name).text = number(value)

    def _rolling_friction(self, joint: Joint) -> float:
        """Return the torque in N m by which the static load resists the rolling of a wheel."""
        wheel = self.wheels.get(joint.child)
        if wheel is None or wheel.spin_joint != joint.name:
            return 0.0
        return wheel.rolling_resistance * wheel.load * wheel.radius

    # -- systems ----------------------------------------------------------------

    def _add_systems(self, model: Element) -> None:
        """Add the systems of Gazebo that drive the joints and publish states and odometry."""
        odometry = add_system(model, "odometry-publisher", "OdometryPublisher")
        odometry.add("odom_frame").text = f"{self.prefix}odom"
        odometry.add("robot_base_frame").text = self.prefix + self.robot.links[0].name
        odometry.add("odom_topic").text = self.prefix + TRUE_ODOMETRY
        odometry.add("odom_publish_frequency").text = number(self.robot.driver.rate)
        odometry.add("dimensions").text = "3"
        if self.share is not None:
            self._add_ros2_control(model, self.share)
            return
        states = add_system(model, "joint-state-publisher", "JointStatePublisher")
        states.add("topic").text = self.prefix + JOINT_STATES
        # By default, Gazebo publishes the states after each step, 1000 times a second.
        states.add("update_rate").text = number(self.robot.driver.rate)
        for joint in self.tree.moving:
            states.add("joint_name").text = self.prefix + joint.name
        topics = dict(joint_commands(self.robot))
        for actuator in self.robot.actuators:
            self._add_controller(model, actuator, self.prefix + topics[actuator.joint])
        for servo in self.robot.joint_servos:
            self._add_controller(model, servo, self.prefix + topics[servo.joint])

    def _add_ros2_control(self, model: Element, share: str) -> None:
        """Add the plug-in that runs a controller manager of ros2_control inside Gazebo.

        The plug-in reads the interfaces of the joints from the URDF that robot_state_publisher
        has, see ``ros2_control``.
        """
        plugin = model.add("plugin", filename=GZ_ROS2_CONTROL[0], name=GZ_ROS2_CONTROL[1])
        plugin.add("parameters").text = f"{share}/{CONTROLLER_FILE}"
        plugin.add("position_proportional_gain").text = number(POSITION_GAIN)
        if self.robot.namespace:
            plugin.add("ros").add("namespace").text = f"/{self.robot.namespace}"

    def _add_controller(self, model: Element, motor: Actuator | JointServo, topic: str) -> None:
        joint = motor.joint
        name = self.prefix + joint
        interface = motor.interface if isinstance(motor, JointServo) else _controlled_by(motor)
        if interface == "velocity":
            system = add_system(model, "joint-controller", "JointController")
            system.add("joint_name").text = name
            system.add("topic").text = topic
            return
        system = add_system(model, "joint-position-controller", "JointPositionController")
        system.add("joint_name").text = name
        system.add("topic").text = topic
        # The controller asks for the speed that reaches the target within one step, up to the
        # largest speed of the joint.
        system.add("use_velocity_commands").text = "true"
        speed = self.tree.joints[joint].velocity
        if isinstance(motor, Actuator):
            speed = motor.max_velocity
        else:
            system.add("initial_position").text = number(motor.initial)
        if speed:
            system.add("cmd_max").text = number(speed)
            system.add("cmd_min").text = number(-speed)


def _controlled_by(actuator: Actuator) -> str:
    return "velocity" if actuator.role == "propulsion" else "position"


def rigid_contact_shapes(tree: JointTree, wheel: Wheel) -> tuple[Collision, ...]:
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
        Collision(Cylinder(wheel.radius_named(t.name), t.width), Pose(t.center, turned))
        for t in wheel.treads
    )
    return (Collision(Sphere(sphere.radius), Pose(sphere.center)), *rings)
