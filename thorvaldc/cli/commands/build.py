"""The commands ``thorvaldc build``, which compiles robot files and writes the output files of the
targets, and ``targets``, which lists them."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completion import target_names
from thorvaldc.cli.exits import DONE

if TYPE_CHECKING:
    from thorvaldc.compiler.result import Compilation
    from thorvaldc.model import Fleet, Robot


def build(
    files: options.ModelFiles,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            "-t",
            metavar="NAMES",
            autocompletion=target_names,
            help="Targets, separated by commas.",
            show_default="see `thorvaldc targets`",
        ),
    ] = None,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            show_default="build/<name>",
            help="Folder to write; for several FILEs, the parent of a folder for each.",
        ),
    ] = "",
    format: options.Format = "text",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Write nothing; fail if the folder is not what a build would write."
        ),
    ] = False,
) -> int:
    from thorvaldc import __version__
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, count
    from thorvaldc.compiler.bus.node_ids import without_lock_files
    from thorvaldc.compiler.output.build_freshness import check_freshness
    from thorvaldc.compiler.output.writer import WriteError, write_locks
    from thorvaldc.compiler.pipeline import compile_file

    check_format(format)
    targets = _parse_targets(target)
    folders = options.library_folders(library)
    files = without_lock_files(files)
    shown = DiagnosticOutput(format, sys.stderr)
    builds: list[dict[str, Any]] = []
    file_by_folder: dict[str, str] = {}
    for file in files:
        compilation = compile_file(file, library=folders, trust=trust)
        contents = _emit(compilation, targets)
        model = compilation.model
        if model is None or compilation.report.has_errors:
            shown.add(compilation.report, compilation.sources)
            continue
        folder = _folder(output, model.name, len(files))
        if str(folder) in file_by_folder:
            raise typer.BadParameter(
                f"{file_by_folder[str(folder)]} and {file} both go to {folder}; build them one by"
                " one with -o",
                param_hint="FILE",
            )
        file_by_folder[str(folder)] = file
        if check:
            difference = check_freshness(
                compilation,
                contents,
                folder,
                file=file,
                command=_command(file, target, output and str(folder), library, trust),
                version=__version__,
            )
            shown.add(compilation.report, compilation.sources)
            if not compilation.report.has_errors:
                shown.result(f"{folder}: fresh ({count(len(contents), 'file')})")
            builds.append({"file": file, "folder": str(folder)} | difference.as_json())
            continue
        pinned_locks = write_locks(compilation.locks, compilation.report)
        shown.add(compilation.report, compilation.sources)
        try:
            _write(compilation, model, contents, folder)
        except WriteError:
            shown.finish(builds=builds)
            raise
        for path in pinned_locks:
            shown.result(f"{os.path.normpath(path)}: automatic ids are pinned")
        shown.result(f"{folder}: {count(len(contents), 'file')} ({', '.join(targets)})")
        builds.append({"file": file, "folder": str(folder), "files": sorted(contents)})
    return shown.finish(builds=builds)


def _parse_targets(text: str | None) -> list[str]:
    """Returns the target names from a text such as ``urdf,mjcf``.

    If the text is ``None``, the function returns the default targets. Raises ``typer.BadParameter``
    for an unknown target and for a backend that cannot be loaded.
    """
    from thorvaldc import backends

    if text is None:
        return list(backends.DEFAULT_TARGETS)
    targets = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not targets:
        raise typer.BadParameter("names no target", param_hint="'--target'")
    for name in targets:
        try:
            backends.load(name)
        except backends.TargetError as error:
            raise typer.BadParameter(str(error), param_hint="'--target'") from None
    return targets


def _emit(compilation: Compilation, targets: list[str]) -> dict[str, bytes]:
    """Returns the contents of the build's output files by path.

    The function adds the diagnostics of the backends to the report of the compilation.
    """
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report

    if compilation.model is None:
        return {}
    report = Report()
    contents = emit(compilation.model, targets, report)
    compilation.report.extend(compilation.located(report))
    return contents


def _write(
    compilation: Compilation, model: Robot | Fleet, contents: Mapping[str, bytes], folder: Path
) -> None:
    from thorvaldc import __version__
    from thorvaldc.compiler.output.writer import write_build

    write_build(
        contents,
        folder,
        name=model.name,
        source_sha256=compilation.source_sha256,
        version=__version__,
    )


def _command(
    file: str, target: str | None, output: str, library: Sequence[str], trust: bool
) -> str:
    """Returns the command that writes a build, for the hint of a build that is not fresh."""
    words = ["thorvaldc", "build", file]
    words += ["--target", target] if target else []
    words += ["-o", output] if output else []
    words += [word for folder in library for word in ("--library", folder)]
    return shlex.join([*words, *(["--trust"] if trust else [])])


def _folder(output: str, name: str, file_count: int) -> Path:
    if not output:
        return Path("build") / name
    return Path(output) if file_count == 1 else Path(output) / name


def targets(json: options.Json = False) -> int:
    from thorvaldc import backends
    from thorvaldc.cli.diagnostic_output import print_json, print_table

    summaries: dict[str, str] = {}
    for name in backends.names():
        try:
            summaries[name] = backends.load(name).summary
        except backends.TargetError as error:
            summaries[name] = str(error)
    if json:
        print_json(summaries)
    else:
        print_table(
            (name, summary if name in backends.DEFAULT_TARGETS else f"{summary} (not by default)")
            for name, summary in summaries.items()
        )
    return DONE
