"""The diagnostics of an open document, from the unsaved texts of all open documents."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.catalogue import check_module
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, Library
from thorvaldc.compiler.pipeline import compile_file, library_folders_of
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Diagnostic, Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.schema.documents import Kind
from thorvaldc.tools.language_server.open_document import OpenDocument


@dataclass(frozen=True)
class Analysis:
    """Result of the analysis of one document.

    Attributes
    ----------
    kind : kind of the document.
    diagnostics : diagnostics with absolute paths, in the order of file and line.
    sources : path of each file name in the spans of the diagnostics, and of each file that the
        analysis has read.
    files : real paths of the files that the analysis has read.
    model : the robot or fleet, or ``None`` if the document has errors or another kind.
    library : library folders that a robot document names.
    """

    kind: Kind | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    sources: Mapping[str, Path] = field(default_factory=dict)
    files: frozenset[str] = frozenset()
    model: Robot | Fleet | None = None
    library: tuple[Path, ...] = ()


def analyse(
    document: OpenDocument, texts: Mapping[str, bytes], folders: tuple[Path, ...] = ()
) -> Analysis:
    """Returns the diagnostics of a document, and of the files that it names.

    - ``texts``: unsaved texts by real path, see ``unsaved_texts``.
    - ``folders``: further library folders, for the modules that a module document names.
    """
    kind = document.kind
    if kind is None:
        return Analysis()
    with unsaved_texts(texts):
        if kind in ("robot", "fleet", "scenario", "study"):
            compilation = compile_file(document.path)
            report, sources = compilation.report, compilation.sources
            model = compilation.model
        else:
            model = None
            report, sources = _checked_alone(document, kind, folders)
    files = frozenset(os.path.realpath(path) for path in sources.values())
    diagnostics = tuple(report.sorted())
    library = library_of(document) if kind == "robot" else ()
    return Analysis(kind, diagnostics, sources, files | {document.real_path}, model, library)


def library_of(document: OpenDocument) -> tuple[Path, ...]:
    """Returns the library folders that a robot document names."""
    if "library" not in document.text:
        return ()
    node = read_text(document.encoded, document.path.name, Report())
    if node is None:
        return ()
    folders = library_folders_of(node, document.path.parent, (), Report())
    return tuple(folder for folder, _ in folders)


def _checked_alone(
    document: OpenDocument, kind: Kind, folders: tuple[Path, ...]
) -> tuple[Report, dict[str, Path]]:
    """Checks a document that no robot needs to name."""
    report, name = Report(), str(document.path)
    if kind == "module":
        module, library = module_library(document.path, folders)
        if library.exists(module):
            check_module(module, library, report)
            builtin = BUILTIN_LIBRARY + "/"
            sources = {n: path for n, path in library.files.items() if n.startswith(builtin)}
            return report, sources | {str(p): p for p in library.files.values()}
    node = read_text(document.encoded, name, report)
    if node is not None:
        check(node, kind, report)
    return report, {name: document.path}


def module_library(path: Path, folders: tuple[Path, ...]) -> tuple[str, Library]:
    """Returns the name of the module type in a module file, and a library with its folder.

    The folder is the one of ``folders`` that contains the file.  Without such a folder, the name of
    the type has two parts, such as ``drive/standard``.
    """
    own = next(
        (folder for folder in folders if path.is_relative_to(folder)), path.parent.parent.parent
    )
    others = [folder for folder in folders if folder != own]
    name = path.parent.relative_to(own).as_posix()
    return name, Library([(folder, str(folder)) for folder in (own, *others)])
