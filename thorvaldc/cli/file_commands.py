"""The commands ``thorvaldc check``, ``build``, ``targets`` and ``explain``: errors of robot files,
the output files of the targets, the list of the targets and of the diagnostic codes."""

from __future__ import annotations

import gc
import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import (
    DiagnosticOutput,
    check_format,
    count,
    has_color,
    print_json,
    print_table,
)
from thorvaldc.cli.exits import DONE, check_full_installation
from thorvaldc.cli.options import diagnostic_codes, target_names
from thorvaldc.diagnostics import Accepted, Report, Severity

if TYPE_CHECKING:
    from thorvaldc.compiler.result import Compilation
    from thorvaldc.model import Fleet, Robot


STANDARD_INPUT = "-"


def check(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE", help="A robot.yaml or fleet.yaml; - reads the standard input."
        ),
    ],
    format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="text|json|github|sarif|badge",
            help="Output format of the diagnostics; badge: the JSON of a shields.io endpoint.",
        ),
    ] = "text",
    json: options.Json = False,
    strict: options.Strict = False,
    settings: options.Settings = [],  # noqa: B006
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show accepted warnings with their reasons.")
    ] = False,
) -> int:
    from thorvaldc.compiler.source.lock_file import without_lock_files

    format = "json" if json else format
    if format != "badge":
        check_format(format)
    folders, values = options.library_folders(library), options.new_values(settings)
    compile_one = partial(check_file, library=folders, set=values, trust=trust)
    output = DiagnosticOutput(format, sys.stdout)
    missing: dict[str, None] = {}
    text: Path | None = None
    with ExitStack() as inputs:
        results: Iterator[CheckedFile]
        if STANDARD_INPUT in files:  # which only this process has
            text = inputs.enter_context(_standard_input())
            results = map(compile_one, without_lock_files(files))
        else:
            results = check_files(list(without_lock_files(files)), compile_one)
        for checked in results:
            if checked.file == STANDARD_INPUT and text is not None:
                checked.sources[STANDARD_INPUT] = text
            output.add(checked.report, checked.sources)
            missing.update(dict.fromkeys(checked.missing_limits))
            accepted = checked.report.accepted
            if accepted and verbose and format == "text":
                from thorvaldc.diagnostics.renderers import render_accepted

                print(render_accepted(checked.report, color=has_color(sys.stdout)))
            if checked.summary:
                more = f"; {_accepted(accepted)} accepted" if accepted else ""
                output.result(f"{checked.file}: {checked.summary}{more}")
    if format == "text" and missing:
        limits = "; ".join(missing)
        print(f"note: limits of the readers of xacro and meshes: {limits}", file=sys.stderr)
    return output.finish(strict)


def _accepted(accepted: list[Accepted]) -> str:
    """Returns the numbers of accepted warnings and notes, such as ``1 warning, 2 notes``."""
    numbers = Counter(entry.diagnostic.severity for entry in accepted)
    kinds = (Severity.WARNING, Severity.NOTE)
    return ", ".join(count(numbers[kind], kind.value) for kind in kinds if numbers[kind])


@contextmanager
def _standard_input() -> Iterator[Path]:
    """Makes the standard input the content of the file ``-`` of the working folder.

    Paths in the document start there.  Returns a file with the same text, for excerpts.
    """
    import tempfile

    from thorvaldc.compiler.source.input_file import unsaved_texts
    from thorvaldc.compiler.source.reader import MAX_BYTES

    data = sys.stdin.buffer.read(MAX_BYTES + 1)  # a longer document is an error
    with tempfile.NamedTemporaryFile(prefix="thorvaldc-") as copy:
        copy.write(data)
        copy.flush()
        with unsaved_texts({os.path.realpath(STANDARD_INPUT): data}):
            yield Path(copy.name)


def explain(
    code: Annotated[
        str,
        typer.Argument(
            metavar="CODE",
            autocompletion=diagnostic_codes,
            help="TV501 or can-id-duplicate; without it, all codes are listed.",
        ),
    ] = "",
    json: options.Json = False,
) -> int:
    from thorvaldc.diagnostics.codes import all_codes, all_codes_text
    from thorvaldc.diagnostics.report import UnknownCode, find_code
    from thorvaldc.diagnostics.report import explain as page_of

    if not code:
        if json:
            print_json([known._asdict() for known in all_codes()])
        else:
            print(all_codes_text(), end="")
        return DONE
    try:
        page = page_of(code)
        if json:
            print_json(find_code(code)._asdict() | {"page": page})
        else:
            print(page, end="")
    except UnknownCode as error:
        hint = f"; {error.hint}" if error.hint else ""
        raise typer.BadParameter(f"{error}{hint}", param_hint="CODE") from None
    return DONE


FILES_OF_PROCESSES = 20
"""Least number of files that are checked in several processes."""


class CheckedFile(NamedTuple):
    """What ``check`` prints about a file.

    - ``file``: path as the user wrote it.
    - ``report``: diagnostics, and accepted warnings.
    - ``sources``: path of the input file for each path in ``report``.
    - ``summary``: name of the model and its size, or empty if the file has errors.
    - ``missing_limits``: limits that this system does not give to the readers of xacro and meshes.
    """

    file: str
    report: Report
    sources: dict[str, Path]
    summary: str
    missing_limits: tuple[str, ...]


def check_file(
    file: str, library: Sequence[Path], set: Mapping[str, object], trust: bool
) -> CheckedFile:
    """Compiles a file; the parameters are those of ``compile_file``."""
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.sandbox import missing_limits

    compilation = compile_file(file, library=library, set=set, trust=trust)
    model = compilation.model
    summary = "" if model is None else f"{model.name}, {_summary(model)}"
    return CheckedFile(
        file, compilation.report, compilation.sources, summary, tuple(missing_limits)
    )


Check = Callable[[str], CheckedFile]
"""Compiles the file with this path."""


def check_files(files: Sequence[str], check: Check) -> Iterator[CheckedFile]:
    """Yields the result of each file in the given order.

    ``FILES_OF_PROCESSES`` files or more are compiled in one process per processor.  If such a
    process ends early, for example because the computer has no memory left, this process compiles
    the remaining files.
    """
    number = 0
    if len(files) >= FILES_OF_PROCESSES:
        from concurrent.futures.process import BrokenProcessPool

        try:
            for checked in _of_processes(files, check):
                yield checked
                number += 1
        except BrokenProcessPool:
            pass
    with ExitStack() as stack:
        if len(files) - number > 1:
            from thorvaldc.compiler.pipeline import many_compilations

            stack.enter_context(many_compilations())
        for file in files[number:]:
            yield check(file)


def _of_processes(files: Sequence[str], check: Check) -> Iterator[CheckedFile]:
    from thorvaldc.simulation.worker_processes import ignored_interrupts, processors, worker_pool

    count = processors()
    if count == 1:
        return
    yield check(files[0])  # which loads the modules of the compiler for all forked processes
    batch = min(20, 1 + len(files) // (8 * count))
    with worker_pool(count, _prepare, may_fork=True) as pool:
        with ignored_interrupts():
            results = pool.map(check, files[1:], chunksize=batch)
        yield from results


_open = ExitStack()


def _prepare() -> None:
    from thorvaldc.compiler.pipeline import many_compilations

    gc.disable()  # as in the process of the command
    _open.enter_context(many_compilations())


def _summary(model: Robot | Fleet) -> str:
    """Returns a summary of a robot, such as ``4 wheels (4 driven, 4 steered), 213.4 kg``."""
    from thorvaldc.model import Robot

    if not isinstance(model, Robot):
        return count(len(model.placements), "robot")
    driven = sum(1 for wheel in model.wheels if wheel.driven)
    steered = sum(1 for wheel in model.wheels if wheel.steered)
    wheels = count(len(model.wheels), "wheel")
    return f"{wheels} ({driven} driven, {steered} steered), {model.inertial.mass:.1f} kg"


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
    json: options.Json = False,
    settings: options.Settings = [],  # noqa: B006
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
    from thorvaldc.compiler.output.build_freshness import check_freshness
    from thorvaldc.compiler.output.writer import WriteError, listed_files, write_locks
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.source.lock_file import without_lock_files

    format = "json" if json else format
    check_format(format)
    targets = _parse_targets(target)
    folders, values = options.library_folders(library), options.new_values(settings)
    files = without_lock_files(files)
    shown = DiagnosticOutput(format, sys.stderr)
    builds: list[dict[str, Any]] = []
    file_by_folder: dict[str, str] = {}
    for file in files:
        compilation = compile_file(file, library=folders, set=values, trust=trust)
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
                command=_command(file, target, output and str(folder), settings, library, trust),
                version=__version__,
            )
            shown.add(compilation.report, compilation.sources)
            if not compilation.report.has_errors:
                shown.result(f"{folder}: fresh ({count(len(contents), 'file')})")
            builds.append({"file": file, "folder": str(folder)} | difference.as_json())
            continue
        pinned_locks = write_locks(compilation.locks, compilation.report)
        shown.add(compilation.report, compilation.sources)
        lost = dict.fromkeys(
            path.split("/")[0] for path in listed_files(folder) or () if "/" in path
        )
        try:
            _write(compilation, model, contents, folder)
        except WriteError:
            shown.finish(builds=builds)
            raise
        for path in pinned_locks:
            shown.result(f"{os.path.normpath(path)}: automatic ids are pinned")
        kept = {path.split("/")[0] for path in contents}
        removed = ", ".join(part for part in lost if part not in kept)
        note = f"; removed {removed} of the last build" if removed else ""
        shown.result(f"{folder}: {count(len(contents), 'file')} ({', '.join(targets)}){note}")
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
    file: str,
    target: str | None,
    output: str,
    settings: Sequence[str],
    library: Sequence[str],
    trust: bool,
) -> str:
    """Returns the command that writes a build, for the hint of a build that is not fresh."""
    words = ["thorvaldc", "build", file]
    words += ["--target", target] if target else []
    words += ["-o", output] if output else []
    words += [word for setting in settings for word in ("--set", setting)]
    words += [word for folder in library for word in ("--library", folder)]
    return shlex.join([*words, *(["--trust"] if trust else [])])


def _folder(output: str, name: str, file_count: int) -> Path:
    if not output:
        return Path("build") / name
    return Path(output) if file_count == 1 else Path(output) / name


def targets(json: options.Json = False) -> int:
    from thorvaldc import backends

    check_full_installation("`thorvaldc targets`")
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
