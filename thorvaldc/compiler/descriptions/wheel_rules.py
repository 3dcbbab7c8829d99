"""Measures the wheels of a description, and compares them with what other files state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from thorvaldc.compiler.descriptions.description_rules import judge_pair, right_name
from thorvaldc.compiler.descriptions.facts import Fact, FileDescription
from thorvaldc.diagnostics import Label, Report, Span, plain
from thorvaldc.model import Cylinder, Joint, Pose, Sphere, Vec3
from thorvaldc.model.spatial import cross, dot, norm

# An effective radius or separation under load may differ a little on purpose.
TOLERANCE = 0.01

Stated = tuple[Fact, Sequence[FileDescription]]
"""A statement, and the descriptions to which it can belong."""


def check_stated_wheels(stated: Sequence[Stated], report: Report) -> None:
    """Compares each stated wheel radius, wheel separation and wheelbase with the descriptions."""
    for kind, measure, motion in (
        ("wheel radius", _true_radius, "drives"),
        ("wheel separation", partial(_true_distance, axis=1), "turns"),
        ("wheelbase", partial(_true_distance, axis=0), ""),
    ):
        code = "audit-wheel-radius" if kind == "wheel radius" else "audit-wheel-separation"
        for fact, true in _differing(measure, [s for s in stated if s[0].kind == kind]):
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


def check_stated_sides(stated: Sequence[Stated], report: Report) -> None:
    """Reports drives whose left wheels are on the right, or turn about another axis."""
    for fact, descriptions in stated:
        middle = fact.names.index("")
        for description in descriptions[:1]:
            for pair in zip(fact.names[:middle], fact.names[middle + 1 :], strict=False):
                left, right = map(description.joints.get, pair)
                is_judged = right_name(pair[0]) == pair[1]  # by the names in the description
                if left is not None and right is not None and not is_judged:
                    judge_pair(description, left, right, report, (fact.subject, fact.span))


def _differing(
    measure: Callable[[FileDescription, Fact], Fact | None], stated: Sequence[Stated]
) -> list[tuple[Fact, Fact]]:
    """Returns pairs of a statement and the geometry that it contradicts.

    A statement that agrees with one of the descriptions to which it can belong is left out.
    """
    pairs: list[tuple[Fact, Fact]] = []
    for fact, descriptions in stated:
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
    tyre = tyre_of(description, joint)
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
    tyre = tyre_of(description, joint)
    if tyre is not None:
        return link.apply(tyre.pose.xyz)
    parts = map(description.links.__getitem__, description.rigid_part(joint.child))
    return None if any(part.visuals or part.collisions for part in parts) else link.xyz


class RoundShape(NamedTuple):
    """A cylinder or sphere with its pose in the frame of the joint that turns it."""

    shape: Cylinder | Sphere
    pose: Pose
    collides: bool
    span: Span


def tyre_of(description: FileDescription, joint: Joint) -> RoundShape | None:
    """Returns the largest round shape that a joint turns, of the collision shapes if there are any.

    A wheel is a sphere, or a cylinder whose axis is that of the joint, with its centre on the axis.
    """
    wheels = _round_shapes(description, joint)
    return max(wheels, key=lambda wheel: (wheel.collides, wheel.shape.radius), default=None)


def _round_shapes(description: FileDescription, joint: Joint) -> list[RoundShape]:
    """Returns the wheel shapes of a joint, with poses in the frame of the joint."""
    if joint.type not in ("revolute", "continuous"):
        return []
    wheels: list[RoundShape] = []
    for link, pose in description.rigid_part(joint.child).items():
        for shape, own, collides, span in description.shapes(description.links[link]):
            if not isinstance(shape, Cylinder | Sphere):
                continue
            placed = pose * own
            along = abs(dot(placed.rotate((0.0, 0.0, 1.0)), joint.axis))
            offset = norm(cross(placed.xyz, joint.axis))
            is_wheel = isinstance(shape, Sphere) or along > 0.99
            if is_wheel and offset < 0.1 * shape.radius:
                wheels.append(RoundShape(shape, placed, collides, span))
    return wheels
