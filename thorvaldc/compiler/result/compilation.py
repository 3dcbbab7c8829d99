"""Defines the classes for the input file and the result of a compilation."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY
from thorvaldc.compiler.result.acceptances import (
    Acceptance,
    accept_warnings,
    read_acceptances,
    report_unused,
)
from thorvaldc.compiler.result.consequences import without_consequences
from thorvaldc.compiler.source.input_file import unsaved_text
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.validation.document_kinds import (
    is_fleet,
    is_scenario,
    is_study,
    report_wrong_kind,
)
from thorvaldc.diagnostics import Accepted, Diagnostic, Label, Report, Span
from thorvaldc.diagnostics.bounded_file import MAX_LOG_BYTES
from thorvaldc.model import Fleet, Robot
from thorvaldc.schema.documents import Kind

# The scenario classes are imported only for type checkers, because the import takes several
# milliseconds.
if TYPE_CHECKING:
    from thorvaldc.compiler.modules.module_tree import Instance
    from thorvaldc.compiler.modules.mounting_ports import MountingPort
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.model.scenario import Scenario

SETTING = "--set "
"""A span of a ``--set`` option of the command line has a file name with this prefix."""


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
    """

    def __init__(self, path: Path, name: str, folder: Path) -> None:
        self.path = path
        self.name = name
        self.folder = folder
        self.shape = Report()
        document = read_file(path, name, self.shape)
        self.document = (
            None if document is None or report_wrong_kind(document, self.shape) else document
        )
        self.kind: Kind = "robot"
        if is_study(self.document):
            self.kind = "study"
        elif is_scenario(self.document):
            self.kind = "scenario"
        elif is_fleet(self.document):
            self.kind = "fleet"

    def check_shape(self, document: Node) -> Node:
        """Checks a document against the schema and returns the valid part of the document.

        The later stages of the compiler use the valid part of the document, so that one run reports
        the errors of all stages.
        """
        check(document, self.kind, self.shape)
        return without_invalid_values(document, self.shape)


@dataclass
class Compilation:
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
        return cls(folder=source.folder, files={source.name: source.path})

    def ports(self, robot: Robot) -> list[MountingPort]:
        """Returns the mounting ports of a robot of the compilation.

        They are no part of the model, because the outputs of a build do not need them.
        """
        from thorvaldc.compiler.modules.mounting_ports import mounting_ports

        return mounting_ports(self.instances[robot.span.file], robot)

    def located(self, report: Report) -> Report:
        """Replaces file names in diagnostics about the model by the paths that the user passed.

        Warnings that the documents accept become accepted warnings.
        """

        def with_user_path(span: Span) -> Span:
            if span.file.startswith((BUILTIN_LIBRARY, SETTING)):
                return span
            # Paths in diagnostics are normalized, because annotations of a pull request in CI need
            # paths without `..`.
            path = os.path.normpath(self.files.get(span.file) or self.folder / span.file)
            return Span(path, *span[1:])

        def with_user_paths(diagnostic: Diagnostic) -> Diagnostic:
            span = diagnostic.span
            labels = (Label(with_user_path(label.span), label.text) for label in diagnostic.labels)
            fixes = (replace(fix, span=with_user_path(fix.span)) for fix in diagnostic.fixes)
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
            self.source_sha256 = self._hash_sources(parts, lock_file)
        own, invalid = self.acceptances, Report()
        if source.document is not None:
            own = [*read_acceptances(source.document, invalid), *own]
        later = without_consequences(source.shape, report.excluding_spans_of(source.shape), own)
        later.extend(invalid)
        self.acceptances = [*own, *(a for part in parts.values() for a in part.acceptances)]
        for stage_report in (source.shape, later):
            self.report.extend(self.located(stage_report))
        # After an error, later stages are left out, so that warnings may be missing.
        if not self.report.has_errors:
            unused = Report()
            report_unused((entry for entry in own if not entry.is_module), unused)
            self.report.extend(self.located(unused))
        for name, path in self.files.items():
            is_builtin = name.startswith(BUILTIN_LIBRARY)
            self.sources[name if is_builtin else os.path.normpath(path)] = path
        for part in parts.values():
            self.files.update(part.files)
        if self.report.has_errors:
            self.model = self.scenario = self.tool_document = None
            self.locks.clear()
        return self

    def _hash_sources(self, parts: dict[str, Compilation], lock_file: str) -> str:
        """Computes the SHA-256 of the names and contents of all input files (hexadecimal).

        Reports an error if an input file was removed since it was read.
        """
        digest = hashlib.sha256(lock_file.encode())
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
