"""Rigid-body algebra: its laws, and comparisons with numpy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from thorvaldc.model import Inertial, Pose, Vec3
from thorvaldc.model.spatial import (
    Quat,
    clean,
    combine,
    cross,
    dot,
    matrix_to_rpy,
    norm,
    quat_from_axis_angle,
    quat_from_rpy,
    quat_multiply,
    quat_to_matrix,
    rotate,
    symmetric_eigenvalues,
)

Array = np.ndarray[Any, Any]
number = st.floats(-10.0, 10.0)
vectors = st.tuples(number, number, number)
angle = st.floats(-math.pi, math.pi)
angles = st.tuples(angle, angle, angle)
poses = st.builds(Pose.from_xyz_rpy, vectors, angles)
quats = angles.map(lambda a: quat_from_rpy(*a))
CLOSE = {"rtol": 1e-9, "atol": 1e-9}
quick = settings(deadline=None, max_examples=60)


def matrix(pose: Pose) -> Array:
    out = np.eye(4)
    out[:3, :3] = quat_to_matrix(pose.quat)
    out[:3, 3] = pose.xyz
    return out


@st.composite
def bodies(draw: st.DrawFn) -> Inertial:
    """Random point masses as one body, so the inertia is physically possible."""
    points = draw(st.lists(st.tuples(st.floats(0.1, 10.0), vectors), min_size=4, max_size=6))
    masses = np.array([m for m, _ in points])
    places = np.array([p for _, p in points])
    com = masses @ places / masses.sum()
    tensor = sum(
        (m * ((p - com) @ (p - com) * np.eye(3) - np.outer(p - com, p - com)) for m, p in points),
        start=np.zeros((3, 3)),
    )
    t = tensor.tolist()
    inertia = (t[0][0], t[1][1], t[2][2], t[0][1], t[0][2], t[1][2])
    return Inertial(float(masses.sum()), (float(com[0]), float(com[1]), float(com[2])), inertia)


# -- rotations ----------------------------------------------------------------------------


@quick
@given(quats, quats, vectors)
def test_a_product_of_rotations_applies_both(p: Quat, q: Quat, v: Vec3) -> None:
    np.testing.assert_allclose(rotate(quat_multiply(p, q), v), rotate(p, rotate(q, v)), **CLOSE)


@quick
@given(quats, vectors, vectors)
def test_rotations_keep_lengths_angles_and_handedness(q: Quat, v: Vec3, w: Vec3) -> None:
    assert norm(rotate(q, v)) == pytest.approx(norm(v), abs=1e-9)
    assert dot(rotate(q, v), rotate(q, w)) == pytest.approx(dot(v, w), abs=1e-7)
    np.testing.assert_allclose(cross(rotate(q, v), rotate(q, w)), rotate(q, cross(v, w)), atol=1e-7)


@quick
@given(quats, vectors)
def test_the_matrix_is_the_rotation(q: Quat, v: Vec3) -> None:
    m = np.array(quat_to_matrix(q))
    np.testing.assert_allclose(m @ v, rotate(q, v), **CLOSE)
    np.testing.assert_allclose(m @ m.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(m) == pytest.approx(1.0)


@quick
@given(angle, angle, angle)
def test_roll_pitch_and_yaw_turn_about_fixed_axes_in_that_order(
    r: float, p: float, y: float
) -> None:
    x_axis, y_axis, z_axis = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    steps = quat_multiply(
        quat_from_axis_angle(z_axis, y),
        quat_multiply(quat_from_axis_angle(y_axis, p), quat_from_axis_angle(x_axis, r)),
    )
    np.testing.assert_allclose(
        quat_to_matrix(quat_from_rpy(r, p, y)), quat_to_matrix(steps), atol=1e-12
    )


@quick
@given(angle, st.sampled_from([-math.pi / 2, math.pi / 2, 0.0]) | angle, angle)
def test_angles_reproduce_the_rotation_also_in_gimbal_lock(r: float, p: float, y: float) -> None:
    m = quat_to_matrix(quat_from_rpy(r, p, y))
    again = quat_to_matrix(quat_from_rpy(*matrix_to_rpy(m)))
    np.testing.assert_allclose(again, m, atol=1e-12)


# -- poses ----------------------------------------------------------------------------------


@quick
@given(poses, poses, poses)
def test_poses_are_a_group(a: Pose, b: Pose, c: Pose) -> None:
    np.testing.assert_allclose(matrix((a * b) * c), matrix(a * (b * c)), atol=1e-8)
    np.testing.assert_allclose(matrix(a * a.inverse()), np.eye(4), atol=1e-8)
    np.testing.assert_allclose(matrix(a.inverse() * a), np.eye(4), atol=1e-8)
    assert a * Pose() == Pose(a.xyz, a.quat)
    np.testing.assert_allclose(matrix(Pose() * a), matrix(a), atol=1e-12)


@quick
@given(poses, poses, vectors)
def test_a_product_of_poses_is_that_of_matrices(a: Pose, b: Pose, v: Vec3) -> None:
    np.testing.assert_allclose(matrix(a * b), matrix(a) @ matrix(b), atol=1e-8)
    np.testing.assert_allclose((a * b).apply(v), a.apply(b.apply(v)), atol=1e-8)
    np.testing.assert_allclose(a.apply(v), (matrix(a) @ [*v, 1.0])[:3], atol=1e-8)


@quick
@given(vectors, angles)
def test_a_pose_gives_back_its_angles(xyz: Vec3, rpy: Vec3) -> None:
    pose = Pose.from_xyz_rpy(xyz, rpy)
    again = Pose.from_xyz_rpy(pose.xyz, pose.rpy())
    np.testing.assert_allclose(matrix(again), matrix(pose), atol=1e-9)
    assert pose.quat[0] >= 0.0


# -- inertia ------------------------------------------------------------------------------------


def tensor(body: Inertial) -> Array:
    return np.array(body.matrix())


def about_origin(body: Inertial) -> Array:
    r = np.array(body.com)
    return np.asarray(tensor(body) + body.mass * (r @ r * np.eye(3) - np.outer(r, r)))


@quick
@given(st.lists(bodies(), min_size=1, max_size=4))
def test_inertias_add_up_about_any_point(parts: list[Inertial]) -> None:
    whole = combine(parts)
    assert whole.mass == pytest.approx(sum(p.mass for p in parts))
    np.testing.assert_allclose(
        whole.mass * np.array(whole.com),
        sum(p.mass * np.array(p.com) for p in parts),
        rtol=1e-9,
        atol=1e-7,
    )
    expected = sum((about_origin(p) for p in parts), start=np.zeros((3, 3)))
    np.testing.assert_allclose(about_origin(whole), expected, rtol=1e-8, atol=1e-6)


@quick
@given(bodies(), bodies(), bodies())
def test_the_order_of_adding_does_not_matter(a: Inertial, b: Inertial, c: Inertial) -> None:
    left, right = combine([combine([a, b]), c]), combine([c, b, a])
    assert left.mass == pytest.approx(right.mass)
    np.testing.assert_allclose(left.com, right.com, atol=1e-9)
    np.testing.assert_allclose(tensor(left), tensor(right), rtol=1e-8, atol=1e-6)


@quick
@given(bodies(), poses)
def test_a_body_that_is_moved_stays_the_same_body(body: Inertial, pose: Pose) -> None:
    moved = body.transformed(pose)
    turn = matrix(pose)[:3, :3]
    assert moved.mass == body.mass
    np.testing.assert_allclose(moved.com, pose.apply(body.com), atol=1e-9)
    np.testing.assert_allclose(tensor(moved), turn @ tensor(body) @ turn.T, rtol=1e-8, atol=1e-6)
    back = moved.transformed(pose.inverse())
    np.testing.assert_allclose(tensor(back), tensor(body), rtol=1e-7, atol=1e-5)


@quick
@given(bodies(), poses)
def test_principal_moments_do_not_depend_on_the_frame(body: Inertial, pose: Pose) -> None:
    largest = max(body.principal_moments())
    np.testing.assert_allclose(
        body.transformed(pose).principal_moments(),
        body.principal_moments(),
        rtol=1e-6,
        atol=1e-7 * largest,
    )


@quick
@given(st.tuples(*[number] * 6))
def test_eigenvalues_are_numpys(v: tuple[float, ...]) -> None:
    m = ((v[0], v[3], v[4]), (v[3], v[1], v[5]), (v[4], v[5], v[2]))
    size = max(1.0, *map(abs, v))
    np.testing.assert_allclose(
        symmetric_eigenvalues(m), np.linalg.eigvalsh(np.array(m)), atol=2e-7 * size
    )


def test_no_bodies_have_no_mass() -> None:
    assert combine([]) == Inertial(0.0, (0.0, 0.0, 0.0), (0.0,) * 6)


# -- rounding -------------------------------------------------------------------------------------


@quick
@given(st.floats(-1e12, 1e12))
def test_rounding_keeps_twelve_digits_and_is_idempotent(value: float) -> None:
    assert clean(value) == pytest.approx(value, rel=1e-11, abs=1e-12)
    assert clean(clean(value)) == clean(value)
    assert math.copysign(1.0, clean(0.0 * value)) == 1.0


@quick
@given(bodies())
def test_rounding_keeps_an_inertia_possible(body: Inertial) -> None:
    assume(min(body.principal_moments()) > 1e-6 * max(body.principal_moments()))
    low, middle, high = body.clean().principal_moments()
    assert high <= low + middle
    np.testing.assert_allclose(tensor(body.clean()), tensor(body), rtol=1e-5, atol=1e-5)


def test_a_flat_plate_stays_possible() -> None:
    plate = Inertial(1.0, (0.0, 0.0, 0.0), (1 / 3, 1 / 7, 1 / 3 + 1 / 7, 0.0, 0.0, 0.0))
    low, middle, high = plate.clean().principal_moments()
    assert low + middle >= high


def test_eigenvalues_of_numbers_whose_squares_overflow() -> None:
    m = ((3e200, 1e200, 0.0), (1e200, 3e200, 0.0), (0.0, 0.0, 1e200))
    assert symmetric_eigenvalues(m) == pytest.approx((1e200, 2e200, 4e200))
