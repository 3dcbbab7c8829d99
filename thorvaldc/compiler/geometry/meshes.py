"""Reads mesh files, checks them and converts them to a format that every target reads.

URDF readers and MuJoCo both read STL and OBJ: these files are copied unchanged, except that text
STL becomes binary STL, because MuJoCo reads only that.  Other formats are converted to binary STL
here, so that no backend has to.
"""

from __future__ import annotations

import functools
import hashlib
import math
import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.interrupts import uninterrupted
from thorvaldc.model import Mesh, Vec3

# Limit of MuJoCo's STL reader.
MAX_TRIANGLES = 200_000
MAX_FILE_BYTES = 64 * 1024 * 1024
MAX_EXTENT = 20.0  # m; a larger mesh is most likely in millimetres
CONVERTED = ("dae", "glb", "gltf", "off", "ply")
FORMATS = ("stl", "obj", *CONVERTED)

_RECORD = struct.Struct("<12xfffffffff2x")
# Fast tests of coordinates by the highest byte of a little-endian float32, for ``translate``:
# bytes of numbers below 1.7e38 (above are also inf and nan), and of magnitudes below 8.
_BELOW_HUGE = bytes(b for b in range(256) if b & 0x7F != 0x7F)
_BELOW_8 = bytes(b for b in range(256) if b & 0x7F < 0x41)


class _MeshError(NamedTuple):
    """An error of a mesh file; ``text`` continues "mesh file `x` ..."."""

    code: str
    text: str
    hint: str


class _LoadedMesh(NamedTuple):
    """A mesh in the format ``suffix``; ``is_large``: a coordinate may be 8 m or more."""

    mesh: Mesh
    suffix: str
    is_large: bool


def load_mesh(
    path: Path,
    span: Span,
    report: Report,
    *,
    display: str,
    scale: Vec3 = (1.0, 1.0, 1.0),
) -> Mesh | None:
    """Returns the mesh of the file at ``path``, or ``None`` if there are errors (reported).

    ``span`` is where the document names the file, ``display`` the file's name in messages.
    ``scale`` is used only to check the size.  The name of the mesh contains a hash of its
    content, so that files of equal names do not collide.  A file is read once per process unless
    its size or time changes.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        report.add(
            "mesh-format",
            f"mesh file `{display}` has the format `{suffix}`, which is not read",
            span,
            hint=f"use one of {', '.join(FORMATS)}; STL and OBJ are copied unchanged",
        )
        return None
    try:
        status = path.stat()
        is_missing = not path.is_file()
    except (OSError, ValueError):
        is_missing = True
    if is_missing:
        report.add(
            "mesh-missing",
            f"mesh file `{display}` does not exist",
            span,
            hint="paths are relative to the file that names them; check spelling and case",
        )
        return None
    loaded = _read(path, status.st_mtime_ns, status.st_size)
    if isinstance(loaded, _MeshError):
        report.add(loaded.code, f"mesh file `{display}` {loaded.text}", span, hint=loaded.hint)
        return None
    if loaded.is_large or max(map(abs, scale)) > 1.0:
        size = _extent(loaded.mesh.data, loaded.suffix)
        largest = max(abs(size[i] * scale[i]) for i in range(3))
        if largest > MAX_EXTENT:
            report.add(
                "mesh-size",
                f"mesh file `{display}` is {largest:g} m long; at most {MAX_EXTENT:g} m are "
                "plausible",
                span,
                hint="meshes are in metres; for a mesh in millimetres, set scale 0.001",
            )
    return loaded.mesh


def binary_stl(triangles: Iterable[tuple[Vec3, Vec3, Vec3]]) -> bytes:
    """Returns the binary STL of triangles with the given corners (m); computes the normals.

    Raises ``OverflowError`` if a coordinate does not fit in a float32.
    """
    body = bytearray()
    count = 0
    for a, b, c in triangles:
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz) or 1.0
        body += struct.pack("<12fH", nx / length, ny / length, nz / length, *a, *b, *c, 0)
        count += 1
    return b"binary stl".ljust(80) + struct.pack("<I", count) + bytes(body)


@functools.lru_cache(maxsize=512)
def _read(path: Path, mtime_ns: int, size: int) -> _LoadedMesh | _MeshError:
    """Reads, checks and converts a file; ``mtime_ns`` is only part of the cache key."""
    if size > MAX_FILE_BYTES:
        return _too_large(f"has {size / 1e6:.0f} MB; at most {MAX_FILE_BYTES / 1e6:.0f} are read")
    try:
        data = path.read_bytes()
    except OSError as error:
        return _MeshError(
            "mesh-missing",
            f"cannot be read: {error.strerror}",
            "check the file's permissions",
        )
    if data.startswith(b"version https://git-lfs"):
        return _invalid("is a Git LFS pointer, not the mesh", "fetch it: git lfs pull")
    suffix = path.suffix.lower().lstrip(".")
    if suffix == "stl":
        checked = _check_stl(data)
    elif suffix == "obj":
        checked = _check_obj(data)
    else:
        checked = _convert(path, data, suffix)
        suffix = "stl"
    if isinstance(checked, _MeshError):
        return checked
    data, is_large = checked
    digest = hashlib.sha256(data).hexdigest()
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).strip("_") or "mesh"
    return _LoadedMesh(Mesh(f"{stem}_{digest[:8]}.{suffix}", digest, data), suffix, is_large)


def _invalid(text: str, hint: str = "export it again, if possible as binary STL") -> _MeshError:
    return _MeshError("mesh-invalid", text, hint)


def _too_large(text: str) -> _MeshError:
    return _MeshError(
        "mesh-large", text, "reduce it: some 10000 triangles are enough for a picture of a robot"
    )


def _check_stl(data: bytes) -> tuple[bytes, bool] | _MeshError:
    """Returns the binary STL without trailing bytes, and true if it may be large.

    Format: 80 bytes of header, the number of triangles (uint32), and 50 bytes per triangle:
    normal and three corners (float32 each) and 2 bytes of attributes.
    """
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else None
    if count is None or len(data) != 84 + 50 * count:
        if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2000]:
            return _text_stl(data)
        if count is None:
            return _invalid(f"has {len(data)} bytes, too few for an STL file")
        if len(data) < 84 + 50 * count:
            return _invalid(
                f"is truncated: its header states {count} triangles, {84 + 50 * count} bytes, "
                f"and it has {len(data)} bytes"
            )
        data = data[: 84 + 50 * count]
    if count < 2:
        return _invalid(f"has {count} triangles and is not a solid")
    if count > MAX_TRIANGLES:
        return _too_large(f"has {count} triangles; at most {MAX_TRIANGLES} are read")
    is_large = False
    for k in range(9):
        high_bytes = data[84 + 12 + 4 * k + 3 :: 50]  # of the k-th coordinate of each triangle
        if high_bytes.translate(None, _BELOW_HUGE):
            return _invalid("has a coordinate that is not a finite number")
        is_large = is_large or bool(high_bytes.translate(None, _BELOW_8))
    return data, is_large


def _text_stl(data: bytes) -> tuple[bytes, bool] | _MeshError:
    words = data.split()
    numbers: list[float] = []
    try:
        for i, word in enumerate(words):
            if word.lower() == b"vertex":
                numbers += [float(words[i + 1]), float(words[i + 2]), float(words[i + 3])]
    except (IndexError, ValueError):
        return _invalid(f"has a vertex that is not three numbers (number {len(numbers) // 3 + 1})")
    if len(numbers) % 9:
        return _invalid(f"has {len(numbers) // 3} vertices, not three for each triangle")
    points = [(numbers[i], numbers[i + 1], numbers[i + 2]) for i in range(0, len(numbers), 3)]
    return _binary([(points[i], points[i + 1], points[i + 2]) for i in range(0, len(points), 3)])


def _binary(triangles: list[tuple[Vec3, Vec3, Vec3]]) -> tuple[bytes, bool] | _MeshError:
    if len(triangles) > MAX_TRIANGLES:
        return _too_large(f"has {len(triangles)} triangles; at most {MAX_TRIANGLES} are read")
    try:
        return _check_stl(binary_stl(triangles))
    except OverflowError:
        return _invalid("has a coordinate that is not a finite number")


def _check_obj(data: bytes) -> tuple[bytes, bool] | _MeshError:
    vertices = faces = 0
    largest = 0.0
    lines: list[bytes] = []
    for number, line in enumerate(data.split(b"\n"), start=1):
        word = line[:7].split(None, 1)[:1]
        if word in ([b"mtllib"], [b"usemtl"]):
            continue  # Material files are not copied: colours come from the model.
        lines.append(line)
        if word == [b"f"]:
            faces += len(line.split()) - 3
        elif word == [b"v"]:
            vertices += 1
            try:
                x, y, z = (abs(float(n)) for n in line.split()[1:4])
            except ValueError:
                return _invalid(f"has a vertex that is not three numbers (line {number})")
            largest = max(largest, x, y, z)
            if not math.isfinite(x + y + z):
                return _invalid(f"has a coordinate that is not a finite number (line {number})")
    if vertices < 4 or faces < 2:
        return _invalid(f"has {vertices} vertices and {faces} triangles and is not a solid")
    if faces > MAX_TRIANGLES:
        return _too_large(f"has {faces} triangles; at most {MAX_TRIANGLES} are read")
    return b"\n".join(lines), largest >= 8.0


def _convert(path: Path, data: bytes, suffix: str) -> tuple[bytes, bool] | _MeshError:
    """Converts a scene of another format to one binary STL, in m and z up."""
    # trimesh treats an interrupt as a missing package and continues without it.
    with uninterrupted():
        return _convert_by_trimesh(path, data, suffix)


def _convert_by_trimesh(path: Path, data: bytes, suffix: str) -> tuple[bytes, bool] | _MeshError:
    import logging
    import warnings

    try:
        import trimesh
    except ImportError:
        return _MeshError(
            "mesh-format",
            f"has the format `{suffix}`, which needs trimesh; it is not installed",
            "install trimesh and pycollada, or convert the mesh to STL",
        )
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            corners = trimesh.load_scene(str(path), file_type=suffix).to_mesh().triangles
            if suffix == "dae":
                corners = corners @ _collada_axes(data)
            rows = corners.reshape(-1, 9).tolist()
    except (AttributeError, TypeError, LookupError):  # not of this format, or empty
        return _invalid(f"is not a {suffix} file, or has no triangles")
    except Exception as error:  # the readers raise exceptions of many types
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        return _invalid(f"cannot be read as {suffix}: {reason}")
    return _binary([((r[0], r[1], r[2]), (r[3], r[4], r[5]), (r[6], r[7], r[8])) for r in rows])


def _collada_axes(data: bytes) -> list[list[float]]:
    """Returns the matrix M of a Collada file for row vectors: ``p_z_up_in_m = p @ M``."""
    from xml.etree import ElementTree

    root = ElementTree.fromstring(data)
    unit, up = 1.0, "Y_UP"  # defaults of Collada 1.4, element <asset>
    for element in root.iter():
        name = element.tag.rpartition("}")[2]
        if name == "unit":
            unit = float(element.get("meter", "1"))
        elif name == "up_axis":
            up = (element.text or up).strip()
        elif name.startswith("library_"):
            break
    s = unit
    return {
        "Z_UP": [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]],
        "Y_UP": [[s, 0.0, 0.0], [0.0, 0.0, s], [0.0, -s, 0.0]],  # (x, y, z) -> (x, -z, y)
        "X_UP": [[0.0, 0.0, s], [-s, 0.0, 0.0], [0.0, -s, 0.0]],  # (x, y, z) -> (-y, -z, x)
    }[up]


@functools.lru_cache(maxsize=512)
def _extent(data: bytes, suffix: str) -> Vec3:
    """Returns the edge lengths of the bounding box, in the unit of the mesh."""
    if suffix == "obj":
        points = [
            [float(n) for n in line.split()[1:4]]
            for line in data.split(b"\n")
            if line.split(None, 1)[:1] == [b"v"]
        ]
    else:
        points = [list(t[i : i + 3]) for t in _RECORD.iter_unpack(data[84:]) for i in (0, 3, 6)]
    sizes = [max(axis) - min(axis) for axis in zip(*points, strict=True)]
    return (sizes[0], sizes[1], sizes[2])
