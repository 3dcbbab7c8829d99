"""``check``, ``build`` and ``modules check``."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.faults import Faults, check_format, count

if TYPE_CHECKING:
    from thorvaldc.compiler.compilation import Compilation
    from thorvaldc.compiler.scenario.variations import Change
    from thorvaldc.model import Fleet, Robot


def check_files(files: Sequence[str], format: str, strict: bool, library: Sequence[str]) -> int:
    check_format(format)
    faults = Faults(format, sys.stdout)
    for file, done in zip(files, _compile_all(files, library), strict=True):
        faults.add(done.report, done.sources)
        if done.model is not None:
            faults.result(f"{file}: {done.model.name}, {summary(done.model)}")
    return faults.finish(strict)


def build_files(
    files: Sequence[str], targets: str | None, output: str, format: str, library: Sequence[str]
) -> int:
    check_format(format)
    wanted = check_targets(targets)
    from thorvaldc import __version__
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.compiler.writer import WriteError, write_build, write_locks
    from thorvaldc.diagnostics import Report

    faults = Faults(format, sys.stderr)
    builds: list[dict[str, Any]] = []
    taken: dict[str, str] = {}
    for file, done in zip(files, _compile_all(files, library), strict=True):
        found = Report()
        made = emit(done.model, wanted, found) if done.model is not None else {}
        done.report.extend(done.located(found))
        pinned = []
        if done.locks and not done.report.has_errors:
            pinned = write_locks(done.locks, done.report)
        faults.add(done.report, done.sources)
        if done.model is None or done.report.has_errors:
            continue
        folder = _folder(output, done.model.name, len(files))
        if str(folder) in taken:
            raise typer.BadParameter(
                f"{taken[str(folder)]} and {file} both go to {folder}; use -o, one by one",
                param_hint="FILE",
            )
        taken[str(folder)] = file
        try:
            write_build(
                made,
                folder,
                name=done.model.name,
                source_sha256=done.source_sha256,
                version=__version__,
            )
        except WriteError as fault:
            faults.finish(builds=builds)
            raise OutsideError(str(fault)) from fault
        for path in pinned:
            faults.result(f"{os.path.normpath(path)}: automatic ids are pinned")
        faults.result(f"{folder}: {count(len(made), 'file')} ({', '.join(wanted)})")
        builds.append({"file": file, "folder": str(folder), "files": sorted(made)})
    return faults.finish(builds=builds)


def check_modules(folders: Sequence[str], format: str, strict: bool) -> int:
    check_format(format)
    from thorvaldc.compiler.modules.library_check import check_library

    faults = Faults(format, sys.stdout)
    wanted: list[Path | None] = [*library_folders(folders, "DIR")]
    for folder in wanted or [None]:
        done = check_library(folder)
        faults.add(done.report, done.sources)
        faults.result(f"{folder or 'modules'}: {count(len(done.names), 'module')}")
    return faults.finish(strict)


def compile_one(
    file: str, library: Sequence[str], robot: str | None = None, changes: Sequence[Change] = ()
) -> Compilation:
    """Compile, a scenario by ``robot`` and with ``changes``; what is said of it goes to stderr."""
    from thorvaldc.compiler.pipeline import compile_file

    done = compile_file(file, library=library_folders(library), robot=robot, changes=changes)
    faults = Faults("text", sys.stderr)
    faults.add(done.report, done.sources)
    faults.finish()
    return done


def _compile_all(files: Sequence[str], library: Sequence[str]) -> Iterable[Compilation]:
    from thorvaldc.compiler.pipeline import compile_file

    folders = library_folders(library)
    for file in files:
        yield compile_file(file, library=folders)


def library_folders(named: Sequence[str], option: str = "'--library'") -> list[Path]:
    """Raises ``typer.BadParameter`` for what is no folder."""
    for name in named:
        if not Path(name).is_dir():
            raise typer.BadParameter(f"there is no folder {name!r}", param_hint=option)
    return [Path(name) for name in named]


def check_targets(text: str | None) -> list[str]:
    """Names of targets from ``urdf,mjcf``; the default targets for ``None``.

    Raises ``typer.BadParameter`` for an unknown target and for a backend that cannot be loaded.
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


def _folder(output: str, name: str, files: int) -> Path:
    if not output:
        return Path("build") / name
    return Path(output) if files == 1 else Path(output) / name


def summary(model: Robot | Fleet) -> str:
    """What was understood, in a line: ``4 wheels (4 driven, 4 steered), 213.4 kg``."""
    from thorvaldc.model import Fleet

    if isinstance(model, Fleet):
        return count(len(model.placements), "robot")
    driven = sum(wheel.driven for wheel in model.wheels)
    steered = sum(wheel.steered for wheel in model.wheels)
    wheels = count(len(model.wheels), "wheel")
    return f"{wheels} ({driven} driven, {steered} steered), {model.inertial.mass:.1f} kg"
