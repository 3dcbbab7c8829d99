"""The vertices of the mesh files of a model."""

from __future__ import annotations

import functools

from thorvaldc.model.spatial import Vec3
from thorvaldc.model.stl import stl_triangles


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
    for triangle in stl_triangles(data):
        vertices |= dict.fromkeys(triangle)
    return tuple(vertices)
