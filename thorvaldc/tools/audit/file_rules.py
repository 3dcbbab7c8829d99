"""Rules about parameter files: keys twice, sections without a node, and ids of CAN nodes."""

from __future__ import annotations

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import nearest
from thorvaldc.tools.audit.audit_facts import Evidence, Fact
from thorvaldc.tools.audit.node_facts import is_drive_controller


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


def bus_facts(document: Node) -> list[Fact]:
    """Returns the CANopen node ids in a bus.yml of ros2_canopen, by the name of the device."""
    if not isinstance(document.value, dict) or "master" not in document.value:
        return []
    facts: list[Fact] = []

    def collect(node: Node, name: str, depth: int) -> None:
        node_id = node.get("node_id")
        if node_id is not None and isinstance(node_id.value, int):
            facts.append(Fact("bus node id", f"`{name}`", node_id.value, node_id.span, "", (name,)))
        elif isinstance(node.value, dict) and depth < 3 and name not in ("options", "defaults"):
            for key, child in node.value.items():
                collect(child, key, depth + 1)

    for key, child in document.value.items():
        collect(child, key, 0)
    return facts


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
