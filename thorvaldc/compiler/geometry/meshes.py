"""Reads, checks and converts mesh files.

Binary STL files and OBJ files are copied without conversion, because URDF readers and MuJoCo can
read both formats.  Text STL files are converted to binary STL, because MuJoCo reads only binary
STL.  Mesh files of all other formats are converted to binary STL, so that no backend needs to
convert a mesh.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.bounded_file import read_bounded
from thorvaldc.model import Mesh, Vec3

# The STL reader of MuJoCo accepts at most 200 000 triangles.
MAX_TRIANGLES = 200_000
MAX_FILE_BYTES = 64 * 1024 * 1024
# Largest size of a mesh (m). A mesh file with a larger mesh probably has the unit mm.
MAX_EXTENT = 20.0
# MuJoCo refuses meshes with a smaller area (its limit is near 1e-15 m^2), and larger coordinates.
MIN_AREA = 1e-12
MAX_COORDINATE = 1e9
WORKER_SECONDS = 30.0  # limit of the process that reads a file with trimesh
MAX_FLOAT32 = 3.4028234e38
CONVERTED = ("dae", "glb", "gltf", "off", "ply")
FORMATS = ("stl", "obj", *CONVERTED)

_RECORD = struct.Struct("<12xfffffffff2x")
# The function ``bytes.translate`` tests the last byte of each little-endian float32 with the tables
# ``_BELOW_HUGE`` and ``_BELOW_8``.  The last byte of a little-endian float32 contains the sign and
# the upper 7 bits of the exponent.  ``_BELOW_HUGE`` contains the last bytes of float32 numbers with
# a magnitude below 1.7e38, which excludes infinity and NaN.  ``_BELOW_8`` contains the last bytes
# of float32 numbers with a magnitude below 8.
_BELOW_HUGE = bytes(b for b in range(256) if b & 0x7F != 0x7F)
_BELOW_8 = bytes(b for b in range(256) if b & 0x7F < 0x41)


class _MeshError(NamedTuple):
    """Description of an error in a mesh file.

    ``code`` is the name of the diagnostic that reports the mesh error.  ``text`` is the error
    message without the first words "mesh file `name`".  ``hint`` explains how the user can correct
    the mesh file.
    """

    code: str
    text: str
    hint: str


class _LoadedMesh(NamedTuple):
    """A mesh that was read from a file.

    ``suffix`` is the format of the mesh data, ``stl`` or ``obj``.  ``is_large`` is true if a
    coordinate of the mesh may have a magnitude of 8 m or more.
    """

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
    """Reads a mesh file.

    Returns ``None`` and reports an error if the mesh file cannot be read or is not valid.  The name
    of the mesh contains a hash of the file content, so that different mesh files with the same file
    name have different mesh names.  A mesh file is read again only if the size or the modification
    time of the file has changed.

    Parameters
    ----------
    path : path of the mesh file.
    span : span of the file name in the document.
    report : collects the diagnostics.
    display : name of the file in messages.
    scale : scale factors of the mesh along x, y and z.  The factors are used only to check the
        size of the mesh.
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
    flaw = _flaw(loaded.mesh.data, loaded.suffix, scale, loaded.is_large)
    if flaw:
        hint = "export it again; the mesh of a body has triangles with an area"
        report.add("mesh-invalid", f"mesh file `{display}` {flaw}", span, hint=hint)
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
    """Returns the content of a binary STL file that contains the triangles.

    Each triangle has three corners (x, y, z in m).  The function computes the normal vectors of the
    triangles from the corners.  Raises ``OverflowError`` if a coordinate is too large for a
    float32.
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
    """Reads, checks and converts a mesh file.

    The converted meshes are cached.  ``mtime_ns`` is the modification time of the file (ns).  A
    mesh file with a new modification time is read again.
    """
    if size > MAX_FILE_BYTES:
        return _too_large(f"has {size / 1e6:.0f} MB; at most {MAX_FILE_BYTES / 1e6:.0f} are read")
    try:
        data = read_bounded(path, MAX_FILE_BYTES)
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
    """Checks the content of an STL file, and converts text STL to binary STL.

    Returns the content of the binary STL file without trailing bytes.  The second return value is
    true if a coordinate of the mesh may have a magnitude of 8 m or more.

    A binary STL file contains a header of 80 bytes, the number of triangles as a uint32, and 50
    bytes for each triangle.  The 50 bytes of a triangle are a normal vector and three corners as
    float32 values, followed by 2 bytes of attributes.
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
        # Last byte of one coordinate of each triangle in the binary STL file.  The 9 coordinates of
        # a triangle have the numbers k = 0 to 8.
        high_bytes = data[84 + 12 + 4 * k + 3 :: 50]
        if high_bytes.translate(None, _BELOW_HUGE):
            return _invalid("has a coordinate that is not a finite number")
        is_large = is_large or bool(high_bytes.translate(None, _BELOW_8))
    return data, is_large


def _text_stl(data: bytes) -> tuple[bytes, bool] | _MeshError:
    """Converts a text STL file to binary STL."""
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
    """Converts the triangles of a mesh to binary STL, and checks the number of triangles."""
    if len(triangles) > MAX_TRIANGLES:
        return _too_large(f"has {len(triangles)} triangles; at most {MAX_TRIANGLES} are read")
    try:
        return _check_stl(binary_stl(triangles))
    except OverflowError:
        return _invalid("has a coordinate that is not a finite number")


def _check_obj(data: bytes) -> tuple[bytes, bool] | _MeshError:
    """Checks the content of an OBJ file.

    Returns the content of the OBJ file without references to material files.  The second return
    value is true if a coordinate of the mesh has a magnitude of 8 m or more.
    """
    vertices = faces = highest = highest_line = 0
    largest = 0.0
    lines: list[bytes] = []
    for number, line in enumerate(data.split(b"\n"), start=1):
        word = line[:7].split(None, 1)[:1]
        if word in ([b"mtllib"], [b"usemtl"]):
            # Material files of OBJ meshes are not copied, because the robot model defines the
            # colours.
            continue
        lines.append(line)
        if word == [b"f"]:
            face = line.partition(b"#")[0].split()[1:]
            faces += len(face) - 2
            try:
                # A face refers to vertices by position; negative numbers count from the last one.
                indices = [int(corner.split(b"/", 1)[0]) for corner in face]
            except ValueError:
                return _invalid(f"has a face that is not a list of vertices (line {number})")
            if len(indices) < 3 or 0 in indices or min(indices) < -vertices:
                return _invalid(f"has a face with a vertex that does not exist (line {number})")
            if max(indices) > highest:
                highest, highest_line = max(indices), number
        elif word in ([b"vn"], [b"vt"]):
            try:
                numbers = [float(n) for n in line.partition(b"#")[0].split()[1:]]
            except ValueError:
                numbers = []
            least = 3 if word == [b"vn"] else 1
            if not least <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
                return _invalid(f"has an invalid normal or texture coordinate (line {number})")
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
    if highest > vertices:
        return _invalid(f"has a face with a vertex that does not exist (line {highest_line})")
    if largest > MAX_FLOAT32:
        return _invalid("has a coordinate that is too large for a float32")
    if faces > MAX_TRIANGLES:
        return _too_large(f"has {faces} triangles; at most {MAX_TRIANGLES} are read")
    return b"\n".join(lines), largest >= 8.0


def _convert(path: Path, data: bytes, suffix: str) -> tuple[bytes, bool] | _MeshError:
    """Converts a mesh file of another format to binary STL, in metres and with the z axis up.

    Another process reads the file with the package trimesh, see ``mesh_worker``.
    """
    if find_spec("trimesh") is None:
        return _MeshError(
            "mesh-format",
            f"has the format `{suffix}`, which needs trimesh; it is not installed",
            "install trimesh and pycollada, or convert the mesh to STL",
        )
    program = (
        f"import sys; sys.path[:] = {sys.path!r}; "
        "from thorvaldc.compiler.geometry.mesh_worker import main; main()"
    )
    try:
        process = subprocess.run(
            [sys.executable, "-S", "-B", "-c", program, str(path.absolute()), suffix],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=WORKER_SECONDS,
            # One thread per process: the memory of a thread counts for the limit.
            env={"OPENBLAS_NUM_THREADS": "1", "LC_ALL": "C.UTF-8"}
            | {k: v for k, v in os.environ.items() if k == "SYSTEMROOT"},
            start_new_session=True,  # Ctrl-C ends the compiler, which then ends the process
        )
    except subprocess.TimeoutExpired:
        return _too_large(f"took longer than {WORKER_SECONDS:g} s to read")
    line, _, triangles = process.stdout.partition(b"\n")
    if process.returncode == -getattr(signal, "SIGXCPU", 24):
        return _too_large("takes too long to read")
    answer: dict[str, Any] = json.loads(line) if line else {"error": "MemoryError"}
    if "error" in answer:
        if answer["error"] == "MemoryError":
            return _too_large("needs too much memory")
        if answer["error"] == "format":
            return _invalid(f"is not a {suffix} file, or has no triangles")
        return _invalid(f"cannot be read as {suffix}: {answer['text'] or answer['error']}")
    if answer["count"] > MAX_TRIANGLES:
        return _too_large(f"has {answer['count']} triangles; at most {MAX_TRIANGLES} are read")
    rows = struct.iter_unpack("<9d", triangles)
    corners = [((r[0], r[1], r[2]), (r[3], r[4], r[5]), (r[6], r[7], r[8])) for r in rows]
    if suffix != "dae":
        return _binary(corners)
    try:
        x, y, z = _collada_axes(data)
    except (ValueError, LookupError, SyntaxError) as error:  # XML errors are SyntaxErrors
        return _invalid(f"cannot be read as {suffix}: {error}")

    def point(p: Vec3) -> Vec3:
        a, b, c = (0.0 + p[0] * x[i] + p[1] * y[i] + p[2] * z[i] for i in range(3))
        return (a, b, c)

    return _binary([(point(p), point(q), point(r)) for p, q, r in corners])


def _collada_axes(data: bytes) -> list[list[float]]:
    """Returns the matrix that converts the points of a Collada file to metres and z up.

    A point p (row vector) is converted by the product ``p @ M`` with the returned matrix M.
    """
    from xml.etree import ElementTree

    root = ElementTree.fromstring(data)
    # Default unit and default up axis of a Collada 1.4 file (element <asset>).
    unit, up = 1.0, "Y_UP"
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
def _flaw(data: bytes, suffix: str, scale: Vec3, is_large: bool) -> str:
    """Returns why MuJoCo cannot load a mesh, or an empty text.

    Nearly every mesh is accepted after its first triangles, because the areas are added only until
    they reach the limit.
    """
    distinct: set[Vec3] = set()
    area = 0.0
    is_solid = False
    for corners in _triangles(data, suffix):
        a, b, c = ([p[i] * scale[i] for i in range(3)] for p in corners)
        if is_large and max(map(abs, (*a, *b, *c))) > MAX_COORDINATE:
            return f"has a coordinate of more than {MAX_COORDINATE:g} m"
        if not is_solid:
            u = [b[i] - a[i] for i in range(3)]
            v = [c[i] - a[i] for i in range(3)]
            normal = (
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            )
            area += 0.5 * math.hypot(*normal)
            distinct.update(corners)
            is_solid = len(distinct) >= 4 and area > MIN_AREA
        if is_solid and not is_large:
            return ""
    if len(distinct) < 4:
        return f"has {len(distinct)} different points and is not a solid"
    return "" if is_solid else f"has an area of {area:.3g} m^2, which is too small"


def _triangles(data: bytes, suffix: str) -> Iterator[tuple[Vec3, Vec3, Vec3]]:
    """Yields the corners of each triangle of a checked mesh, in the unit of the mesh."""
    if suffix == "stl":
        for t in _RECORD.iter_unpack(data[84:]):
            yield t[0:3], t[3:6], t[6:9]
        return
    points: list[Vec3] = []
    faces: list[tuple[int, list[int]]] = []  # with the number of vertices above the face
    for line in data.split(b"\n"):
        words = line.partition(b"#")[0].split()
        if words[:1] == [b"v"]:
            points.append((float(words[1]), float(words[2]), float(words[3])))
        elif words[:1] == [b"f"]:
            faces.append((len(points), [int(word.split(b"/", 1)[0]) for word in words[1:]]))
    for above, face in faces:
        corners = [points[i - 1 if i > 0 else above + i] for i in face]
        for b, c in itertools.pairwise(corners[1:]):
            yield corners[0], b, c


@functools.lru_cache(maxsize=512)
def _extent(data: bytes, suffix: str) -> Vec3:
    """Returns the edge lengths of the bounding box of a mesh, in the unit of the mesh."""
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
