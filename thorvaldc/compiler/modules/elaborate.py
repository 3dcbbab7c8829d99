"""From module instances to the robot: one tree of links and joints, wheels, motors, bus."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from thorvaldc.compiler.bus.assemble_buses import connect_actuators
from thorvaldc.compiler.bus.lock_file import Lock
from thorvaldc.compiler.bus.wiring import Wiring
from thorvaldc.compiler.geometry.static_loads import (
    PlacedWheel,
    contact_point,
    free_pivots,
    ground_height,
    make_wheels,
    spring_reference,
    static_loads,
)
from thorvaldc.compiler.modules.calculator_choice import read_calculator
from thorvaldc.compiler.modules.driver_settings import DEFAULT_RATE, DriverParameters
from thorvaldc.compiler.modules.hardware import Hardware, hardware_of
from thorvaldc.compiler.modules.instance import Instance, name_prefix, used_by
from thorvaldc.compiler.modules.references import References
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.modules.twist_inputs import TwistInputs
from thorvaldc.compiler.modules.wheel_calibration import (
    MOST_RADIUS,
    calibrate_steering,
    calibrate_wheels,
    load_calibration,
    raise_axles,
)
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.robot import (
    Actuator,
    Battery,
    Collision,
    Cylinder,
    Joint,
    Link,
    Mesh,
    Robot,
    Sensor,
    Wheel,
)
from thorvaldc.model.spatial import Pose, Vec3, clean, cross, norm, scale
from thorvaldc.model.statics.joint_tree import JointTree

HEIGHT_TOLERANCE = 1e-3


@dataclass
class _Parts:
    """What is gathered while the modules are walked through."""

    links: list[Link] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    actuators: list[Actuator] = field(default_factory=list)
    wheels: list[PlacedWheel] = field(default_factory=list)
    sensors: list[Sensor] = field(default_factory=list)
    batteries: list[Battery] = field(default_factory=list)
    meshes: dict[str, Mesh] = field(default_factory=dict)
    mounts: dict[str, Instance] = field(default_factory=dict)


class Elaborator:
    """Makes the model of a resolved robot.

    ``base_dir`` is the folder of the robot file, for what it refers to; ``files``
    gets the files that were read besides, by their names in spans; ``lock`` holds the
    ids of the last build.
    """

    def __init__(
        self,
        document: Node,
        resolver: Resolver,
        base_dir: Path,
        report: Report,
        files: dict[str, Path],
        lock: Lock,
    ) -> None:
        self.document = document
        self.resolver = resolver
        self.base_dir = base_dir
        self.files = files
        # What is said of the robot as a whole is said where it is named.
        self.span = (document.get("name") or document).span
        self.lock = lock
        self.report = report
        self.scope = Scope(None, {}, resolver.library, report, None)

    def elaborate(self, robot: Instance, whole: bool) -> Robot | None:
        """The robot, or ``None`` where its tree is not whole (reported).

        Then nothing is said about its geometry, which would be that of another
        robot; the bus is checked in either case.
        """
        parts = _Parts(links=[Link("base_link", "", None, (), (), self.span)])
        calibration = load_calibration(self.document, self.base_dir, self.report, self.files)
        hardware: dict[str, Hardware] = {}
        self.resolver.library.palette(self.report)
        for leaf in robot.leaves():
            if leaf.type is None:
                continue
            with self.report.used_by(used_by(leaf.path, leaf.span)):
                own = hardware_of(leaf.type, leaf.scope, self.report)
            if own is not None:
                hardware[leaf.path] = own
        if self.report.has_errors or not whole:
            for leaf in robot.leaves():
                if leaf.path in hardware:
                    self._place_joints(leaf, hardware[leaf.path], parts)
            self._check_bus(robot, parts)
            return None
        for leaf in robot.leaves():
            if leaf.is_mechanical:
                self._place(leaf, hardware, parts)
                self._place_joints(leaf, hardware[leaf.path], parts)
        self._check_names(parts)
        extensions = self._add_extras(robot, hardware, parts)
        if self.report.has_errors:
            self._check_bus(robot, parts)
            return None
        tree = JointTree(parts.links, parts.joints)
        if calibration is not None:
            measured = calibrate_wheels(calibration, parts.wheels, self.report)
            raise_axles(parts.joints, tree, parts.wheels, measured)
            parts.wheels = measured
            tree = JointTree(parts.links, parts.joints)
        lift = clean(ground_height(tree, parts.wheels, self.report))
        self._lift(parts, lift, robot, hardware)
        tree = JointTree(parts.links, parts.joints)
        self._wheel_collisions(parts, tree)
        actuated = {a.joint: a for a in parts.actuators}
        wheels = make_wheels(tree, parts.wheels, actuated, self.report)
        if calibration is not None:
            calibrate_steering(calibration, parts.actuators, wheels, self.report)
        body = tree.inertial()
        pivots = free_pivots(tree, wheels, actuated)
        loads = static_loads([contact_point(w) for w in wheels], body, pivots) if body.mass else []
        wheels = [replace(w, load=clean(n)) for w, n in zip(wheels, loads, strict=False)]
        joints = tuple(self._sprung(j, tree, wheels) for j in parts.joints)
        sound = not self.report.has_errors
        # A limit that the modules allow stays right where a wheel was measured to be smaller.
        tolerance = 1e-6 if calibration is None else MOST_RADIUS
        parameters = DriverParameters(
            self.document, self.scope, wheels, actuated, tolerance, self.report
        )
        driver = parameters.driver()
        parameter_sets = parameters.sets(driver)
        inputs = TwistInputs(self.document, self.scope, self.report)
        sources, locks = inputs.sources(driver.command_timeout), inputs.locks()
        buses = self._wiring(parts, self.report).buses(robot, 1.0 / driver.rate)
        if not sound:
            return None
        return Robot(
            name=self.scope.text(self.document.get("name")),
            namespace=self.scope.text(self.document.get("namespace")),
            description=self.scope.text(self.document.get("description")),
            links=tuple(parts.links),
            joints=joints,
            wheels=tuple(wheels),
            actuators=connect_actuators(parts.actuators, buses),
            sensors=tuple(parts.sensors),
            batteries=tuple(parts.batteries),
            buses=buses,
            meshes=tuple(parts.meshes.values()),
            calculator=read_calculator(self.document, self.scope),
            driver=driver,
            inertial=body.clean(),
            span=self.span,
            urdf_extensions=extensions,
            parameter_sets=parameter_sets,
            twist_sources=sources,
            twist_locks=locks,
        )

    # -- links, joints, motors ------------------------------------------------------------

    def _wiring(self, parts: _Parts, report: Report) -> Wiring:
        actuators = {a.name: a for a in parts.actuators}
        joints = {joint.name: joint for joint in parts.joints}
        return Wiring(
            self.document, self.resolver, self.scope, actuators, joints, self.lock, report
        )

    def _check_bus(self, robot: Instance, parts: _Parts) -> None:
        """The bus of a robot that is at fault already; warnings would be about its holes."""
        found = Report()
        self._wiring(parts, found).buses(robot, 1.0 / DEFAULT_RATE)
        for fault in found.errors:
            self.report.put(fault)

    def _place(self, leaf: Instance, hardware: dict[str, Hardware], parts: _Parts) -> None:
        own = hardware[leaf.path]
        prefix = name_prefix(leaf.path)
        for mesh in own.meshes:
            parts.meshes[mesh.name] = mesh
        for link in own.links:
            parts.links.append(
                Link(
                    f"{prefix}_{link.name}",
                    leaf.path,
                    link.inertial,
                    link.visuals,
                    link.collisions,
                    leaf.span,
                )
            )
        parts.joints.append(self._mount_joint(leaf, own, hardware, prefix))
        if own.wheel is not None:
            parts.wheels.append(
                PlacedWheel(prefix, leaf.path, f"{prefix}_{own.wheel.link}", own.wheel, leaf.span)
            )
        if own.sensor is not None:
            s = own.sensor
            parts.sensors.append(
                Sensor(prefix, leaf.path, s.type, f"{prefix}_{s.link}", s.properties, leaf.span)
            )
        if own.battery is not None:
            b = own.battery
            node = prefix if b.present else None
            parts.batteries.append(
                Battery(prefix, leaf.path, f"{prefix}_{b.link}", node, b.properties, leaf.span)
            )

    def _place_joints(self, leaf: Instance, own: Hardware, parts: _Parts) -> None:
        prefix = name_prefix(leaf.path)
        motors = {motor.joint: motor for motor in own.motors}
        limits: dict[str, tuple[float, float]] = {}
        for joint in own.joints:
            motor = motors.get(joint.name)
            effort, velocity = joint.effort, joint.velocity
            if motor is not None:  # the weaker and the slower of joint and motor
                effort = min(motor.max_torque, math.inf if effort is None else effort)
                velocity = min(motor.max_velocity, math.inf if velocity is None else velocity)
                velocity = clean(velocity)
                limits[joint.name] = (effort, velocity)
            parts.joints.append(
                Joint(
                    name=f"{prefix}_{joint.name}",
                    module=leaf.path,
                    type=joint.type,
                    parent=f"{prefix}_{joint.parent}",
                    child=f"{prefix}_{joint.child}",
                    pose=joint.pose,
                    span=leaf.span,
                    axis=joint.axis,
                    lower=joint.lower,
                    upper=joint.upper,
                    effort=effort,
                    velocity=velocity,
                    damping=joint.damping,
                    friction=joint.friction,
                    stiffness=joint.stiffness,
                    armature=clean(motor.armature) if motor is not None else 0.0,
                    role=joint.role,
                )
            )
        for motor in own.motors:
            effort, velocity = limits.get(motor.joint, (motor.max_torque, motor.max_velocity))
            parts.actuators.append(
                Actuator(
                    name=f"{prefix}_{motor.name}",
                    module=leaf.path,
                    joint=f"{prefix}_{motor.joint}",
                    role=motor.role,
                    gear_ratio=motor.gear_ratio,
                    motor_max_speed=motor.motor_max_speed,
                    encoder_ppr=motor.encoder_ppr,
                    max_velocity=velocity,
                    max_acceleration=clean(motor.max_acceleration),
                    max_torque=effort,
                    armature=clean(motor.armature),
                    node=None,
                    channel=None,
                    span=leaf.span,
                )
            )

    def _mount_joint(
        self, leaf: Instance, own: Hardware, hardware: dict[str, Hardware], prefix: str
    ) -> Joint:
        child = f"{prefix}_{own.links[0].name}"
        if leaf.mount is None:
            parent, pose = "base_link", Pose()
        else:
            holder = hardware[leaf.mount.leaf.path]
            link = leaf.mount.link or holder.links[0].name
            parent = f"{name_prefix(leaf.mount.leaf.path)}_{link}"
            pose = leaf.mount.pose * own.mount_pose.inverse()
        return Joint(f"{prefix}_mount", leaf.path, "fixed", parent, child, pose.clean(), leaf.span)

    def _check_names(self, parts: _Parts) -> None:
        for word, elements in (("link", parts.links), ("joint", parts.joints)):
            first: dict[str, Link | Joint] = {}
            for element in elements:
                other = first.setdefault(element.name, element)
                if other is not element:
                    self.report.add(
                        "name-twice",
                        f"two {word}s come out as `{element.name}`: "
                        f"of `{other.module or 'the base'}` and of `{element.module}`",
                        element.span,
                        labels=[Label(other.span, "the first one")],
                        hint="rename one of the modules",
                    )

    # -- extras ---------------------------------------------------------------------------

    def _add_extras(
        self, robot: Instance, hardware: dict[str, Hardware], parts: _Parts
    ) -> tuple[str, ...]:
        extras = self.document.get("extras")
        if extras is None or not isinstance(extras.value, tuple):
            return ()
        from thorvaldc.compiler.extras.extras import Attachment, load_extras

        roots = {
            name_prefix(path): f"{name_prefix(path)}_{own.links[0].name}"
            for path, own in hardware.items()
            if own.links
        }
        named = {
            leaf.path: roots[name_prefix(leaf.path)]
            for leaf in robot.leaves()
            if name_prefix(leaf.path) in roots
        }
        links = {link.name: link.span for link in parts.links}

        def resolve(text: str) -> tuple[str, Pose] | None:
            """A link and a pose in it for `module`, `module.port` or a link's own name."""
            if text in links:
                return text, Pose()
            if text in named:
                return named[text], Pose()
            quiet = References(Report())
            asked = Node(text, self.document.span)
            found = quiet.find_port(robot, text, asked)
            if found is not None and found[0].type is not None:
                leaf, port = found
                socket = leaf.type.section("ports")[port] if leaf.type else None
                if socket is not None and name_prefix(leaf.path) in roots:
                    link = leaf.scope.text(socket.get("link")) or hardware[leaf.path].links[0].name
                    return f"{name_prefix(leaf.path)}_{link}", leaf.scope.pose(socket)
            part = quiet.find(robot, text, asked)
            if part is not None and not part[1]:
                for leaf in part[0].leaves():
                    if leaf.path in named:
                        return named[leaf.path], Pose()
            return None

        def attach(text: str | None) -> Attachment | None:
            place = (parts.links[1].name, Pose()) if text is None else resolve(text)
            return Attachment(*place) if place is not None else None

        found = load_extras(
            extras.value,
            self.base_dir,
            links=links,
            joints={joint.name: joint.span for joint in parts.joints},
            attach=attach,
            report=self.report,
        )
        self.files.update(found.files)
        parts.links.extend(found.links)
        parts.joints.extend(found.joints)
        for mesh in found.meshes:
            parts.meshes[mesh.name] = mesh
        return found.urdf_extensions

    # -- the base -------------------------------------------------------------------------

    def _lift(
        self, parts: _Parts, lift: float, robot: Instance, hardware: dict[str, Hardware]
    ) -> None:
        """Put the root at its height, and compare with what its module says of it."""
        for i, joint in enumerate(parts.joints):
            if joint.parent == "base_link" and joint.type == "fixed" and joint.module:
                root = hardware.get(joint.module)
                if root is None:
                    continue
                xyz = (joint.pose.xyz[0], joint.pose.xyz[1], joint.pose.xyz[2] + lift)
                parts.joints[i] = replace(joint, pose=Pose(xyz, joint.pose.quat).clean())
                stated = root.height_above_ground
                if not parts.wheels and stated is not None:
                    lifted = (xyz[0], xyz[1], stated)
                    parts.joints[i] = replace(joint, pose=Pose(lifted, joint.pose.quat))
                elif stated is not None and abs(stated - xyz[2]) > HEIGHT_TOLERANCE:
                    self.report.add(
                        "frame-height",
                        f"`{joint.module}` says its height is {stated * 1000:.6g} mm; "
                        f"on these wheels it is {xyz[2] * 1000:.6g} mm",
                        joint.span,
                        hint=f"set `height: {xyz[2] * 1000:.6g} mm`, leave it out, "
                        "or choose legs of another length",
                    )

    def _wheel_collisions(self, parts: _Parts, tree: JointTree) -> None:
        """A wheel's link gets its cylinder, along the axis that it spins about."""
        index = {link.name: i for i, link in enumerate(parts.links)}
        for wheel in parts.wheels:
            spin = next((j for j in tree.joints_above(wheel.link) if j.type != "fixed"), None)
            if spin is None:
                continue
            to_wheel = tree.pose[wheel.link].inverse()
            axis = to_wheel.rotate(tree.pose[spin.child].rotate(spin.axis))
            pose = Pose(quat=_turn_z_to(axis)).clean()
            shape = Cylinder(wheel.part.radius, wheel.part.width)
            i = index[wheel.link]
            others = parts.links[i].collisions
            parts.links[i] = replace(parts.links[i], collisions=(Collision(shape, pose), *others))

    def _sprung(self, joint: Joint, tree: JointTree, wheels: list[Wheel]) -> Joint:
        if joint.stiffness <= 0.0:
            return joint
        return replace(
            joint, spring_reference=spring_reference(joint, tree, wheels, [w.load for w in wheels])
        )


def _turn_z_to(axis: Vec3) -> tuple[float, float, float, float]:
    """The shortest rotation that takes z to a unit vector (a half turn about x for -z)."""
    if axis[2] < -1 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    v = cross((0.0, 0.0, 1.0), axis)
    w = 1.0 + axis[2]
    n = math.sqrt(w * w + norm(v) ** 2)
    x, y, z = scale(1.0 / n, v)
    return (w / n, x, y, z)


def elaborate(
    document: Node,
    resolver: Resolver,
    base_dir: Path,
    report: Report,
    files: dict[str, Path],
    lost: Iterable[str] = (),
    *,
    whole: bool = True,
    lock: Lock | None = None,
) -> Robot | None:
    """Resolve and elaborate a robot document; ``None`` where its tree is not whole.

    There may be a robot although the report has errors: of its bus, say.
    ``files`` gets the files that were read besides, by their names in spans;
    ``lost`` names modules that were taken out of the document for their faults;
    ``whole`` is false where any value of its modules was; ``lock`` holds the ids of
    the last build.
    """
    instance = resolver.resolve(document, lost)
    return Elaborator(document, resolver, base_dir, report, files, lock or {}).elaborate(
        instance, whole
    )
