"""Rules about twists: stamped against unstamped, and speeds beyond the limits."""

from __future__ import annotations

from thorvaldc.diagnostics import Label, Report
from thorvaldc.tools.audit.audit_facts import Evidence, Fact
from thorvaldc.tools.audit.drive_facts import wheel_radius
from thorvaldc.tools.audit.node_facts import stamped_arguments
from thorvaldc.tools.audit.transform_rules import closest

TOLERANCE = 0.01


def check_stamps(evidence: Evidence, report: Report) -> None:
    """Reports nodes that exchange Twist with nodes that exchange TwistStamped."""
    if any(node.package == "twist_stamper" for f in evidence.launches for node in f.nodes):
        return  # it converts one type to the other
    decided = {f"({name})" for name in stamped_arguments(evidence)}
    facts = [
        fact
        for fact in evidence.facts
        if fact.kind == "stamped" and fact.subject.partition(" ")[2] not in decided
    ]
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
        limits = [fact for fact in evidence.facts if fact.kind == f"{kind} limit"]
        for plan in (fact for fact in evidence.facts if fact.kind == f"{kind} plan"):
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
    wheels = {fact.span.file: fact for fact in evidence.facts if fact.kind == "wheel radius"}
    for fact in evidence.facts:
        radius = wheels.get(fact.span.file)
        is_controller = "linear.x.max_velocity" in fact.subject
        if fact.kind != "linear limit" or radius is None or not is_controller:
            continue
        joints = [
            (description, description.joints[name])
            for description in evidence.related(fact.span.file, radius.names)
            for name in radius.names
            if name in description.joints and "velocity" in description.joints[name].limits
        ]
        for description, joint in joints:
            true = wheel_radius(description, joint) or radius
            needed, limit = fact.value / true.value, joint.limits["velocity"]
            if limit.value > 0.0 and needed > limit.value * (1.0 + TOLERANCE):
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
