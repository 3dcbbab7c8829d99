"""Tests of the mass and inertia of shapes, against the package trimesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from thorvaldc.compiler.shapes.solids import solid, solid_of_shapes
from thorvaldc.model import Box, Cylinder, Mesh, MeshShape, Pose, Shape, Sphere, Vec3

trimesh = pytest.importorskip("trimesh")
ONES = (1.0, 1.0, 1.0)


def torus(shift: Vec3 = (0.0, 0.0, 0.0)) -> Any:
    mesh = trimesh.creation.torus(0.3, 0.1)
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    mesh.apply_transform(turned)
    mesh.apply_translation(shift)
    return mesh


def inertial(mesh: Any, scale: Vec3 = ONES, suffix: str = "stl", density: float = 1000.0) -> Any:
    data = mesh.export(file_type=suffix)
    name = f"a.{suffix}"
    meshes = {name: Mesh(name, "", data.encode() if isinstance(data, str) else data)}
    return solid(MeshShape(name, scale), density, meshes)


@pytest.mark.parametrize("suffix", ["stl", "obj"])
@pytest.mark.parametrize("scale", [ONES, (0.001, 0.001, 0.001), (1.0, -2.0, 0.5)])
def test_a_closed_mesh_has_the_mass_properties_of_trimesh(suffix: str, scale: Vec3) -> None:
    mesh = torus((5.0, -2.0, 1.0))
    computed = inertial(mesh, scale, suffix)
    mesh.apply_transform(np.diag([*scale, 1.0]))
    mesh.density = 1000.0
    assert computed.mass == pytest.approx(mesh.mass, rel=1e-6)
    assert computed.com == pytest.approx(tuple(mesh.center_mass), rel=1e-6)
    size = float(np.abs(mesh.moment_inertia).max())
    assert np.array(computed.matrix()) == pytest.approx(mesh.moment_inertia, abs=1e-6 * size)


@pytest.mark.parametrize("shape", [Box((1.0, 2.0, 3.0)), Cylinder(0.5, 2.0), Sphere(0.5)])
def test_a_shape_is_as_heavy_as_its_mesh(shape: Shape) -> None:
    match shape:
        case Box(size):
            mesh = trimesh.creation.box(size)
        case Cylinder(radius, length):
            mesh = trimesh.creation.cylinder(radius, length, sections=400)
        case _:
            mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    exact, meshed = solid(shape, 500.0, {}), inertial(mesh, density=500.0)
    assert exact is not None
    assert exact.mass == pytest.approx(meshed.mass, rel=2e-3)
    assert exact.inertia == pytest.approx(meshed.inertia, rel=4e-3, abs=1e-4)


def test_a_mesh_with_a_hole_or_a_turned_face_has_no_mass() -> None:
    mesh = torus()
    hole, turned, twice = mesh.copy(), mesh.copy(), mesh.copy()
    hole.update_faces(np.arange(len(mesh.faces)) != 7)
    turned.faces[7] = turned.faces[7][::-1]
    twice.faces = np.vstack([twice.faces, twice.faces[:1]])
    for mesh in (hole, turned, twice):
        assert inertial(mesh) is None


def test_triangles_without_area_do_not_open_a_mesh() -> None:
    mesh = torus()
    mesh.faces = np.vstack([mesh.faces, [[0, 0, 1]]])
    assert inertial(mesh) == inertial(torus())


def test_faces_of_an_obj_file_with_four_corners_and_negative_indices() -> None:
    text = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1//1 4//1 3//1 2//1  # below
f -4 -3 -2 -1
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
    cube = solid(MeshShape("a.obj", ONES), 1.0, {"a.obj": Mesh("a.obj", "", text.encode())})
    assert cube is not None
    assert (cube.mass, *cube.com) == pytest.approx((1.0, 0.5, 0.5, 0.5))
    assert cube.inertia == pytest.approx((1 / 6, 1 / 6, 1 / 6, 0, 0, 0))


def test_several_shapes_are_one_body() -> None:
    halves = [(Box((1.0, 1.0, 1.0)), Pose((x, 0.0, 0.0))) for x in (-0.5, 0.5)]
    whole = solid(Box((2.0, 1.0, 1.0)), 3.0, {})
    together = solid_of_shapes(halves, 3.0, {})
    assert whole is not None
    assert together is not None
    assert together.mass == whole.mass
    assert together.inertia == pytest.approx(whole.inertia)
    assert solid_of_shapes([], 3.0, {}) is None
