"""Rules about frames and transforms: each frame exists, and each transform has one owner."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import nearest
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, LaunchedNode, LaunchFile, path_words
from thorvaldc.tools.audit.launched_tree import launched_nodes
from thorvaldc.tools.audit.node_facts import published_frames


def check_frames(evidence: Evidence, report: Report) -> None:
    """Reports frames of the robot that no description has and no node publishes."""
    published = published_frames(evidence)
    known = published | {
        name for d in evidence.descriptions for name in (*d.bodies, *d.frames, *d.joints)
    }
    for description in evidence.descriptions:
        for fact in description.facts:
            if fact.kind == "gazebo reference" and fact.value not in known:
                _report_frame(fact, known, report)
    # A description that cannot be read may have any frame.
    if evidence.incomplete or not evidence.descriptions:
        return
    for fact in evidence.facts:
        if fact.kind in ("base frame", "sensor frame") and fact.value not in known:
            _report_frame(fact, known, report)


def _report_frame(fact: Fact, known: set[str], report: Report) -> None:
    near = nearest(str(fact.value), sorted(known))
    report.add(
        "audit-frame-unknown",
        f"{fact.subject} uses the frame `{fact.value}`, which no description has",
        fact.span,
        hint=f"did you mean `{near}`?" if near else "add the link, or a static transform to it",
    )


def check_transform_owners(evidence: Evidence, report: Report) -> None:
    """Reports a drive controller and an estimator that both publish the transform of odometry."""
    controllers = [fact for fact in evidence.facts if fact.kind == "controller transform"]
    controllers += [
        fact
        for description in evidence.descriptions
        for fact in description.facts
        if fact.kind == "controller transform"
    ]
    for fact in evidence.facts:
        if fact.kind != "estimator transform" or not fact.value:
            continue
        nearby = closest([c for c in controllers if c.names == fact.names], fact.span.file)
        if not nearby or not all(controller.value for controller in nearby):
            continue
        report.add(
            "audit-transform-owners",
            f"{fact.subject} and {nearby[0].subject} both publish the transform from"
            f" `{fact.names[0]}` to the robot, which then jumps between two poses",
            fact.span,
            hint="let the estimator publish it, and set enable_odom_tf of the controller to false",
            labels=[Label(nearby[0].span, "the other owner")],
        )


def closest(facts: Sequence[Fact], file: str) -> list[Fact]:
    """Returns the statements whose files have most words in common with the path of a file."""
    words = path_words(file)
    affinities = [len(words & path_words(fact.span.file)) for fact in facts]
    best = max(affinities, default=0)
    return [fact for fact, value in zip(facts, affinities, strict=True) if value == best]


def check_state_publishers(evidence: Evidence, report: Report) -> None:
    """Reports launch files that start two robot_state_publishers in one name space."""
    for launch in evidence.launches:
        known: dict[str, LaunchedNode] = {}
        for node in _state_publishers(launch, evidence):
            first = known.setdefault(node.namespace, node)
            if first is not node and first.span != node.span:
                report.add(
                    "audit-state-publishers",
                    f"`{launch.file}` starts two robot_state_publishers"
                    f" {f'in the name space `{node.namespace}`' if node.namespace else ''}".strip()
                    + ": both publish the transforms of the robot",
                    node.span,
                    hint="start it in one launch file, or give each robot its name space",
                    labels=[Label(first.span, "the other one")],
                )


def _state_publishers(launch: LaunchFile, evidence: Evidence) -> Iterator[LaunchedNode]:
    for node in launched_nodes(launch, evidence):
        if node.executable == "robot_state_publisher" and not node.conditional:
            yield node
