"""Mesh files of a model: binary STL files, and the vertices of STL and OBJ files.

A file has a header of 80 bytes and the number of triangles (uint32). A triangle has 50 bytes: its
normal vector and three corners as float32, and 2 bytes of attributes, all in little-endian order.
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Iterable, Iterator

from thorvaldc.model import Vec3

Triangle = tuple[Vec3, Vec3, Vec3]
HEADER, RECORD = 84, 50  # bytes
_CORNERS = struct.Struct("<12x9f2x")


def binary_stl(triangles: Iterable[Triangle], name: bytes = b"binary stl".ljust(80)) -> bytes:
    """Return the content of a binary STL file. The normals are computed from the corners.

    - ``triangles``: the corners of each triangle in m.
    - ``name``: first 80 bytes of the file.

    Raises ``OverflowError`` if a coordinate is too large for a float32.
    """
    body = bytearray()
    for a, b, c in triangles:
        nx, ny, nz = triangle_normal(a, b, c)
        length = math.sqrt(nx * nx + ny * ny + nz * nz) or 1.0
        body += struct.pack("<12fH", nx / length, ny / length, nz / length, *a, *b, *c, 0)
    return name + struct.pack("<I", len(body) // RECORD) + bytes(body)


def stl_triangles(data: bytes, step: int = 1) -> Iterator[Triangle]:
    """Yield every ``step``-th triangle of a binary STL file, without the bytes after the last."""
    for start in range(HEADER, len(data) - RECORD + 1, RECORD * step):
        t = _CORNERS.unpack_from(data, start)
        yield t[0:3], t[3:6], t[6:9]


def triangle_normal(a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    """Return the cross product of two edges of a triangle."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@functools.lru_cache(maxsize=256)
def mesh_pieces(name: str, data: bytes) -> list[list[Vec3]]:
    """Return the vertices of each connected piece of a mesh file, in the order of the file.

    Triangles of an STL file that share a vertex belong together.  An OBJ file is one piece.
    """
    if name.endswith(".obj"):
        return [list(mesh_vertices(name, data))]
    parent: dict[Vec3, Vec3] = {}

    def root(vertex: Vec3) -> Vec3:
        while (above := parent.setdefault(vertex, vertex)) != vertex:
            parent[vertex] = vertex = parent[above]  # shortens the way for the next search
        return vertex

    for first, *others in stl_triangles(data):
        for other in others:
            parent[root(other)] = root(first)
    pieces: dict[Vec3, list[Vec3]] = {}
    for vertex in parent:
        pieces.setdefault(root(vertex), []).append(vertex)
    return list(pieces.values())


def mesh_vertices(name: str, data: bytes) -> tuple[Vec3, ...]:
    """Return the vertices of a mesh file of the model, a binary STL file or an OBJ file.

    Each vertex is returned once, in the order of the file.
    """
    vertices: dict[Vec3, None] = {}
    if name.endswith(".obj"):
        for line in data.decode("utf-8", "replace").splitlines():
            words = line.split()
            if words[:1] == ["v"]:
                vertices[float(words[1]), float(words[2]), float(words[3])] = None
        return tuple(vertices)
    for triangle in stl_triangles(data):
        vertices |= dict.fromkeys(triangle)
    return tuple(vertices)
