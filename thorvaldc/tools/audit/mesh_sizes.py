"""Finds the mesh files of descriptions and their sizes, in bounded time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from urllib.parse import unquote

from thorvaldc.compiler.shapes.meshes import load_mesh, shared_mesh_workers
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Mesh, Vec3
from thorvaldc.model.stl import RECORD, stl_triangles
from thorvaldc.tools.audit.audit_facts import Body, Description, Evidence, SolidShape

SECONDS = 30.0
MAX_MESHES = 300
_VERTICES = 30_000  # of a mesh with more, a part is read

Box = tuple[Vec3, Vec3]


def mesh_path(name: str, description: Description, evidence: Evidence) -> Path | None:
    """Returns the path of a mesh file, or ``None`` if its package is not audited."""
    key = f"{description.path.parent} {name}"
    if key not in evidence.paths:
        evidence.paths[key] = _mesh_path(name, description, evidence)
    return evidence.paths[key]


def _mesh_path(name: str, description: Description, evidence: Evidence) -> Path | None:
    for scheme in ("package://", "model://", "$(find "):
        if name.startswith(scheme):
            return evidence.file_in_package(
                unquote(name.removeprefix(scheme)).replace(")/", "/", 1)
            )
    if name.startswith("file://"):
        path = Path(unquote(name.removeprefix("file://")))
        return path if path.is_absolute() and str(path) != "/" else None
    if not name or "://" in name:
        return None
    return description.path.parent / name


class MeshSizes:
    """Bounding boxes of the mesh files that descriptions use.

    - ``boxes``: corners (m) of a mesh with scale 1 by its path, for meshes that can be read.
    - ``is_complete``: whether all meshes were read.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.boxes: dict[Path, Box] = {}
        self.is_complete = True
        paths: dict[Path, None] = {}
        for description, _, shape in mesh_shapes(evidence):
            path = mesh_path(shape.mesh, description, evidence)
            if path is not None and _is_file(path):
                paths[path] = None
        end = time.monotonic() + SECONDS
        with shared_mesh_workers():
            for count, path in enumerate(paths):
                if count >= MAX_MESHES or time.monotonic() > end:
                    self.is_complete = False
                    break
                mesh = load_mesh(path, Span(path.name), Report(), display=path.name)
                box = _bounds(mesh) if mesh is not None else None
                if box is not None:
                    self.boxes[path] = box


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def mesh_shapes(evidence: Evidence) -> Iterator[tuple[Description, Body, SolidShape]]:
    """Yields the meshes of URDF and SDF descriptions."""
    for description in evidence.descriptions:
        if description.format != "MJCF":
            for body in description.bodies.values():
                for shape in body.shapes:
                    if shape.kind == "mesh":
                        yield description, body, shape


def _bounds(mesh: Mesh) -> Box | None:
    points = _obj_points(mesh.data) if mesh.name.endswith(".obj") else _stl_points(mesh.data)
    low, high = [float("inf")] * 3, [float("-inf")] * 3
    for point in points:
        for axis in range(3):
            low[axis], high[axis] = min(low[axis], point[axis]), max(high[axis], point[axis])
    if low[0] > high[0]:
        return None
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _stl_points(data: bytes) -> Iterator[tuple[float, ...]]:
    step = max(1, len(data) // RECORD * 3 // _VERTICES)
    return chain.from_iterable(stl_triangles(data, step))


def _obj_points(data: bytes) -> Iterator[tuple[float, ...]]:
    for line in data.splitlines():
        if line.startswith(b"v "):
            yield tuple(float(word) for word in line.split()[1:4])
