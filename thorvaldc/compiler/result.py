"""The result of a compilation: the model, the report, and the files that were read.

A document accepts warnings in its section ``accept``:

    accept:
      - {code: TV408, reason: the mast is removed on slopes}
      - {code: TV416, at: driver.max_linear_velocity, reason: tested at this speed}

An entry accepts the warnings with its code.  With ``at``, it accepts only those at one place of the
document, or in a module that is mounted there.  The entries of a module file accept the warnings in
that file.  Notes are accepted like warnings.  Errors cannot be accepted.

Diagnostics that probably follow from another error in the same report are dropped.  A misspelled
key, for example, removes a module.  The robot then stands on three wheels, which is not a mistake
of its own.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.modules.mounting import MountingPort, mounting_ports
from thorvaldc.compiler.source.input_file import unsaved_text
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.overrides import SETTING, Change, with_changes
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation import document_check
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import (
    FIRST_USE,
    Accepted,
    Code,
    Diagnostic,
    Label,
    Report,
    Severity,
    Span,
    did_you_mean,
)
from thorvaldc.diagnostics.codes import STRUCTURE, all_codes
from thorvaldc.diagnostics.files import MAX_LOG_BYTES
from thorvaldc.diagnostics.html_view import HtmlView
from thorvaldc.model import Robot
from thorvaldc.schema import Kind

# The imports of fleets and scenarios take several milliseconds.
if TYPE_CHECKING:
    from thorvaldc.model import Fleet
    from thorvaldc.model.scenario import Scenario

SECTION = "accept"
_LATER = "68"
"""First digits of codes that commands after the compilation report: backends and simulation."""
_SHORT = ("modules", "robots")
"""Sections whose entries ``at`` can name without the name of the section."""

_OCCUPIED = "mount-occupied"  # an invalid length in another line can move two ports together
_WIRING = {
    *("can-bus-unknown", "channel-unknown", "motor-conflict", "channel-role"),
    _OCCUPIED,
}
# Codes of 1xx to 3xx and 7xx whose cause is often another error in the structure.
_CONSEQUENCES = {"root-missing", "root-ambiguous", "scenario-robots-missing", "calibration-wheel"}
_UNREAD_LIBRARIES = {"library-not-fetched", "library-changed"}
# Checks of the physics of the whole robot.
_PHYSICS = {
    *("link-massless", "no-wheels", "wheel-off-ground", "wheels-overlap", "unstable"),
    *("no-free-motion", "twist-uncontrolled", "slope-too-steep", "frame-height"),
    "start-in-obstacle",
}
_NO_UNIT = "number-without-unit"
_TIME = " is a time of "  # in the message about a number that changes no body
_UNUSED_ARGUMENT = "extra-argument-unused"  # a warning that names the cause of an error


class SourceFile:
    """A robot, fleet or scenario file and the YAML document in the file.

    Attributes
    ----------
    path : path of the file.
    name : name of the file in diagnostics, relative to ``folder``.
    folder : folder of the file that the user named on the command line.
    document : YAML tree of the file.  ``None`` if the file cannot be read, or if it is not a
        robot, fleet or scenario document.
    kind : kind of the document: ``robot``, ``fleet``, ``scenario`` or ``study``.
    shape : errors of the document against the schema, and errors of reading the file.
    changes : values that replace those of the file.
    files : path of the file, and of those of the design of a unit, by their names in spans.
    """

    def __init__(self, path: Path, name: str, folder: Path) -> None:
        self.path = path
        self.name = name
        self.folder = folder
        self.shape = Report()
        document = read_file(path, name, self.shape)
        self.document = (
            None
            if document is None or document_check.report_wrong_kind(document, self.shape)
            else document
        )
        self.changes: tuple[Change, ...] = ()
        self.files = {name: path}
        self.kind: Kind = document_check.compiled_kind(self.document)
        if self.kind == "robot" and self.document is not None and self.document.get("extends"):
            # A robot without a design does not need this module.
            from thorvaldc.compiler.values.unit_file import with_design

            self.document = with_design(self.document, self.files, path, self.shape)

    def change(self, changes: tuple[Change, ...]) -> None:
        """Replaces values of the document."""
        if self.document is not None and changes:
            for change in (change for change in changes if change.path == "extends"):
                message = "the design of a unit is read before a value is set"
                self.shape.add("variation-path", message, change.value.where)
            self.changes = changes
            self.document = with_changes(self.document, changes, self.shape)

    def check_shape(self, document: Node) -> Node:
        """Checks a document against the schema and returns the valid part of the document.

        The later stages of the compiler use the valid part of the document, so that one run reports
        the errors of all stages.
        """
        document_check.check(document, self.kind, self.shape)
        return document_check.without_invalid_values(document, self.shape)


@dataclass
class Compilation(HtmlView):
    """Result of the compilation of one robot, fleet or scenario file.

    Attributes
    ----------
    model : the robot, or the fleet of a fleet or scenario file.  ``None`` if there are errors.
        File names in spans of the model are relative to ``folder``.  The outputs of a build
        therefore do not depend on the location of the folder.
    scenario : the scenario of a scenario file.  The fleet of the scenario is in ``model``.
    tool_document : what a tool has read from a document of its own kind, such as a study.  The
        robot that the document names is in ``model``.
    report : all diagnostics.  Paths in spans of the report are written as the user gave them.
    source_sha256 : SHA-256 of all input files (hexadecimal).
    sources : path of the input file for each path in ``report``.  Messages show excerpts of the
        input files.
    folder : the folder of the compiled file.
    files : path of the input file for each file name in spans of ``model``.
    locks : text of each lock file that a build must write, by the path of the lock file.
    acceptances : entries of the sections ``accept`` of the compiled file, its modules and parts.
    instances : tree of module instances of each robot, by the file name in the span of the robot.
    """

    html_view = "thorvaldc.compiler.pipeline:compilation_html"

    model: Robot | Fleet | None = None
    scenario: Scenario | None = None
    tool_document: object = None
    report: Report = field(default_factory=Report)
    source_sha256: str = ""
    sources: dict[str, Path] = field(default_factory=dict)
    folder: Path = field(default_factory=Path)
    files: dict[str, Path] = field(default_factory=dict)
    locks: dict[Path, str] = field(default_factory=dict)
    acceptances: list[Acceptance] = field(default_factory=list)
    instances: dict[str, Instance] = field(default_factory=dict)

    def __repr__(self) -> str:
        content = "no model" if self.model is None else repr(self.model)
        return f"<Compilation: {content}, {self.report.summary()}>"

    @classmethod
    def of(cls, source: SourceFile) -> Compilation:
        """Returns a compilation of the file without a model and without diagnostics."""
        return cls(folder=source.folder, files=dict(source.files))

    def ports(self, robot: Robot) -> list[MountingPort]:
        """Returns the mounting ports of a robot of the compilation.

        They are no part of the model, because the outputs of a build do not need them.
        """
        return mounting_ports(self.instances[robot.span.file], robot)

    def located(self, report: Report) -> Report:
        """Replaces file names in diagnostics about the model by the paths that the user passed.

        Warnings that the documents accept become accepted warnings.
        """

        def with_user_path(span: Span) -> Span:
            if span.file.startswith(("<", SETTING)):  # a library has no path of the user
                return span
            # Paths in diagnostics are normalized, because annotations of a pull request in CI need
            # paths without `..`.
            path = os.path.normpath(self.files.get(span.file) or self.folder / span.file)
            return Span(path, *span[1:])

        def with_user_paths(diagnostic: Diagnostic) -> Diagnostic:
            span = diagnostic.span
            labels = (Label(with_user_path(label.span), label.text) for label in diagnostic.labels)
            fixes = (fix._replace(span=with_user_path(fix.span)) for fix in diagnostic.fixes)
            return replace(
                diagnostic,
                span=with_user_path(span) if span is not None else None,
                labels=tuple(labels),
                fixes=tuple(fixes),
            )

        accept_warnings(report, self.acceptances)
        located = Report()
        located.extend(map(with_user_paths, report))
        for diagnostic, reason, span in report.accepted:
            located.add_accepted(
                Accepted(with_user_paths(diagnostic), reason, with_user_path(span))
            )
        return located

    def complete(
        self,
        source: SourceFile,
        report: Report,
        parts: dict[str, Compilation] | None = None,
        lock_file: str = "",
    ) -> Compilation:
        """Adds the hash of the input files, the diagnostics and the paths of the input files to the
        compilation.

        If the input files have errors, the model is removed from the compilation.

        Parameters
        ----------
        source : the compiled file.
        report : diagnostics of the stages after the schema check.  A diagnostic is dropped if
            the schema check already reported an error at the same span.
        parts : compilations of the robot and fleet files that the compiled file names, by the
            names in the document.
        lock_file : text of the lock file after this build.  The hash includes the text.  The
            first build, which writes the lock file, and the next build, which reads the lock
            file, therefore have the same hash.
        """
        parts = parts or {}
        for part in parts.values():
            self.report.extend(part.report)
            self.sources.update(part.sources)
            self.locks.update(part.locks)
            self.instances.update(part.instances)
        if source.document is not None:
            texts = (lock_file, *(f"\0{c.path}={c.text}" for c in source.changes))
            self.source_sha256 = self._hash_sources(parts, "".join(texts))
        own, invalid = self.acceptances, Report()
        if source.document is not None:
            own = [*read_acceptances(source.document, invalid), *own]
        later = without_consequences(source.shape, report.excluding_spans_of(source.shape), own)
        later.extend(invalid)
        if len(source.files) > 1:
            later = _blamed_on_unit(later, source)
        self.acceptances = [*own, *(a for part in parts.values() for a in part.acceptances)]
        for stage_report in (source.shape, later):
            self.report.extend(self.located(stage_report))
        # After an error, later stages are left out, so that warnings may be missing.
        if not self.report.has_errors:
            unused = Report()
            report_unused((entry for entry in own if not entry.is_module), unused)
            self.report.extend(self.located(unused))
        for name, path in self.files.items():
            self.sources[name if name.startswith("<") else os.path.normpath(path)] = path
        for part in parts.values():
            self.files.update(part.files)
        if self.report.has_errors:
            self.model = self.scenario = self.tool_document = None
            self.locks.clear()
        return self

    def _hash_sources(self, parts: dict[str, Compilation], more: str) -> str:
        """Computes the SHA-256 of a text ``more`` and the names and contents of all input files.

        Reports an error if an input file was removed since it was read.
        """
        digest = hashlib.sha256(more.encode())
        for name in sorted(parts):
            digest.update(f"{name}\0{parts[name].source_sha256}\0".encode())
        for name in sorted(self.files):
            digest.update(name.encode() + b"\0")
            if (text := unsaved_text(self.files[name])) is not None:
                digest.update(text + b"\0")
                continue
            try:
                status = os.stat(self.files[name])
                # A reader has refused a pipe, which never ends, and a file above the limit of logs.
                if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_LOG_BYTES:
                    continue
                with self.files[name].open("rb") as file:  # records and meshes can be large
                    while part := file.read(1 << 20):
                        digest.update(part)
            except OSError as error:
                self.report.add(
                    "file-unreadable",
                    f"`{self.files[name]}` was read, but cannot be read again: {error.strerror}",
                    hint="another program changed it during the compilation; start again",
                )
            digest.update(b"\0")
        return digest.hexdigest()


Compile = Callable[[SourceFile], Compilation]
"""Function that compiles a robot or fleet file named in a fleet or scenario file."""


# -- the section ``accept`` ------------------------------------------------------------


@dataclass
class Acceptance:
    """An entry of the section ``accept``.

    - ``code``: the accepted code.
    - ``reason``: the user's reason.
    - ``span``: the entry in the document.
    - ``file``: name of the document in spans.
    - ``places``: spans of the key and value that ``at`` names; none for the whole document.
    - ``is_module``: whether the document is a module file.
    - ``is_used``: whether a warning was accepted.
    """

    code: Code
    reason: str
    span: Span
    file: str
    places: tuple[Span, ...]
    is_module: bool
    is_used: bool = False

    def covers(self, diagnostic: Diagnostic) -> bool:
        """Returns whether the entry accepts a diagnostic."""
        if diagnostic.code != self.code:
            return False
        span = diagnostic.span
        is_here = span is not None and span.file in (self.file, *(p.file for p in self.places))
        if self.is_module and not is_here:
            return False
        if not self.places:
            return True
        # A warning in a module file has a label at the module in the robot file.
        spans = [span] if is_here else [label.span for label in diagnostic.labels]
        return any(s is not None and _is_inside(s, place) for s in spans for place in self.places)


def read_acceptances(document: Node, report: Report, is_module: bool = False) -> list[Acceptance]:
    """Returns the entries of the section ``accept`` of a document.

    Entries that do not match the schema are left out.  Reports codes that are not those of
    warnings, and places that do not exist.
    """
    acceptances: list[Acceptance] = []
    for entry in items(document.get(SECTION)):
        code_node, reason = entry.get("code"), entry.get("reason")
        at = entry.get("at")
        if code_node is None or reason is None or not isinstance(code_node.value, str):
            continue
        code = _warning_code(code_node, report)
        places = _places(document, at, report) if at is not None else ()
        if code is None or (at is not None and not places):
            continue
        file = document.span.file
        acceptances.append(Acceptance(code, str(reason.value), entry.span, file, places, is_module))
    return acceptances


def accept_warnings(report: Report, acceptances: Iterable[Acceptance]) -> None:
    """Moves the warnings that an entry accepts to the accepted diagnostics of the report."""
    acceptances = list(acceptances)
    if not acceptances:
        return
    for diagnostic in report:
        matching = [entry for entry in acceptances if entry.covers(diagnostic)]
        for entry in matching:
            entry.is_used = True
        if matching:
            report.accept(diagnostic, matching[0].reason, matching[0].span)


def report_unused(acceptances: Iterable[Acceptance], report: Report) -> None:
    """Reports entries whose warning did not occur in a complete compilation."""
    for entry in acceptances:
        if not entry.is_used and entry.code.number[2] not in _LATER:
            code = f"{entry.code.severity} {entry.code.number} {entry.code.name}"
            report.add(
                "accept-unused",
                f"there is no {code} here any more",
                entry.span,
                hint="remove the entry",
            )


def _warning_code(node: Node, report: Report) -> Code | None:
    """Returns the code of a warning or note by its number or name."""
    word = str(node.value)
    code = next((c for c in all_codes() if word in (c.number, c.name)), None)
    error = Severity.ERROR.value
    if code is None:
        accepted = [c for c in all_codes() if c.severity != error]
        warnings = [name for c in accepted for name in (c.number, c.name)]
        report.add(
            "accept-code",
            f"there is no code `{word}`",
            node.span,
            hint=did_you_mean(word, warnings, "the code is in the warning, such as `TV408`"),
        )
    elif code.severity == error or code.name == "accept-unused":
        reason = "is an error" if code.severity == error else "is about this section"
        report.add(
            "accept-code",
            f"{code.number} {code.name} {reason}; only warnings and notes can be accepted",
            node.span,
            hint="correct the cause instead" if code.severity == error else "remove the entry",
        )
        return None
    return code


def _places(document: Node, at: Node, report: Report) -> tuple[Span, ...]:
    """Returns the spans of the key and value that a path such as ``modules.fl.params`` names."""
    keys = str(at.value).split(".")
    node, known = document, _known(document)
    for number, key in enumerate(keys):
        child = {str(name): entry for name, entry in node.children()}.get(key)
        if child is None and number == 0:
            sections = (entries(document.get(name)) for name in _SHORT)
            child = next((section[key] for section in sections if key in section), None)
        if child is None:
            where = f"`{'.'.join(keys[:number])}` has no" if number else "the document has no"
            report.add(
                "accept-place",
                f"{where} `{key}`",
                at.span,
                hint=did_you_mean(key, known, fixable=len(keys) == 1),
            )
            return ()
        node, known = child, list(entries(child))
    return tuple(node.places())


def _known(document: Node) -> list[str]:
    """Returns the first words of all places."""
    return [*entries(document), *(name for key in _SHORT for name in entries(document.get(key)))]


def _is_inside(span: Span, place: Span) -> bool:
    start, end = (place.line, place.column), (place.end_line, place.end_column)
    return span.file == place.file and start <= (span.line, span.column) < end


# -- consequences of errors ------------------------------------------------------------


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
    is_unread = any(cause.code.name in _UNREAD_LIBRARIES for cause in causes)
    if code.name == "module-type-unknown":
        return is_unread
    if code.name in _CONSEQUENCES:
        return is_unread or any(cause.code.number < "TV304" for cause in causes)
    if code.name == _OCCUPIED:
        return any(cause.code.name != _OCCUPIED for cause in causes)
    if diagnostic.severity is Severity.ERROR:
        return code.name in _PHYSICS
    return _is_remark(diagnostic) and code.name != _UNUSED_ARGUMENT


def _is_remark(diagnostic: Diagnostic) -> bool:
    """Returns whether a diagnostic is a warning or a note about the robot as a whole."""
    return diagnostic.severity is not Severity.ERROR and diagnostic.code.number >= "TV4"


def _blamed_on_unit(report: Report, unit: SourceFile) -> Report:
    """Moves errors about values that two entries have, as CAN ids, to the entry of the unit."""
    moved = Report()
    for diagnostic in report:
        span, uses = diagnostic.span, [x.span for x in diagnostic.labels if x.text == FIRST_USE]
        if span and uses and uses[0].file == unit.name != span.file:
            diagnostic = replace(diagnostic, span=uses[0], labels=(Label(span, "also here"),))
        moved.put(diagnostic)
    return moved


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
