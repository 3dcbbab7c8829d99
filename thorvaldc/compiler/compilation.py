"""The input file of a compilation, and its result."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.library import BUILTIN_LIBRARY
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.validation.document_kinds import is_fleet, is_scenario, report_wrong_kind
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Fleet, Robot
from thorvaldc.schema.documents import Kind

if TYPE_CHECKING:  # Creating these classes takes milliseconds, and only scenarios need them.
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.model.scenario import Scenario

SETTING = "--set "
"""Prefix of the file name in a span that points at a ``--set`` option of the command line."""


class SourceFile:
    """A robot, fleet or scenario file: its document and the diagnostics about its shape.

    Attributes
    ----------
    path : where the file is.
    name : the file name that spans of this file show; relative to ``folder``.
    folder : the folder of the file that the user named.
    document : the YAML tree, or ``None`` if the file is unreadable or is no document of
        these kinds; ``shape`` then contains the reason.
    kind : the schema of the document.
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
        if is_scenario(self.document):
            self.kind = "scenario"
        elif is_fleet(self.document):
            self.kind = "fleet"

    def check_shape(self, document: Node) -> Node:
        """Checks the document against the schema; returns it without the values that are wrong.

        The later stages compile what is left, so that one run reports the errors of all stages.
        """
        check(document, self.kind, self.shape)
        return without_invalid_values(document, self.shape)


@dataclass
class Compilation:
    """The result of compiling one file.

    Attributes
    ----------
    model : the robot, or the fleet of a fleet or scenario file.  ``None`` if there are errors.
        Spans in it are relative to ``folder``, so that outputs do not depend on where that is.
    scenario : the scenario of a scenario file; ``model`` is then its fleet.
    report : all diagnostics.  Their spans contain paths as the user gave them.
    source_sha256 : hash of all input files (hexadecimal).
    sources : maps the paths in ``report`` to files, for excerpts.
    folder : the folder of the compiled file.
    files : maps the file names in spans of ``model`` to the input files.
    locks : maps the lock files that a build must write to their text.
    """

    model: Robot | Fleet | None = None
    scenario: Scenario | None = None
    report: Report = field(default_factory=Report)
    source_sha256: str = ""
    sources: dict[str, Path] = field(default_factory=dict)
    folder: Path = field(default_factory=Path)
    files: dict[str, Path] = field(default_factory=dict)
    locks: dict[Path, str] = field(default_factory=dict)

    @classmethod
    def of(cls, source: SourceFile) -> Compilation:
        """Returns the still empty compilation of a file."""
        return cls(folder=source.folder, files={source.name: source.path})

    def located(self, report: Report) -> Report:
        """Returns diagnostics about ``model`` with paths as the user gave them."""

        def with_user_path(span: Span) -> Span:
            if span.file.startswith((BUILTIN_LIBRARY, SETTING)):
                return span
            # Normalized, because annotations of changes in CI need paths without `..`.
            path = os.path.normpath(self.files.get(span.file) or self.folder / span.file)
            return Span(path, *span[1:])

        located = Report()
        for diagnostic in report:
            span = diagnostic.span
            labels = (Label(with_user_path(label.span), label.text) for label in diagnostic.labels)
            located.put(
                replace(
                    diagnostic,
                    span=with_user_path(span) if span is not None else None,
                    labels=tuple(labels),
                )
            )
        return located

    def complete(
        self,
        source: SourceFile,
        report: Report,
        parts: dict[str, Compilation] | None = None,
        lock_file: str = "",
    ) -> Compilation:
        """Adds hash, diagnostics and paths, and removes the model if there are errors.

        ``report`` contains the diagnostics of the stages after the shape check; those at a span
        with a shape error are dropped.  ``parts`` are the compilations of the robot files that
        the file names, by the names in it.  ``lock_file`` is the text of the lock file after
        this build: with it, the hash of the first build, which writes the lock file, equals the
        hash of the next build, which reads it.
        """
        parts = parts or {}
        for part in parts.values():
            self.report.extend(part.report)
            self.sources.update(part.sources)
            self.locks.update(part.locks)
        if source.document is not None:
            self.source_sha256 = _hash_sources(self.files, parts, lock_file)
        for stage_report in (source.shape, report.excluding_spans_of(source.shape)):
            self.report.extend(self.located(stage_report))
        for name, path in self.files.items():
            is_builtin = name.startswith(BUILTIN_LIBRARY)
            self.sources[name if is_builtin else os.path.normpath(path)] = path
        for part in parts.values():
            self.files.update(part.files)
        if self.report.has_errors:
            self.model = self.scenario = None
            self.locks.clear()
        return self


Compile = Callable[[SourceFile], Compilation]
"""Compiles a robot or fleet file that a fleet or scenario file names."""


def _hash_sources(files: dict[str, Path], parts: dict[str, Compilation], lock_file: str) -> str:
    """Computes the SHA-256 of all input files and their names."""
    digest = hashlib.sha256(lock_file.encode())
    for name in sorted(parts):
        digest.update(f"{name}\0{parts[name].source_sha256}\0".encode())
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + files[name].read_bytes() + b"\0")
    return digest.hexdigest()
