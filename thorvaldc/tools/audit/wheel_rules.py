"""Rules about wheels: radius and separation of controllers against the geometry."""

from __future__ import annotations

from collections.abc import Callable

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.tools.audit.audit_facts import Description, Evidence, Fact
from thorvaldc.tools.audit.drive_facts import wheel_center, wheel_radius

# An effective radius or separation under load may differ a little on purpose.
TOLERANCE = 0.01

Measure = Callable[[Description, Fact], Fact | None]


def check_wheel_radii(evidence: Evidence, report: Report) -> None:
    """Compares each stated wheel radius with the wheels of the description, and with others."""
    for fact, true in _differing("wheel radius", _true_radius, evidence):
        percent = 100.0 * (true.value / fact.value - 1.0)
        report.add(
            "audit-wheel-radius",
            f"{fact.subject} computes with a wheel radius of {plain(fact.value)} m, but"
            f" {true.subject} has {plain(true.value)} m: the robot drives {abs(percent):.2g} %"
            f" {'further' if percent > 0 else 'less far'} than its odometry says",
            fact.span,
            hint="write the measured radius in all files, or keep the geometry and set the"
            " controller's radius multiplier",
            labels=[Label(true.span, f"{plain(true.value)} m here")],
        )


def check_wheel_separations(evidence: Evidence, report: Report) -> None:
    """Compares each stated wheel separation with the description, and with others."""
    for fact, true in _differing("wheel separation", _true_separation, evidence):
        percent = 100.0 * (fact.value / true.value - 1.0)
        report.add(
            "audit-wheel-separation",
            f"{fact.subject} computes with a wheel separation of {plain(fact.value)} m, but"
            f" {true.subject} has {plain(true.value)} m: the robot turns {abs(percent):.2g} %"
            f" {'further' if percent > 0 else 'less far'} than its odometry says",
            fact.span,
            hint="write the true separation; corrections for slip belong in the controller's"
            " separation multiplier",
            labels=[Label(true.span, f"{plain(true.value)} m here")],
        )


def _differing(kind: str, measure: Measure, evidence: Evidence) -> list[tuple[Fact, Fact]]:
    """Returns pairs of a statement and the geometry that it contradicts.

    A statement that agrees with one of the descriptions to which it can belong is left out.
    """
    pairs: list[tuple[Fact, Fact]] = []
    facts = [fact for fact in evidence.facts if fact.kind == kind and fact.value > 0.0]
    for description in evidence.descriptions:
        for fact in description.facts:
            if fact.kind == kind and fact.value > 0.0:
                true = measure(description, fact)
                if true is not None and _differs(fact, true):
                    pairs.append((fact, true))
    for fact in facts:
        joints = tuple(name for name in fact.names if name)
        related = evidence.related(fact.span.file, joints)
        values = [true for d in related if (true := measure(d, fact)) is not None]
        if values and all(_differs(fact, true) for true in values):
            pairs.append((fact, min(values, key=lambda true: abs(true.value - fact.value))))
    return pairs


def _differs(fact: Fact, true: Fact) -> bool:
    ratio = float(fact.value) / float(true.value)
    return abs(ratio - 1.0) > TOLERANCE + 1e-9


def _true_radius(description: Description, fact: Fact) -> Fact | None:
    """Returns the wheel whose radius is next to a stated radius."""
    radii = [
        radius
        for name in fact.names
        if name in description.joints
        and (radius := wheel_radius(description, description.joints[name])) is not None
    ]
    return min(radii, key=lambda radius: abs(radius.value - fact.value), default=None)


def _true_separation(description: Description, fact: Fact) -> Fact | None:
    """Returns the lateral distance between the left and the right wheels of a statement."""
    poses = description.root_poses()
    middle = fact.names.index("")
    sides: list[float] = []
    for names in (fact.names[:middle], fact.names[middle + 1 :]):
        centers = [
            center
            for name in names
            if name in description.joints
            and (center := wheel_center(description, description.joints[name], poses)) is not None
        ]
        if len(centers) < len(names) or not centers:
            return None
        lateral = sorted(center[1] for center in centers)
        sides.append(lateral[len(lateral) // 2])
    first = description.joints[fact.names[0]]
    distance = abs(sides[0] - sides[1])
    if distance < 1e-6:
        return None
    return Fact("wheel separation", f"the description `{description.name}`", distance, first.span)
