"""Reads the section `couplings` of robots and modules, and couples the joints.

A coupling such as a differential bar or a pair of gears makes a joint follow another one:

    position of `joint` = ratio * position of `follows` + offset.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from thorvaldc.compiler.hardware.robot_parts import RobotParts
from thorvaldc.compiler.modules.module_parameters import hint_of_known
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.port_references import References
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Joint, Mimic
from thorvaldc.model.statics.passive_joints import Coordinate, Member, follow


def couple_joints(
    document: Node, robot: Instance, parts: RobotParts, references: References, report: Report
) -> None:
    """Sets the leader of each joint that follows another one, and reports impossible couplings.

    ``document`` is the robot document, whose couplings may also name joints of extras.
    """
    coupler = _Coupler(parts, references, report)
    for instance, node in _couplings(document, robot):
        coupler.couple(instance, node)
    parts.joints = [coupler.joints[joint.name] for joint in parts.joints]


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
        scope = instance.scope
        ratio_node, offset_node = node.get("ratio"), node.get("offset")
        ratio = scope.quantity(ratio_node, "number", 1.0)
        quantity = "length" if joint.type == "prismatic" else "angle"
        offset = scope.quantity(offset_node, quantity, 0.0)
        problem = self._problem(joint, leader, ratio)
        if problem is not None:
            message, hint, label = problem
            labels = [label] if label is not None else []
            at = ratio_node if ratio == 0.0 and ratio_node is not None else node.get("joint")
            span = at.span if at is not None else node.where
            self.report.add("coupling-impossible", message, span, labels=labels, hint=hint)
            return
        self.joints[joint.name] = replace(joint, mimic=Mimic(leader.name, ratio, offset))
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
        self, joint: Joint, leader: Joint, ratio: float
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

    def _joint(self, instance: Instance, node: Node | None) -> Joint | None:
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
