"""Collects the links, joints and devices of all modules of a robot, and couples joints.

A coupling such as a differential bar or a pair of gears makes a joint follow another one::

    position of `joint` = ratio * position of `follows` + offset
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from types import MappingProxyType
from typing import Any, TypeVar

from thorvaldc import model
from thorvaldc.compiler.hardware.hardware_reader import Hardware
from thorvaldc.compiler.modules.module_parameters import hint_of_known
from thorvaldc.compiler.modules.module_tree import Instance, References, name_prefix
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Report, Span, millimetres
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.joint_tree import Coordinate, Member, follow
from thorvaldc.schema import inlined

Placed = TypeVar(
    "Placed", model.Link, model.Joint, model.Actuator, model.Wheel, model.Sensor, model.Battery
)
Device = TypeVar("Device", model.Wheel, model.Sensor, model.Battery)

# Allowed difference (m) between the computed height of the root module and the height in the module
# document.
HEIGHT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class RobotParts:
    """The links, joints, actuators, wheels, sensors, batteries and meshes of a robot.

    ``joint_servos`` and ``urdf_extensions`` are those of extras.

    The name of a link or joint is ``<module>_<name>``.  The part ``<module>`` is the path of the
    module instance with underscores instead of dots.  The part ``<name>`` is the name of the link
    or joint in the module document.
    """

    links: tuple[model.Link, ...] = ()
    joints: tuple[model.Joint, ...] = ()
    actuators: tuple[model.Actuator, ...] = ()
    wheels: tuple[model.Wheel, ...] = ()
    sensors: tuple[model.Sensor, ...] = ()
    batteries: tuple[model.Battery, ...] = ()
    meshes: tuple[model.Mesh, ...] = ()
    joint_servos: tuple[model.JointServo, ...] = ()
    urdf_extensions: tuple[str, ...] = ()

    @classmethod
    def joined(cls, parts: Sequence[RobotParts]) -> RobotParts:
        """Returns all parts in order.  Of meshes with one name, one remains."""
        all_parts: dict[str, Any] = {
            field.name: tuple(chain.from_iterable(getattr(part, field.name) for part in parts))
            for field in fields(cls)
        }
        all_parts["meshes"] = tuple({mesh.name: mesh for mesh in all_parts["meshes"]}.values())
        return cls(**all_parts)

    @classmethod
    def of_modules(
        cls, leaves: Iterable[Instance], hardware: Mapping[str, Hardware], span: Span
    ) -> RobotParts:
        """Returns ``base_link`` and the parts of the modules.

        ``hardware`` contains the links, joints and devices of each module, by the path of the
        module.  ``span``: span of ``base_link``.
        """
        base_link = model.Link("base_link", "", None, (), (), span)
        return cls.joined([cls((base_link,)), *(_placed_module(leaf, hardware) for leaf in leaves)])

    @classmethod
    def moving(cls, leaf: Instance, hardware: Hardware) -> RobotParts:
        """Returns the joints and motors of a module."""
        prefix = name_prefix(leaf.path)
        return cls(
            joints=tuple(
                _placed(
                    joint,
                    leaf,
                    parent=f"{prefix}_{joint.parent}",
                    child=f"{prefix}_{joint.child}",
                )
                for joint in hardware.joints
            ),
            actuators=tuple(
                _placed(motor, leaf, joint=f"{prefix}_{motor.joint}") for motor in hardware.motors
            ),
        )

    def check_names(self, report: Report) -> None:
        """Reports two links or two joints with the same name.

        For example, the links of the modules `a_b.c` and `a.b_c` have the same prefix `a_b_c`.
        """
        for word, elements in (("link", self.links), ("joint", self.joints)):
            first_by_name: dict[str, model.Link | model.Joint] = {}
            for element in elements:
                first = first_by_name.setdefault(element.name, element)
                if first is not element:
                    report.add(
                        "name-twice",
                        f"two {word}s have the name `{element.name}`: "
                        f"one of `{first.module or 'the base'}` and one of `{element.module}`",
                        element.span,
                        labels=[Label(first.span, "the first one")],
                        hint="rename one of the modules",
                    )

    def raised(self, height: float, hardware: Mapping[str, Hardware], report: Report) -> RobotParts:
        """Returns the robot raised by ``height`` (m), so that the wheels stand on the ground.

        The module document may state the height of the root module above the ground.  A difference
        between ``height`` and the height in the module document is reported.  The root module of a
        robot without wheels is placed at the height in the module document.
        """
        joints = list(self.joints)
        for i, joint in enumerate(joints):
            if joint.parent != "base_link" or joint.type != "fixed" or not joint.module:
                continue
            root = hardware.get(joint.module)
            if root is None:
                continue
            x, y, z = joint.pose.xyz
            z += height
            joints[i] = replace(joint, pose=model.Pose((x, y, z), joint.pose.quat).clean())
            stated = root.height_above_ground
            if not self.wheels and stated is not None:
                joints[i] = replace(joint, pose=model.Pose((x, y, stated), joint.pose.quat))
            elif stated is not None and abs(stated - z) > HEIGHT_TOLERANCE:
                report.add(
                    "frame-height",
                    f"`{joint.module}` states a height of {millimetres(stated, 6)}; "
                    f"on these wheels it is {millimetres(z, 6)}",
                    joint.span,
                    hint=f"set `height: {millimetres(z, 6)}`, leave it out, "
                    "or choose legs of another length",
                )
        return replace(self, joints=tuple(joints))


def _placed_module(leaf: Instance, hardware: Mapping[str, Hardware]) -> RobotParts:
    """Returns the links, joints, motors and devices of a mounted module."""
    part, prefix = hardware[leaf.path], name_prefix(leaf.path)

    def device(element: Device | None, **changes: str | None) -> tuple[Device, ...]:
        if element is None:
            return ()
        return (_placed(element, leaf, name=prefix, link=f"{prefix}_{element.link}", **changes),)

    moving = RobotParts.moving(leaf, part)
    has_node = part.battery is not None and part.battery.node is not None
    return replace(
        moving,
        links=tuple(_placed(link, leaf) for link in part.links),
        joints=(_mount_joint(leaf, hardware), *moving.joints),
        wheels=device(part.wheel),
        sensors=device(part.sensor),
        batteries=device(part.battery, node=prefix if has_node else None),
        meshes=part.meshes,
    )


def modules_of(
    robot: Instance,
    hardware: Mapping[str, Hardware],
    purchases: Mapping[str, model.Purchase] = MappingProxyType({}),
) -> tuple[model.Module, ...]:
    """Returns the modules of the robot that are not assemblies, in the order of the file.

    ``purchases``: purchase data in the robot document, by module type or path of a module.
    """
    modules = []
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        mounted = leaf.is_mechanical
        modules.append(
            model.Module(
                leaf.path,
                leaf.type.name,
                leaf.mount.leaf.path if mounted and leaf.mount is not None else "",
                mounted,
                masses_by_source(hardware[leaf.path].masses) if mounted else (),
                leaf.span,
                _purchase_of(leaf, hardware, purchases),
            )
        )
    return tuple(modules)


def _purchase_of(
    leaf: Instance, hardware: Mapping[str, Hardware], purchases: Mapping[str, model.Purchase]
) -> model.Purchase:
    """Returns the purchase data of a module.

    A value that the robot document states for the module replaces the one for its type, which
    replaces the one in the module document.
    """
    purchase = hardware[leaf.path].purchase
    names = (leaf.type.name if leaf.type is not None else "", leaf.path)
    for stated in (purchases[name] for name in names if name in purchases):
        if stated.price is not None:
            purchase = replace(purchase, price=stated.price, currency=stated.currency)
        if stated.supplier:
            purchase = replace(purchase, supplier=stated.supplier)
        if stated.lead_time is not None:
            purchase = replace(purchase, lead_time=stated.lead_time)
    return purchase


def masses_by_source(parts: Iterable[model.SourcedMass]) -> tuple[model.SourcedMass, ...]:
    """Returns the sum of the masses of each source, in the order of the sources."""
    masses: dict[str, float] = {}
    for part in parts:
        masses[part.source] = masses.get(part.source, 0.0) + part.mass
    return tuple(model.SourcedMass(clean(mass), source) for source, mass in masses.items())


def _placed(element: Placed, leaf: Instance, **changes: str | None) -> Placed:
    """Returns an element of a module's hardware as an element of the robot.

    ``changes``: names of other elements in the robot.  Without a new ``name``, the element gets
    the name of the module as a prefix.
    """
    changes.setdefault("name", f"{name_prefix(leaf.path)}_{element.name}")
    return replace(element, module=leaf.path, span=leaf.span, **changes)  # type: ignore[arg-type]


def _mount_joint(leaf: Instance, hardware: Mapping[str, Hardware]) -> model.Joint:
    """Returns the fixed joint between the carrying link and the first link of a leaf module."""
    part = hardware[leaf.path]
    prefix = name_prefix(leaf.path)
    child = f"{prefix}_{part.links[0].name}"
    if leaf.mount is None:
        parent, pose = "base_link", model.Pose()
    else:
        carrier = leaf.mount.leaf
        link = leaf.mount.link or hardware[carrier.path].links[0].name
        parent = f"{name_prefix(carrier.path)}_{link}"
        pose = leaf.mount.pose * part.mount_pose.inverse()
    return model.Joint(
        f"{prefix}_mount", leaf.path, "fixed", parent, child, pose.clean(), leaf.span
    )


# -- couplings ---------------------------------------------------------------------------


def couple_joints(
    document: Node, robot: Instance, parts: RobotParts, references: References, report: Report
) -> RobotParts:
    """Returns the robot with coupled joints, and reports impossible couplings.

    ``document`` is the robot document, whose couplings may also name joints of extras.
    """
    coupler = _Coupler(parts, references, report)
    for instance, node in _couplings(document, robot):
        coupler.couple(instance, node)
    return replace(parts, joints=tuple(coupler.joints.values()))


def _couplings(document: Node, instance: Instance) -> Iterator[tuple[Instance, Node]]:
    """Yields the couplings of an instance and of all modules inside it."""
    source = instance.type.document if instance.type is not None else document
    if not instance.is_leaf or instance.is_mechanical:
        for node in entries(source.get("couplings")).values():
            if instance.scope.boolean(node.get("when"), True):
                yield instance, node
    for child in instance.children.values():
        yield from _couplings(document, child)


class _Coupler:
    """The joints of a robot while they are coupled one after the other."""

    def __init__(self, parts: RobotParts, references: References, report: Report) -> None:
        self.joints = {joint.name: joint for joint in parts.joints}
        self.motors = {actuator.joint: actuator.span for actuator in parts.actuators}
        self.motors |= {servo.joint: servo.span for servo in parts.joint_servos}
        self.references = references
        self.report = report
        self.coupled_at: dict[str, Span] = {}

    def couple(self, instance: Instance, node: Node) -> None:
        """Makes the joint of a coupling follow its leader."""
        joint = self._joint(instance, node.get("joint"))
        leader = self._joint(instance, node.get("follows"))
        if joint is None or leader is None:
            return
        schema = inlined("robot")["properties"]["couplings"]["additionalProperties"]
        section = Section(node, schema, instance.scope, int(joint.type == "prismatic"))
        ratio, offset = section["ratio"], section["offset"]
        ratio_node, offset_node = node.get("ratio"), node.get("offset")
        problem = self._problem(joint, leader, ratio)
        if problem is not None:
            message, hint, label = problem
            labels = [label] if label is not None else []
            at = ratio_node if ratio == 0.0 and ratio_node is not None else node.get("joint")
            span = at.span if at is not None else node.where
            self.report.add("coupling-impossible", message, span, labels=labels, hint=hint)
            return
        self.joints[joint.name] = replace(joint, mimic=model.Mimic(leader.name, ratio, offset))
        self.coupled_at[joint.name] = node.where
        low, high = Coordinate((Member(leader, 1.0, 0.0), Member(joint, ratio, offset))).limits()
        if low > high:
            self.report.add(
                "coupling-impossible",
                f"no position of `{leader.name}` brings `{joint.name}` within its limits",
                offset_node.span if offset_node is not None else node.where,
                hint="change `ratio` or `offset`, or the limits of the joints",
            )

    def _problem(
        self, joint: model.Joint, leader: model.Joint, ratio: float
    ) -> tuple[str, str, Label | None] | None:
        """Returns message, hint and label if a joint cannot follow its leader."""
        if joint is leader:
            return (
                f"the joint `{joint.name}` follows itself",
                "name two different joints in `joint` and `follows`",
                None,
            )
        for end in (joint, leader):
            if end.type == "fixed":
                return f"the joint `{end.name}` is fixed", "name a joint that moves", None
        if ratio == 0.0:
            return (
                f"with the ratio 0, the joint `{joint.name}` does not move",
                "write the motion of `joint` per motion of `follows`, such as -1 for a "
                "differential",
                None,
            )
        if joint.mimic is not None:
            return (
                f"the joint `{joint.name}` follows `{joint.mimic.joint}` and `{leader.name}`",
                "a joint has one leader: couple the leaders to each other",
                Label(self.coupled_at.get(joint.name, joint.span), "the first leader"),
            )
        if joint.name in self.motors:
            return (
                f"the joint `{joint.name}` has a motor and cannot follow `{leader.name}`",
                "exchange `joint` and `follows`, or leave the motor out",
                Label(self.motors[joint.name], "its motor"),
            )
        chain = follow(leader, self.joints)
        if chain is None or chain.joint.name == joint.name:
            return (
                f"the joint `{leader.name}` follows `{joint.name}` through other couplings",
                "leave one of the couplings out: they form a cycle",
                Label(self.coupled_at.get(leader.name, leader.span), "a coupling of the cycle"),
            )
        return None

    def _joint(self, instance: Instance, node: Node | None) -> model.Joint | None:
        """Returns the joint that a reference such as ``left.pivot`` names."""
        if node is None or not isinstance(node.value, str):
            return None
        reference = node.value
        if instance.is_leaf or "." not in reference:
            path, name = (instance.path, reference) if instance.is_leaf else ("", reference)
        else:
            part_and_rest = self.references.find(instance, reference, node)
            if part_and_rest is None:
                return None
            path, name = part_and_rest[0].path, ".".join(part_and_rest[1])
        full_name = f"{name_prefix(path)}_{name}" if path else name
        joint = self.joints.get(full_name)
        if joint is not None and path in ("", joint.module):
            return joint
        known = [
            j.name.removeprefix(name_prefix(path) + "_")
            for j in self.joints.values()
            if j.module == path and j.type != "fixed"
        ]
        self.report.add(
            "coupling-joint-unknown",
            f"`{path}` has no joint `{name}`" if path and name else f"`{reference}` is no joint",
            node.span,
            hint=hint_of_known(name, known, reference)
            if known and name
            else "name a joint of a module, such as `left_rocker.pivot`",
        )
        return None
