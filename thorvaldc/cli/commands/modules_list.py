"""The command ``thorvaldc modules list``: lists the module types of the library."""

from __future__ import annotations

from thorvaldc.cli import options


def list_modules(json: options.Json = False, library: options.Library = []) -> int:  # noqa: B006
    from thorvaldc.cli.diagnostic_output import print_json, print_table, show_report
    from thorvaldc.compiler.catalogue import first_sentence, module_summary
    from thorvaldc.compiler.modules.library import Library as ModuleLibrary
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.diagnostics import Report, Span

    folders = options.library_folders(library)
    module_library = ModuleLibrary([(folder, str(folder)) for folder in folders])
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
