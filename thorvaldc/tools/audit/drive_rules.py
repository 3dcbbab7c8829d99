"""Rules about driving: wheels, limits of joints, speeds and stamps of twists."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

from thorvaldc.compiler.descriptions.description_rules import (
    judge_pair,
    right_name,
)
from thorvaldc.diagnostics import Label, Report, Span, plain
from thorvaldc.model import Cylinder, Joint, Pose, Sphere, Vec3
from thorvaldc.model.spatial import cross, dot, norm, sub
from thorvaldc.tools.audit import audit_facts
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, FileDescription
from thorvaldc.tools.audit.parameter_files import stamped_arguments

# An effective radius or separation under load may differ a little on purpose.
TOLERANCE = 0.01


def check_wheels(evidence: Evidence, report: Report) -> None:
    """Compares each stated wheel radius, wheel separation and wheelbase with the description."""
    for kind, measure, motion in (
        ("wheel radius", _true_radius, "drives"),
        ("wheel separation", partial(_true_distance, axis=1), "turns"),
        ("wheelbase", partial(_true_distance, axis=0), ""),
    ):
        code = "audit-wheel-radius" if kind == "wheel radius" else "audit-wheel-separation"
        for fact, true in _differing(kind, measure, evidence):
            # The distance grows with the radius; the angle is inverse to the separation.
            further = true.value / fact.value if motion == "drives" else fact.value / true.value
            percent = 100.0 * (further - 1.0)
            effect = (
                f": the robot {motion} {abs(percent):.2g} %"
                f" {'further' if percent > 0 else 'less far'} than its odometry says"
            )
            report.add(
                code,
                f"{fact.subject} computes with a {kind} of {plain(fact.value)} m, but"
                f" {true.subject} has {plain(true.value)} m{effect if motion else ''}",
                fact.span,
                hint="write the measured value in all files; corrections for load and slip belong"
                " in the multipliers of the controller",
                labels=[Label(true.span, f"{plain(true.value)} m here")],
            )


def check_sides(evidence: Evidence, report: Report) -> None:
    """Reports drives whose left wheels are on the right, or turn about another axis."""
    facts = [fact for _, fact in evidence.described("wheel separation")]
    for fact in (*facts, *evidence.stated("wheel separation")):
        middle = fact.names.index("")
        names = tuple(filter(None, fact.names))
        for description in evidence.related(fact.span.file, names)[:1]:
            for pair in zip(fact.names[:middle], fact.names[middle + 1 :], strict=False):
                left, right = map(description.joints.get, pair)
                is_judged = right_name(pair[0]) == pair[1]  # by the names in the description
                if left is not None and right is not None and not is_judged:
                    judge_pair(description, left, right, report, (fact.subject, fact.span))


def _differing(
    kind: str, measure: Callable[[FileDescription, Fact], Fact | None], evidence: Evidence
) -> list[tuple[Fact, Fact]]:
    """Returns pairs of a statement and the geometry that it contradicts.

    A statement that agrees with one of the descriptions to which it can belong is left out.
    """
    places = [(fact, [description]) for description, fact in evidence.described(kind)]
    for fact in evidence.stated(kind):
        joints = tuple(name for name in fact.names if name)
        places.append((fact, evidence.related(fact.span.file, joints)))
    pairs: list[tuple[Fact, Fact]] = []
    for fact, descriptions in places:
        if fact.value > 0.0:
            values = [true for d in descriptions if (true := measure(d, fact)) is not None]
            if values and all(_differs(fact, true) for true in values):
                pairs.append((fact, min(values, key=lambda true: abs(true.value - fact.value))))
    return pairs


def _differs(fact: Fact, true: Fact) -> bool:
    ratio = float(fact.value) / float(true.value)
    return abs(ratio - 1.0) > TOLERANCE + 1e-9


def _true_radius(description: FileDescription, fact: Fact) -> Fact | None:
    """Returns the wheel whose radius is next to a stated radius."""
    radii = [
        radius
        for name in fact.names
        if name in description.joints
        and (radius := wheel_radius(description, description.joints[name])) is not None
    ]
    return min(radii, key=lambda radius: abs(radius.value - fact.value), default=None)


def _true_distance(description: FileDescription, fact: Fact, axis: int) -> Fact | None:
    """Returns the distance along an axis between the two groups of wheels of a statement.

    ``axis``: 1 for the lateral distance of left and right wheels, 0 for that of front and rear.
    """
    middle = fact.names.index("")
    sides: list[float] = []
    for names in (fact.names[:middle], fact.names[middle + 1 :]):
        centers = [
            center
            for name in names
            if name in description.joints
            and (center := wheel_center(description, description.joints[name])) is not None
        ]
        if len(centers) < len(names) or not centers:
            return None
        along = sorted(center[axis] for center in centers)
        sides.append(along[len(along) // 2])
    first = description.joints[fact.names[0]]
    distance = abs(sides[0] - sides[1])
    if distance < 1e-6:
        return None
    return Fact(fact.kind, f"the description `{description.name}`", distance, first.span)


def wheel_radius(description: FileDescription, joint: Joint) -> Fact | None:
    """Returns the radius of the wheel that a joint turns, from its shapes, or ``None``."""
    tyre = _tyre(description, joint)
    if tyre is None:
        return None
    return Fact("wheel radius", f"joint `{joint.name}`", tyre.shape.radius, tyre.span, "m")


def wheel_center(description: FileDescription, joint: Joint) -> Vec3 | None:
    """Returns the centre of the wheel that a joint turns in the frame of the root, or ``None``.

    A wheel without shapes is at the joint.  The centre of a wheel that is only a mesh is unknown,
    because the mesh can lie beside the joint.
    """
    link = description.poses.get(joint.child)
    if link is None:
        return None
    tyre = _tyre(description, joint)
    if tyre is not None:
        return link.apply(tyre.pose.xyz)
    parts = map(description.links.__getitem__, description.rigid_part(joint.child))
    return None if any(part.visuals or part.collisions for part in parts) else link.xyz


class _Wheel(NamedTuple):
    shape: Cylinder | Sphere
    pose: Pose
    collides: bool
    span: Span


def _tyre(description: FileDescription, joint: Joint) -> _Wheel | None:
    """Returns the largest round shape that a joint turns, of the collision shapes if there are any.

    A wheel is a sphere, or a cylinder whose axis is that of the joint, with its centre on the axis.
    """
    wheels = _round_shapes(description, joint)
    return max(wheels, key=lambda wheel: (wheel.collides, wheel.shape.radius), default=None)


def _round_shapes(description: FileDescription, joint: Joint) -> list[_Wheel]:
    """Returns the wheel shapes of a joint, with poses in the frame of the joint."""
    if joint.type not in ("revolute", "continuous"):
        return []
    wheels: list[_Wheel] = []
    for link, pose in description.rigid_part(joint.child).items():
        for shape, own, collides, span in description.shapes(description.links[link]):
            if not isinstance(shape, Cylinder | Sphere):
                continue
            placed = pose * own
            along = abs(dot(placed.rotate((0.0, 0.0, 1.0)), joint.axis))
            offset = norm(cross(placed.xyz, joint.axis))
            is_wheel = isinstance(shape, Sphere) or along > 0.99
            if is_wheel and offset < 0.1 * shape.radius:
                wheels.append(_Wheel(shape, placed, collides, span))
    return wheels


# -- limits of joints, and one robot in several descriptions ----------------------------


def check_command_limits(evidence: Evidence, report: Report) -> None:
    """Reports commands of ``<ros2_control>`` that go beyond the limits of the joint."""
    for description in evidence.descriptions:
        worst: dict[tuple[str, str], tuple[float, Fact, Fact]] = {}
        for fact in description.facts:
            interface, _, end = fact.kind.partition(" ")
            joint = description.joints.get(fact.names[0]) if fact.names else None
            if joint is None or end not in ("min", "max"):
                continue
            limit = None
            if interface == "velocity":
                limit = description.limit(joint, "velocity")
            elif interface == "position":
                limit = description.limit(joint, "upper" if end == "max" else "lower")
            if limit is None or (interface == "velocity" and limit.value <= 0.0):
                continue
            bound = -limit.value if interface == "velocity" and end == "min" else limit.value
            excess = fact.value - bound if end == "max" else bound - fact.value
            known = worst.get((joint.name, interface))
            if excess > TOLERANCE * max(abs(bound), 1e-3) and (known is None or excess > known[0]):
                worst[joint.name, interface] = excess, fact, limit._replace(value=bound)
        for (name, interface), (_, fact, limit) in worst.items():
            report.add(
                "audit-joint-limit",
                f"{fact.subject} allows a {interface} of {fact.value:g} {limit.unit} for joint"
                f" `{name}`, whose limit is {limit.value:g} {limit.unit}",
                fact.span,
                hint="write the limit of the motor in both places",
                labels=[Label(limit.span, "limit here")],
            )


def _pairs(evidence: Evidence) -> Iterator[tuple[FileDescription, FileDescription]]:
    """Yields descriptions of one robot in two formats: most of the joints have equal names."""
    for a, b in itertools.combinations(evidence.descriptions[:200], 2):
        if a.format == b.format:
            continue
        names_a = {n for n, j in a.joints.items() if j.type not in ("fixed", "floating")}
        names_b = {n for n, j in b.joints.items() if j.type not in ("fixed", "floating")}
        common = names_a & names_b
        if len(common) >= 2 and 2 * len(common) >= min(len(names_a), len(names_b)):
            words = audit_facts.path_words(a.file) & audit_facts.path_words(b.file)
            best = max(
                len(audit_facts.path_words(a.file) & audit_facts.path_words(other.file))
                for other in evidence.descriptions
                if other.format == b.format
            )
            if len(words) == best:
                yield a, b


# Relative and absolute tolerances.  A wheel that sinks into the soft contact of a simulator may be
# a little larger there.
_TOLERANCES = {"wheel radius": (0.02, 0.0), "distance": (TOLERANCE, 0.002)}


def check_descriptions_agree(evidence: Evidence, report: Report) -> None:
    """Reports limits, wheel radii and wheel positions that differ between formats of one robot."""
    for a, b in _pairs(evidence):
        names = [name for name in a.joints if name in b.joints]
        wheels = [n for n in names if all(wheel_radius(d, d.joints[n]) for d in (a, b))]
        others = _quantities(b, names, wheels)
        for what, first in _quantities(a, names, wheels).items():
            second = others.get(what)
            relative, absolute = _TOLERANCES.get(first.kind, (TOLERANCE, 1e-5))
            if second is None or first.unit != second.unit:
                continue
            if not math.isclose(first.value, second.value, rel_tol=relative, abs_tol=absolute):
                report.add(
                    "audit-descriptions-differ",
                    f"{what} is {second.value:.6g} {second.unit} in {b.format}, but"
                    f" {first.value:.6g} {first.unit} in {a.format}",
                    second.span,
                    hint="make both files from one source",
                    labels=[Label(first.span, f"{first.value:.6g} {first.unit} here")],
                )


def _quantities(
    description: FileDescription, names: Sequence[str], wheels: Sequence[str]
) -> dict[str, Fact]:
    """Returns limits, wheel radii and distances from the first wheel, by their names."""
    facts: dict[str, Fact] = {}
    for name in names:
        for quantity in ("lower", "upper", "velocity", "effort"):
            limit = description.limit(description.joints[name], quantity)
            if limit is not None:
                facts[f"the {quantity} limit of joint `{name}`"] = limit
    for name in wheels:
        joint, first = description.joints[name], description.joints[wheels[0]]
        radius = wheel_radius(description, joint)
        if radius is not None:
            facts[f"the wheel radius at joint `{name}`"] = radius
        start, end = wheel_center(description, first), wheel_center(description, joint)
        if start is not None and end is not None:
            what = f"the distance of the wheels at joints `{wheels[0]}` and `{name}`"
            facts[what] = Fact("distance", name, norm(sub(end, start)), joint.span, "m")
    return facts


# -- twists: stamped against unstamped, and speeds beyond the limits --------------------


def check_stamps(evidence: Evidence, report: Report) -> None:
    """Reports nodes that exchange Twist with nodes that exchange TwistStamped."""
    if any(node.package == "twist_stamper" for f in evidence.launches for node in f.nodes):
        return  # it converts one type to the other
    decided = {f"({name})" for name in stamped_arguments(evidence)}
    facts = [
        fact for fact in evidence.stated("stamped") if fact.subject.partition(" ")[2] not in decided
    ]
    stamped = sum(1 for fact in facts if fact.value)
    rare = 2 * stamped <= len(facts)  # the type of fewer nodes is reported
    for fact in (fact for fact in facts if bool(fact.value) is rare):
        nearby = audit_facts.closest([f for f in facts if _name(f) != _name(fact)], fact.span.file)
        others = [other for other in nearby if other.value is not fact.value]
        if others:
            types = ("TwistStamped", "Twist") if rare else ("Twist", "TwistStamped")
            report.add(
                "audit-stamped",
                f"{fact.subject} uses {types[0]}, but {others[0].subject} uses {types[1]}: a node"
                " does not receive messages of the other type",
                fact.span,
                hint="use one type in all files; TwistStamped is the default since ROS 2 Kilted",
                labels=[Label(others[0].span, f"{types[1]} here")],
            )


def _name(fact: Fact) -> str:
    """Returns the node of a statement; its files for other distributions are alternatives."""
    return fact.subject.partition(" ")[0]


def check_speeds(evidence: Evidence, report: Report) -> None:
    """Reports speeds that a planner demands and a controller or smoother does not let through."""
    for kind in ("linear", "angular"):
        limits = evidence.stated(f"{kind} limit")
        for plan in evidence.stated(f"{kind} plan"):
            others = [f for f in limits if _name(f) != _name(plan)]
            nearby = audit_facts.closest(others, plan.span.file)
            if not nearby:
                continue
            limit = max(nearby, key=lambda fact: float(fact.value))
            if plan.value > limit.value * (1.0 + TOLERANCE):
                report.add(
                    "audit-speed",
                    f"{plan.subject} plans with {plan.value:g} {plan.unit}, but {limit.subject}"
                    f" lets only {limit.value:g} {plan.unit} through",
                    plan.span,
                    hint="the robot falls behind its plan; plan with the lower value",
                    labels=[Label(limit.span, f"{limit.value:g} {plan.unit} here")],
                )


def check_wheel_speeds(evidence: Evidence, report: Report) -> None:
    """Reports limits of controllers that need faster wheels than the description allows."""
    wheels = {fact.span.file: fact for fact in evidence.stated("wheel radius")}
    for fact in evidence.stated("linear limit"):
        radius = wheels.get(fact.span.file)
        if radius is None or "linear.x.max_velocity" not in fact.subject:
            continue
        for description, name in itertools.product(
            evidence.related(fact.span.file, radius.names), radius.names
        ):
            joint = description.joints.get(name)
            limit = description.limit(joint, "velocity") if joint is not None else None
            if joint is None or limit is None or limit.value <= 0.0:
                continue
            true = wheel_radius(description, joint) or radius
            needed = fact.value / true.value
            if needed > limit.value * (1.0 + TOLERANCE):
                report.add(
                    "audit-speed",
                    f"{fact.subject} allows {fact.value:g} m/s, for which the wheels turn with"
                    f" {needed:.4g} rad/s, but joint `{joint.name}` is limited to"
                    f" {limit.value:g} rad/s",
                    fact.span,
                    hint=f"that limit is {limit.value * true.value:.3g} m/s",
                    labels=[Label(limit.span, f"{limit.value:g} rad/s here")],
                )
                break
