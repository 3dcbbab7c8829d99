"""One robot in MJCF: its bodies, joints, geoms, sensors and actuators, and the sections of a model
that all robots share: options, defaults and assets."""

from __future__ import annotations

import math
from collections.abc import Iterable

from thorvaldc import model
from thorvaldc.backends.description_parts import NEGLIGIBLE, Palette
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model.number_origins import derived
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.model.spatial import clean, quat_from_z_to
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.occupied_space import FLANGE_THICKNESS
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.standing_pose import solve_statics
from thorvaldc.model.statics.wheel_contact import SOLIMP, SOLREF, WheelContact

TIMESTEP = 0.005  # s
# Largest d h / I of a servo for which the model uses MuJoCo's explicit integrator. The implicit
# integrators apply the damping of the motor joints after the contact forces. With MuJoCo's implicit
# integrators, an accelerating robot is ahead of its wheels by 5 ms. With MuJoCo's explicit
# integrator, an accelerating robot is not ahead of its wheels. For a joint with the inertia I and
# the damping d, an explicit step of h s multiplies the joint speed by 1 - d h / I. The explicit
# integrator is therefore stable for d h / I < 2, with the joint damping d, the time step h and the
# joint inertia I. MuJoCo models of robots with wheels that must slide use an implicit integrator.
# With the explicit integrator, sliding wheels would chatter if d h / I is above 1, because friction
# is their only load (d: joint damping, h: time step, I: joint inertia).
EXPLICIT_DAMPING = 1.5
SAME_AXLE = 1e-3  # m and rad, largest distance and angle between two wheels on the same axle
DEFLECTION = 0.02  # rad, position error at which a servo applies the effort limit
LINEAR_DEFLECTION = 0.002  # m, the same for a prismatic joint
FREQUENCY = 20.0  # rad/s, natural frequency of a joint without an effort limit
LAG = 4 * TIMESTEP  # s, least ratio of damping and stiffness
# Torsional friction coefficient (m) of a tyre, divided by the friction coefficient mu times the
# tyre width. A tyre that turns on the spot has the resisting torque mu N width / 4, with the
# friction coefficient mu, the wheel load N and a contact patch as wide as the tyre. A rolling tyre
# deforms, so it resists turning less than a standing tyre. MuJoCo has only one torsional friction
# coefficient for standing and rolling tyres, and torsional and sliding friction share one friction
# cone. In simulated turns, a robot with two driven wheels and casters drifts outwards by up to 2.1
# % of the turn with the ratio 1/4, and by 0.4 % with the ratio 1/16.
TORSION = 1 / 16
ROLLING_FRICTION = 0.0005  # third friction coefficient of MuJoCo, not used with condim 4
DRIVE_FREQUENCY = 20.0  # rad/s, natural frequency of the propulsion servo
DRIVE_DAMPING = 1.0  # damping ratio: critical
# s, time constant of a ``velocity`` servo of a drive with its share of the robot's mass. On a slope
# of 10 degrees, such a robot creeps by 6 to 7 mm/s. With 2 ms it creeps by 3 mm/s, but the torque
# of robots with few driven wheels then jumps between its limits in ramps.
VELOCITY_TIME = 0.005
STEERING_STIFFNESS = 4000.0  # N m/rad
WORLD = "world"  # name of the root body in MuJoCo

# In the simulation, robots collide with the world and with other robots. The parts of one robot do
# not collide with each other, because the parts overlap at the joints. In MuJoCo, two geoms collide
# if contype1 & conaffinity2 or contype2 & conaffinity1 is not 0. Robot number i has the contype i
# and the conaffinity ~i (the bitwise complement of i). Two parts of robot number i do not collide,
# because i & ~i is 0. Parts of the robots number i and j collide, because i & ~j or j & ~i is not 0
# for different numbers i and j. Objects of the MuJoCo world have the default values contype 1 and
# conaffinity 1. Each robot collides with the objects of the MuJoCo world, because bit 0 is set in
# the contype or in the conaffinity of the robot.
_ALL_BITS = 0x7FFFFFFF


class ModelSections:
    """Collects the sections of an MJCF model with one or several robots."""

    def __init__(self, name: str, robots: list[model.Robot], mesh_folders: list[str]) -> None:
        self.model = name
        self.palette = Palette(*robots)
        self.folders = mesh_folders
        self.robots = robots
        self.worldbody = Element("worldbody")
        self.equality = Element("equality")
        self.actuators = Element("actuator")
        self.sensors = Element("sensor")
        self.asset = Element("asset")
        for material, color in self.palette.entries():
            self.asset.add("material", name=material, rgba=color)
        self.meshes: dict[tuple[str, tuple[float, ...]], str] = {}
        self.taken: dict[str, str] = {}
        # Largest ratio d h / I of all servos (d: joint damping, h: time step, I: joint inertia),
        # see EXPLICIT_DAMPING.
        self.largest_damping = 0.0

    def root(self) -> Element:
        """Return the root element ``mujoco`` of the MJCF model.

        The method ``root`` must be called after all robots are written to the MJCF model.
        """
        root = Element("mujoco", model=self.model)
        # With "false", Drake, Newton and Pinocchio refuse bodies without ``inertial``. For MuJoCo,
        # "auto" is the same, because the shapes of bodies without mass have the mass 0.
        root.add(
            "compiler",
            angle="radian",
            autolimits=True,
            inertiafromgeom="auto",
            balanceinertia=False,
        )
        # MuJoCo uses a dense Jacobian by default for fewer than 60 degrees of freedom. A sparse
        # Jacobian is better for these robots, because the rows of the wheels are mostly zeros.
        explicit = self.largest_damping <= EXPLICIT_DAMPING and not any(map(_slides, self.robots))
        root.add(
            "option",
            timestep=TIMESTEP,
            integrator="Euler" if explicit else "implicitfast",
            cone="elliptic",
            impratio=100,
            jacobian="sparse",
        )
        default = root.add("default")
        default.add("default", class_="visual").add(
            "geom", group=2, contype=0, conaffinity=0, mass=0
        )
        default.add("default", class_="collision").add("geom", group=3, mass=0)
        default.add("default", class_="wheel").add(
            "geom",
            type="ellipsoid",
            group=3,
            mass=0,
            condim=4,
            priority=1,
            solref=SOLREF,
            solimp=SOLIMP,
        )
        sections = (self.asset, self.worldbody, self.equality, self.actuators, self.sensors)
        root.children += [section for section in sections if section.children]
        return root

    def mesh(self, prefix: str, number: int, mesh: model.Mesh, scale: model.Vec3) -> str:
        """Return the name of the MJCF asset for a mesh file with a scale.

        Equal mesh files with the same scale share one asset.
        """
        key = (mesh.sha256, tuple(map(float, scale)))
        name = self.meshes.get(key)
        if name is None:
            # Mesh files can have names that differ only in the extension. A mesh file can be used
            # with several scales. The name of an MJCF asset is therefore made unique.
            name = stem = prefix + mesh.name.rsplit(".", 1)[0]
            for count in range(2, len(self.meshes) + 2):
                if name not in self.taken:
                    break
                name = f"{stem}_{count}"
            self.taken[name] = mesh.name
            self.meshes[key] = name
            self.asset.add(
                "mesh",
                name=name,
                file=f"{self.folders[number]}/{derived(mesh.name, scale)}",
                scale=None if scale == (1.0, 1.0, 1.0) else scale,
                # MuJoCo does not use the inertia of mesh files, because the MJCF model contains all
                # masses. MuJoCo's default value of the mesh attribute ``inertia`` fails for open
                # and flat meshes.
                inertia="shell",
            )
        return name


def _slides(robot: model.Robot) -> bool:
    """True if some wheels of a robot must slide sideways when the robot turns.

    Wheels must slide in a turn if the wheels that cannot steer or swivel are on several axles.
    """
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    for wheel in fixed[1:]:
        c, s = math.cos(fixed[0].heading), math.sin(fixed[0].heading)
        along = c * (wheel.x - fixed[0].x) + s * (wheel.y - fixed[0].y)
        if abs(along) > SAME_AXLE or abs(math.sin(wheel.heading - fixed[0].heading)) > SAME_AXLE:
            return True
    return False


def _free(name: str, taken: Iterable[str]) -> str:
    """Return an MJCF name, with underscores appended until the name is not in ``taken``."""
    names = set(taken)
    while name in names:
        name += "_"
    return name


def body_names(robot: model.Robot) -> dict[str, str]:
    """Return a dictionary from link names to MJCF body names.

    An MJCF body name begins with the name space of the robot. The body name ``world`` is reserved
    in MJCF and is never used for a link.
    """
    prefix = robot.prefix
    names = {link.name: prefix + link.name for link in robot.links}
    if names.get(WORLD) == WORLD:
        names[WORLD] = _free(f"{WORLD}_link", names)
    return names


class RobotWriter:
    """Writes one robot into the sections of an MJCF model."""

    def __init__(
        self,
        sections: ModelSections,
        robot: model.Robot,
        number: int,
        *,
        velocity_servos: bool = False,
        visuals: bool = True,
    ) -> None:
        """Prepare to write a robot. With ``velocity_servos``, servos that are commanded a speed are
        ``velocity`` instead of ``intvelocity``. Without ``visuals``, the visual shapes are left
        out; the physics is the same."""
        self.velocity_servos = velocity_servos
        self.visuals = visuals
        self.sections = sections
        self.robot = robot
        self.number = number
        self.statics = solve_statics(robot)
        self.prefix = robot.prefix
        self.tree = tree_of(robot)
        self.meshes = {mesh.name: mesh for mesh in robot.meshes}
        self.wheel_of_link = {wheel.link: wheel for wheel in robot.wheels}
        self.wheel_of_joint = {wheel.spin_joint: wheel for wheel in robot.wheels}
        self.actuated = {actuator.joint for actuator in robot.actuators}
        self.actuated |= {servo.joint for servo in robot.joint_servos}
        standing = standing_of(robot)
        self.carrying = standing.positions.keys() if standing is not None else frozenset[str]()
        contype = (number + 1) & _ALL_BITS
        self.bits = {"contype": contype, "conaffinity": _ALL_BITS & ~contype}

    def write(self, pose: model.Pose | None) -> None:
        robot, prefix = self.robot, self.prefix
        bodies: dict[str, Element] = {}
        names = body_names(robot)
        for name in self.tree.order:
            link = self.tree.links[name]
            joint = self.tree.parent_joint.get(name)
            if joint is None:
                body = self.sections.worldbody.add("body", name=names[link.name])
                if pose is not None:
                    _place(body, pose)
                base = _free("floating_base", self.tree.joints)
                body.add("freejoint", name=prefix + base)
            else:
                body = bodies[joint.parent].add("body", name=names[link.name])
                _place(body, joint.pose)
                if joint.type != "fixed":
                    self._add_joint(body, joint)
            bodies[link.name] = body
            self._add_link(body, link)
        for sensor in robot.sensors:
            self._add_sensor(bodies[sensor.link], sensor)
        driven = sum(1 for wheel in robot.wheels if wheel.driven)
        for actuator in robot.actuators:
            self._add_actuator(actuator, driven)
        for servo in robot.joint_servos:
            self._add_joint_servo(servo)
        for joint in self.tree.moving:
            if joint.name in self.actuated or joint.role == "suspension":
                name = prefix + joint.name
                self.sections.sensors.add("jointpos", name=f"{name}_position", joint=name)
                self.sections.sensors.add("jointvel", name=f"{name}_velocity", joint=name)

    # -- bodies -----------------------------------------------------------------

    def _add_joint(self, body: Element, joint: model.Joint) -> None:
        friction = joint.friction
        wheel = self.wheel_of_joint.get(joint.name)
        if wheel is not None:
            force = self.statics.wheels[wheel.name].force
            friction = clean(friction + wheel.rolling_resistance * force * wheel.radius)
        limits = _limits(joint)
        body.add(
            "joint",
            name=self.prefix + joint.name,
            type="slide" if joint.type == "prismatic" else "hinge",
            axis=derived(joint.axis, joint.damping, joint.armature, joint.stiffness),
            range=limits,
            damping=joint.damping or None,
            frictionloss=friction or None,
            armature=joint.armature or None,
            stiffness=joint.stiffness or None,
            springref=joint.spring_reference if joint.stiffness else None,
        )
        if joint.mimic is not None:
            # A differential that carries a body must not yield to its weight. The default of MuJoCo
            # is softer; light fingers would chatter on a stiff coupling.
            carries = joint.name in self.carrying
            self.sections.equality.add(
                "joint",
                joint1=self.prefix + joint.name,
                joint2=self.prefix + joint.mimic.joint,
                polycoef=(joint.mimic.offset, joint.mimic.multiplier, 0, 0, 0),
                solref=(0.01, 1) if carries else None,
                solimp=(0.99, 0.999, 0.001) if carries else None,
            )

    def _add_link(self, body: Element, link: model.Link) -> None:
        inertial = link.inertial
        if inertial is None and any(isinstance(c.shape, model.MeshShape) for c in link.collisions):
            inertial = NEGLIGIBLE
        if inertial is not None:
            body.add("inertial", pos=inertial.com, mass=inertial.mass, fullinertia=inertial.inertia)
        for visual in link.visuals if self.visuals else ():
            geom = body.add("geom", class_="visual")
            self._shape(geom, visual.shape, visual.pose)
            geom.set(material=self.sections.palette.name(visual.color))
        wheel = self.wheel_of_link.get(link.name)
        if wheel is not None:
            self._add_tread(body, wheel, self.statics.wheels[wheel.name])
        else:
            for i, collision in enumerate(link.collisions):
                name = f"{self.prefix}{link.name}_collision_{i}"
                geom = body.add("geom", name=name, class_="collision", **self.bits)
                self._shape(geom, collision.shape, collision.pose)
        if link.inertial is None:
            # Pinocchio does not read the mass of shapes from default classes.
            for geom in body.children:
                if geom.tag == "geom":
                    geom.set(mass=0)

    def _shape(self, geom: Element, shape: model.Shape, pose: model.Pose) -> None:
        if isinstance(shape, model.MeshShape):
            mesh = self.meshes[shape.mesh]
            name = self.sections.mesh(self.prefix, self.number, mesh, shape.scale)
            geom.set(type="mesh", mesh=name)
        else:
            set_shape(geom, shape)
        _place(geom, pose)

    def _add_tread(self, body: Element, wheel: model.Wheel, contact: WheelContact) -> None:
        """Add the collision ellipsoid of a wheel.

        The collision ellipsoid replaces the collision shapes of the wheel's link.
        """
        axis = contact.axis
        x, y, z = axis
        shift = contact.offset
        geom = body.add("geom", name=f"{self.prefix}{wheel.link}_tread", class_="wheel")
        geom.set(**self.bits)
        geom.set(size=(contact.radius, contact.radius, contact.half_width))
        center = model.Pose((shift * x, shift * y, shift * z), quat_from_z_to(axis)).clean()
        _place(geom, center)
        mu = wheel.friction
        geom.set(friction=(mu, clean(mu * wheel.width * TORSION), ROLLING_FRICTION))
        geom.set(solref=_solref(contact))
        for tread in wheel.treads:
            self._add_ring(body, wheel, tread, contact)

    def _add_ring(
        self, body: Element, wheel: model.Wheel, tread: model.Tread, contact: WheelContact
    ) -> None:
        """Add the collision shape of a tread: a ring beside the tyre that rolls on a rail.

        The flanges of the ring guide the wheel on the rail.
        """
        radius = wheel.radius_named(tread.name)
        name = f"{self.prefix}{wheel.link}_{tread.name}"
        mu, half = wheel.friction, tread.width / 2
        ring = body.add("geom", name=name, class_="wheel", **self.bits)
        ring.set(type="cylinder", size=(clean(radius + contact.penetration / 2), half))
        ring.set(friction=(mu, clean(mu * tread.width * TORSION), ROLLING_FRICTION))
        ring.set(solref=_solref(contact))
        turned = quat_from_z_to(contact.axis)
        _place(ring, model.Pose(tread.center, turned).clean())
        for side in (1, -1) if tread.flange else ():
            shift = side * (half + FLANGE_THICKNESS / 2)
            center = tuple(c + shift * a for c, a in zip(tread.center, contact.axis, strict=True))
            flange = body.add(
                "geom", name=f"{name}_flange_{'left' if side > 0 else 'right'}", class_="wheel"
            )
            flange.set(**self.bits)
            flange.set(
                type="cylinder", size=(clean(radius + tread.flange), FLANGE_THICKNESS / 2), condim=1
            )
            _place(flange, model.Pose((center[0], center[1], center[2]), turned).clean())

    # -- sensors and actuators -----------------------------------------------

    def _add_sensor(self, body: Element, sensor: model.Sensor) -> None:
        name = self.prefix + sensor.name
        body.add("site", name=name, group=4, size=0.01)
        if sensor.type == "imu":
            self.sections.sensors.add("gyro", name=f"{name}_gyro", site=name)
            self.sections.sensors.add("accelerometer", name=f"{name}_accelerometer", site=name)
        elif sensor.type == "camera":
            # The optical frame of a camera looks along its z axis, and its y axis points down. A
            # MuJoCo camera looks along its -z axis, and its y axis points up.
            camera = body.add("camera", name=name, quat=(0, 1, 0, 0))
            values = sensor_numbers(sensor)
            width, height = values["image_width"], values["image_height"]
            across = math.tan(values["horizontal_field_of_view"] / 2) * height / width
            camera.set(fovy=clean(math.degrees(2 * math.atan(across))))
            camera.set(resolution=(int(width), int(height)))

    def _add_actuator(self, actuator: model.Actuator, driven: int) -> None:
        joint = self.tree.joints[actuator.joint]
        torque, speed = actuator.max_torque, actuator.max_velocity
        names = {"name": self.prefix + actuator.name, "joint": self.prefix + actuator.joint}
        joint_inertia = self.statics.inertias[actuator.joint] + joint.armature
        if actuator.role == "steering":
            self.sections.actuators.add(
                "position",
                **names,
                kp=STEERING_STIFFNESS,
                dampratio=1,
                ctrlrange=_limits(joint),
                forcerange=(-torque, torque),
            )
            self._note_damping(2 * math.sqrt(STEERING_STIFFNESS * joint_inertia), joint_inertia)
            return
        inertia = joint_inertia
        wheel = self.wheel_of_joint.get(actuator.joint)
        if wheel is not None and driven:
            inertia += self.robot.inertial.mass * wheel.radius**2 / driven
        # For a joint with the inertia I, a second-order servo with the natural frequency w and the
        # damping ratio D has the gains kp = I w^2 and kv = 2 D I w. The speed servo of MuJoCo
        # (``intvelocity``) integrates the speed set point to an angle. The speed servo holds the
        # integrated angle, so the robot stands still on a slope. The integrated angle of a speed
        # servo has no limit.
        if self.velocity_servos:
            self._add_velocity_servo(names, inertia / VELOCITY_TIME, joint_inertia, torque, speed)
            return
        damping = 2 * DRIVE_DAMPING * inertia * DRIVE_FREQUENCY
        self._note_damping(damping, joint_inertia)
        self.sections.actuators.add(
            "intvelocity",
            **names,
            kp=clean(inertia * DRIVE_FREQUENCY**2),
            kv=clean(damping),
            ctrlrange=(-speed, speed),
            forcerange=(-torque, torque),
            actlimited=False,
        )

    def _add_velocity_servo(
        self,
        names: dict[str, str],
        damping: float,
        inertia: float,
        effort: float | None,
        speed: float | None,
    ) -> None:
        self._note_damping(damping, inertia)
        self.sections.actuators.add(
            "velocity",
            **names,
            kv=clean(damping),
            ctrlrange=(-speed, speed) if speed else None,
            forcerange=(-effort, effort) if effort else None,
        )

    def _add_joint_servo(self, servo: model.JointServo) -> None:
        joint = self.tree.joints[servo.joint]
        inertia = self.statics.inertias[servo.joint] + joint.armature
        stiffness, damping = _servo_gains(joint, inertia)
        limits = _limits(joint)
        motors = [actuator.name for actuator in self.robot.actuators]
        if self.velocity_servos and servo.interface == "velocity":
            names = {"name": self.prefix + _free(servo.joint, motors)}
            names["joint"] = self.prefix + servo.joint
            self._add_velocity_servo(names, damping, inertia, joint.effort, joint.velocity)
            return
        element = self.sections.actuators.add(
            "position" if servo.interface == "position" else "intvelocity",
            name=self.prefix + _free(servo.joint, motors),
            joint=self.prefix + servo.joint,
            kp=stiffness,
            kv=damping,
            forcerange=(-joint.effort, joint.effort) if joint.effort else None,
        )
        if servo.interface == "position":
            element.set(ctrlrange=limits)
        else:
            speed = joint.velocity
            element.set(ctrlrange=(-speed, speed) if speed else None)
            element.set(actrange=limits, actlimited=limits is not None)
        self._note_damping(damping, inertia)

    def _note_damping(self, damping: float, inertia: float) -> None:
        ratio = damping * TIMESTEP / inertia if inertia > 0.0 else math.inf
        self.sections.largest_damping = max(self.sections.largest_damping, ratio)


def set_shape(geom: Element, shape: model.Shape) -> None:
    """Give a geom its shape, except for a mesh, which is an asset of the model."""
    match shape:
        case model.Box((x, y, z)):
            geom.set(type="box", size=(x / 2, y / 2, z / 2))
        case model.Cylinder(radius, length):
            geom.set(type="cylinder", size=(radius, length / 2))
        case model.MeshShape():
            raise TypeError("a mesh is an asset")
        case _:
            geom.set(type="sphere", size=shape.radius)


def _limits(joint: model.Joint) -> tuple[float, float] | None:
    if joint.lower is None or joint.upper is None:
        return None
    return joint.lower, joint.upper


def _servo_gains(joint: model.Joint, inertia: float) -> tuple[float, float]:
    """Return stiffness and damping of the servo of a joint of an extra, such as an arm, in N m/rad
    or N/m and the same times s.

    - ``inertia``: inertia I that the joint carries, in kg m^2 or kg.

    A URDF states neither the gains of the controllers nor the inertia of the motors.  The gains
    therefore follow from the effort limit of the joint and the inertia:

    - Stiffness: kp = effort / DEFLECTION.  Under its own weight, an arm sags by the share of the
      effort limit that the weight needs, times DEFLECTION.  The arms of MuJoCo Menagerie, whose
      gains were chosen by hand, have 0.006 rad (Franka) to 0.075 rad (UR5e).  Without an effort
      limit, kp = I w^2 with w = FREQUENCY.
    - Damping: kv = 2 sqrt(kp I), which is critical for the joint alone, and at least kp LAG.  With
      the implicit integrator and the time step h, a servo is stable for any inertia if
      kv > kp h / 2: the last joints of arms carry much less inertia than their torque can hold.
    """
    deflection = LINEAR_DEFLECTION if joint.type == "prismatic" else DEFLECTION
    stiffness = joint.effort / deflection if joint.effort else inertia * FREQUENCY**2
    damping = max(2.0 * math.sqrt(stiffness * inertia), stiffness * LAG)
    return clean(stiffness), clean(damping)


def _solref(contact: WheelContact) -> tuple[float, float] | None:
    """Return MuJoCo's ``solref`` of a wheel, or ``None`` for the value of the default class."""
    return None if contact.damping_ratio == SOLREF[1] else (SOLREF[0], contact.damping_ratio)


def _place(element: Element, pose: model.Pose) -> None:
    element.attributes += derived("", pose)  # also of what is left out
    if pose.xyz != (0.0, 0.0, 0.0):
        element.set(pos=pose.xyz)
    if pose.quat != (1.0, 0.0, 0.0, 0.0):
        element.set(quat=pose.quat)
