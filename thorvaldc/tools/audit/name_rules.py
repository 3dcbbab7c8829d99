"""Rules about names: the joints, files, controllers and CAN nodes that files name must exist."""

from __future__ import annotations

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean, nearest
from thorvaldc.tools.audit.audit_facts import Description, Evidence, Fact, is_nearer
from thorvaldc.tools.audit.launch_files import resolved
from thorvaldc.tools.audit.node_facts import is_drive_controller


def check_joint_names(evidence: Evidence, report: Report) -> None:
    """Reports joints in parameter files, plug-ins and ``<ros2_control>`` that do not exist."""
    for description in evidence.descriptions:
        for fact in description.facts:
            if fact.kind == "joint" and fact.value not in description.joints:
                _report_joint(fact, description, report)
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
                _report_joint(fact, related[0], report)


def _report_joint(fact: Fact, description: Description, report: Report) -> None:
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


def check_launched_files(evidence: Evidence, report: Report) -> None:
    """Reports parameter files and launch files that do not exist in their package."""
    for launch in evidence.launches:
        files = [*launch.includes, *(f for node in launch.nodes for f in node.parameter_files)]
        for fact in files:
            path = resolved(fact, launch, evidence)
            is_local = str(fact.value).startswith("package://")
            try:
                is_missing = is_local and path is not None and not path.exists()
            except (OSError, ValueError):
                is_missing = True
            if is_missing:
                what = "launch file" if fact.kind.endswith("include") else fact.kind
                report.add(
                    "audit-file-missing",
                    f"the {what} `{str(fact.value).removeprefix('package://')}` does not exist",
                    fact.span,
                    hint="paths of packages begin with the folder that the package installs",
                )


def check_controller_sections(evidence: Evidence, report: Report) -> None:
    """Reports parameters of a drive controller that no controller manager loads."""
    for section in evidence.sections:
        if not is_drive_controller(section) or section.short_name in ("**", "*"):
            continue
        if "type" in section.values:  # its spawner passes the section with the type
            continue
        managers = [
            other
            for other in evidence.sections
            if other.file == section.file and other.short_name == "controller_manager"
        ]
        declared = [
            name.removesuffix(".type")
            for manager in managers
            for name in manager.values
            if name.endswith(".type")
        ]
        if declared and section.short_name not in declared:
            near = nearest(section.short_name, declared)
            report.add(
                "audit-section-unused",
                f"the controller manager of this file loads no controller `{section.short_name}`,"
                " so nobody reads these parameters",
                section.span,
                hint=f"it loads {', '.join(f'`{name}`' for name in declared[:6])}"
                if near is None
                else f"did you mean `{near}`?",
                labels=[Label(managers[0].span, "the controller manager")],
            )


def check_node_ids(evidence: Evidence, report: Report) -> None:
    """Reports CANopen node ids that occur twice on a bus, or differ from ``<ros2_control>``."""
    by_file: dict[str, dict[int, Fact]] = {}
    for fact in evidence.facts:
        if fact.kind != "bus node id":
            continue
        first = by_file.setdefault(fact.span.file, {}).setdefault(fact.value, fact)
        if first is not fact:
            report.add(
                "audit-node-id",
                f"{fact.subject} and {first.subject} have the node id {fact.value} on one bus",
                fact.span,
                hint="give each device an id of its own",
                labels=[Label(first.span, "the other device")],
            )
    known = {node_id for ids in by_file.values() for node_id in ids}
    for description in evidence.descriptions:
        for fact in description.facts:
            if fact.kind != "node id" or not known:
                continue
            try:
                node_id = int(str(fact.value).strip(), 0)
            except ValueError:
                continue
            if node_id not in known:
                files = ", ".join(f"`{file}`" for file in by_file)
                report.add(
                    "audit-node-id",
                    f"joint `{fact.names[0]}` uses the node id {node_id}, which {files} does not"
                    " have",
                    fact.span,
                    hint=f"the ids there are {', '.join(map(str, sorted(known)))}",
                )
