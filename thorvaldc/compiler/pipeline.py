"""Runs the stages of the compiler.

Stages of the compilation of a robot file:

- Stage 1 reads the YAML file.
- Stage 2 checks the document against the schema.
- Stage 3 resolves the document to a tree of module instances.
- Stage 4 elaborates the tree of module instances to the model.
- Stage 5 checks the model.
- Stage 6 emits the files of the targets.

`compile_file` runs the stages 1 to 5 and returns a `Compilation`, which contains the model and
all diagnostics.  `emit` runs stage 6 and returns the files of the targets in memory.
`fleet_compilation` and `scenario_compilation` run the same stages for each robot file that a
fleet or scenario file names.  `load` and `load_fleet` return the model, or raise all errors of the
file as one exception.
"""

from __future__ import annotations

import os
import posixpath
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.bus.assemble_buses import remembered_buses
from thorvaldc.compiler.bus.bus_checks import check_sides
from thorvaldc.compiler.bus.node_ids import Lock, address_lines, chosen_ids, read_lock
from thorvaldc.compiler.bus.stopping_distance import check_stops_on_slope
from thorvaldc.compiler.elaborate import elaborate
from thorvaldc.compiler.hardware.wheel_geometry import check_steering_axes
from thorvaldc.compiler.modules.fetched_library import (
    fetched_libraries,
    pinned_folder,
    read_pins,
)
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.result import Compilation, Compile, SourceFile, read_acceptances
from thorvaldc.compiler.robot_checks import check_purpose, check_robot
from thorvaldc.compiler.robot_settings.robot_sections import check_calculator, read_design
from thorvaldc.compiler.shapes.meshes import shared_mesh_workers
from thorvaldc.compiler.source.input_file import (
    FOLDERS,
    check_no_link_outside,
    folder_of,
    report_missing,
    unsaved_texts,
)
from thorvaldc.compiler.source.lock_file import lock_path, lock_text
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.overrides import Change, read_changes
from thorvaldc.compiler.source.reader import MAX_BYTES, read_file
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Diagnostic, Report, Severity, Span
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.model import Robot
from thorvaldc.schema import Kind, keys_of
from thorvaldc.tool_folders import document_compiler

# The import of fleets takes several milliseconds.
if TYPE_CHECKING:
    from thorvaldc.model import Fleet


MODEL_FILE = "model.json"
TEXT_FILE = "document.yaml"
"""Name in messages of a document without a file; its paths begin in the working folder."""
Source = Path | str | Mapping[str, object]
"""Path of a file, text of a document (several lines), or a document as a mapping."""


def compile_file(
    path: Source,
    *,
    library: Sequence[Path | str] = (),
    robot: Path | str | None = None,
    set: Mapping[str, object] | None = None,
    trust: bool = False,
) -> Compilation:
    """Compiles a robot, fleet or scenario file.

    The report of the returned compilation contains every error and warning of the file.  Errors in
    the file, or a file that does not exist, do not raise an exception; the model is then ``None``.
    ``load`` is the function for programs that need a robot.

    Parameters
    ----------
    path : path of the file, the text of a document, or a document as a mapping of Python.
    library : additional library folders with module types.
    robot : path of a robot or fleet file.  The robots of the file replace the robots of a
        scenario.
    set : new values by their dotted paths, such as ``{"modules.frame.params.length": "1.3 m"}``.
        In a fleet or scenario, a path that begins as in a robot file changes all robots.
    trust : whether xacro files are expanded without restrictions, as programs that the caller
        trusts.  A robot file cannot state this.

    >>> import thorvaldc
    >>> compilation = thorvaldc.compile("examples/4wd4ws_wide/robot.yaml")
    >>> compilation.report
    <Report: 0 errors, 0 warnings>
    >>> compilation.model
    <Robot thorvald_4wd4ws_wide: 4 wheels, 190.6 kg>
    """
    if isinstance(library, str | os.PathLike):
        raise TypeError(f"library: expected a list of folders, got {library!r}")
    if (text := _text_of(path)) is not None:
        with unsaved_texts({os.path.realpath(TEXT_FILE): text}):
            return compile_file(TEXT_FILE, library=library, robot=robot, set=set, trust=trust)
    path = Path(path)  # type: ignore[arg-type]
    source = SourceFile(path, path.name or str(path), path.parent)
    changes = read_changes(set or {})
    own = tuple(c for c in changes if source.kind == "robot" or not _is_of_robots(c, source.kind))
    source.change(own)
    compile_one = partial(
        _compile,
        library=[Path(folder) for folder in library],
        trust=trust,
        changes=tuple(c for c in changes if c not in own),
    )
    with shared_mesh_workers():
        if source.kind == "scenario":
            # The module ``scenario_compilation`` is imported only for scenario files.
            from thorvaldc.compiler.scenario.scenario_compilation import compile_scenario

            return compile_scenario(source, compile_one, robot)
        if source.kind not in ("robot", "fleet"):
            return _compile_document_of_tool(source, compile_one)
        return compile_one(source)


def _text_of(source: Source) -> bytes | None:
    """Returns the text of a document without a file, or ``None`` for a path."""
    if isinstance(source, Mapping):
        import json

        return json.dumps(source, indent=1).encode()  # which is YAML
    return source.encode() if isinstance(source, str) and "\n" in source else None


@contextmanager
def many_compilations() -> Iterator[None]:
    """Within this context, many compilations share what does not change between them.

    These are the worker processes that read meshes, the expansions of equal xacro files and the
    buses of equal devices.  The xacro files must not change in the meantime.
    """
    # A robot without xacro files does not need this module.
    from thorvaldc.compiler.extras.xacro_expand import remembered_expansions

    with shared_mesh_workers(), remembered_expansions(), remembered_buses():
        yield


def _compile_document_of_tool(source: SourceFile, compile_one: Compile) -> Compilation:
    """Compiles a document whose kind belongs to a tool, such as a study."""
    compile_document = document_compiler(source.kind)
    if compile_document is not None:
        return compile_document(source, compile_one)  # type: ignore[no-any-return]
    compilation, report = Compilation.of(source), Report()
    assert source.document is not None  # its keys say the kind
    message = f"this is a {source.kind} document, and no tool of this installation reads it"
    report.add("other-document", message, source.document.span)
    return compilation.complete(source, report)


def _is_of_robots(change: Change, kind: Kind) -> bool:
    """Returns whether a change in a fleet or scenario is one of its robot files."""
    key = change.path.partition(".")[0]
    return key not in keys_of(kind) and key in keys_of("robot")


def _compile(
    source: SourceFile, library: Sequence[Path], trust: bool, changes: tuple[Change, ...]
) -> Compilation:
    """Compiles a robot or fleet file; ``changes`` are those of its robots."""
    if source.kind == "fleet":
        # The module ``fleet_compilation`` is imported only for fleet files.
        from thorvaldc.compiler.scenario.fleet_compilation import compile_fleet

        compile_one = partial(_compile, library=library, trust=trust, changes=changes)
        return compile_fleet(source, compile_one)
    source.change(changes)
    return compile_robot(source, library, trust)


def compile_robot(source: SourceFile, library: Sequence[Path], trust: bool = False) -> Compilation:
    """Runs the stages of the compiler, except ``emit``, for one robot file.

    Each stage of the compiler uses the valid part of the document, so that one run reports the
    errors of all stages.
    """
    compilation, report = Compilation.of(source), Report()
    if source.document is None:
        return compilation.complete(source, report)
    document = source.check_shape(source.document)
    lock_file = ""
    if _module_names(document):
        lock = read_robot_lock(source, compilation, report)
        folder = source.path.parent
        folders = library_folders_of(document, folder, library, report, compilation.files)
        modules = Library(folders, folder)
        resolver = Resolver(modules, report)
        invalid_modules = sorted(_module_names(source.document) - _module_names(document))
        instance = resolver.resolve(document, invalid_modules)
        compilation.instances[source.name] = instance
        model = elaborate(
            document,
            instance,
            resolver,
            source.path.parent,
            report,
            compilation.files,
            modules_are_valid=_modules_are_valid(source),
            lock=lock,
            trust=trust,
        )
        compilation.files.update(modules.files)
        for module in modules.user_modules():
            compilation.acceptances += read_acceptances(module.document, report, is_module=True)
        design = read_design(document, report)
        if model is not None:
            model = replace(model, design_slope=design.slope)
            check_robot(model, design, report)
            if not report.has_errors:  # the physics of a wrong robot cause false errors
                check_stops_on_slope(model, design, document.get("driver"), report)
            check_purpose(model, document, report)
            check_sides(model, instance, report)
            check_steering_axes(model, report)
            lock_file = update_robot_lock(source, model, document, compilation)
        check_calculator(model, document, report)
        compilation.model = model
    return compilation.complete(source, report, lock_file=lock_file)


def emit(
    model: Robot | Fleet, targets: Sequence[str], report: Report | None = None
) -> dict[str, bytes]:
    """Returns the content of each output file of the targets, by the relative path of the file.

    One of the output files is ``model.json``, which contains the whole model.  The function writes
    nothing to the disk.

    Parameters
    ----------
    model : the robot or fleet, as ``load`` or ``compile`` returns it.
    targets : names of targets: ``urdf``, ``mjcf``, ``sdf``, ``ros2``, ``can`` and those of other
        packages; ``thorvaldc targets`` lists them.
    report : receives a diagnostic for each part of the model that the format of a target cannot
        express, at the source span of the part.

    Raises ``TargetError`` (a ``KeyError``) with the known names if a target is unknown or cannot be
    loaded, and ``TypeError`` if ``model`` or ``targets`` has another type.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/2wd0ws_greenhouse/robot.yaml")
    >>> files = thorvaldc.emit(robot, ["urdf"])
    >>> [name for name in files if name.endswith(".urdf")]
    ['urdf/robot.urdf']
    """
    from thorvaldc.model.model_json import to_json

    _check_types(model, targets)
    return {MODEL_FILE: to_json(model).encode()} | emit_without_model(model, targets, report)


def emit_without_model(
    model: Robot | Fleet, targets: Sequence[str], report: Report | None = None
) -> dict[str, bytes]:
    """Returns the files of ``emit`` without ``model.json``, for a simulation in this process."""
    # The command `check` needs no targets.
    from thorvaldc import backends
    from thorvaldc.model import robots_by_name

    _check_names(model)
    files: dict[str, bytes] = {}
    for backend in [backends.load(target) for target in dict.fromkeys(targets)]:
        if report is not None:
            for robot in robots_by_name(model).values():
                for diagnostic in backend.unsupported(robot):
                    report.put(diagnostic)
        files.update(backend.emit(model) if isinstance(model, Robot) else backend.emit_fleet(model))
    return files


def _check_names(model: Robot | Fleet) -> None:
    """Raises ``DiagnosticError`` if two robots of a fleet that a program made have one name."""
    if isinstance(model, Robot):
        return
    names = Counter(placement.name for placement in model.placements)
    for name, number in names.items():
        if number > 1:
            from thorvaldc.diagnostics import DiagnosticError

            message = f"two robots of {model.name} have the name `{name}`"
            raise DiagnosticError("fleet-name-twice", message, hint="rename one of them")


def _check_types(model: object, targets: object) -> None:
    """Raises ``TypeError`` for the mistakes that a program without type checks makes."""
    from thorvaldc.model import Fleet

    if model is None:
        raise TypeError(
            "model: expected a Robot or a Fleet, got None: the file has errors, see the report of"
            " the compilation, or let thorvaldc.load() raise them"
        )
    if not isinstance(model, Robot | Fleet):
        raise TypeError(f"model: expected a Robot or a Fleet, got {type(model).__name__}")
    if isinstance(targets, str):
        raise TypeError(f"targets: expected a list of names such as ['urdf'], got {targets!r}")


def library_folders_of(
    document: Node,
    base_dir: Path,
    library: Sequence[Path],
    report: Report,
    files: Mapping[str, Path],
) -> list[tuple[Path, str]]:
    """Returns the path of each library folder, and the name of the folder in diagnostics.

    The library folders that the document names are followed by the library folders of the user.
    Those of repositories and archives are in the cache, see ``pinned_folder``.  ``files``: paths of
    the file of the document, and of those of its design, by their names.
    """
    folders: list[tuple[Path, str]] = []
    fetched = {node.span: library for library, node in fetched_libraries(document)}
    for node in items(document.get("library")):
        if node.span in fetched:
            first = next(iter(files.values()), base_dir / node.span.file)
            robot = files.get(node.span.file, first)  # `--set` is no file
            pinned = pinned_folder(fetched[node.span], node, robot, report)
            folders += [pinned] if pinned is not None else []
            continue
        if not isinstance(node.value, str):
            continue
        start, prefix = folder_of(node, files, base_dir), posixpath.dirname(node.span.file)
        folder = start / str(node.value)
        if os.path.isdir(folder):
            name = posixpath.normpath(posixpath.join(prefix, str(node.value)))
            folders.append((folder, name))
        else:
            report_missing("library-missing", start, node, FOLDERS, report)
    return [*folders, *((folder, folder.name) for folder in library)]


def _module_names(document: Node) -> set[str]:
    """Returns the names of the modules in a robot document."""
    return set(entries(document.get("modules")))


def _modules_are_valid(source: SourceFile) -> bool:
    """Returns whether the section ``modules`` of a document has no errors against the schema."""
    modules = source.document.get("modules") if source.document is not None else None
    if modules is None:
        return True
    spans = modules.places() if len(source.files) > 1 else (modules.span,)
    return not any(map(source.shape.has_error_in, spans))


def read_robot_lock(source: SourceFile, compilation: Compilation, report: Report) -> Lock | None:
    """Returns the node ids in a robot's lock file, or ``None`` if the robot has no lock file.

    A unit without a lock file begins with the ids of its design, whose spare parts fit it.
    """
    locks = {lock_path(Path(name)).as_posix(): lock_path(p) for name, p in source.files.items()}
    name = next((name for name, path in locks.items() if os.path.lexists(path)), None)
    if name is None:
        return None
    path = locks[name]
    if not check_no_link_outside(path, path.parent, name, report):
        return {}
    compilation.sources[os.path.normpath(path)] = path
    document = read_file(path, name, report)
    return read_lock(document, report) if document is not None else {}


def update_robot_lock(
    source: SourceFile, robot: Robot, document: Node, compilation: Compilation
) -> str:
    """Returns the new text of the lock file, or ``""`` if the robot needs no lock file.

    If the new text differs from the lock file on the disk, the new text is added to
    ``compilation.locks``; but not that of a robot with other values than its file: the ids of
    the file are in hardware.
    """
    path = lock_path(source.path)
    was_read = os.path.normpath(path) in compilation.sources
    ids = chosen_ids(robot)
    if not was_read and not ids:
        return ""
    libraries = {library for library, _ in fetched_libraries(document)}
    pins = read_pins(source.path, source.name, Report()) if libraries else []
    used = (pin.line for pin in pins if pin.library in libraries)
    text = lock_text(source.path.name, used, address_lines(ids))
    is_new = not was_read or read_bounded(path, MAX_BYTES + 1, cut=True) != text.encode()
    if is_new and not source.changes:
        compilation.locks[path] = text
    return text


# -- for programs that need the model and cannot continue without it ---------------------


class CompileError(Exception):
    """Raised if a robot, fleet or scenario file has errors.

    The text of the exception is the report that ``thorvaldc check`` prints: every error and
    warning with its file, line, column, excerpt and hint.

    Attributes
    ----------
    diagnostics : the errors and warnings as data, in the order of file and line.
    """

    def __init__(self, text: str, diagnostics: Sequence[Diagnostic] = ()) -> None:
        super().__init__(text, tuple(diagnostics))  # all arguments: the exception can be pickled
        self.diagnostics: tuple[Diagnostic, ...] = tuple(diagnostics)

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """The diagnostics that are errors."""
        return tuple(d for d in self.diagnostics if d.severity is Severity.ERROR)


def load(
    path: Source,
    *,
    library: Sequence[Path | str] = (),
    set: Mapping[str, object] | None = None,
    trust: bool = False,
) -> Robot:
    """Returns the robot of a robot.yaml, or of the ``model.json`` of a build.

    All values of the robot are in SI units, and poses are in the frames that the class names; a
    robot is immutable.  The returned robot has no errors; ``compile(path).report`` has its
    warnings.

    Parameters
    ----------
    path : path of the file, the text of a document, or a document as a mapping of Python.
    library : folders with module types, beside the project's library and the folders that the
        file names.
    set : new values by their dotted paths, see ``compile``.
    trust : whether xacro files are expanded without restrictions, as programs that the caller
        trusts.

    Raises ``CompileError`` with all errors of the file.  A file with a fleet or a scenario is an
    error too: ``load_fleet`` reads it.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> robot
    <Robot thorvald_4wd4ws_wide: 4 wheels, 190.6 kg>
    >>> robot.wheels[0].radius
    0.2
    """
    model = _load(path, library, set, trust)
    if not isinstance(model, Robot):
        raise _other_model(path, "a fleet", "a robot", "thorvaldc.load_fleet")
    return model


def load_fleet(
    path: Source,
    *,
    library: Sequence[Path | str] = (),
    set: Mapping[str, object] | None = None,
    trust: bool = False,
) -> Fleet:
    """Returns the fleet of a fleet or scenario file, or of the ``model.json`` of a build.

    The placements of the fleet have the robots with their poses in the scene (m, rad).

    Parameters
    ----------
    path : path of the file, the text of a document, or a document as a mapping of Python.
    library : folders with module types, beside the project's library and the folders that the
        files name.
    set : new values by their dotted paths, see ``compile``.
    trust : whether xacro files are expanded without restrictions.

    Raises ``CompileError`` with all errors of the file and of its robots.  A file with a single
    robot is an error too: ``load`` reads it.

    >>> import thorvaldc
    >>> fleet = thorvaldc.load_fleet("examples/fleet_of_four/fleet.yaml")
    >>> fleet
    <Fleet fleet_of_four: 4 robots>
    >>> [placement.name for placement in fleet.placements]
    ['tall', 'slim', 'wide', 'six']
    """
    model = _load(path, library, set, trust)
    if isinstance(model, Robot):
        raise _other_model(path, "a robot", "a fleet", "thorvaldc.load")
    return model


def _load(
    path: Source,
    library: Sequence[Path | str],
    set: Mapping[str, object] | None,
    trust: bool,
) -> Robot | Fleet:
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.model.model_json import is_model_file, load_model

    file = Path(path) if isinstance(path, (Path, str)) and _text_of(path) is None else None
    if file is not None and (is_model_file(file) or file.name == MODEL_FILE):
        if set:
            raise ValueError(f"{file} is a compiled model; change the values of its robot file")
        try:
            return load_model(file)
        except DiagnosticError as error:
            raise compile_error([error.diagnostic], {}) from error
    compilation = compile_file(path, library=library, set=set, trust=trust)
    if compilation.model is None:
        raise compile_error(compilation.report, compilation.sources)
    return compilation.model


def compile_error(
    diagnostics: Sequence[Diagnostic] | Report, sources: Mapping[str, Path]
) -> CompileError:
    from thorvaldc.diagnostics.renderers import render_text

    report = Report()
    report.extend(diagnostics)
    count = len(report.errors)
    text = render_text(report, sources).rstrip()
    return CompileError(f"{count} error{'' if count == 1 else 's'}\n{text}", report.sorted())


def compilation_html(compilation: Compilation) -> str:
    """Returns the diagnostics of a compilation with the lines of their files, for a notebook."""
    from thorvaldc.diagnostics.renderers import render_text
    from thorvaldc.diagnostics.text_layout import preformatted

    return preformatted(f"{compilation!r}\n{render_text(compilation.report, compilation.sources)}")


def _other_model(source: Source, content: str, expected: str, function: str) -> CompileError:
    report = Report()
    name = TEXT_FILE if isinstance(source, Mapping) or _text_of(source) else os.fspath(source)
    report.add(
        "other-document",
        f"expected {expected}, got {content}",
        Span(name),
        hint=f"{function}() reads this file",
    )
    return compile_error(report, {})
