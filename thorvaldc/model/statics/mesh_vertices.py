"""The vertices of the mesh files of a model."""

from __future__ import annotations

import functools
import struct

from thorvaldc.model.spatial import Vec3


@functools.lru_cache(maxsize=256)
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
    # Binary STL: 80 bytes, the number of triangles, and for each a normal, corners and 2 bytes.
    count = (len(data) - 84) // 50
    for values in struct.iter_unpack("<12x9f2x", data[84 : 84 + 50 * max(count, 0)]):
        vertices[values[0:3]] = None
        vertices[values[3:6]] = None
        vertices[values[6:9]] = None
    return tuple(vertices)
