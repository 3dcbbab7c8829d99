"""Recognises a document as a robot, fleet, scenario or study document by its top-level keys."""

from __future__ import annotations

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report

_SCENARIO_KEYS = ("duration", "script", "world", "expect")


def is_scenario(document: Node | None) -> bool:
    """Returns whether a YAML document is a scenario.

    A document with robots and another key of a scenario, or without modules and with two keys of
    a scenario, is a scenario without a name.
    """
    if document is None:
        return False
    if document.get("scenario") is not None:
        return True
    keys = [key for key in _SCENARIO_KEYS if document.get(key) is not None]
    if document.get("robots") is not None or document.get("fleet") is not None:
        return bool(keys)
    return document.get("modules") is None and len(keys) >= 2


def is_study(document: Node | None) -> bool:
    """Returns whether a YAML document is a study."""
    return document is not None and document.get("study") is not None


def is_fleet(document: Node | None) -> bool:
    """Returns whether a YAML document has the key ``robots``.

    Fleet documents and scenario documents have the key ``robots``.  A document without modules, in
    which another key contains robots, is a fleet with a misspelled key.
    """
    if document is None or document.get("robots") is not None:
        return document is not None
    entries = document.value if isinstance(document.value, dict) else {}
    return document.get("modules") is None and any(map(_contains_robots, entries.values()))


def _contains_robots(node: Node) -> bool:
    entries = node.value if isinstance(node.value, dict) else {}
    return bool(entries) and all(entry.get("robot") is not None for entry in entries.values())


# Kinds of documents that a user may pass instead of a robot, fleet or scenario document.  Each kind
# of document is a tuple (key that only this kind of document has, name of the kind, hint).
_WRONG_KINDS = (
    (
        "motor_drives",
        "a configuration file of the original system",
        "convert it with `thorvaldc import FILE -o robot.yaml`",
    ),
    ("thorvaldc_lock", "a lock file", "name the robot file"),
    ("model", "the model of a build", "name the robot file; `info`, `run` and `can` read a model"),
    ("links", "a module document", "`thorvaldc modules check` checks a folder of modules"),
    ("params", "a module document", "`thorvaldc modules check` checks a folder of modules"),
)


def report_wrong_kind(document: Node, report: Report) -> bool:
    """Reports an error if a YAML document is neither a robot nor a fleet nor a scenario.

    Returns ``True`` if the YAML document has a wrong kind.  For a YAML document of a wrong kind,
    the schema check is skipped, because errors of the robot schema would be misleading.
    """
    if document.get("name") is None:
        for key, description, hint in _WRONG_KINDS:
            node = document.get(key)
            if node is not None:
                message = f"this is {description}; expected a robot, fleet or scenario document"
                report.add("other-document", message, node.where, hint=hint)
                return True
    return False
