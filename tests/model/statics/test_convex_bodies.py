"""Overlaps of convex bodies against the distances that MuJoCo computes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from thorvaldc.model import Box, Cylinder, MeshShape, Pose, Sphere
from thorvaldc.model.spatial import norm, quat_normalize, scale
from thorvaldc.model.statics.convex_bodies import ConvexBody, overlap_along, overlap_of
from thorvaldc.model.stl import binary_stl

Solid = Box | Cylinder | Sphere


def random_shape(random: np.random.Generator) -> Solid:
    a, b, c = random.uniform(0.05, 0.4, 3)
    return (Box((a, b, c)), Cylinder(a / 2, b), Sphere(a / 2))[random.integers(3)]


def random_pose(random: np.random.Generator) -> Pose:
    x, y, z = random.uniform(-0.25, 0.25, 3)
    w, a, b, c = random.normal(size=4)
    return Pose((x, y, z), quat_normalize((w, a, b, c)))


def distance_in_mujoco(solids: list[tuple[Solid, Pose]]) -> float:
    spec = mujoco.MjSpec()
    for shape, pose in solids:
        body = spec.worldbody.add_body(pos=pose.xyz, quat=pose.quat)
        body.add_freejoint()
        geom = mujoco.mjtGeom
        match shape:
            case Box(size):
                body.add_geom(type=geom.mjGEOM_BOX, size=[edge / 2 for edge in size])
            case Cylinder(radius, length):
                body.add_geom(type=geom.mjGEOM_CYLINDER, size=[radius, length / 2, 0])
            case Sphere(radius):
                body.add_geom(type=geom.mjGEOM_SPHERE, size=[radius, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None))


def test_bodies_apart_and_bodies_inside_each_other() -> None:
    random = np.random.default_rng(5)
    apart = inside = 0
    for _ in range(250):
        solids = [(random_shape(random), random_pose(random)) for _ in range(2)]
        first, second = (ConvexBody(shape, pose) for shape, pose in solids)
        distance = distance_in_mujoco(solids)
        overlap = overlap_of(first, second)
        assert norm(overlap.direction) == pytest.approx(1.0)
        if distance > 0.0:
            apart += 1
            assert -overlap.depth == pytest.approx(distance, abs=8e-3), solids
        else:
            inside += 1
            # Any direction is a way out, the shortest one of curved bodies may be missed.
            assert -distance - 1e-4 <= overlap.depth <= -1.3 * distance + 6e-3, solids
            way = scale(overlap.depth + 1e-4, overlap.direction)
            moved = (solids[1][0], Pose(way) * solids[1][1])
            assert distance_in_mujoco([solids[0], moved]) > 0.0
    assert min(apart, inside) > 60


def test_the_way_along_a_direction() -> None:
    floor, box = Box((2.0, 2.0, 0.2)), Box((0.2, 0.4, 0.6))
    first, second = ConvexBody(floor, Pose()), ConvexBody(box, Pose((0.5, 0.0, 0.3)))
    assert overlap_along(first, second, (0.0, 0.0, 1.0)) == pytest.approx(0.1)
    assert overlap_along(first, second, (1.0, 0.0, 0.0)) == pytest.approx(0.6)
    assert overlap_of(first, second, 0.0).depth == pytest.approx(0.1)


def test_a_mesh_is_the_hull_of_its_vertices() -> None:
    a, b, c, d = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    mesh = MeshShape("a.stl", (0.2, 0.2, 0.4))
    data = binary_stl([(a, c, b), (a, b, d), (a, d, c), (b, c, d)])
    body = ConvexBody(mesh, Pose((0.1, 0.0, 0.0)), data)
    ball = ConvexBody(Sphere(0.05), Pose((0.1, 0.0, 0.47)))
    assert overlap_of(body, ball).depth == pytest.approx(-0.02, abs=1e-3)
    assert body.furthest((1.0, 0.0, 0.0)) == pytest.approx((0.3, 0.0, 0.0), abs=1e-6)
