"""Rules about frames and transforms: each frame exists, and each transform has one owner."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import nearest
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, LaunchedNode, LaunchFile, path_words
from thorvaldc.tools.audit.launch_files import launched_nodes
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
    # A file that cannot be read may make any frame.
    if evidence.incomplete or evidence.unread_launches or not evidence.descriptions:
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
    estimators = [fact for fact in evidence.facts if fact.kind == "estimator transform"]
    for fact in estimators:
        nearby = closest([c for c in controllers if c.names == fact.names], fact.span.file)
        if fact.value and nearby and all(controller.value for controller in nearby):
            _report_owners(fact, nearby[0], "enable_odom_tf of the controller", report)
    for description in evidence.descriptions:
        for plugin in description.facts:
            if plugin.kind == "plug-in transform":
                nearby = closest(
                    [e for e in estimators if e.names == plugin.names], plugin.span.file
                )
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


_DISTRIBUTIONS = frozenset(
    ["foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
)


def closest(facts: Sequence[Fact], file: str) -> list[Fact]:
    """Returns the statements whose files have most words in common with the path of a file.

    Files for another distribution of ROS, as in `param/humble/nav2.yaml`, are alternatives.
    """
    words = path_words(file)
    distributions = words & _DISTRIBUTIONS
    candidates = [
        (len(words & path_words(fact.span.file)), fact)
        for fact in facts
        if path_words(fact.span.file) & _DISTRIBUTIONS == distributions
    ]
    best = max((affinity for affinity, _ in candidates), default=0)
    return [fact for affinity, fact in candidates if affinity == best]


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
