"""Which kind of document one is, by a key that only that kind has."""

from __future__ import annotations

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report


def is_scenario(document: Node | None) -> bool:
    return document is not None and document.get("scenario") is not None


# Files that may be taken for a robot's, by a key that only they have.
_OTHERS = (
    (
        "motor_drives",
        "a configuration file of the original system",
        "`thorvaldc import FILE -o robot.yaml` makes a robot of it",
    ),
    ("thorvaldc_lock", "a lock file", "name the robot's own file"),
    ("links", "a module document", "`thorvaldc modules check` checks a folder of modules"),
    ("params", "a module document", "`thorvaldc modules check` checks a folder of modules"),
)


def report_wrong_kind(document: Node, report: Report) -> bool:
    """Whether the document is another thing altogether, which is all that is said of it."""
    if document.get("name") is None:
        for key, what, hint in _OTHERS:
            node = document.get(key)
            if node is not None:
                message = f"this is {what}; a robot, fleet or scenario document is wanted"
                report.add("other-document", message, node.where, hint=hint)
                return True
    return False


def is_fleet(document: Node | None) -> bool:
    return document is not None and document.get("robots") is not None
