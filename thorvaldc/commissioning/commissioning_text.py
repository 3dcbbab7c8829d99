"""Formats scan results, plans and verifications as text tables and as JSON."""

from __future__ import annotations

from typing import Any

from thorvaldc.can.lss import UNCONFIGURED
from thorvaldc.commissioning.bus_configuration import Plan, step_to_json
from thorvaldc.commissioning.scan_result import ScanEntry, ScanResult, identity_text
from thorvaldc.commissioning.verify import Verification
from thorvaldc.diagnostics.text_layout import text_table


def scan_table(scan: ScanResult, width: int | None = None) -> str:
    """Returns a text table with one row for each node and each unknown device.

    The columns of the scan table are the verdict, the name of the node, the node id in the robot
    file, the node id on the bus, and the description of the device.
    ``width``: number of columns of the terminal, or ``None`` for one line per row.
    """
    header = ("verdict", "node", "id", "found", "device")
    return text_table([header, *(_scan_row(entry) for entry in scan.entries)], width)


def _scan_row(entry: ScanEntry) -> tuple[str, ...]:
    device = entry.device
    found_id, description = "", ""
    if device is not None:
        if device.id is not None:
            found_id = "none" if device.id == UNCONFIGURED else str(device.id)
        if device.identity is not None:
            description = identity_text(device.identity)
        if any(device.texts):
            description += f" ({', '.join(text for text in device.texts if text)})"
    details = "; ".join(part for part in (description, entry.detail) if part)
    wanted_id = "" if entry.wanted_id is None else str(entry.wanted_id)
    return (entry.verdict, entry.node or "-", wanted_id, found_id, details)


def scan_notes(scan: ScanResult) -> list[str]:
    """Returns notes for the user about duplicate node ids, other CANopen masters and enabled
    drives."""
    notes = [
        f"two devices may have the id {node_id}: {evidence}"
        for node_id, evidence in scan.duplicates
    ]
    if scan.masters:
        notes.append(f"another master is on the bus: {', '.join(scan.masters)}")
    notes += [f"{name} may move: {reason}" for name, reason in scan.enabled]
    if not scan.active:
        notes.append("the scan only listened; --active sends a request to every node")
    return notes


def plan_table(plan: Plan, width: int | None = None) -> str:
    """Returns the steps, problems, notes and hash of a commissioning plan as text.

    ``width``: number of columns of the terminal, or ``None`` for one line per step.
    """
    lines = []
    if plan.steps:
        rows = [("step", "how", "what")]
        rows += [
            (str(number), step.back_end, step.description)
            for number, step in enumerate(plan.steps, 1)
        ]
        lines.append(text_table(rows, width))
    lines += [f"problem: {problem}" for problem in (*plan.strangers, *plan.problems)]
    lines += [f"note: {note}" for note in plan.notes]
    if not plan.steps and not plan.problems and not plan.strangers:
        lines.append("the bus matches the robot file")
    lines.append(f"plan {plan.hash}")
    return "\n".join(lines)


def plan_as_json(plan: Plan) -> dict[str, Any]:
    """Returns a commissioning plan as JSON values."""
    return {
        "hash": plan.hash,
        "robot": plan.configuration.robot,
        "bus": plan.configuration.bus,
        "steps": [{**step_to_json(step), "words": step.description} for step in plan.steps],
        "strangers": list(plan.strangers),
        "problems": list(plan.problems),
        "notes": list(plan.notes),
    }


def verification_table(verification: Verification, width: int | None = None) -> str:
    """Returns a text table with one row for each check of a verification.

    The columns of the verification table are the result, the node, the checked quantity, the
    expected value, and the value on the bus.
    ``width``: number of columns of the terminal, or ``None`` for one line per check.
    """
    rows = [("", "node", "what", "wanted", "found")]
    rows += [
        (
            "ok" if check.passed else "DIFFERS",
            check.node or "bus",
            check.what,
            check.expected,
            check.actual,
        )
        for check in verification.checks
    ]
    return text_table(rows, width)
