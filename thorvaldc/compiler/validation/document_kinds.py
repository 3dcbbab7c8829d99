"""Recognises the kind of a document by a key that only this kind has."""

from __future__ import annotations

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report


def is_scenario(document: Node | None) -> bool:
    """Returns whether the document is a scenario."""
    return document is not None and document.get("scenario") is not None


def is_fleet(document: Node | None) -> bool:
    """Returns whether the document lists robots, as fleets and scenarios do."""
    return document is not None and document.get("robots") is not None


# Files that users pass by mistake: a key that only they have, their description, a hint.
_WRONG_KINDS = (
    (
        "motor_drives",
        "a configuration file of the original system",
        "convert it with `thorvaldc import FILE -o robot.yaml`",
    ),
    ("thorvaldc_lock", "a lock file", "name the robot file"),
    ("links", "a module document", "`thorvaldc modules check` checks a folder of modules"),
    ("params", "a module document", "`thorvaldc modules check` checks a folder of modules"),
)


def report_wrong_kind(document: Node, report: Report) -> bool:
    """Returns whether the document is no robot, fleet or scenario.

    If so, adds the only diagnostic about it: schema errors would be misleading.
    """
    if document.get("name") is None:
        for key, description, hint in _WRONG_KINDS:
            node = document.get(key)
            if node is not None:
                message = f"this is {description}; expected a robot, fleet or scenario document"
                report.add("other-document", message, node.where, hint=hint)
                return True
    return False
