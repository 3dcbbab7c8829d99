"""Rules about driving: wheels, one robot in several formats, speeds and stamps of twists."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

from thorvaldc.compiler.descriptions.facts import Fact, FileDescription
from thorvaldc.compiler.descriptions.wheel_rules import (
    TOLERANCE,
    Stated,
    check_stated_sides,
    check_stated_wheels,
    wheel_center,
    wheel_radius,
)
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.spatial import norm, sub
from thorvaldc.tools.audit.audit_facts import Evidence, affinity, closest


def check_wheels(evidence: Evidence, report: Report) -> None:
    """Compares each stated wheel radius, wheel separation and wheelbase with the description."""
    kinds = ("wheel radius", "wheel separation", "wheelbase")
    stated: list[Stated] = [(fact, [d]) for d, fact in evidence.described(*kinds)]
    check_stated_wheels([*stated, *_places(evidence, evidence.stated(*kinds))], report)


def check_sides(evidence: Evidence, report: Report) -> None:
    """Reports drives whose left wheels are on the right, or turn about another axis."""
    facts = [fact for _, fact in evidence.described("wheel separation")]
    check_stated_sides(_places(evidence, [*facts, *evidence.stated("wheel separation")]), report)


def _places(evidence: Evidence, facts: Sequence[Fact]) -> list[Stated]:
    return [(f, evidence.related(f.span.file, tuple(filter(None, f.names)))) for f in facts]


# -- one robot in several descriptions --------------------------------------------------


def _pairs(evidence: Evidence) -> Iterator[tuple[FileDescription, FileDescription]]:
    """Yields descriptions of one robot in two formats: most of the joints have equal names."""
    for a, b in itertools.combinations(evidence.descriptions[:200], 2):
        if a.format == b.format:
            continue
        names_a = {n for n, j in a.joints.items() if j.type not in ("fixed", "floating")}
        names_b = {n for n, j in b.joints.items() if j.type not in ("fixed", "floating")}
        common = names_a & names_b
        if len(common) >= 2 and 2 * len(common) >= min(len(names_a), len(names_b)):
            others = [other.file for other in evidence.descriptions if other.format == b.format]
            if affinity(a.file, b.file) == max(affinity(a.file, other) for other in others):
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
    facts = evidence.stated("stamped")
    decided = {fact.subject.partition(" ")[2] for fact in facts if fact.value is None}
    facts = [fact for fact in facts if fact.subject.partition(" ")[2] not in decided]
    stamped = sum(1 for fact in facts if fact.value)
    rare = 2 * stamped <= len(facts)  # the type of fewer nodes is reported
    for fact in (fact for fact in facts if bool(fact.value) is rare):
        nearby = closest([f for f in facts if _name(f) != _name(fact)], fact.span.file)
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
            nearby = closest(others, plan.span.file)
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
