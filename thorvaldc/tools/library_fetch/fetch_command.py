"""The command ``thorvaldc modules fetch``: the only one that reads libraries of others.

It writes the cache and the lock file, each in one step; `check` and `build` read both.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import DiagnosticOutput, count, message
from thorvaldc.cli.exits import DONE, closing_when_terminated, write_errors
from thorvaldc.diagnostics import DiagnosticError, Report

if TYPE_CHECKING:
    from thorvaldc.compiler.modules.fetched_library import FetchedLibrary, LibraryPin
    from thorvaldc.compiler.source.node import Node


def fetch(
    files: Annotated[
        list[str],
        typer.Argument(metavar="FILE", help="A robot file, or a fleet or scenario with robots."),
    ],
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Fetch again, and pin what the tags and archives are at present."
        ),
    ] = False,
    json: options.Json = False,
) -> int:
    from thorvaldc.compiler.source.lock_file import without_lock_files

    output = DiagnosticOutput("json" if json else "text", sys.stderr)
    libraries: list[dict[str, Any]] = []
    with closing_when_terminated():
        for path in dict.fromkeys(map(Path, without_lock_files(files))):
            libraries += fetch_libraries(path, update, output)
    status = output.finish(libraries=libraries)
    if status == DONE and not libraries:
        output.result("no robot names a repository or an archive")
    return status


def fetch_libraries(path: Path, update: bool, output: DiagnosticOutput) -> list[dict[str, Any]]:
    """Fetches the libraries that a robot file names, and those of its design.

    The pins go to the lock file of the file that names the library.  Returns what was pinned, as
    JSON values, and adds the errors to ``output``.
    """
    from thorvaldc.compiler.modules.fetched_library import fetched_libraries
    from thorvaldc.compiler.result import Compilation, SourceFile

    source, report = SourceFile(path, path.name or str(path), path.parent), Report()
    compilation = Compilation.of(source)
    rows: list[dict[str, Any]] = []
    if source.kind != "robot":
        for robot in _robots_of(path):
            rows += fetch_libraries(robot, update, output)
    elif source.document is not None:
        entries = list(fetched_libraries(source.check_shape(source.document)))
        for name, file in source.files.items():
            own = [(library, node) for library, node in entries if node.span.file == name]
            rows += _fetch_own(own, file, name, update, report, output)
    errors = Report()
    for part in (source.shape, report):
        errors.extend(compilation.located(part))
    output.add(errors, {os.path.normpath(file): file for file in source.files.values()})
    return rows


def _robots_of(path: Path) -> list[Path]:
    """Returns the robot files with libraries that a fleet or scenario names."""
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.result import SourceFile

    files = dict.fromkeys(compile_file(path).files.values())
    sources = [SourceFile(file, file.name, file.parent) for file in files if file != path]
    return [
        source.path
        for source in sources
        if source.document is not None and source.kind == "robot" and source.document.get("library")
    ]


def _fetch_own(
    entries: list[tuple[FetchedLibrary, Node]],
    file: Path,
    name: str,
    update: bool,
    report: Report,
    output: DiagnosticOutput,
) -> list[dict[str, Any]]:
    """Fetches the libraries that one file names, and writes its lock file."""
    from thorvaldc.compiler.modules.fetched_library import cache_folder, is_intact, read_pins

    errors = Report()
    old = read_pins(file, name, errors) if entries else []
    report.extend(errors)
    if not entries or errors.has_errors:
        return []
    pins: list[LibraryPin] = []
    rows: list[dict[str, Any]] = []
    for library, node in entries:
        pin = next((pin for pin in old if pin.library == library), None)
        if pin is not None and not update and is_intact(cache_folder() / pin.sha256, pin.sha256):
            new, text = pin, "is in the cache"
        else:
            try:
                new, types = _fetch_one(library, file, pin if not update else None)
            except DiagnosticError as error:
                named = f"`{library.name}`: {error.diagnostic.message}"
                report.put(replace(error.diagnostic, message=named, span=node.span))
                pins += [pin] if pin is not None else []
                continue
            text = f"{count(len(types), 'module')}, such as {types[0]}"
        pins.append(new)
        output.result(f"{library.name}: {text}, {new.version}")
        rows.append(new.document)
    if pins != old:
        _write_lock(file, pins, report, output)
    return rows


def _fetch_one(
    library: FetchedLibrary, file: Path, pin: LibraryPin | None
) -> tuple[LibraryPin, list[str]]:
    """Fetches a library into the cache; returns its pin and its module types.

    Raises ``DiagnosticError`` if it cannot be fetched or differs from the pin.
    """
    from thorvaldc.compiler.modules.fetched_library import LibraryPin
    from thorvaldc.tools.library_fetch.archive_file import unpack
    from thorvaldc.tools.library_fetch.git_repository import fetch_tag
    from thorvaldc.tools.library_fetch.library_stage import new_stage

    if sys.stderr.isatty():
        message(f"fetching {library.git or library.archive} ...")
    with new_stage(library.folder) as stage:
        commit = ""
        if library.git:
            commit = fetch_tag(library.git, library.tag, stage)
        else:
            unpack(library.archive, file.parent, stage)
        if pin is not None and pin.commit != commit:
            raise _changed(f"the tag has moved from the commit {pin.commit[:12]} to {commit[:12]}")
        sha256, types = stage.keep()
    if pin is not None and pin.sha256 != sha256:
        raise _changed("the content has changed since it was pinned")
    return LibraryPin(library, commit, sha256), types


def _changed(text: str) -> DiagnosticError:
    hint = "if that is right, `thorvaldc modules fetch --update` pins the new content"
    return DiagnosticError("library-changed", text, hint=hint)


def _write_lock(
    file: Path, pins: list[LibraryPin], report: Report, output: DiagnosticOutput
) -> None:
    """Replaces the libraries of a lock file, which keeps its node ids."""
    from thorvaldc.compiler.bus.node_ids import address_lines, read_lock
    from thorvaldc.compiler.source.lock_file import lock_path, lock_text
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics.files import write_file

    path, errors = lock_path(file), Report()
    document = read_file(path, path.name, errors) if path.exists() else None
    lock = read_lock(document, errors) if document is not None else {}
    report.extend(errors)
    if errors.has_errors:
        return
    ids = {key: pin.id for key, pin in lock.items()}
    text = lock_text(file.name, (pin.line for pin in pins), address_lines(ids))
    with write_errors(path):
        write_file(path, text)
    output.result(f"{path}: the libraries are pinned; keep it with the robot")
