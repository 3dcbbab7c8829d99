"""Holds back diagnostics that probably follow from another error in the same report.

A misspelled key, for example, removes a module.  The robot then stands on three wheels, which is
not a mistake of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from thorvaldc.compiler.result.acceptances import Acceptance
from thorvaldc.diagnostics import Diagnostic, Label, Report, Severity
from thorvaldc.diagnostics.codes import STRUCTURE

_OCCUPIED = "mount-occupied"  # an invalid length in another line can move two ports together
_WIRING = {
    *("can-bus-unknown", "channel-unknown", "motor-conflict", "channel-role"),
    _OCCUPIED,
}
# Codes of 1xx to 3xx and 7xx whose cause is often another error in the structure.
_CONSEQUENCES = {"root-missing", "root-ambiguous", "scenario-robots-missing", "calibration-wheel"}
# Checks of the physics of the whole robot.
_PHYSICS = {
    *("link-massless", "no-wheels", "wheel-off-ground", "wheels-overlap", "unstable"),
    *("no-free-motion", "twist-uncontrolled", "slope-too-steep", "frame-height"),
    "start-in-obstacle",
}
_NO_UNIT = "number-without-unit"
_TIME = " is a time of "  # in the message about a number that changes no body
_UNUSED_ARGUMENT = "extra-argument-unused"  # a warning that names the cause of an error


def without_consequences(
    shape: Report, later: Report, acceptances: Iterable[Acceptance] = ()
) -> Report:
    """Returns the diagnostics of ``later`` that do not follow from errors in the structure.

    - ``shape``: errors of the document against the schema.
    - ``later``: diagnostics of the stages after the schema check.
    - ``acceptances``: warnings that the document accepts.  An accepted number has no consequences.
    """
    accepted = tuple(acceptances)
    numbers = [
        d for d in later if d.code.name == _NO_UNIT and not any(a.covers(d) for a in accepted)
    ]
    causes = [d for d in (*shape.errors, *later.errors) if is_structural(d)]
    remaining = Report()
    if not causes and numbers:
        remaining.extend(_without_consequences_of(numbers, later))
    elif causes:
        remaining.extend(d for d in later if not _follows(d, causes))
    else:
        remaining.extend(later)
    return _grouped(remaining)


def _without_consequences_of(numbers: list[Diagnostic], later: Report) -> Iterator[Diagnostic]:
    """Yields the diagnostics that do not follow from numbers without a unit.

    A length in the wrong unit changes the whole robot: the wheels that do not reach the ground are
    those that the user did not touch.  One error about physics remains, at the number.
    """
    bodies = [d for d in numbers if _TIME not in d.message]
    blamed = False
    for diagnostic in later:
        if bodies and diagnostic.code.name in _PHYSICS:
            if not blamed and diagnostic.severity is Severity.ERROR:
                blamed = True
                yield _moved(diagnostic, bodies[0])
        elif diagnostic.code.name == _NO_UNIT or not _is_remark(diagnostic):
            yield diagnostic


def _moved(diagnostic: Diagnostic, number: Diagnostic) -> Diagnostic:
    """Returns an error about physics at the number without a unit that probably causes it."""
    labels = diagnostic.labels
    if diagnostic.span is not None and diagnostic.span != number.span:
        labels = (Label(diagnostic.span, "the effect is here"),)
    message = f"with this number, {diagnostic.message}"
    hint = "first give the number its unit"
    return Diagnostic(diagnostic.code, message, number.span, hint, labels)


def is_structural(diagnostic: Diagnostic) -> bool:
    """Returns whether a diagnostic is an error in the structure of a document."""
    code = diagnostic.code
    return (
        diagnostic.severity is Severity.ERROR
        and (code.number[2] in STRUCTURE or code.name in _WIRING)
        and code.name not in _CONSEQUENCES
    )


def _follows(diagnostic: Diagnostic, causes: list[Diagnostic]) -> bool:
    code = diagnostic.code
    if code.name in _CONSEQUENCES:
        return any(cause.code.number < "TV304" for cause in causes)
    if code.name == _OCCUPIED:
        return any(cause.code.name != _OCCUPIED for cause in causes)
    if diagnostic.severity is Severity.ERROR:
        return code.name in _PHYSICS
    return _is_remark(diagnostic) and code.name != _UNUSED_ARGUMENT


def _is_remark(diagnostic: Diagnostic) -> bool:
    """Returns whether a diagnostic is a warning or a note about the robot as a whole."""
    return diagnostic.severity is not Severity.ERROR and diagnostic.code.number >= "TV4"


def _grouped(report: Report) -> Report:
    """Returns a report in which references to one missing module are one diagnostic."""
    by_message: dict[str, list[Diagnostic]] = {}
    for diagnostic in report:
        if diagnostic.code.name == "module-unknown" and not diagnostic.fixes:
            by_message.setdefault(diagnostic.message, []).append(diagnostic)
    grouped = Report()
    for diagnostic in report:
        same = by_message.get(diagnostic.message, [diagnostic])
        if diagnostic is same[0]:
            others = tuple(Label(d.span, "also here") for d in same[1:] if d.span is not None)
            labelled = replace(diagnostic, labels=(*diagnostic.labels, *others))
            grouped.put(labelled if others else diagnostic)
    return grouped
