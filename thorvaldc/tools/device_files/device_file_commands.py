"""The commands ``thorvaldc modules from-dbc`` and ``from-eds``: a module of a CAN device from a
file of others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli.diagnostic_output import count, show_report
from thorvaldc.cli.exits import DONE
from thorvaldc.cli.library_commands import check_new_module
from thorvaldc.diagnostics import Report

if TYPE_CHECKING:
    from thorvaldc.tools.device_files.device_module import DeviceModule

Type = Annotated[str, typer.Argument(metavar="TYPE", help="For instance battery/mine.")]
Folder = Annotated[str, typer.Option("--library", metavar="DIR", help="Folder of your modules.")]


def from_dbc(
    type: Type,
    file: Annotated[str, typer.Argument(metavar="FILE", help="A DBC file.")],
    node: Annotated[
        str,
        typer.Option("--node", metavar="NODE", help="Name of the device in the DBC file."),
    ],
    library: Folder = "modules",
) -> int:
    from thorvaldc.tools.device_files.dbc_module import module_from_dbc

    check_new_module(type, library)
    report = Report()
    device = module_from_dbc(Path(file), node, type, report)
    return _finish(device, file, library, report)


def from_eds(
    type: Type,
    file: Annotated[str, typer.Argument(metavar="FILE", help="An EDS or DCF file.")],
    library: Folder = "modules",
) -> int:
    from thorvaldc.tools.device_files.eds_module import module_from_eds

    check_new_module(type, library)
    report = Report()
    device = module_from_eds(Path(file), type, report)
    return _finish(device, file, library, report)


def _finish(device: DeviceModule | None, file: str, library: str, report: Report) -> int:
    from thorvaldc.compiler import scaffolding
    from thorvaldc.compiler.modules.library import FILE
    from thorvaldc.tools.device_files.device_module import module_text

    status = show_report(report, {file: Path(file)})
    if device is None:
        return status
    folder = Path(library)
    files = {f"{device.type}/{FILE}": module_text(device).encode()}
    files |= {f"{device.type}/{name}": data for name, data in device.files.items()}
    try:
        scaffolding.write_module(folder, files)
    except FileExistsError as error:
        raise typer.BadParameter(f"{error} exists already", param_hint="TYPE") from None
    for comment in device.comments:
        print(comment)
    print(
        f"{folder / device.type / FILE}: {count(len(device.frames), 'frame')}. Next:\n"
        f"  thorvaldc modules check {folder}\n"
        f"and in a robot file beside the folder:\n"
        f"  library: [{folder.resolve().name}]\n"
        f"{device.usage()}"
    )
    return DONE
