"""Reads the joints and motors of a module document."""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.hardware.module_values import ModuleValues
from thorvaldc.compiler.modules.module_parameters import hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model.robot import Actuator, Brake, Joint
from thorvaldc.model.spatial import Vec3, clean, norm, scale


def read_joints(values: ModuleValues) -> tuple[Joint, ...]:
    """Returns the joints of a module, and checks that the joints and links form a tree.

    Joints with a false condition `when` are left out.
    """
    joints = tuple(
        _JointReader(values, name, node).read()
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


class _JointReader:
    """Reads one joint of a module document.

    The limits of a prismatic joint are linear quantities, such as a length and a force.  The
    limits of all other joints are rotational quantities, such as an angle and a torque.
    """

    def __init__(self, values: ModuleValues, name: str, node: Node) -> None:
        self.values = values
        self.name = name
        self.node = node
        self.type = values.scope.text(node.get("type"), "fixed")
        linear = self.type == "prismatic"
        self.position = "length" if linear else "angle"
        self.velocity = "velocity" if linear else "angular_velocity"
        self.effort = "force" if linear else "torque"
        self.stiffness = "stiffness" if linear else "rotational_stiffness"
        self.damping = "damping" if linear else "rotational_damping"

    def read(self) -> Joint:
        """Returns the joint of a module document, and reports errors."""
        values, node = self.values, self.node
        axis = self._axis()
        lower, upper = self._limits()
        spring = node.get("spring")
        stiffness = spring_damping = 0.0
        if spring is not None:
            stiffness = values.not_negative(spring, "stiffness", self.stiffness)
            spring_damping = values.not_negative(spring, "damping", self.damping)
        is_continuous = self.type == "continuous"
        return Joint(
            name=self.name,
            module="",
            type=self.type,
            parent=values.link_name(node.get("parent")),
            child=values.link_name(node.get("child")),
            pose=values.scope.pose(node).clean(),
            span=node.where,
            axis=axis,
            lower=None if is_continuous else lower,
            upper=None if is_continuous else upper,
            effort=self._positive_or_none("effort", self.effort),
            velocity=self._positive_or_none("velocity", self.velocity),
            damping=spring_damping + values.not_negative(node, "damping", self.damping),
            friction=values.not_negative(node, "friction", self.effort),
            stiffness=stiffness,
            role=values.scope.text(node.get("role")),
        )

    def _axis(self) -> Vec3:
        """Returns the joint axis as a unit vector in the joint frame."""
        axis_node = self.node.get("axis")
        axis = self.values.scope.vector(axis_node, "ratio", (0.0, 0.0, 1.0))
        length = norm(axis)
        if length < 1e-9:
            self.values.report.add(
                "axis-zero",
                f"the axis of joint `{self.name}` has no direction",
                axis_node.span if axis_node is not None else self.node.where,
            )
            return (0.0, 0.0, 1.0)
        return axis if length == 1.0 else scale(1.0 / length, axis)

    def _limits(self) -> tuple[float | None, float | None]:
        """Returns the lower and upper position limits (m or rad), and checks the limits."""
        report = self.values.report
        lower_node, upper_node = self.node.get("lower"), self.node.get("upper")
        lower, upper = (
            self.values.scope.quantity(limit, self.position) if limit is not None else None
            for limit in (lower_node, upper_node)
        )
        if self.type in ("revolute", "prismatic"):
            for key, limit in (("lower", lower), ("upper", upper)):
                if limit is None:
                    report.add(
                        "joint-limit-missing",
                        f"joint `{self.name}` is {self.type} and has no `{key}`",
                        self.node.where,
                        hint="state it, or make the joint `continuous`"
                        if self.type == "revolute"
                        else "state it",
                    )
        if lower is not None and upper is not None and lower >= upper:
            report.add(
                "joint-limits-reversed",
                f"joint `{self.name}`: lower {plain(lower)} is not below upper {plain(upper)}",
                self.node.where,
            )
        return lower, upper

    def _positive_or_none(self, key: str, quantity: str) -> float | None:
        """Returns the positive physical quantity of a key, or ``None`` if the key is missing."""
        if self.node.get(key) is None:
            return None
        return self.values.positive(self.node, key, quantity, 1.0)


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


def _whole_number(values: ModuleValues, node: Node, key: str, default: int) -> int:
    """Returns a positive whole number, which an expression may compute."""
    value = values.positive(node, key, "ratio", default)
    entry = node.get(key)
    if value.is_integer() or entry is None:
        return int(value)
    values.report.add(
        "wrong-type", f"`{key}` is {value:.6g}; it must be a whole number", entry.span
    )
    return default


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
    gear_ratio = values.positive(node, "gear_ratio", "ratio", 1.0)
    motor_max_speed = values.positive(node, "motor_max_speed", "angular_velocity", 1.0)
    rotor_inertia = scope.quantity(node.get("rotor_inertia"), "inertia")
    encoder_ppr = _whole_number(values, node, "encoder_ppr", 1024)
    stated_velocity = scope.quantity(node.get("max_velocity"), "angular_velocity", math.inf)
    return Actuator(
        name=name,
        module="",
        joint=joint,
        role=scope.text(node.get("role")),
        gear_ratio=gear_ratio,
        motor_max_speed=motor_max_speed,
        encoder_ppr=encoder_ppr,
        max_velocity=min(stated_velocity, motor_max_speed / gear_ratio),
        max_acceleration=clean(
            values.positive(node, "max_acceleration", "angular_acceleration", 1.0)
        ),
        max_torque=values.positive(node, "max_torque", "torque", 1.0),
        # A gear with the ratio n multiplies the motor torque by n and divides the motor's
        # acceleration by n.  For a gear with the ratio n, the inertia of the rotor at the joint is
        # therefore n^2 times the inertia at the motor shaft.
        armature=clean(rotor_inertia * gear_ratio * gear_ratio),
        node=None,
        channel=None,
        span=node.where,
        back_driving_torque=clean(values.not_negative(node, "back_driving_torque", "torque")),
        brake=_read_brake(values, node.get("brake"), gear_ratio),
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


def _read_brake(values: ModuleValues, node: Node | None, gear_ratio: float) -> Brake | None:
    """Returns the brake of a motor, or ``None`` for `none` and for a false condition `when`."""
    if node is None or node.value == "none" or not values.is_present(node):
        return None
    return Brake(
        values.positive(node, "torque", "torque", 1.0) * gear_ratio,
        values.not_negative(node, "closing_time", "time"),
    )


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
