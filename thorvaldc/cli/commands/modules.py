"""The commands ``thorvaldc modules``: list, show and check the module types of a library, and make
a new one."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completion import module_types
from thorvaldc.cli.exits import DONE

if TYPE_CHECKING:
    from thorvaldc.compiler.modules.library import Library


def _library(folders: Sequence[str]) -> Library:
    from thorvaldc.compiler.modules.library import Library

    return Library([(folder, str(folder)) for folder in options.library_folders(folders)])


def list_modules(json: options.Json = False, library: options.Library = []) -> int:  # noqa: B006
    from thorvaldc.cli.diagnostic_output import print_json, print_table, show_report
    from thorvaldc.compiler.catalogue import first_sentence, module_summary
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.diagnostics import Report, Span

    module_library = _library(library)
    report = Report()
    loaded = [
        module_library.load(name, Node(name, Span("command line")), report)
        for name in module_library.names()
    ]
    modules = [module for module in loaded if module is not None]
    status = show_report(report, module_library.files)
    if json:
        print_json([module_summary(module) for module in modules])
    else:
        print_table((module.name, first_sentence(module)) for module in modules)
    return status


def show_module(
    type: Annotated[
        str,
        typer.Argument(
            metavar="TYPE", autocompletion=module_types, help="For instance drive/standard."
        ),
    ],
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
) -> int:
    from thorvaldc.cli.diagnostic_output import print_json, print_table, show_report
    from thorvaldc.compiler.catalogue import (
        describe_module,
        description_document,
        description_rows,
        mass_rows,
        parameter_rows,
        port_rows,
    )
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.diagnostics import Report, Span, nearest

    module_library = _library(library)
    names = module_library.names()
    if type not in names:
        near = nearest(type, names)
        hint = f"; did you mean {near!r}?" if near else ""
        raise typer.BadParameter(f"there is no module type {type!r}{hint}", param_hint="TYPE")
    report = Report()
    module = module_library.load(type, Node(type, Span("command line")), report)
    status = show_report(report, module_library.files)
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
        typer.Argument(metavar="[DIR]...", help="Library folders.", show_default="the project's"),
    ] = [],  # noqa: B006
    format: options.Format = "text",
    strict: options.Strict = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, count
    from thorvaldc.compiler.catalogue import check_library

    check_format(format)
    output = DiagnosticOutput(format, sys.stdout)
    paths: list[Path | None] = [*options.library_folders(folders, "DIR")]
    for folder in paths or [None]:
        result = check_library(folder)
        output.add(result.report, result.sources)
        output.result(f"{folder or 'modules'}: {count(len(result.names), 'module')}")
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
    from thorvaldc.cli.diagnostic_output import show_report
    from thorvaldc.compiler import scaffolding
    from thorvaldc.compiler.modules.library import FILE, Library
    from thorvaldc.diagnostics import Report

    if not scaffolding.is_module_type(type):
        raise typer.BadParameter(
            f"{type!r} is no name of a module type: category/name in small letters, digits and _",
            param_hint="TYPE",
        )
    folder = Path(library)
    if Library().exists(type):
        raise typer.BadParameter(f"the library has a module {type!r} already", param_hint="TYPE")
    if folder.exists() and not folder.is_dir():
        raise typer.BadParameter(f"{library!r} is not a folder", param_hint="'--library'")
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
        f"    part: {{type: {type}, mount: {{parent: frame, xyz: [0, 0, 300 mm]}}}}"
    )
    return DONE
