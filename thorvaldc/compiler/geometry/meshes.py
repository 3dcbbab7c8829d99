"""Mesh files: found, checked and brought into a format that every target reads.

STL and OBJ are what URDF readers and MuJoCo share, so they go along as they are
(binary STL: MuJoCo does not read the text form).  Collada and what else trimesh
reads becomes binary STL here, once, so that no backend has to convert.
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

# MuJoCo's STL reader takes 1..200000 faces; more helps no viewer either.
MAX_TRIANGLES = 200_000
MAX_FILE_BYTES = 64 * 1024 * 1024
# A part of a robot that is longer than this is a mesh in millimetres.
MAX_EXTENT = 20.0
CONVERTED = ("dae", "glb", "gltf", "off", "ply")
FORMATS = ("stl", "obj", *CONVERTED)

_RECORD = struct.Struct("<12xfffffffff2x")
# Screens on the highest byte of a little-endian float: exponents of 1.7e38 and up
# (with inf and nan), and magnitudes of 8 and up.
_BELOW_HUGE = bytes(b for b in range(256) if b & 0x7F != 0x7F)
_BELOW_8 = bytes(b for b in range(256) if b & 0x7F < 0x41)


class _Fault(NamedTuple):
    code: str
    text: str
    hint: str


class _Loaded(NamedTuple):
    mesh: Mesh
    suffix: str
    large: bool  # some coordinate may be 8 m or more: worth measuring


def load_mesh(
    path: Path,
    asked_by: Span,
    report: Report,
    *,
    display: str,
    scale: Vec3 = (1.0, 1.0, 1.0),
) -> Mesh | None:
    """The mesh in the file at ``path``, or ``None`` with the reason in ``report``.

    ``asked_by`` is where the file is named, ``display`` how messages call it.
    ``scale`` only serves to judge the size.  The name of the result is made of the
    file's and of its contents' hash, so that two files of one name do not meet.
    Files are read once per process as long as their size and time stay the same.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        report.add(
            "mesh-format",
            f"mesh file `{display}` has the format `{suffix}`, which is not read",
            asked_by,
            hint=f"use one of {', '.join(FORMATS)}; STL and OBJ go along unchanged",
        )
        return None
    try:
        status = path.stat()
        missing = not path.is_file()
    except (OSError, ValueError):
        missing = True
    if missing:
        report.add(
            "mesh-missing",
            f"mesh file `{display}` does not exist",
            asked_by,
            hint="paths are relative to the file that names them; check spelling and case",
        )
        return None
    found = _read(path, status.st_mtime_ns, status.st_size)
    if isinstance(found, _Fault):
        report.add(found.code, f"mesh file `{display}` {found.text}", asked_by, hint=found.hint)
        return None
    if found.large or max(map(abs, scale)) > 1.0:
        size = _extent(found.mesh.data, found.suffix)
        largest = max(abs(size[i] * scale[i]) for i in range(3))
        if largest > MAX_EXTENT:
            report.add(
                "mesh-size",
                f"mesh file `{display}` is {largest:g} m long; over {MAX_EXTENT:g} m is "
                "taken for a mistake",
                asked_by,
                hint="meshes are in metres; for one in millimetres say scale 0.001",
            )
    return found.mesh


def binary_stl(triangles: Iterable[tuple[Vec3, Vec3, Vec3]]) -> bytes:
    """Binary STL of triangles given by their corners in m, normals computed.

    Raises ``OverflowError`` where a coordinate does not fit in 32 bits.
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
def _read(path: Path, mtime_ns: int, size: int) -> _Loaded | _Fault:
    """Read, check and convert; ``mtime_ns`` and ``size`` only serve as the key."""
    if size > MAX_FILE_BYTES:
        return _too_large(f"has {size / 1e6:.0f} MB; at most {MAX_FILE_BYTES / 1e6:.0f} are read")
    try:
        data = path.read_bytes()
    except OSError as fault:
        return _Fault(
            "mesh-missing",
            f"cannot be read: {fault.strerror}",
            "check the file's permissions",
        )
    if data.startswith(b"version https://git-lfs"):
        return _invalid("is a pointer of Git LFS, not the mesh", "fetch it: git lfs pull")
    suffix = path.suffix.lower().lstrip(".")
    if suffix == "stl":
        checked = _check_stl(data)
    elif suffix == "obj":
        checked = _check_obj(data)
    else:
        checked = _convert(path, data, suffix)
        suffix = "stl"
    if isinstance(checked, _Fault):
        return checked
    data, large = checked
    digest = hashlib.sha256(data).hexdigest()
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).strip("_") or "mesh"
    return _Loaded(Mesh(f"{stem}_{digest[:8]}.{suffix}", digest, data), suffix, large)


def _invalid(
    text: str, hint: str = "export it again, as binary STL where there is a choice"
) -> _Fault:
    return _Fault("mesh-invalid", text, hint)


def _too_large(text: str) -> _Fault:
    return _Fault("mesh-large", text, "reduce it: a robot is seen well with some 10000 triangles")


def _check_stl(data: bytes) -> tuple[bytes, bool] | _Fault:
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else None
    if count is None or len(data) != 84 + 50 * count:
        if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2000]:
            return _text_stl(data)
        if count is None:
            return _invalid(f"has {len(data)} bytes, too few for an STL file")
        if len(data) < 84 + 50 * count:
            return _invalid(
                f"is cut off: it announces {count} triangles, {84 + 50 * count} bytes, "
                f"and has {len(data)} bytes"
            )
        data = data[: 84 + 50 * count]
    if count < 2:
        return _invalid(f"has {count} triangles, no body")
    if count > MAX_TRIANGLES:
        return _too_large(f"has {count} triangles; at most {MAX_TRIANGLES} are read")
    large = False
    for k in range(9):
        high = data[84 + 12 + 4 * k + 3 :: 50]
        if high.translate(None, _BELOW_HUGE):
            return _invalid("has a coordinate that is not a finite number")
        large = large or bool(high.translate(None, _BELOW_8))
    return data, large


def _text_stl(data: bytes) -> tuple[bytes, bool] | _Fault:
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


def _binary(triangles: list[tuple[Vec3, Vec3, Vec3]]) -> tuple[bytes, bool] | _Fault:
    if len(triangles) > MAX_TRIANGLES:
        return _too_large(f"has {len(triangles)} triangles; at most {MAX_TRIANGLES} are read")
    try:
        return _check_stl(binary_stl(triangles))
    except OverflowError:
        return _invalid("has a coordinate that is not a finite number")


def _check_obj(data: bytes) -> tuple[bytes, bool] | _Fault:
    vertices = faces = 0
    largest = 0.0
    kept: list[bytes] = []
    for number, line in enumerate(data.split(b"\n"), start=1):
        word = line[:7].split(None, 1)[:1]
        if word in ([b"mtllib"], [b"usemtl"]):
            continue  # the material file does not go along; colours come from the model
        kept.append(line)
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
        return _invalid(f"has {vertices} vertices and {faces} triangles, no body")
    if faces > MAX_TRIANGLES:
        return _too_large(f"has {faces} triangles; at most {MAX_TRIANGLES} are read")
    return b"\n".join(kept), largest >= 8.0


def _convert(path: Path, data: bytes, suffix: str) -> tuple[bytes, bool] | _Fault:
    """Binary STL of another format, in m, z up; every instance in it, placed."""
    # trimesh takes an interrupt for a package that cannot be imported, and goes on without it.
    with uninterrupted():
        return _converted(path, data, suffix)


def _converted(path: Path, data: bytes, suffix: str) -> tuple[bytes, bool] | _Fault:
    import logging
    import warnings

    try:
        import trimesh
    except ImportError:
        return _Fault(
            "mesh-format",
            f"has the format `{suffix}`, which needs trimesh, and that is not installed",
            "install trimesh and pycollada, or convert the mesh to STL",
        )
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            whole = trimesh.load_scene(str(path), file_type=suffix).to_mesh()
            corners = whole.triangles
            if suffix == "dae":
                corners = corners @ _collada_axes(data)
            rows = corners.reshape(-1, 9).tolist()
    except (AttributeError, TypeError, LookupError):  # a reader that finds something else
        return _invalid(f"is no {suffix} file, or has nothing to show")
    except Exception as fault:  # readers of eight formats raise what they like
        reason = " ".join(str(fault).split())[:200] or type(fault).__name__
        return _invalid(f"cannot be read as {suffix}: {reason}")
    return _binary([((r[0], r[1], r[2]), (r[3], r[4], r[5]), (r[6], r[7], r[8])) for r in rows])


def _collada_axes(data: bytes) -> list[list[float]]:
    """The matrix M for row vectors, ``p_z_up_in_m = p @ M``, of a Collada file's asset."""
    from xml.etree import ElementTree

    root = ElementTree.fromstring(data)
    unit, up = 1.0, "Y_UP"  # the standard's defaults
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
    """Edge lengths of the bounding box in the mesh's own unit."""
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
