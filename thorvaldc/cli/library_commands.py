"""The commands ``thorvaldc new``, ``schema`` and ``modules``: new robots and modules, the JSON
Schemas, and the module types of a library."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import (
    DiagnosticOutput,
    check_format,
    count,
    print_json,
    print_table,
    show_report,
)
from thorvaldc.cli.exits import DONE
from thorvaldc.cli.options import module_types, preset_names, schema_kinds
from thorvaldc.diagnostics import Report, Span, nearest

if TYPE_CHECKING:
    from thorvaldc.compiler.modules.fetched_library import LibraryPin
    from thorvaldc.compiler.modules.library import Library, ModuleType


MODEL = "model"
PRESET, NAME = "4wd4ws", "my_robot"
"""Answers to the questions of ``new`` that an empty line means."""


def new(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="Name of the robot and its folder; without it, a terminal is asked.",
        ),
    ] = "",
    preset: Annotated[
        str,
        typer.Option(
            "--preset",
            metavar="PRESET",
            autocompletion=preset_names,
            help="4wd4ws (the default), 2wd0ws or 1wd1ws.",
        ),
    ] = "",
    project: Annotated[
        bool,
        typer.Option(
            "--project", help="Make a repository: robot, own module, scenario, CI, README."
        ),
    ] = False,
    design: Annotated[
        str,
        typer.Option(
            "--of", metavar="FILE", help="Write the file of a unit beside this file of its design."
        ),
    ] = "",
) -> int:
    from thorvaldc import __version__
    from thorvaldc.compiler import scaffolding

    if not name:
        if design or not _is_terminal():
            raise typer.BadParameter(
                "give the robot a name: thorvaldc new my_robot", param_hint="NAME"
            )
        preset = preset or _asked("Preset", _preset_problem, _preset_question())
        name = _asked("Name of the robot and its folder", _name_problem)
    if design:
        options.refuse_options({"--preset": preset, "--project": project}, "a design has its own")
    preset = preset or PRESET
    if problem := _name_problem(name):
        raise typer.BadParameter(problem, param_hint="NAME")
    if problem := _preset_problem(preset):
        raise typer.BadParameter(problem, param_hint="'--preset'")
    if design and not Path(design).is_file():
        raise typer.BadParameter(f"there is no file {design!r}", param_hint="'--of'")
    folder = Path(design).parent if design else Path(name)
    files = (
        scaffolding.project_files(name, preset, __version__)
        if project
        else scaffolding.unit_files(name, Path(design))
        if design
        else scaffolding.robot_files(name, preset)
    )
    try:
        scaffolding.write_new_files(folder, files)
    except FileExistsError as error:
        raise typer.BadParameter(f"{error} exists already", param_hint="NAME") from None
    if project:
        print(
            f"{name}: a repository with {len(files)} files. Next:\n  cd {name}\n"
            "  thorvaldc check --strict robots/*.yaml\n"
            "  thorvaldc scenario scenarios/straight.yaml"
        )
        if wheel := scaffolding.missing_wheel(files):
            print(f"CI installs a wheel of thorvaldc; build it, and commit it:\n  {wheel}")
    else:
        file = folder / next(iter(files))
        what = f"a unit of {design}" if design else f"a {preset} robot"
        print(f"{file}: {what}. Next:\n  thorvaldc check {file}\n  thorvaldc build {file}")
    return DONE


def _is_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _preset_question() -> str:
    from thorvaldc.compiler import scaffolding

    presets = scaffolding.presets()
    rows = [f"  {name}  {scaffolding.description_of(name)}" for name in presets]
    return "\n".join(["Which robot do you want to start from?", *rows])


def _asked(question: str, problem_of: Callable[[str], str], text: str = "") -> str:
    """Asks until the answer has no problem, and returns it.  An empty answer means the default."""
    default = PRESET if text else NAME
    if text:
        print(text)
    while True:
        try:
            answer = input(f"{question} [{default}]: ").strip() or default
        except EOFError:
            raise typer.BadParameter("there is no answer", param_hint="NAME") from None
        problem = problem_of(answer)
        if not problem:
            return answer
        print(f"  {problem}")


def _name_problem(name: str) -> str:
    """Returns why a robot cannot have a name, or an empty text."""
    from thorvaldc.compiler import scaffolding

    if not scaffolding.is_robot_name(name):
        from thorvaldc.compiler.validation.schema_diagnostics import similar_name

        similar = similar_name(name)
        meant = f"; did you mean `{similar}`?" if similar else ""
        rule = "small letters, digits and _, a letter first"
        return f"{name!r} is no name for a robot: {rule}{meant}"
    return ""


def _preset_problem(preset: str) -> str:
    """Returns why there is no such preset, or an empty text."""
    from thorvaldc.compiler import scaffolding

    known = scaffolding.presets()
    return "" if preset in known else f"there is no preset {preset!r}; there are {', '.join(known)}"


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            autocompletion=schema_kinds,
            help="Kind of document: robot, fleet, module, scenario, ...; model: model.json.",
        ),
    ],
) -> int:
    from thorvaldc.model.model_json import model_schema_text
    from thorvaldc.schema import KINDS, schema_text

    if kind not in (*KINDS, MODEL):
        kinds = ", ".join((*KINDS, MODEL))
        raise typer.BadParameter(f"{kind!r} is none of {kinds}", param_hint="KIND")
    print(model_schema_text() if kind == MODEL else schema_text(kind), end="")
    return DONE


_OfRobot = Annotated[
    str,
    typer.Argument(metavar="[ROBOT]", help="With the libraries of this robot.", show_default=False),
]


def list_modules(
    robot: _OfRobot = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
) -> int:
    from thorvaldc.compiler.source.node import Node

    report, sources = Report(), dict[str, Path]()
    module_library, pins = _library(robot, library, report, sources)
    loaded = [
        module_library.load(name, Node(name, Span("command line")), report)
        for name in module_library.names()
    ]
    modules = [module for module in loaded if module is not None]
    status = show_report(report, {**sources, **module_library.files})
    if json:
        print_json([_module_document(module, pins) for module in modules])
        return status
    print_table((m.name, f"{_origin(m, bool(robot))}{m.summary}") for m in modules)
    if pins:
        print("\nlibraries:")
    for display, pin in pins.items():
        print(f"{display}  {pin.origin}")  # an address remains in one line
    return status


def _library(
    robot: str, library: Sequence[str], report: Report, sources: dict[str, Path]
) -> tuple[Library, dict[str, LibraryPin]]:
    """Returns the library of a robot file, and the fetched libraries by their names in diagnostics.

    Without a ``robot``, it is the built-in library with the folders ``library``.  ``report``,
    ``sources``: the function adds the diagnostics of the file and their files.
    """
    from thorvaldc.compiler.modules.library import Library

    folders = options.library_folders(library)
    named = [(folder, str(folder)) for folder in folders]
    if not robot:
        return Library(named), {}
    from thorvaldc.compiler.modules.fetched_library import read_pins
    from thorvaldc.compiler.pipeline import library_folders_of
    from thorvaldc.compiler.result import Compilation, SourceFile

    path = Path(robot)
    source, errors = SourceFile(path, path.name or robot, path.parent), Report()
    if source.document is not None:
        document = source.check_shape(source.document)
        named = library_folders_of(document, path.parent, folders, errors, source.files)
    compilation = Compilation.of(source)
    for part in (source.shape, errors):
        report.extend(compilation.located(part))
    sources.update({os.path.normpath(file): file for file in source.files.values()})
    all_pins = [p for name, file in source.files.items() for p in read_pins(file, name, Report())]
    used = {display for _, display in named}
    pins = {pin.display: pin for pin in all_pins if pin.display in used}
    return Library(named, path.parent), pins


def _origin(module: ModuleType, is_shown: bool) -> str:
    """Returns the library folder of a module type that is not built in, before its summary."""
    from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY

    folder = module.library_display
    return f"{folder}: " if is_shown and folder != BUILTIN_LIBRARY else ""


def _module_document(module: ModuleType, pins: Mapping[str, LibraryPin]) -> dict[str, Any]:
    """Returns the description, parameters, ports and mount kinds of a module type as JSON values.

    ``fits`` lists the kinds of ports that the module can be mounted on.  ``pins``: the fetched
    libraries, whose address, version and content are ``origin``.
    """
    document = module.document.plain()
    pin = pins.get(module.library_display)
    return {
        "type": module.name,
        "category": module.category,
        "library": module.library_display,
        **({"origin": pin.document} if pin is not None else {}),
        "description": document.get("description", ""),
        "params": document.get("params", {}),
        "ports": document.get("ports", {}),
        "fits": (document.get("mount") or {}).get("kinds", []),
    }


def show_module(
    type: Annotated[
        str,
        typer.Argument(
            metavar="TYPE", autocompletion=module_types, help="For instance drive/standard."
        ),
    ],
    robot: _OfRobot = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
) -> int:
    from thorvaldc.compiler.catalogue import (
        describe_module,
        description_document,
        description_rows,
        mass_rows,
        parameter_rows,
        port_rows,
    )
    from thorvaldc.compiler.source.node import Node

    report, sources = Report(), dict[str, Path]()
    module_library, _ = _library(robot, library, report, sources)
    names = module_library.names()
    if type not in names and report.has_errors:
        return show_report(report, sources)
    if type not in names:
        near = nearest(type, names)
        hint = f"; did you mean {near!r}?" if near else ""
        raise typer.BadParameter(f"there is no module type {type!r}{hint}", param_hint="TYPE")
    module = module_library.load(type, Node(type, Span("command line")), report)
    status = show_report(report, {**sources, **module_library.files})
    if module is None:
        return status
    description = describe_module(module, module_library)
    if json:
        facts = description_document(description)
        print_json({"type": type} | module.document.plain() | {"facts": facts})
        return status
    print(type)
    print_table(description_rows(module, description))
    for title, rows in (
        ("sources of the mass", mass_rows(description)),
        ("ports, with default params and relative to the first link", port_rows(description)),
        ("params", parameter_rows(module)),
    ):
        lines = [(f"  {name}", text) for name, text in rows]
        if lines:
            print(f"\n{title}:")
            print_table(lines)
    return status


def check_modules(
    folders: Annotated[
        list[str],
        typer.Argument(
            metavar="[DIR|ROBOT]...",
            help="Library folders, or robots whose libraries are checked.",
            show_default="the project's",
        ),
    ] = [],  # noqa: B006
    format: options.Format = "text",
    json: options.Json = False,
    strict: options.Strict = False,
) -> int:
    from thorvaldc.compiler.catalogue import check_library

    format = "json" if json else format
    check_format(format)
    output = DiagnosticOutput(format, sys.stdout)
    robots = [name for name in folders if Path(name).is_file()]
    options.library_folders([name for name in folders if name not in robots], "DIR")
    for name in folders or ["modules"]:
        checked: Path | Library | None = Path(name) if folders else None
        if name in robots:
            report, sources = Report(), dict[str, Path]()
            checked, _ = _library(name, (), report, sources)
            output.add(report, sources)
        check = check_library(checked)
        output.add(check.report, check.sources)
        output.result(f"{name}: {count(len(check.names), 'module')}")
    return output.finish(strict)


def new_module(
    type: Annotated[str, typer.Argument(metavar="TYPE", help="For instance tool/sprayer.")],
    mesh: Annotated[
        str, typer.Option("--mesh", metavar="FILE", help="Copy this mesh (STL, OBJ, GLB, DAE).")
    ] = "",
    library: Annotated[
        str, typer.Option("--library", metavar="DIR", help="Folder of your modules.")
    ] = "modules",
) -> int:
    from thorvaldc.compiler import scaffolding
    from thorvaldc.compiler.modules.library import FILE

    check_new_module(type, library)
    folder = Path(library)
    report = Report()
    content = scaffolding.module_mesh(Path(mesh) if mesh else None, report)
    if content is None:
        return show_report(report, {})
    mesh_name = re.sub(r"\W+", "_", Path(mesh).stem, flags=re.ASCII).strip("_") or "body"
    files = scaffolding.module_files(type, content, mesh_name)
    try:
        scaffolding.write_module(folder, files)
    except FileExistsError as error:
        raise typer.BadParameter(f"{error} exists already", param_hint="TYPE") from None
    print(
        f"{folder / type / FILE}: a module with a mesh. Next:\n"
        f"  thorvaldc modules check {folder}\n"
        f"and in a robot file beside the folder:\n"
        f"  library: [{folder.resolve().name}]\n"
        f"  modules:\n"
        f"{scaffolding.usage(type)}"
    )
    return DONE


def check_new_module(type: str, library: str) -> None:
    """Raises ``typer.BadParameter`` if a new module cannot have a name or be in a folder."""
    from thorvaldc.compiler import scaffolding
    from thorvaldc.compiler.modules.library import Library

    if not scaffolding.is_module_type(type):
        raise typer.BadParameter(
            f"{type!r} is no name of a module type: category/name in small letters, digits and _",
            param_hint="TYPE",
        )
    if Library().exists(type):
        raise typer.BadParameter(f"the library has a module {type!r} already", param_hint="TYPE")
    if Path(library).exists() and not Path(library).is_dir():
        raise typer.BadParameter(f"{library!r} is not a folder", param_hint="'--library'")
