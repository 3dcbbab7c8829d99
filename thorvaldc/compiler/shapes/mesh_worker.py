"""Reads mesh files in a contained worker process, see ``worker_protocol``.

A small file can describe a mesh of any size, by nested instances, large counts or compressed parts.
STL and OBJ files are read by ``mesh_formats``, all others by the package trimesh.

A request has the format of the mesh, the scale, and ``files``: the name and the size of each file
in the data.  The first file is the mesh.  An answer is one of

- ``{"suffix": ..., "size": ..., "is_flat": ...}`` with the mesh as data, see ``CheckedMesh``
- ``{"code": ..., "text": ..., "hint": ...}``, see ``MeshError``
- ``{"needs": name}`` if the mesh refers to a file that is not in the request
"""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, Any

from thorvaldc.compiler.shapes.mesh_formats import (
    MeshError,
    check_count,
    check_mesh,
    checked_stl,
)

if TYPE_CHECKING:
    from thorvaldc.model import Vec3

IMPORTS = ("numpy", "trimesh", "collada")
"""Modules that a worker process for other formats than STL and OBJ imports at its start."""
_LARGEST_FLOAT32 = 3.4028234e38
_SPARE_BYTES = 16 << 20


class _MissingFileError(Exception):
    """Raised if a mesh refers to a file that is not in the request."""


class _Files(dict[str, bytes]):
    """The files of a request by name, as trimesh reads them."""

    def __missing__(self, name: str) -> bytes:
        if name == "model.gltf":  # where trimesh looks for a mesh that is no JSON
            raise KeyError(name)
        raise _MissingFileError(name)

    def get(self, name: str, default: Any = None) -> bytes:
        return self[name]


def answer(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the checked mesh of a request, or why it is refused."""
    files, start = _Files(), 0
    for name, size in request["files"]:
        files[name] = data[start : start + size]
        start += size
    suffix, (x, y, z) = request["format"], request["scale"]
    del data
    try:
        mesh = files.pop(request["files"][0][0])
        if suffix not in ("stl", "obj"):
            mesh, suffix = checked_stl(_triangles(suffix, mesh, files)), "stl"
        checked = check_mesh(suffix, mesh, (x, y, z))
    except MeshError as error:
        return {"code": error.code, "text": error.text, "hint": error.hint}, b""
    except _MissingFileError as error:
        return {"needs": str(error)}, b""
    return {
        "suffix": checked.suffix,
        "size": checked.size,
        "is_flat": checked.is_flat,
    }, checked.data


def _triangles(suffix: str, data: bytes, files: _Files) -> list[tuple[Vec3, Vec3, Vec3]]:
    """Reads the triangles of a mesh with trimesh, in metres and with the z axis up.

    Raises ``MeshError`` if it cannot be read, and ``_MissingFileError`` if it needs another file.
    """
    import logging
    import warnings

    import trimesh

    if data.startswith(b"PK\x03\x04"):
        raise MeshError(
            "mesh-invalid", "is a zip archive", f"unpack it, and name the {suffix} file"
        )
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            corners = (
                trimesh.load_scene(
                    io.BytesIO(data), file_type=suffix, resolver=files, skip_materials=True
                )
                .to_mesh()
                .triangles
            )
        check_count(len(corners))
        rows = struct.iter_unpack("<9d", corners.astype("<f8").tobytes())
        triangles = [((r[0], r[1], r[2]), (r[3], r[4], r[5]), (r[6], r[7], r[8])) for r in rows]
        return _in_metres(triangles, data) if suffix == "dae" else triangles
    except (MeshError, _MissingFileError, MemoryError):
        raise
    except Exception as error:  # The readers of trimesh raise exceptions of many types.
        if _is_out_of_memory(error):
            raise MemoryError from error
        # The mesh file is empty, or has another format than the file name suggests.
        if isinstance(error, (AttributeError, TypeError, LookupError)):
            text = f"is not a {suffix} file, or has no triangles"
        else:
            shown = " ".join(str(error).split())[:200] or type(error).__name__
            text = f"cannot be read as {suffix}: {shown}"
        raise MeshError("mesh-invalid", text) from error


def _is_out_of_memory(error: BaseException | None) -> bool:
    """Whether a MemoryError is a cause of the error, or no memory is left.

    A ``SystemError`` is one, too: C code without memory may not even have an exception.  A reader
    may also fail with any other error when C code returned ``None``.  The frames of the error still
    hold their memory here, so an allocation shows whether some was left.
    """
    try:
        bytearray(_SPARE_BYTES)
    except MemoryError:
        return True
    for _ in range(20):
        if error is None or isinstance(error, (MemoryError, SystemError)):
            break
        error = error.__cause__ or error.__context__
    return isinstance(error, (MemoryError, SystemError))


def _in_metres(
    triangles: list[tuple[Vec3, Vec3, Vec3]], data: bytes
) -> list[tuple[Vec3, Vec3, Vec3]]:
    """Converts the triangles of a Collada file to metres, with the z axis up."""
    x, y, z = _collada_axes(data)

    def point(p: Vec3) -> Vec3:
        a, b, c = (0.0 + p[0] * x[i] + p[1] * y[i] + p[2] * z[i] for i in range(3))
        return (a, b, c)

    return [(point(p), point(q), point(r)) for p, q, r in triangles]


def _collada_axes(data: bytes) -> list[list[float]]:
    """Returns the matrix M that converts the points of a Collada file to metres and z up.

    A point p (row vector) is converted by the product ``p @ M``.
    """
    from xml.etree import ElementTree

    # Default unit and default up axis of a Collada 1.4 file (element <asset>).
    unit, up = 1.0, "Y_UP"
    for _, element in ElementTree.iterparse(io.BytesIO(data), events=("end",)):
        name = element.tag.rpartition("}")[2]
        if name == "unit":
            unit = float(element.get("meter", "1"))
        elif name == "up_axis":
            up = (element.text or up).strip()
        elif name == "asset" or name.startswith("library_"):
            break
    s = unit
    return {
        "Z_UP": [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]],
        "Y_UP": [[s, 0.0, 0.0], [0.0, 0.0, s], [0.0, -s, 0.0]],  # (x, y, z) -> (x, -z, y)
        "X_UP": [[0.0, 0.0, s], [-s, 0.0, 0.0], [0.0, -s, 0.0]],  # (x, y, z) -> (-y, -z, x)
    }[up]
