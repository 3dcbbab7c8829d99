"""Rules about names: joints and frames that files refer to must exist."""

from __future__ import annotations

from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.tools.audit.audit_facts import Description, Evidence, Fact, is_nearer


def check_joint_names(evidence: Evidence, report: Report) -> None:
    """Reports joints in parameter files, plug-ins and ``<ros2_control>`` that do not exist."""
    for description in evidence.descriptions:
        for fact in description.facts:
            if fact.kind == "joint" and fact.value not in description.joints:
                _report(fact, description, report)
    by_subject: dict[tuple[str, str], list[Fact]] = {}
    for fact in evidence.facts:
        if fact.kind == "joint":
            by_subject.setdefault((fact.span.file, fact.subject), []).append(fact)
    for (file, _), facts in by_subject.items():
        names = tuple(fact.value for fact in facts)
        related = evidence.related(file, names)
        if not related and not evidence.incomplete:
            related = evidence.related(file)
        if related and any(is_nearer(file, u, related[0].file) for u in evidence.incomplete):
            continue
        for fact in facts:
            if related and not any(fact.value in d.joints for d in evidence.descriptions):
                _report(fact, related[0], report)


def _report(fact: Fact, description: Description, report: Report) -> None:
    known = [joint.name for joint in description.joints.values() if joint.kind != "fixed"]
    some = ", ".join(f"`{name}`" for name in known[:6])
    report.add(
        "audit-joint-unknown",
        f"{fact.subject} names joint `{fact.value}`, which `{description.file}` does not have",
        fact.span,
        hint=did_you_mean(
            fact.value,
            description.joints,
            f"its moving joints are {some}{' ...' if len(known) > 6 else ''}" if known else None,
            fixable=False,
        ),
    )
