"""Triangles of shapes.  The package trimesh reads the same meshes, and is the judge."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import trimesh

from tests.examples import example_robot
from thorvaldc.compiler.shapes.mesh_formats import check_mesh
from thorvaldc.model import Box, Mesh, MeshShape, Vec3
from thorvaldc.model.stl import Triangle, binary_stl
from thorvaldc.simulation.pictures.triangles import Corners, is_closed, shape_triangles

NAME = "4wd2ws_tall"  # has OBJ and STL meshes
CUBE = trimesh.creation.box((0.2, 0.2, 0.2)).triangles + 0.1  # m; a corner is at the origin


def coordinates(points: Sequence[Vec3], triangles: Sequence[Corners]) -> Counter[Triangle]:
    """Returns how often each triangle is there, from its smallest corner on."""
    counter: Counter[Triangle] = Counter()
    for corners in triangles:
        a, b, c = (points[i] for i in corners)
        counter[min((a, b, c), (b, c, a), (c, a, b))] += 1
    return counter


def judged(mesh: Mesh) -> tuple[list[Vec3], list[Corners]]:
    """Returns the points and triangles that trimesh reads."""
    suffix = mesh.name.rpartition(".")[2]
    read: Any = trimesh.load(io.BytesIO(mesh.data), file_type=suffix, force="mesh")
    points, triangles = ([*map(tuple, rows.tolist())] for rows in (read.vertices, read.faces))
    return points, triangles


def test_meshes_have_the_triangles_that_trimesh_reads() -> None:
    robot = example_robot(NAME)
    assert len(robot.meshes) > 10
    for mesh in robot.meshes:
        points, triangles = shape_triangles(robot, MeshShape(mesh.name, (1.0, 1.0, 1.0)))
        expected_points, expected = judged(mesh)
        assert len(points) == len(expected_points), mesh.name  # equal points are merged
        assert coordinates(points, triangles) == coordinates(expected_points, expected), mesh.name
        enclosed = trimesh.Trimesh(points, triangles, process=False)
        assert is_closed(points, triangles) == enclosed.is_watertight, mesh.name


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_a_mesh_file_of_either_format(suffix: str) -> None:
    corners = CUBE.copy()
    corners[abs(corners) < 1e-3] = 0.0
    corners[0][corners[0] == 0.0] = 1e-12  # one triangle has rounding errors
    if suffix == "stl":
        data = binary_stl(corners.tolist())
    else:
        lines = ["v {} {} {}".format(*point) for point in corners.reshape(-1, 3).tolist()]
        # Indices count from the first vertex, or from the last one above the face.
        lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i - 34}" for i in range(12)]
        data = "\n".join(lines).encode()
    checked = check_mesh(suffix, data, (1.0, 1.0, 1.0), collides=False).data
    mesh = replace(example_robot(NAME).meshes[0], name=f"cube.{suffix}", data=checked)
    robot = replace(example_robot(NAME), meshes=(mesh,))
    points, triangles = shape_triangles(robot, MeshShape(mesh.name, (1.0, 1.0, 1.0)))
    assert (len(points), len(triangles)) == (8, 12)
    assert coordinates(points, triangles) == coordinates(*judged(mesh))
    for scale in ((1.0, 1.0, 1.0), (-2.0, 1.0, 0.5), (-1.0, -1.0, 1.0)):
        points, triangles = shape_triangles(robot, MeshShape(mesh.name, scale))
        assert is_closed(points, triangles)
        volume = trimesh.Trimesh(points, triangles, process=False).volume
        expected = 0.008 * abs(scale[0] * scale[1] * scale[2])
        assert volume == pytest.approx(expected, rel=1e-5)  # also of a mirrored mesh


def test_a_box_of_any_size_is_closed() -> None:
    robot = example_robot(NAME)
    for size in ((0.5, 1.0, 2.0), (1e-3, 1e3, 1.0), (1e304, 1e304, 1.0)):
        points, triangles = shape_triangles(robot, Box(size))
        assert is_closed(points, triangles)
    points, triangles = shape_triangles(robot, Box((0.5, 1.0, 2.0)))
    assert not is_closed([*points[:-1], (9.0, 9.0, 9.0)], [*triangles[:-1], (0, 1, 2)])
