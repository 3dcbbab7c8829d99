"""What a module type with given parameters is made of: links, joints, ports, motors.

The result does not depend on where the module sits, so that nine equal drives
are worked out once.  Names are still the module's own.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Container, Iterator
from typing import NamedTuple

from thorvaldc.compiler.library import ModuleType
from thorvaldc.compiler.modules.link_parts import PartReader
from thorvaldc.compiler.modules.scope import Scope, hint_of_known
from thorvaldc.compiler.modules.value_reader import INVALID
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model.robot import Collision, Mesh, Scalar, Tread, Visual
from thorvaldc.model.spatial import Inertial, Pose, Vec3, combine, norm, scale

MAX_REPEATED = 1000  # of one part by its `for`


class LinkPart(NamedTuple):
    """A link of a module; ``inertial`` is ``None`` for a massless one."""

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    collisions: tuple[Collision, ...]
    span: Span


class JointPart(NamedTuple):
    """A joint of a module; ``spring`` is stiffness and damping, ``None`` for none."""

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
    """A motor; speeds in rad/s, torque in N m; limits at the joint."""

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
    """A module with its parameters filled in.  ``mount_pose``: where its first link is held."""

    links: tuple[LinkPart, ...]
    joints: tuple[JointPart, ...]
    motors: tuple[MotorPart, ...]
    wheel: WheelPart | None
    sensor: SensorPart | None
    battery: BatteryPart | None
    mount_pose: Pose
    meshes: tuple[Mesh, ...]
    height_above_ground: float | None


def hardware_of(module: ModuleType, scope: Scope, report: Report) -> Hardware | None:
    """The hardware of a leaf module; kept by the values of its parameters.

    ``None`` where a parameter is at fault (reported): what the module is made
    of is not known.
    """
    key = tuple(tuple(v) if isinstance(v, list) else v for v in scope.parameter_values())
    if any(value is INVALID for value in key):
        return None
    key = (*scope.library.palette().items(), *key)
    known = module.elaborated.get(key)
    if known is None:
        own = Report()
        outer, scope.report = scope.report, own
        try:
            known = (_Builder(module, scope, own).build(), own)
        finally:
            scope.report = outer
        module.elaborated[key] = known
    hardware: Hardware
    hardware, own = known
    report.extend(own)
    return hardware


class _Builder:
    def __init__(self, module: ModuleType, scope: Scope, report: Report) -> None:
        self.module = module
        self.scope = scope
        self.report = report
        self.parts = PartReader(module.folder, scope.library.palette(), report)
        self.link_names = [n for n, node in module.section("links").items() if self._present(node)]

    def build(self) -> Hardware:
        section = self.module.section
        if not self.link_names and (section("links") or section("joints")):
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` has no links with these parameters",
                next(iter({**section("joints"), **section("links")}.values())).where,
                hint="leave the whole module out instead: `type: none`",
            )
            return Hardware((), (), (), None, None, None, Pose(), (), None)
        links = tuple(self._link(name, section("links")[name]) for name in self.link_names)
        joints = tuple(
            self._joint(name, node)
            for name, node in section("joints").items()
            if self._present(node)
        )
        self._check_tree(joints)
        motors = tuple(
            self._motor(name, node, joints)
            for name, node in section("motors").items()
            if self._present(node)
        )
        self._check_motors(motors, joints)
        for port in section("ports").values():
            self._link_name(port.get("link"))
        document = self.module.document
        mount = document.get("mount")
        self._check_mount_link(mount)
        free = document.get("free_mount")
        if free is not None:
            self._link_name(free.get("link"))
        wheel, sensor, battery = (
            document.get("wheel"),
            document.get("sensor"),
            document.get("battery"),
        )
        height = document.get("height_above_ground")
        stated = self.scope.evaluate(height) if height is not None else None
        return Hardware(
            links,
            joints,
            motors,
            self._wheel(wheel) if wheel is not None and self._present(wheel) else None,
            self._sensor(sensor) if sensor is not None and self._present(sensor) else None,
            self._battery(battery) if battery is not None and self._present(battery) else None,
            self.scope.pose(mount) if mount is not None else Pose(),
            tuple(self.parts.meshes.values()),
            self.scope.quantity(height, "length") if stated is not None else None,
        )

    def _present(self, node: Node) -> bool:
        return self.scope.boolean(node.get("when"), True)

    def _link_name(self, node: Node | None) -> str:
        """The link that a key names; the root link where the key is left out."""
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

    def _check_mount_link(self, mount: Node | None) -> None:
        node = mount.get("link") if mount is not None else None
        if node is not None and self._link_name(node) in self.link_names[1:]:
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` is held by `{self.scope.text(node)}`, which is not its "
                f"first link, `{self.link_names[0]}`",
                node.span,
                hint="the first link carries the mount; write that link first",
            )

    # -- links ------------------------------------------------------------------------

    def _link(self, name: str, node: Node) -> LinkPart:
        visuals: list[Visual] = []
        collisions: list[Collision] = []
        masses: list[Inertial] = []
        parts = node.get("parts")
        for part in parts.value if parts is not None and isinstance(parts.value, tuple) else ():
            for scope in self._repeated(part):
                if scope.boolean(part.get("when"), True):
                    self.parts.read(part, scope, visuals, collisions, masses)
        inertial = combine(masses).clean() if masses else None
        return LinkPart(name, inertial, tuple(visuals), tuple(collisions), node.where)

    def _repeated(self, part: Node) -> list[Scope]:
        loop = part.get("for")
        if loop is None or not isinstance(loop.value, dict):
            return [self.scope]
        scopes = [self.scope]
        for name, node in loop.value.items():
            values = self.scope.evaluate(node) if isinstance(node.value, str) else node.value
            if not isinstance(values, tuple | list):
                self.report.add("wrong-type", "a list is wanted", node.span)
                values = ()
            items = [self._any(v) if isinstance(v, Node) else v for v in values]
            if len(scopes) * len(items) > MAX_REPEATED:
                self.report.add(
                    "too-many-parts",
                    f"a part is repeated {len(scopes) * len(items)} times; "
                    f"at most {MAX_REPEATED} are read",
                    loop.where,
                )
                return []
            scopes = [s.with_names({name: item}) for s in scopes for item in items]
        return scopes

    def _any(self, node: Node) -> Scalar:
        """A value of any kind; text with a unit in SI."""
        value = self.scope.evaluate(node)
        if isinstance(value, str) and not node.quoted:
            with contextlib.suppress(UnitError):
                return parse_any(value)
        return value if isinstance(value, bool | int | float | str) else 0.0

    # -- joints and motors ---------------------------------------------------------------

    def _joint(self, name: str, node: Node) -> JointPart:
        scope = self.scope
        kind = scope.text(node.get("type"), "fixed")
        linear = kind == "prismatic"
        position, speed = ("length", "velocity") if linear else ("angle", "angular_velocity")
        axis_node = node.get("axis")
        axis = scope.vector(axis_node, "ratio", (0.0, 0.0, 1.0))
        length = norm(axis)
        if length < 1e-9:
            self.report.add(
                "axis-zero",
                f"the axis of joint `{name}` has no direction",
                axis_node.span if axis_node is not None else node.where,
            )
            axis, length = (0.0, 0.0, 1.0), 1.0

        def optional(key: str, quantity: str) -> float | None:
            value = node.get(key)
            return scope.quantity(value, quantity) if value is not None else None

        def above_zero(key: str, quantity: str) -> float | None:
            return None if node.get(key) is None else self._above_zero(node, key, quantity, 1.0)

        lower, upper = optional("lower", position), optional("upper", position)
        if kind in ("revolute", "prismatic"):
            for key, limit in (("lower", lower), ("upper", upper)):
                if limit is None:
                    self.report.add(
                        "joint-limit-missing",
                        f"joint `{name}` is {kind} and has no `{key}`",
                        node.where,
                        hint="state it, or make the joint `continuous`"
                        if kind == "revolute"
                        else "state it",
                    )
        if lower is not None and upper is not None and lower >= upper:
            self.report.add(
                "joint-limits-reversed",
                f"joint `{name}`: lower {lower:g} is not below upper {upper:g}",
                node.where,
            )
        spring = node.get("spring")
        per = ("stiffness", "damping") if linear else ("rotational_stiffness", "rotational_damping")
        stiffness = damping = 0.0
        if spring is not None:
            stiffness = self._not_negative(spring, "stiffness", per[0])
            damping = self._not_negative(spring, "damping", per[1])
        return JointPart(
            name,
            kind,
            scope.text(node.get("role")),
            self._link_name(node.get("parent")),
            self._link_name(node.get("child")),
            scope.pose(node).clean(),
            axis if length == 1.0 else scale(1.0 / length, axis),
            lower if kind != "continuous" else None,
            upper if kind != "continuous" else None,
            above_zero("effort", "force" if linear else "torque"),
            above_zero("velocity", speed),
            damping + self._not_negative(node, "damping", per[1]),
            self._not_negative(node, "friction", "force" if linear else "torque"),
            stiffness,
            node.where,
        )

    def _check_tree(self, joints: tuple[JointPart, ...]) -> None:
        """Every link but the first is the child of exactly one joint, without loops."""
        parents: dict[str, JointPart] = {}
        for joint in joints:
            if joint.child in parents or joint.child in self.link_names[:1]:
                self.report.add(
                    "link-two-parents",
                    f"link `{joint.child}` of `{self.module.name}` has two parents"
                    if joint.child in parents
                    else f"the first link `{joint.child}` carries the mount and cannot be a child",
                    joint.span,
                )
            parents.setdefault(joint.child, joint)
        if self.report.has_errors:
            return
        children: dict[str, list[str]] = {}
        for joint in joints:
            children.setdefault(joint.parent, []).append(joint.child)
        reached = dict.fromkeys(self.link_names[:1])
        waiting = list(reached)
        while waiting:
            found = children.get(waiting.pop(), [])
            reached.update(dict.fromkeys(found))
            waiting.extend(found)
        for name in self.link_names:
            if name not in reached:
                self.report.add(
                    "link-unconnected",
                    f"link `{name}` of `{self.module.name}` is not connected "
                    f"to `{self.link_names[0]}`",
                    self.module.section("links")[name].where,
                    hint="add a joint whose child it is",
                )

    def _motor(self, name: str, node: Node, joints: tuple[JointPart, ...]) -> MotorPart:
        scope = self.scope
        joint_node = node.get("joint")
        joint = scope.text(joint_node)
        if joint_node is not None and joint not in [j.name for j in joints]:
            self.report.add(
                "joint-unknown",
                f"`{self.module.name}` has no joint `{joint}`",
                joint_node.span,
                hint=hint_of_known(joint, [j.name for j in joints]),
            )
        gear = self._above_zero(node, "gear_ratio", "ratio", 1.0)
        speed = self._above_zero(node, "motor_max_speed", "angular_velocity", 1.0)
        rotor = scope.quantity(node.get("rotor_inertia"), "inertia")
        ppr = self._above_zero(node, "encoder_ppr", "ratio", 1024.0)
        return MotorPart(
            name,
            joint,
            scope.text(node.get("role")),
            gear,
            round(ppr),
            speed,
            min(
                scope.quantity(node.get("max_velocity"), "angular_velocity", math.inf), speed / gear
            ),
            self._above_zero(node, "max_acceleration", "angular_acceleration", 1.0),
            self._above_zero(node, "max_torque", "torque", 1.0),
            rotor * gear * gear,
            node.where,
        )

    def _check_motors(self, motors: tuple[MotorPart, ...], joints: tuple[JointPart, ...]) -> None:
        """A motor turns a joint, alone."""
        types = {joint.name: joint.type for joint in joints}
        first: dict[str, MotorPart] = {}
        for motor in motors:
            kind = types.get(motor.joint)
            other = first.setdefault(motor.joint, motor)
            if kind is not None and kind not in ("continuous", "revolute"):
                self.report.add(
                    "motor-joint",
                    f"motor `{motor.name}` is on joint `{motor.joint}`, which is {kind}",
                    motor.span,
                    hint="a motor turns a `continuous` or a `revolute` joint",
                )
            elif kind is not None and other is not motor:
                self.report.add(
                    "motor-joint",
                    f"motors `{other.name}` and `{motor.name}` are both on joint `{motor.joint}`",
                    motor.span,
                    labels=[Label(other.span, "the first one")],
                    hint="put them together into one motor",
                )

    def _not_negative(self, node: Node, key: str, quantity: str) -> float:
        found = node.get(key)
        value = self.scope.quantity(found, quantity)
        if value < 0 and found is not None:
            self.report.add(
                "size-not-positive",
                f"`{key}` is {QUANTITIES[quantity].shown(value)}; it must not be negative",
                found.span,
            )
        return max(value, 0.0)

    def _above_zero(self, node: Node, key: str, quantity: str, default: float) -> float:
        found = node.get(key)
        value = self.scope.quantity(found, quantity, default)
        if value > 0:
            return value
        if found is not None:
            self.report.add(
                "size-not-positive",
                f"`{key}` is {QUANTITIES[quantity].shown(value)}; it must be positive",
                found.span,
            )
        return default

    # -- what the module is -----------------------------------------------------------------

    def _wheel(self, node: Node) -> WheelPart:
        scope = self.scope
        radii = node.get("radii")
        named = radii.value if radii is not None and isinstance(radii.value, dict) else {}
        return WheelPart(
            self._link_name(node.get("link")),
            self._above_zero(node, "radius", "length", 0.1),
            self._above_zero(node, "width", "length", 0.1),
            tuple((k, self._above_zero(radii, k, "length", 0.1)) for k in named) if radii else (),
            scope.quantity(node.get("friction"), "ratio", 0.8),
            scope.quantity(node.get("rolling_resistance"), "ratio", 0.0),
            tuple(self._treads(node.get("treads"), named)),
            node.where,
        )

    def _treads(self, node: Node | None, radii: Container[str]) -> Iterator[Tread]:
        entries = node.value if node is not None and isinstance(node.value, dict) else {}
        for name, entry in entries.items():
            if name not in radii:
                self.report.add(
                    "missing-key",
                    f"the ring `{name}` has no radius",
                    entry.where,
                    hint=f"add `radii: {{{name}: 90 mm}}`",
                )
                continue
            yield Tread(
                name,
                self.scope.vector(entry.get("xyz"), "length"),
                self._above_zero(entry, "width", "length", 0.1),
                self._not_negative(entry, "flange", "length"),
            )

    def _sensor(self, node: Node) -> SensorPart:
        return SensorPart(
            self.scope.text(node.get("type")),
            self._link_name(node.get("link")),
            self._properties(node.get("properties")),
        )

    def _battery(self, node: Node) -> BatteryPart:
        return BatteryPart(
            self.scope.boolean(node.get("present"), True),
            self._link_name(node.get("link")),
            self._properties(node.get("properties")),
        )

    def _properties(self, node: Node | None) -> tuple[tuple[str, Scalar], ...]:
        """Named values; text that is a quantity becomes its SI value."""
        entries = node.value if node is not None and isinstance(node.value, dict) else {}
        return tuple((key, self._any(item)) for key, item in entries.items())
