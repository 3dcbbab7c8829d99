"""Creates the files of a new module type from a template and a mesh."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from pathlib import Path, PurePosixPath

from thorvaldc.backends.templates import Templates
from thorvaldc.compiler.modules.library import FILE
from thorvaldc.compiler.scaffolding.new_project import write_new_files
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.compiler.shapes.solids import mesh_triangles
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Mesh
from thorvaldc.model.data_folder import data_folder
from thorvaldc.schema.documents import schema_text

SCHEMA = "module.schema.json"
_TYPE = re.compile(r"[a-z][a-z0-9_]{0,63}(/[a-z][a-z0-9_]{0,63}){1,3}")
# CAD programs export millimetres, and no part with a mount is longer.
_MAX_METRES = 5.0


def is_module_type(name: str) -> bool:
    """Returns whether a text is a valid name of a new module type, such as ``tool/sprayer``."""
    return _TYPE.fullmatch(name) is not None


def module_mesh(path: Path | None, report: Report) -> Mesh | None:
    """Returns the mesh of a new module: that of a file, or the mesh of the template.

    Returns ``None`` and reports an error if the file cannot be read.
    """
    path = path or data_folder("templates") / "module" / "body.obj"
    return load_mesh(path, Span(str(path)), report, display=str(path))


def module_files(name: str, mesh: Mesh, mesh_name: str) -> dict[str, bytes]:
    """Returns the content of each file of a new module type, by its path in the library folder.

    The module has a box as large as the mesh, which gives mass, inertia and the shape for
    collisions.  A mesh longer than 5 m is taken to be in millimetres.

    - ``name``: name of the module type, such as ``tool/sprayer``.
    - ``mesh_name``: name of the mesh file without its suffix.
    """
    corners = mesh_triangles(mesh).reshape(-1, 3)
    low, high = (tuple(map(float, edge)) for edge in (corners.min(axis=0), corners.max(axis=0)))
    is_metric = max(b - a for a, b in zip(low, high, strict=True)) <= _MAX_METRES
    to_millimetres = 1000.0 if is_metric else 1.0
    # The smallest whole millimetres that contain the mesh; a box of a flat mesh needs a thickness.
    lows = [math.floor(a * to_millimetres + 1e-3) for a in low]
    highs = [math.ceil(b * to_millimetres - 1e-3) for b in high]
    sizes = [max(b - a, 1) for a, b in zip(lows, highs, strict=True)]
    centre = [(a + b) / 2 for a, b in zip(lows, highs, strict=True)]
    mesh_file = f"meshes/{mesh_name}{PurePosixPath(mesh.name).suffix}"
    text = Templates("module").render(
        FILE,
        schema="../" * (name.count("/") + 1) + SCHEMA,
        mesh=mesh_file,
        scale="" if is_metric else ", scale: 0.001",
        size=_millimetres(sizes),
        centre=_millimetres(centre),
        top=_millimetres([centre[0], centre[1], highs[2]]),
    )
    return {f"{name}/{FILE}": text.encode(), f"{name}/{mesh_file}": mesh.data}


def write_module(library: Path, files: dict[str, bytes]) -> None:
    """Writes the files of a new module type into a library folder, and the schema of modules for
    editors beside its types.

    Raises ``FileExistsError`` before any file is written if one of ``files`` exists.
    """
    write_new_files(library, files)
    with suppress(FileExistsError):
        write_new_files(library, {SCHEMA: schema_text("module")})


def _millimetres(values: list[int] | list[float]) -> str:
    return ", ".join(f"{plain(value)} mm" if value else "0" for value in values)
