"""The command ``thorvaldc modules show``: shows one module type of the library."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completed_values import module_types


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
    from thorvaldc.compiler.modules.library import Library as ModuleLibrary
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.diagnostics import Report, Span, nearest

    folders = options.library_folders(library)
    module_library = ModuleLibrary([(folder, str(folder)) for folder in folders])
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
