"""Reads the joints and motors of a module document."""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Report, plain
from thorvaldc.model import Actuator, Brake, Joint, Scalar, Vec3
from thorvaldc.model.spatial import clean, norm, scale
from thorvaldc.schema import inlined


class ModuleValues:
    """Reader of conditions, sizes and properties in a module document.

    Expressions in the module document use the parameter values in ``scope``.
    """

    def __init__(self, module: ModuleType, scope: Scope, report: Report) -> None:
        self.module = module
        self.scope = scope
        self.report = report
        links = module.section("links")
        self.link_names = [name for name, node in links.items() if self.is_present(node)]

    def is_present(self, node: Node) -> bool:
        """Returns the value of the condition `when`, or true if there is no condition."""
        return self.scope.boolean(node.get("when"), True)

    def link_name(self, node: Node | None) -> str:
        """Returns the link name that a node of a module document contains.

        If the module document contains no link name, the name of the first link is returned.  A
        link name that the module document does not define is reported.
        """
        first = self.link_names[0] if self.link_names else ""
        if node is None:
            return first
        name = self.scope.text(node)
        if name in self.link_names:
            return name
        if name:
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` has no link `{name}`",
                node.span,
                hint=hint_of_known(name, self.link_names),
            )
        return name or first

    def section(self, node: Node, key: str, alternative: int = 0) -> Section:
        """Returns an entry of a section of the module document such as `motors`, or the section
        itself, with its values in SI units.

        ``alternative``: as for ``Section``.
        """
        schema = inlined("module")["properties"][key]
        entry_schema = schema.get("additionalProperties") or schema
        return Section(node, entry_schema, self.scope, alternative)

    def properties(self, node: Node | None) -> tuple[tuple[str, Scalar], ...]:
        """Returns the properties in a mapping of a module document, by name.

        Properties with a unit are converted to SI units.
        """
        return tuple((key, self.scope.scalar(value, 0.0)) for key, value in entries(node).items())


def read_joints(values: ModuleValues) -> tuple[Joint, ...]:
    """Returns the joints of a module, and checks that the joints and links form a tree.

    Joints with a false condition `when` are left out.
    """
    joints = tuple(
        _read_joint(values, name, node)
        for name, node in values.module.section("joints").items()
        if values.is_present(node)
    )
    _check_tree(joints, values)
    return joints


def read_motors(values: ModuleValues, joints: tuple[Joint, ...]) -> tuple[Actuator, ...]:
    """Returns the motors of a module, and checks the joint of each motor.

    Motors with a false condition `when` are left out.
    """
    motors = tuple(
        _read_motor(values, name, node, joints)
        for name, node in values.module.section("motors").items()
        if values.is_present(node)
    )
    _check_motors(motors, joints, values)
    return motors


def _read_joint(values: ModuleValues, name: str, node: Node) -> Joint:
    """Returns a joint of a module document, and reports errors.

    The limits of a prismatic joint are linear quantities, such as a length and a force.  The
    limits of all other joints are rotational quantities, such as an angle and a torque, which the
    schema names first.
    """
    joint_type = values.scope.text(node.get("type"), "fixed")
    section = values.section(node, "joints", int(joint_type == "prismatic"))
    axis = _axis(name, section, values.report)
    lower, upper = _limits(name, joint_type, section, values.report)
    spring = section["spring"]
    is_continuous = joint_type == "continuous"
    return Joint(
        name=name,
        module="",
        type=joint_type,
        parent=values.link_name(node.get("parent")),
        child=values.link_name(node.get("child")),
        pose=section.pose().clean(),
        span=node.where,
        axis=axis,
        lower=None if is_continuous else lower,
        upper=None if is_continuous else upper,
        effort=section["effort"],
        velocity=section["velocity"],
        damping=spring["damping"] + section["damping"],
        friction=section["friction"],
        stiffness=spring["stiffness"] if "spring" in section else 0.0,
        role=values.scope.text(node.get("role")),
    )


def _axis(name: str, section: Section, report: Report) -> Vec3:
    """Returns the joint axis as a unit vector in the joint frame."""
    axis: Vec3 = section["axis"]
    length = norm(axis)
    if length < 1e-9:
        span = section.entry("axis").span
        report.add("axis-zero", f"the axis of joint `{name}` has no direction", span)
        return (0.0, 0.0, 1.0)
    return axis if length == 1.0 else scale(1.0 / length, axis)


def _limits(
    name: str, joint_type: str, section: Section, report: Report
) -> tuple[float | None, float | None]:
    """Returns the lower and upper position limits (m or rad), and checks the limits."""
    lower, upper, node = section["lower"], section["upper"], section.node
    for key in ("lower", "upper") if joint_type in ("revolute", "prismatic") else ():
        if node.get(key) is None:
            report.add(
                "joint-limit-missing",
                f"joint `{name}` is {joint_type} and has no `{key}`",
                node.where,
                hint="state it, or make the joint `continuous`"
                if joint_type == "revolute"
                else "state it",
            )
    if lower is not None and upper is not None and lower >= upper:
        report.add(
            "joint-limits-reversed",
            f"joint `{name}`: lower {plain(lower)} is not below upper {plain(upper)}",
            node.where,
        )
    return lower, upper


def _check_tree(joints: tuple[Joint, ...], values: ModuleValues) -> None:
    """Checks that the links and joints of a module form a tree.

    Every link except the first must be the child of exactly one joint.
    """
    first_links = values.link_names[:1]
    parent_joints: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in parent_joints or joint.child in first_links:
            values.report.add(
                "link-two-parents",
                f"link `{joint.child}` of `{values.module.name}` has two parents"
                if joint.child in parent_joints
                else f"the first link `{joint.child}` carries the mount and cannot be a child",
                joint.span,
            )
        parent_joints.setdefault(joint.child, joint)
    if values.report.has_errors:
        return
    children: dict[str, list[str]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint.child)
    connected = dict.fromkeys(first_links)
    stack = list(connected)
    while stack:
        links_below = children.get(stack.pop(), [])
        connected.update(dict.fromkeys(links_below))
        stack.extend(links_below)
    for name in values.link_names:
        if name not in connected:
            values.report.add(
                "link-unconnected",
                f"link `{name}` of `{values.module.name}` is not connected "
                f"to `{values.link_names[0]}`",
                values.module.section("links")[name].where,
                hint="add a joint whose child it is",
            )


def _read_motor(values: ModuleValues, name: str, node: Node, joints: tuple[Joint, ...]) -> Actuator:
    """Reads a motor and computes the limits of the motor at the joint."""
    scope = values.scope
    joint_node = node.get("joint")
    joint = scope.text(joint_node)
    joint_names = [part.name for part in joints]
    if joint_node is not None and joint not in joint_names:
        values.report.add(
            "joint-unknown",
            f"`{values.module.name}` has no joint `{joint}`",
            joint_node.span,
            hint=hint_of_known(joint, joint_names),
        )
    section = values.section(node, "motors")
    gear_ratio, motor_max_speed = section["gear_ratio"], section["motor_max_speed"]
    return Actuator(
        name=name,
        module="",
        joint=joint,
        role=scope.text(node.get("role")),
        gear_ratio=gear_ratio,
        motor_max_speed=motor_max_speed,
        encoder_ppr=section["encoder_ppr"],
        max_velocity=min(section.get("max_velocity", math.inf), motor_max_speed / gear_ratio),
        max_acceleration=clean(section["max_acceleration"]),
        max_torque=section["max_torque"],
        # A gear with the ratio n multiplies the motor torque by n and divides the motor's
        # acceleration by n.  For a gear with the ratio n, the inertia of the rotor at the joint is
        # therefore n^2 times the inertia at the motor shaft.
        armature=clean(section["rotor_inertia"] * gear_ratio * gear_ratio),
        node=None,
        channel=None,
        span=node.where,
        back_driving_torque=clean(section["back_driving_torque"]),
        brake=_read_brake(values, section, gear_ratio),
        inverted=scope.boolean(node.get("inverted"), False),
    )


def with_common_limits(
    joints: tuple[Joint, ...], motors: tuple[Actuator, ...]
) -> tuple[tuple[Joint, ...], tuple[Actuator, ...]]:
    """Returns joints and motors with the lower of the limits of a joint and of its motor.

    The joint gets the inertia of the rotor, too.
    """
    motor_of = {motor.joint: motor for motor in motors}
    limits: dict[str, tuple[float, float]] = {}
    limited_joints = []
    for joint in joints:
        motor = motor_of.get(joint.name)
        if motor is not None:
            effort = min(motor.max_torque, math.inf if joint.effort is None else joint.effort)
            velocity = math.inf if joint.velocity is None else joint.velocity
            velocity = clean(min(motor.max_velocity, velocity))
            limits[joint.name] = effort, velocity
            joint = replace(joint, effort=effort, velocity=velocity, armature=motor.armature)
        limited_joints.append(joint)
    limited_motors = []
    for motor in motors:
        effort, velocity = limits.get(motor.joint, (motor.max_torque, motor.max_velocity))
        limited_motors.append(replace(motor, max_torque=effort, max_velocity=velocity))
    return tuple(limited_joints), tuple(limited_motors)


def _read_brake(values: ModuleValues, motor: Section, gear_ratio: float) -> Brake | None:
    """Returns the brake of a motor, or ``None`` for `none` and for a false condition `when`."""
    brake = motor["brake"]
    if not isinstance(brake, Section) or not values.is_present(brake.node):
        return None
    return Brake(brake["torque"] * gear_ratio, brake["closing_time"])


def _check_motors(
    motors: tuple[Actuator, ...], joints: tuple[Joint, ...], values: ModuleValues
) -> None:
    """Checks that each motor turns a rotating joint, and that no joint has two motors."""
    types = {joint.name: joint.type for joint in joints}
    first_motors: dict[str, Actuator] = {}
    for motor in motors:
        joint_type = types.get(motor.joint)
        first = first_motors.setdefault(motor.joint, motor)
        if joint_type is not None and joint_type not in ("continuous", "revolute"):
            values.report.add(
                "motor-joint",
                f"motor `{motor.name}` is on joint `{motor.joint}`, which is {joint_type}",
                motor.span,
                hint="a motor turns a `continuous` or a `revolute` joint",
            )
        elif joint_type is not None and first is not motor:
            values.report.add(
                "motor-joint",
                f"motors `{first.name}` and `{motor.name}` are both on joint `{motor.joint}`",
                motor.span,
                labels=[Label(first.span, "the first one")],
                hint="combine them into one motor",
            )
