"""Checks documents against the JSON Schemas in ``thorvaldc/schema``.

One walk over document and schema checks the shape of each value and each quantity.  If the shape is
wrong, the package jsonschema lists the schema errors of the document.  The module
``schema_diagnostics`` converts errors of jsonschema to diagnostics with source spans.

The kind of a document is recognised by its top-level keys.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.validation.schema_walk import SchemaWalk, matches
from thorvaldc.diagnostics import Report, Span
from thorvaldc.schema import Kind, inlined

MAX_DIAGNOSTICS = 1000


def check(node: Node, kind: Kind, report: Report) -> bool:
    """Checks a YAML document against the JSON Schema for this kind of document.

    Returns whether the document matches the JSON Schema.  Adds a diagnostic to ``report`` for each
    schema error, and stops if the report has more than ``MAX_DIAGNOSTICS`` diagnostics.  If
    ``report`` already contains an error about a value, no further diagnostic about the value is
    added.
    """
    # The YAML reader returns the most likely value of an invalid scalar.  A schema error about the
    # most likely value of an invalid scalar could be misleading.
    reported = {diagnostic.span for diagnostic in report.errors if diagnostic.span is not None}
    walk, is_valid = SchemaWalk(kind), True
    if not walk.fits(inlined(kind), node):
        from thorvaldc.compiler.validation.schema_diagnostics import explain

        for error in _validator(kind).iter_errors(node.plain()):
            is_valid = False
            explain(error, node, kind, reported, report)
            if len(report) > MAX_DIAGNOSTICS:
                return False
    for span, unit_error in walk.errors:
        if len(report) > MAX_DIAGNOSTICS:
            return False
        if span not in reported:
            is_valid = False
            report.add(unit_error.code, unit_error.message, span, hint=unit_error.hint)
    return is_valid


@functools.cache
def _validator(kind: Kind) -> Any:
    from jsonschema import Draft202012Validator, ValidationError
    from jsonschema.validators import extend

    # JSON Schema accepts the number 3.0 as an integer.  The compiler rejects the number 3.0 as an
    # integer, because a device id, for example, has no decimal point.
    checker = Draft202012Validator.TYPE_CHECKER.redefine(
        "integer", lambda _, value: isinstance(value, int) and not isinstance(value, bool)
    )

    def pattern(_validator: Any, expected: str, value: Any, _schema: Any) -> Iterator[Any]:
        if isinstance(value, str) and not matches(expected, value):
            yield ValidationError(f"{value!r} does not match {expected!r}")

    strict: Any = extend(  # type: ignore[no-untyped-call]
        Draft202012Validator, {"pattern": pattern}, type_checker=checker
    )
    return strict(inlined(kind))


def without_invalid_values(node: Node, report: Report) -> Node:
    """Returns a copy of a YAML document in which each invalid value is replaced by ``None``.

    A value of a document is invalid if ``report`` contains an error at the source span of the
    value.  Later stages of the compiler can process the copy without the invalid values, so one run
    also reports errors of later stages.  The value ``None`` that replaces an invalid value keeps
    the key and the source span.
    """
    spans = {diagnostic.span for diagnostic in report.errors if diagnostic.span is not None}
    return _blanked(node, spans) if spans else node


def _blanked(node: Node, spans: set[Span]) -> Node:
    value = node.value
    if node.span in spans:
        value = None
    elif isinstance(value, dict):
        value = {key: _blanked(entry, spans) for key, entry in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_blanked(item, spans) for item in value)
    return Node(value, node.span, node.key_span, node.quoted)


# -- kinds of documents -----------------------------------------------------------

_TOP_LEVEL_KEY = r"(?m)^(?:\{\s*)?[\"']?([A-Za-z_]\w*)[\"']?[ \t]*:(?=\s|$)"
_NO_KIND = frozenset(["thorvaldc_lock", "motor_drives"])
_KEYS_OF_KINDS: tuple[tuple[Kind, frozenset[str]], ...] = (
    ("study", frozenset(["study", "objectives", "samples"])),
    ("scenario", frozenset(["scenario", "script", "expect", "duration", "world"])),
    ("robot", frozenset(["base_calculator", "extras", "buses", "design", "defaults", "extends"])),
    ("fleet", frozenset(["robots"])),
    ("bus_faults", frozenset(["faults", "quirks"])),
    ("module", frozenset(["params", "links", "joints", "ports", "let", "category", "mount"])),
    ("robot", frozenset(["modules", "driver"])),
    ("calibration", frozenset(["wheels"])),
)
_FILE_NAMES: dict[str, Kind] = {
    "robot.yaml": "robot",
    "fleet.yaml": "fleet",
    "scenario.yaml": "scenario",
    "calibration.yaml": "calibration",
    "module.yaml": "module",
}


def kind_of(text: str, file_name: str) -> Kind | None:
    """Returns the kind of a document, also if it is half typed.

    Returns ``None`` if the document is not one of thorvaldc: a document has the key ``thorvaldc``
    or a file name of the language, such as ``robot.yaml``.
    """
    keys = set(re.findall(_TOP_LEVEL_KEY, text[:1_000_000]))
    by_name = _FILE_NAMES.get(file_name)
    if keys & _NO_KIND or ("thorvaldc" not in keys and by_name is None):
        return None
    if by_name is not None:
        return by_name
    for kind, kind_keys in _KEYS_OF_KINDS:
        if keys & kind_keys:
            return kind
    return "robot"


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


def compiled_kind(document: Node | None) -> Kind:
    """Returns the kind of a document that can be compiled: a robot, unless its keys say more."""
    if is_study(document) or is_scenario(document):
        return "study" if is_study(document) else "scenario"
    return "fleet" if is_fleet(document) else "robot"


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
