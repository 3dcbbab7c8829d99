"""The stages of the compiler: read, check the shape, resolve and elaborate, check, emit.

`compile_file` goes from a path to a `Compilation`, which contains the model and all diagnostics;
`emit` goes from the model to the files of the targets, in memory.  The stages below compile one
robot.  A fleet or scenario file names robot files; `fleet_compilation` and
`scenario_compilation` compile them with these same stages.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc import backends
from thorvaldc.compiler.compilation import Compilation, SourceFile
from thorvaldc.compiler.geometry.robot_checks import check_robot
from thorvaldc.compiler.library import Library
from thorvaldc.compiler.lock_update import read_robot_lock, update_robot_lock
from thorvaldc.compiler.modules.calculator_choice import check_calculator
from thorvaldc.compiler.modules.design_requirements import read_design
from thorvaldc.compiler.modules.elaborate import elaborate
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import to_json

if TYPE_CHECKING:  # Creating these classes takes milliseconds, and few files need them.
    from thorvaldc.compiler.scenario.variations import Change

MODEL_FILE = "model.json"


def compile_file(
    path: Path | str,
    *,
    library: Sequence[Path] = (),
    robot: Path | str | None = None,
    changes: Sequence[Change] = (),
) -> Compilation:
    """Compiles a robot, fleet or scenario file.

    ``library`` are folders of further module types.  ``robot`` is a robot or fleet file that
    replaces the robots of a scenario; ``changes`` replace values in a scenario document.
    The report contains every error of the file; bad input raises no exception.
    """
    path = Path(path)
    source = SourceFile(path, path.name or str(path), path.parent)
    if source.kind == "scenario":
        from thorvaldc.compiler.scenario_compilation import compile_scenario  # rarely needed

        return compile_scenario(source, partial(_compile, library=library), robot, changes)
    return _compile(source, library)


def _compile(source: SourceFile, library: Sequence[Path]) -> Compilation:
    """Compiles a robot or fleet file."""
    if source.kind == "fleet":
        from thorvaldc.compiler.fleet_compilation import compile_fleet  # rarely needed

        return compile_fleet(source, partial(_compile, library=library))
    return compile_robot(source, library)


def compile_robot(source: SourceFile, library: Sequence[Path]) -> Compilation:
    """Runs the stages for one robot file.

    Each stage continues with the valid part of the document, so that one run reports the errors
    of all stages.
    """
    compilation, report = Compilation.of(source), Report()
    if source.document is None:
        return compilation.complete(source, report)
    document = source.check_shape(source.document)
    lock_file = ""
    if _module_names(document):
        lock = read_robot_lock(source, compilation, report)
        modules = Library(_library_folders(document, source.path.parent, library, report))
        model = elaborate(
            document,
            Resolver(modules, report),
            source.path.parent,
            report,
            compilation.files,
            sorted(_module_names(source.document) - _module_names(document)),
            modules_are_valid=_modules_are_valid(source),
            lock=lock,
        )
        compilation.files.update(modules.files)
        design = read_design(document, report)
        if model is not None:
            check_robot(model, design, report)
            check_calculator(model, document, report)
            lock_file = update_robot_lock(source, model, compilation)
        compilation.model = model
    return compilation.complete(source, report, lock_file=lock_file)


def emit(
    model: Robot | Fleet, targets: Sequence[str], report: Report | None = None
) -> dict[str, bytes]:
    """Returns the files of the targets by relative path, and ``model.json``.

    Raises ``KeyError`` for an unknown target.  Elements of the model that a format cannot
    express are reported, with spans as in the model.
    """
    # Imported here because `check` does not need them.
    from thorvaldc.backends.statics_backend import StaticsBackend
    from thorvaldc.model.statics.standing_pose import solve_statics

    files = {MODEL_FILE: to_json(model).encode()}
    robots = [p.robot for p in model.placements] if isinstance(model, Fleet) else [model]
    emitters = [backends.load(target) for target in dict.fromkeys(targets)]
    needed = any(isinstance(backend, StaticsBackend) for backend in emitters)
    statics = [solve_statics(robot) for robot in robots] if needed else []
    for backend in emitters:
        if report is not None:
            for robot in robots:
                for diagnostic in backend.unsupported(robot):
                    report.put(diagnostic)
        if isinstance(backend, StaticsBackend):
            files.update(
                backend.emit_fleet_with_statics(model, statics)
                if isinstance(model, Fleet)
                else backend.emit_with_statics(model, statics[0])
            )
        else:
            files.update(
                backend.emit_fleet(model) if isinstance(model, Fleet) else backend.emit(model)
            )
    return files


def _library_folders(
    document: Node, base_dir: Path, library: Sequence[Path], report: Report
) -> list[tuple[Path, str]]:
    """Returns the library folders of the document, then those of the user, with their names."""
    folders: list[tuple[Path, str]] = []
    prefix = posixpath.dirname(document.span.file)
    listed = document.get("library")
    for node in listed.value if listed is not None and isinstance(listed.value, tuple) else ():
        folder = base_dir / str(node.value)
        if os.path.isdir(folder):
            name = posixpath.normpath(posixpath.join(prefix, str(node.value)))
            folders.append((folder, name))
        else:
            report.add("library-missing", f"there is no folder `{node.value}`", node.span)
    return [*folders, *((folder, folder.name) for folder in library)]


def _module_names(document: Node) -> set[str]:
    modules = document.get("modules")
    return set(modules.value) if modules is not None and isinstance(modules.value, dict) else set()


def _modules_are_valid(source: SourceFile) -> bool:
    modules = source.document.get("modules") if source.document is not None else None
    return modules is None or not source.shape.has_error_in(modules.span)
