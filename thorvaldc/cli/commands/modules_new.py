"""The command ``thorvaldc modules new``: makes a module type with a mesh to start from."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli.exits import DONE


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
    from thorvaldc.compiler.modules.library import FILE, Library
    from thorvaldc.compiler.scaffolding import (
        is_module_type,
        module_files,
        module_mesh,
        write_module,
    )
    from thorvaldc.diagnostics import Report

    if not is_module_type(type):
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
    content = module_mesh(Path(mesh) if mesh else None, report)
    if content is None:
        return show_report(report, {})
    mesh_name = re.sub(r"\W+", "_", Path(mesh).stem, flags=re.ASCII).strip("_") or "body"
    files = module_files(type, content, mesh_name)
    try:
        write_module(folder, files)
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
