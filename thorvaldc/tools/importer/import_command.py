"""The command ``thorvaldc import``: converts files of others to a robot.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli.diagnostic_output import show_report
from thorvaldc.cli.exits import INPUT, OutsideError, write_errors

_DESCRIPTIONS = (".urdf", ".xacro", ".sdf", ".world", ".xml", ".mjcf")


def import_file(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="A configuration file of the original Thorvald system, or a URDF, xacro, SDF or"
            " MJCF file.",
        ),
    ],
    more: Annotated[
        list[str],
        typer.Argument(
            metavar="CONTROLLERS|NAME:=VALUE",
            help="ROS parameter file of the controllers of a robot, and arguments of a xacro file.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="File to write; of a URDF, xacro, SDF or MJCF file, the folder.",
            show_default="stdout",
        ),
    ] = "",
) -> int:
    arguments = dict(word.split(":=", 1) for word in more if ":=" in word)
    controllers = [Path(word) for word in more if ":=" not in word]
    if len(controllers) > 1:
        raise typer.BadParameter(f"one file states the controllers, not `{controllers[1]}` too")
    if arguments and Path(file).suffix.lower() not in _DESCRIPTIONS[:2]:
        raise typer.BadParameter("only a xacro file has arguments")
    if Path(file).suffix.lower() in _DESCRIPTIONS:
        return _import_urdf(Path(file), controllers[0] if controllers else None, arguments, output)
    if more:
        raise typer.BadParameter("only a description of a robot has controllers")
    from thorvaldc.tools.importer.original_import import import_original as convert

    result = convert(Path(file))
    status = show_report(result.report, {file: Path(file)})
    if result.text is not None and output:
        _write_new_file(Path(output), result.text.encode())
        print(output)
    elif result.text is not None:
        print(result.text, end="")
    return status


def _import_urdf(
    file: Path, controllers: Path | None, arguments: dict[str, str], output: str
) -> int:
    from thorvaldc.tools.importer.urdf_import import import_urdf, write_files

    if not output:
        raise typer.BadParameter("name the folder of the robot: -o FOLDER", param_hint="'-o'")
    folder = Path(output)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutsideError(f"will not write into {folder}: it exists; name another folder")
    imported = import_urdf(file, controllers, arguments)
    status = show_report(imported.report, imported.sources)
    if status == INPUT or not imported.files:
        return status
    with write_errors(folder):
        write_files(imported.files, folder)
    print(folder / "robot.yaml")
    return status


def _write_new_file(path: Path, data: bytes) -> None:
    from thorvaldc.diagnostics.files import write_file

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_file(path, data, new=True)
    except FileExistsError:
        raise OutsideError(f"will not overwrite {path}; move it away or name another") from None
