"""Rules about names: joints, files and frames that files name must exist.

Each transform has one owner.
"""

from __future__ import annotations

import os

from thorvaldc.compiler.descriptions.facts import Fact, FileDescription
from thorvaldc.diagnostics import Label, Report, did_you_mean
from thorvaldc.tools.audit.audit_facts import Evidence, affinity, closest
from thorvaldc.tools.audit.launch_files import resolved
from thorvaldc.tools.audit.parameter_facts import published_frames


def check_joint_names(evidence: Evidence, report: Report) -> None:
    """Reports joints in parameter files, plug-ins and ``<ros2_control>`` that do not exist."""
    for description, fact in evidence.described("joint"):
        if fact.value not in description.joints:
            _report_joint(fact, description, report)
    by_subject: dict[tuple[str, str], list[Fact]] = {}
    for fact in evidence.stated("joint"):
        by_subject.setdefault((fact.span.file, fact.subject), []).append(fact)
    for (file, _), facts in by_subject.items():
        names = tuple(fact.value for fact in facts)
        related = evidence.related(file, names)
        if not related and not evidence.incomplete:
            related = evidence.related(file)
        unread = max((affinity(file, name) for name in evidence.incomplete), default=-1)
        if related and unread >= affinity(file, related[0].file):
            continue
        for fact in facts:
            if related and not any(fact.value in d.joints for d in evidence.descriptions):
                _report_joint(fact, related[0], report)


def _report_joint(fact: Fact, description: FileDescription, report: Report) -> None:
    known = [joint.name for joint in description.joints.values() if joint.type != "fixed"]
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


def check_launched_files(evidence: Evidence, report: Report) -> None:
    """Reports parameter files and launch files that do not exist in their package."""
    for launch in evidence.launches:
        files = [*launch.includes, *(f for node in launch.nodes for f in node.parameter_files)]
        for fact in files:
            path = resolved(fact, launch, evidence)
            is_local = str(fact.value).startswith("package://")
            if is_local and path is not None and not os.path.exists(path):
                report.add(
                    "audit-file-missing",
                    f"the {fact.kind} `{fact.value.removeprefix('package://')}` does not exist",
                    fact.span,
                    hint="paths of packages begin with the folder that the package installs",
                )


def check_frames(evidence: Evidence, report: Report) -> None:
    """Reports frames of the robot that no description has and no node publishes."""
    published = published_frames(evidence)
    known = published | {
        name for d in evidence.descriptions for name in (*d.links, *d.frames, *d.joints)
    }
    for _, fact in evidence.described("gazebo reference"):
        if fact.value not in known:
            _report_frame(fact, known, report)
    # A file that cannot be read may make any frame.
    if evidence.incomplete or evidence.unread_launches or not evidence.descriptions:
        return
    for fact in evidence.stated("base frame", "sensor frame"):
        if fact.value not in known:
            _report_frame(fact, known, report)


def _report_frame(fact: Fact, known: set[str], report: Report) -> None:
    report.add(
        "audit-frame-unknown",
        f"{fact.subject} uses the frame `{fact.value}`, which no description has",
        fact.span,
        hint=did_you_mean(
            str(fact.value),
            sorted(known),
            "add the link, or a static transform to it",
            fixable=False,
        ),
    )


def check_transform_owners(evidence: Evidence, report: Report) -> None:
    """Reports a drive controller and an estimator that both publish the transform of odometry."""
    controllers = evidence.stated("controller transform")
    estimators = evidence.stated("estimator transform")
    for fact in estimators:
        nearby = closest([c for c in controllers if c.names == fact.names], fact.span.file)
        if fact.value and nearby and all(controller.value for controller in nearby):
            _report_owners(fact, nearby[0], "enable_odom_tf of the controller", report)
    for _, plugin in evidence.described("plug-in transform"):
        nearby = closest([e for e in estimators if e.names == plugin.names], plugin.span.file)
        if nearby and all(estimator.value for estimator in nearby):
            _report_owners(nearby[0], plugin, "publish_odom_tf of the plug-in", report)


def _report_owners(estimator: Fact, other: Fact, switch: str, report: Report) -> None:
    report.add(
        "audit-transform-owners",
        f"{estimator.subject} and {other.subject} both publish the transform from"
        f" `{estimator.names[0]}` to the robot, which then jumps between two poses",
        estimator.span,
        hint=f"let the estimator publish it, and set {switch} to false",
        labels=[Label(other.span, "the other owner")],
    )
