"""Reads and checks the content of mesh files, also as the service of a contained worker process.

A small file can describe a mesh of any size, by nested instances, large counts or compressed parts.
STL and OBJ files are read here, all others by the package trimesh.  A mesh is refused if MuJoCo
cannot load it.  The module imports no package of others at its start, because worker processes
import it.

A request to the worker process (see ``worker_protocol``) has the format of the mesh, the scale,
``collides`` and ``files``: the name and the size of each file in the data.  The first file is the
mesh.  An answer is one of

- ``{"suffix": ..., "size": ...}`` with the mesh as data, see ``CheckedMesh``
- ``{"code": ..., "text": ..., "hint": ...}``, see ``MeshError``
- ``{"needs": name}`` if the mesh refers to a file that is not in the request
"""

from __future__ import annotations

import io
import itertools
import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from thorvaldc.diagnostics import plain
from thorvaldc.model.stl import Triangle, binary_stl, stl_triangles, triangle_normal

if TYPE_CHECKING:
    from thorvaldc.model import Vec3

Corners = tuple[int, int, int]
"""Indices of the three corners of a triangle, counterclockwise for a viewer outside the shape."""

# The STL reader of MuJoCo accepts at most 200 000 triangles.
MAX_TRIANGLES = 200_000
_MAX_VERTICES = 3 * MAX_TRIANGLES
# MuJoCo refuses meshes with a smaller area (its limit is near 1e-15 m^2), and larger coordinates.
_MIN_AREA = 1e-12
_MAX_COORDINATE = 1e9
_MAX_FLOAT32 = 3.4028234e38
# A mesh is flat if all points are nearer to a plane than this part of its size.
_FLAT = 1e-6
_SAMPLE = 100  # triangles that decide for most meshes whether they are flat

_FLOAT32 = struct.Struct("<3f")
_VERTEX = rb"(?i)(?<!\S)vertex(?!\S)\s*(\S*)\s*(\S*)\s*(\S*)"
# The function ``bytes.translate`` tests the last byte of each little-endian float32 with the tables
# ``_BELOW_HUGE`` and ``_BELOW_8``.  The last byte of a little-endian float32 contains the sign and
# the upper 7 bits of the exponent.  ``_BELOW_HUGE`` contains the last bytes of float32 numbers with
# a magnitude below 1.7e38, which excludes infinity and NaN.  ``_BELOW_8`` contains the last bytes
# of float32 numbers with a magnitude below 8.
_BELOW_HUGE = bytes(b for b in range(256) if b & 0x7F != 0x7F)
_BELOW_8 = bytes(b for b in range(256) if b & 0x7F < 0x41)


class MeshError(Exception):
    """Raised if a mesh file is refused.

    - ``code``: name of the diagnostic.
    - ``text``: message without the first words "mesh file `name`".
    - ``hint``: how the user can correct the mesh file.
    """

    def __init__(
        self, code: str, text: str, hint: str = "export it again, if possible as binary STL"
    ) -> None:
        super().__init__(text)
        self.code = code
        self.text = text
        self.hint = hint


class CheckedMesh(NamedTuple):
    """A mesh that MuJoCo can load.

    - ``suffix``: format of the data, ``stl`` or ``obj``.
    - ``size``: largest edge length of the bounding box (m), or 0 if no coordinate exceeds 8 m.
    """

    data: bytes
    suffix: str
    size: float


def check_mesh(suffix: str, data: bytes, scale: Vec3, collides: bool) -> CheckedMesh:
    """Checks the content of an STL or OBJ file with the scale of its use.

    MuJoCo loads a mesh with all points in a plane only if it is not used for collisions
    (``collides``).

    The data of the result is binary STL, or OBJ without references to material files.  Raises
    ``MeshError``.
    """
    if suffix == "stl":
        data, is_large = _check_stl(data)
        count = (len(data) - 84) // 50
        source: Callable[[int], Iterable[Triangle]] = partial(stl_triangles, data)
    else:
        data, is_large = _check_obj(data)
        listed = [*obj_triangles(data, as_float32=True)]
        count = len(listed)
        source = lambda step: listed[::step]  # noqa: E731

    def triangles(step: int = 1) -> Iterator[Triangle]:
        x, y, z = scale
        for a, b, c in source(step):
            yield (
                (a[0] * x, a[1] * y, a[2] * z),
                (b[0] * x, b[1] * y, b[2] * z),
                (c[0] * x, c[1] * y, c[2] * z),
            )

    _check_shape(triangles(), is_large)
    size = 0.0
    if is_large or max(map(abs, scale)) > 1.0:
        axes = zip(*itertools.chain.from_iterable(triangles()), strict=True)
        size = max(max(axis) - min(axis) for axis in axes)
    steps = sorted({1, max(1, count // _SAMPLE)}, reverse=True)
    if collides and all(
        _is_flat([*dict.fromkeys(itertools.chain.from_iterable(triangles(step)))]) for step in steps
    ):
        text = "is flat; a collision shape needs a volume"
        raise MeshError("mesh-flat", text, "use a thin box, or a mesh with a thickness")
    return CheckedMesh(data, suffix, size)


def check_count(triangles: int) -> None:
    """Raises ``MeshError`` if a mesh has too many triangles."""
    if triangles > MAX_TRIANGLES:
        raise too_large(f"has {triangles} triangles; at most {MAX_TRIANGLES} are read")


def too_large(text: str) -> MeshError:
    """Returns the error for a mesh that exceeds a limit."""
    return MeshError(
        "mesh-large", text, "reduce it: some 10000 triangles are enough for a picture of a robot"
    )


def checked_stl(triangles: Iterable[Triangle]) -> bytes:
    """Returns the content of a binary STL file.

    Raises ``MeshError`` if a coordinate is too large for a float32.
    """
    try:
        return binary_stl(triangles)
    except OverflowError as error:
        raise _invalid("has a coordinate that is not a finite number") from error


def _invalid(text: str) -> MeshError:
    return MeshError("mesh-invalid", text)


def _check_stl(data: bytes) -> tuple[bytes, bool]:
    """Checks the content of an STL file, and converts text STL to binary STL.

    Returns the content of the binary STL file without trailing bytes.  The second return value is
    true if a coordinate of the mesh may have a magnitude of 8 m or more.

    ``model/stl`` describes the layout of the bytes.
    """
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else None
    if count is None or len(data) != 84 + 50 * count:
        if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2000]:
            return _text_stl(data)
        if count is None:
            raise _invalid(f"has {len(data)} bytes, too few for an STL file")
        if len(data) < 84 + 50 * count:
            raise _invalid(
                f"is truncated: its header states {count} triangles, {84 + 50 * count} bytes, "
                f"and it has {len(data)} bytes"
            )
        data = data[: 84 + 50 * count]
    if count < 2:
        raise _invalid(f"has {count} triangles and is not a solid")
    check_count(count)
    is_large = False
    for k in range(9):
        # Last byte of one coordinate of each triangle in the binary STL file.  The 9 coordinates of
        # a triangle have the numbers k = 0 to 8.
        high_bytes = data[84 + 12 + 4 * k + 3 :: 50]
        if high_bytes.translate(None, _BELOW_HUGE):
            raise _invalid("has a coordinate that is not a finite number")
        is_large = is_large or bool(high_bytes.translate(None, _BELOW_8))
    return data, is_large


def _text_stl(data: bytes) -> tuple[bytes, bool]:
    """Converts a text STL file to binary STL."""
    numbers: list[float] = []
    try:
        for match in re.finditer(_VERTEX, data):
            numbers += map(float, match.groups())
    except ValueError as error:
        number = len(numbers) // 3 + 1
        raise _invalid(f"has a vertex that is not three numbers (number {number})") from error
    if len(numbers) % 9:
        raise _invalid(f"has {len(numbers) // 3} vertices, not three for each triangle")
    points = [(numbers[i], numbers[i + 1], numbers[i + 2]) for i in range(0, len(numbers), 3)]
    triangles = [(points[i], points[i + 1], points[i + 2]) for i in range(0, len(points), 3)]
    check_count(len(triangles))
    return _check_stl(checked_stl(triangles))


def _check_obj(data: bytes) -> tuple[bytes, bool]:
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
            except ValueError as error:
                raise _invalid(
                    f"has a face that is not a list of vertices (line {number})"
                ) from error
            if len(indices) < 3 or 0 in indices or min(indices) < -vertices:
                raise _invalid(f"has a face with a vertex that does not exist (line {number})")
            if max(indices) > highest:
                highest, highest_line = max(indices), number
        elif word in ([b"vn"], [b"vt"]):
            try:
                numbers = [float(n) for n in line.partition(b"#")[0].split()[1:]]
            except ValueError:
                numbers = []
            least = 3 if word == [b"vn"] else 1
            if not least <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
                raise _invalid(f"has an invalid normal or texture coordinate (line {number})")
        elif word == [b"v"]:
            vertices += 1
            if vertices > _MAX_VERTICES:
                raise too_large(f"has more than {_MAX_VERTICES} vertices")
            try:
                x, y, z = (abs(float(n)) for n in line.split()[1:4])
            except ValueError as error:
                raise _invalid(f"has a vertex that is not three numbers (line {number})") from error
            largest = max(largest, x, y, z)
            if not math.isfinite(x + y + z):
                raise _invalid(f"has a coordinate that is not a finite number (line {number})")
    if vertices < 4 or faces < 2:
        raise _invalid(f"has {vertices} vertices and {faces} triangles and is not a solid")
    if highest > vertices:
        raise _invalid(f"has a face with a vertex that does not exist (line {highest_line})")
    if largest > _MAX_FLOAT32:
        raise _invalid("has a coordinate that is too large for a float32")
    check_count(faces)
    return b"\n".join(lines), largest >= 8.0


def obj_triangles(data: bytes, *, as_float32: bool = False) -> Iterator[Triangle]:
    """Yields the triangles of a checked OBJ file.

    - ``as_float32``: whether the coordinates are rounded to float32, as MuJoCo reads them.
    """
    points: list[Vec3] = []
    faces: list[tuple[int, list[int]]] = []  # with the number of vertices above the face
    for line in data.split(b"\n"):
        words = line.partition(b"#")[0].split()
        if words[:1] == [b"v"]:
            x, y, z = map(float, words[1:4])
            points.append(_FLOAT32.unpack(_FLOAT32.pack(x, y, z)) if as_float32 else (x, y, z))
        elif words[:1] == [b"f"]:
            faces.append((len(points), [int(word.split(b"/", 1)[0]) for word in words[1:]]))
    for above, face in faces:
        corners = [points[i - 1 if i > 0 else above + i] for i in face]
        for b, c in itertools.pairwise(corners[1:]):
            yield corners[0], b, c


def mesh_triangles(name: str, data: bytes) -> Iterator[Triangle]:
    """Yields the triangles of a mesh of a model, which is a checked STL or OBJ file."""
    return obj_triangles(data) if name.endswith(".obj") else stl_triangles(data)


def indexed_triangles(name: str, data: bytes) -> tuple[list[Vec3], list[Corners]]:
    """Returns the different points of a mesh of a model, in the order of the file, and its
    triangles."""
    numbers: dict[Vec3, int] = {}
    number = numbers.setdefault
    triangles = [
        (number(a, len(numbers)), number(b, len(numbers)), number(c, len(numbers)))
        for a, b, c in mesh_triangles(name, data)
    ]
    return [*numbers], triangles


def is_closed(triangles: Iterable[Corners]) -> bool:
    """Returns whether triangles enclose a body: each edge belongs to two triangles, which pass
    along it in opposite directions.

    Some programs fill gaps with triangles that have a corner twice.  They do not count.
    """
    forward: set[int] = set()
    backward: set[int] = set()
    count = 0
    for i, j, k in triangles:
        if i != j and j != k and k != i:
            count += 3
            forward.add(i << 32 | j) if i < j else backward.add(j << 32 | i)
            forward.add(j << 32 | k) if j < k else backward.add(k << 32 | j)
            forward.add(k << 32 | i) if k < i else backward.add(i << 32 | k)
    return 0 < count == 2 * len(forward) and forward == backward


def _check_shape(triangles: Iterable[Triangle], is_large: bool) -> None:
    """Raises ``MeshError`` if MuJoCo cannot load a mesh because of its points.

    Nearly every mesh is accepted after its first triangles, because the areas are added only until
    they reach the limit.
    """
    hint = "export it again; the mesh of a body has triangles with an area"
    distinct: set[Vec3] = set()
    area = 0.0
    is_solid = False
    for corners in triangles:
        if is_large and max(abs(n) for p in corners for n in p) > _MAX_COORDINATE:
            text = f"has a coordinate of more than {plain(_MAX_COORDINATE)} m"
            raise MeshError("mesh-invalid", text, hint)
        if not is_solid:
            area += 0.5 * math.hypot(*triangle_normal(*corners))
            distinct.update(corners)
            is_solid = len(distinct) >= 4 and area > _MIN_AREA
        elif not is_large:
            return
    if len(distinct) < 4:
        text = f"has {len(distinct)} different points and is not a solid"
        raise MeshError("mesh-invalid", text, hint)
    if not is_solid:
        text = f"has an area of {area:.3g} m^2, which is too small"
        raise MeshError("mesh-invalid", text, hint)


def _is_flat(points: Sequence[Vec3]) -> bool:
    """Whether the distances of points to a plane are below ``_FLAT`` of the size of the mesh.

    The plane contains three points that are far from each other: a, the point b farthest from a,
    and the point c farthest from the line through a and b.
    """
    a = points[0]
    b = max(points, key=lambda p: math.dist(a, p))
    c = max(points, key=lambda p: math.hypot(*triangle_normal(a, b, p)))
    normal = triangle_normal(a, b, c)
    length = math.hypot(*normal)
    limit = _FLAT * math.dist(a, b) * length
    x, y, z = normal
    return all(
        abs(x * (p[0] - a[0]) + y * (p[1] - a[1]) + z * (p[2] - a[2])) <= limit for p in points
    )


# -- worker process ----------------------------------------------------------------

IMPORTS = ("numpy", "trimesh", "collada")
"""Modules that a worker process for other formats than STL and OBJ imports at its start."""
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
        checked = check_mesh(suffix, mesh, (x, y, z), request["collides"])
    except MeshError as error:
        return {"code": error.code, "text": error.text, "hint": error.hint}, b""
    except _MissingFileError as error:
        return {"needs": str(error)}, b""
    return {"suffix": checked.suffix, "size": checked.size}, checked.data


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
