"""Reads the inputs of a comparison: robot files, fleet files, builds and git revisions."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from thorvaldc.comparison.module_outline import Outline, outline_of_file
from thorvaldc.comparison.robot_comparison import compare_fleets, compare_robots
from thorvaldc.comparison.robot_difference import Difference
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import DiagnosticError, Label, Report, Span
from thorvaldc.diagnostics.bounded_file import read_bounded
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import is_model_file, load_model
from thorvaldc.tools.comparison.git_revision import (
    exported_revision,
    is_revision,
    split_revision,
)

MAX_MESH_BYTES = 64_000_000


@dataclass
class ComparedInput:
    """A robot or fleet to compare.

    Attributes
    ----------
    name : name of the input, as the user gave it.
    model : the robot or the fleet.  ``None`` if there are errors.
    modules : modules of the robot file, or of each robot of a fleet by its name.  Empty for a
        build, whose model has no module types.
    report : all diagnostics.
    sources : path of each file in ``report``, for excerpts.
    """

    name: str
    model: Robot | Fleet | None = None
    modules: dict[str, Outline] = field(default_factory=dict)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)


class InputKindError(ValueError):
    """Two inputs cannot be compared, because one is a robot and the other a fleet."""


def read_input(
    name: str, temporary: ExitStack, library: Sequence[Path] = (), *, trust: bool = False
) -> ComparedInput:
    """Reads one input of a comparison.

    ``name``: a robot file, a fleet file, a build folder, a ``model.json`` or a file of a git
    revision such as ``HEAD~1:robot.yaml``.  ``temporary``: the files of a revision are removed when
    this stack is closed; until then, excerpts of them can be shown.  ``library``: additional
    folders with modules.
    """
    compared = ComparedInput(name)
    try:
        revision = split_revision(name)
        if revision is not None:
            file = temporary.enter_context(exported_revision(*revision, Path.cwd()))
            inside = [_in_revision(each, file.repository, file.root) for each in library]
            _read(compared, file.path, inside, trust)
            _rename_files(compared, file.root, f"{revision[0]}:")
        else:
            _read(compared, Path(name), library, trust)
    except DiagnosticError as error:
        compared.report.put(error.diagnostic)
    return compared


def revision_hint(before: str, after: str) -> str | None:
    """Returns the hint if one input is a git revision without the file, such as ``HEAD``."""
    for revision, file in ((before, after), (after, before)):
        if os.path.exists(revision) or not os.path.isfile(file):
            continue
        if is_revision(revision, Path.cwd()):
            path = Path(file).as_posix()
            return f"write `{revision}:{path}` for the file in the revision `{revision}`"
    return None


def compare(before: ComparedInput, after: ComparedInput) -> Difference:
    """Returns the differences of two inputs that have a model.

    Raises ``InputKindError`` for a robot and a fleet.
    """
    if isinstance(before.model, Robot) and isinstance(after.model, Robot):
        return compare_robots(
            before.model, after.model, before.modules.get(""), after.modules.get("")
        )
    if isinstance(before.model, Fleet) and isinstance(after.model, Fleet):
        return compare_fleets(before.model, after.model, (before.modules, after.modules))
    kinds = [
        f"{each.name} is a {'fleet' if isinstance(each.model, Fleet) else 'robot'}"
        for each in (before, after)
    ]
    raise InputKindError(" and ".join(kinds))


def _read(compared: ComparedInput, path: Path, library: Sequence[Path], trust: bool) -> None:
    if path.is_dir() or is_model_file(path) or path.suffix == ".json":
        folder = path if path.is_dir() else path.parent
        compared.model = _with_meshes(load_model(path), folder / "meshes")
        return
    compilation = compile_file(path, library=library, trust=trust)
    compared.model = compilation.model
    compared.report, compared.sources = compilation.report, compilation.sources
    if isinstance(compilation.model, Robot):
        compared.modules = {"": outline_of_file(path, library, compilation.model)}
    elif isinstance(compilation.model, Fleet):
        compared.modules = _fleet_modules(path, library, compilation, compilation.model)


def _with_meshes(model: Robot | Fleet, folder: Path) -> Robot | Fleet:
    """Returns the model of a build with the bytes of its mesh files, as far as they are there."""
    if isinstance(model, Fleet):
        placements = (
            replace(p, robot=_robot_with_meshes(p.robot, folder)) for p in model.placements
        )
        return replace(model, placements=tuple(placements))
    return _robot_with_meshes(model, folder)


def _robot_with_meshes(robot: Robot, folder: Path) -> Robot:
    meshes = []
    for mesh in robot.meshes:
        data = b""
        with contextlib.suppress(OSError):
            # A name of a mesh is not a path: nothing outside of the folder is read.
            data = read_bounded(folder / Path(mesh.name).name, MAX_MESH_BYTES)
        is_same = hashlib.sha256(data).hexdigest() == mesh.sha256
        meshes.append(replace(mesh, data=data if is_same else b""))
    return replace(robot, meshes=tuple(meshes))


def _fleet_modules(
    path: Path, library: Sequence[Path], compilation: Compilation, fleet: Fleet
) -> dict[str, Outline]:
    """Returns the modules of each robot of a fleet."""
    modules: dict[str, Outline] = {}
    for placement in fleet.placements:
        file = compilation.files.get(placement.robot.span.file)
        if file is not None:
            modules[placement.name] = outline_of_file(file, library, placement.robot)
    return modules


def _in_revision(folder: Path, repository: Path, root: Path) -> Path:
    """Returns the folder of the revision for a library folder of the repository."""
    try:
        inside = root / folder.resolve().relative_to(repository.resolve())
    except ValueError:
        return folder
    return inside if inside.is_dir() else folder


def _rename_files(compared: ComparedInput, root: Path, prefix: str) -> None:
    """Replaces paths of the temporary folder by the names of the files in the revision."""

    def named(path: str) -> str:
        return path.replace(f"{root}{os.sep}", prefix).replace(str(root), prefix)

    def at(span: Span) -> Span:
        return Span(named(span.file), *span[1:])

    report = Report()
    for diagnostic in compared.report:
        report.put(
            replace(
                diagnostic,
                message=named(diagnostic.message),
                span=at(diagnostic.span) if diagnostic.span is not None else None,
                labels=tuple(Label(at(label.span), label.text) for label in diagnostic.labels),
                # A file of a revision cannot be changed.
                fixes=(),
            )
        )
    compared.report = report
    compared.sources = {named(name): path for name, path in compared.sources.items()}
