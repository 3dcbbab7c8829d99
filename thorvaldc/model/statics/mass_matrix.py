"""The joint-space mass matrix, its sparse factors, and MuJoCo's inverse weights.

The composite-rigid-body algorithm computes the mass matrix M(q) at joint positions 0 (Featherstone,
Rigid Body Dynamics Algorithms, 2008, section 6.2). The degrees of freedom are three translations
and three rotations of the base, followed by one degree of freedom for each movable joint. Elements
of the mass matrix M:

    M_ij = s_j^T C_i s_i, for each j on the path from the root to i,

and M_ij = 0 if neither joint carries the other joint. The symbols are:

- s_i: motion of degree of freedom i. The motion consists of the angular velocity w and the linear
  velocity v at the origin, for the joint velocity 1.
- C_i: spatial inertia of the composite body i. The composite body consists of all links below joint
  i.

The mass matrix is factored as L^T D L (Featherstone, section 6.5). The element (i, j) of the mass
matrix is nonzero only if j is on the path from the root to i, or i on the path to j. The factors L
and D are nonzero only where the mass matrix is nonzero. The time to factor the mass matrix
therefore grows linearly with the number of branches of the joint tree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thorvaldc.model import Inertial, Vec3
from thorvaldc.model.spatial import add, clean, cross, dot, sub
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.sums import float_sum


class BranchSparse:
    """A symmetric matrix over the degrees of freedom of a joint tree, and its L^T D L factors.

    - ``paths``: one list for each degree of freedom i. The list ``paths[i]`` contains the degrees
      of freedom on the path from the root of the joint tree to i, including i.
    - ``rows``: one list for each degree of freedom i. The number ``rows[i][k]`` is the element of
      the matrix in row i and column ``paths[i][k]``. All other elements of the matrix to the left
      of the diagonal are zero.
    """

    def __init__(self, paths: list[list[int]]) -> None:
        self.paths = paths
        self.rows = [[0.0] * len(path) for path in paths]

    def factor(self) -> bool:
        """Replace the symmetric matrix M by its factors: a triangular matrix L and a diagonal
        matrix D with M = L^T D L.

        Each row of the symmetric matrix is replaced by the row of the factor L, and the last
        element of the row by 1/D. Returns false if the symmetric matrix is singular. A degree of
        freedom with a zero pivot is locked by filling its row with zeros.
        """
        regular = True
        for i in range(len(self.rows) - 1, -1, -1):
            row, path = self.rows[i], self.paths[i]
            pivot = row[-1]
            if pivot <= 1e-12:
                regular = False
                self.rows[i] = [0.0] * len(row)
                continue
            for k in range(len(path) - 2, -1, -1):
                a = row[k] / pivot
                if a != 0.0:
                    upper = self.rows[path[k]]
                    for m in range(k + 1):
                        upper[m] -= a * row[m]
                    row[k] = a
            row[-1] = 1.0 / pivot
        return regular

    def quadratic(self, path: list[int], column: list[float]) -> float:
        """Return ``j^T M^-1 j`` for the factored matrix M and a sparse vector j.

        ``column`` lists the elements of the vector j at the degrees of freedom in ``path``.
        """
        y = list(column)
        total = 0.0
        for k in range(len(path) - 1, -1, -1):
            value = y[k]
            if value != 0.0:
                row = self.rows[path[k]]
                for m in range(k):
                    y[m] -= row[m] * value
                total += value * value * row[-1]
        return total

    def solve(self, b: list[float]) -> list[float]:
        """Return ``M^-1 b`` for the factored matrix M and the dense vector ``b``."""
        y = list(b)
        for i in range(len(y) - 1, -1, -1):
            row, path = self.rows[i], self.paths[i]
            for k in range(len(path) - 1):
                y[path[k]] -= row[k] * y[i]
        for i in range(len(y)):
            row, path = self.rows[i], self.paths[i]
            y[i] *= row[-1]
            for k in range(len(path) - 1):
                y[i] -= row[k] * y[path[k]]
        return y


# Spatial inertia of a body about the common origin: (m, m cx, m cy, m cz, Ixx, Iyy, Izz, Ixy, Ixz,
# Iyz). The spatial inertia of several bodies is the sum of the spatial inertias of the bodies.
_SpatialInertia = list[float]


def _spatial_inertia(placed: Inertial, origin: Vec3) -> _SpatialInertia:
    """Return the spatial inertia of a body about ``origin``; both are in ``base_link``."""
    m = placed.mass
    x, y, z = sub(placed.com, origin)
    xx, yy, zz, xy, xz, yz = placed.inertia
    return [
        m,
        m * x,
        m * y,
        m * z,
        xx + m * (y * y + z * z),
        yy + m * (x * x + z * z),
        zz + m * (x * x + y * y),
        xy - m * x * y,
        xz - m * x * z,
        yz - m * y * z,
    ]


def _momentum(body: _SpatialInertia, w: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
    """Return the linear and angular momentum of a rigid body.

    ``w`` is the angular velocity of the rigid body, and ``v`` is the linear velocity of the body at
    the origin. With the mass m, the centre of mass c, h = m c and the inertia I, the linear
    momentum is m v + w x h and the angular momentum is I w + h x v.
    """
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = body
    wx, wy, wz = w
    vx, vy, vz = v
    return (
        (m * vx + wy * hz - wz * hy, m * vy + wz * hx - wx * hz, m * vz + wx * hy - wy * hx),
        (
            xx * wx + xy * wy + xz * wz + hy * vz - hz * vy,
            xy * wx + yy * wy + yz * wz + hz * vx - hx * vz,
            xz * wx + yz * wy + zz * wz + hx * vy - hy * vx,
        ),
    )


_BASE_PATH = [0, 1, 2, 3, 4, 5]
_UNIT: tuple[Vec3, Vec3, Vec3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def inverse_weights(
    tree: JointTree, origin: Vec3, links: Sequence[str]
) -> tuple[list[float], dict[str, float]]:
    """Return the inverse weights of links in 1/kg, and the carried inertia of each joint.

    The inverse weight of a body is the value ``body_invweight0`` of MuJoCo for translation. The
    inverse weight of a body is the acceleration by a unit force at its centre of mass, as the mean
    over three directions. Inverse weight: trace(J M^-1 J^T) / 3, where M is the mass matrix of the
    robot. J is the Jacobian matrix of the centre of mass of the body.

    The carried inertia of a joint is the inertia in kg m^2 of all links that the joint moves, about
    the joint axis. For a prismatic joint, the carried inertia is the mass of these links in kg. The
    second returned value maps the name of each movable joint to its carried inertia.

    - ``tree``: joint tree with every joint at position 0.
    - ``origin``: common origin of all spatial inertias, best near the centre of mass of the robot.
    """
    parent_of = tree.moving_parent
    count = len(tree.moving)
    composite: list[_SpatialInertia] = [[0.0] * 10 for _ in range(count + 1)]
    placed = {
        name: inertial.transformed(tree.pose[name])
        for name in tree.order
        if (inertial := tree.links[name].inertial) is not None
    }
    for name, inertial in placed.items():
        body, rigid_body = _spatial_inertia(inertial, origin), composite[tree.carrier[name]]
        for k in range(10):
            rigid_body[k] += body[k]
    for j in range(count, 0, -1):
        carried, parent = composite[j], composite[parent_of[j]]
        for k in range(10):
            parent[k] += carried[k]
    motions: list[tuple[Vec3, Vec3]] = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    paths = [_BASE_PATH[: k + 1] for k in range(6)]
    for j in range(1, count + 1):
        joint = tree.moving[j - 1]
        pose = tree.pose[joint.child]
        axis = pose.rotate(joint.axis)
        if joint.type == "prismatic":
            motions.append(((0.0, 0.0, 0.0), axis))
        else:
            motions.append((axis, cross(sub(pose.xyz, origin), axis)))
        parent_path = _BASE_PATH if parent_of[j] == 0 else paths[parent_of[j] + 5]
        paths.append([*parent_path, j + 5])
    inertias = _carried_inertias(tree, placed)
    matrix = _mass_matrix(tree, paths, composite, motions, inertias)
    matrix.factor()
    weights = []
    for name in links:
        inertial, pose = tree.links[name].inertial, tree.pose[name]
        point = sub(pose.xyz if inertial is None else pose.apply(inertial.com), origin)
        carrier = tree.carrier[name]
        path = _BASE_PATH if carrier == 0 else paths[carrier + 5]
        columns = [*_UNIT, *(cross(unit, point) for unit in _UNIT)]
        for freedom in path[6:]:
            w, v = motions[freedom - 5]
            columns.append(add(v, cross(w, point)))
        trace = float_sum(matrix.quadratic(path, [c[axis] for c in columns]) for axis in range(3))
        weights.append(trace / 3)
    return weights, inertias


def _mass_matrix(
    tree: JointTree,
    paths: list[list[int]],
    composite: list[_SpatialInertia],
    motions: list[tuple[Vec3, Vec3]],
    inertias: dict[str, float],
) -> BranchSparse:
    """Return the mass matrix with motor inertias.

    ``inertias`` are the carried inertias of the joints; they are its diagonal.
    """
    matrix = BranchSparse(paths)
    for k in range(3):
        unit = _UNIT[k]
        linear, _ = _momentum(composite[0], (0.0, 0.0, 0.0), unit)
        matrix.rows[k] = list(linear[: k + 1])
        linear, angular = _momentum(composite[0], unit, (0.0, 0.0, 0.0))
        matrix.rows[k + 3] = [*linear, *angular[: k + 1]]
    for j, joint in enumerate(tree.moving, 1):
        linear, angular = _momentum(composite[j], *motions[j])
        row = [*linear, *angular]
        for freedom in paths[j + 5][6:-1]:
            w, v = motions[freedom - 5]
            row.append(dot(w, angular) + dot(v, linear))
        row.append(inertias[joint.name] + joint.armature)
        matrix.rows[j + 5] = row
    return matrix


def _carried_inertias(tree: JointTree, placed: Mapping[str, Inertial]) -> dict[str, float]:
    """Return the carried inertia of each joint, as ``inverse_weights``.

    ``placed``: inertias of the links in ``base_link``, by the name of the link.

    A sum over the links of terms about the axis, none of them negative: a difference of moments
    about a common origin has no correct digit far away from it.
    """
    inertias = {joint.name: 0.0 for joint in tree.moving}
    for name, inertial in placed.items():
        xx, yy, zz, xy, xz, yz = inertial.inertia
        j = tree.carrier[name]
        while j != 0:
            joint = tree.moving[j - 1]
            pose = tree.pose[joint.child]
            x, y, z = axis = pose.rotate(joint.axis)
            if joint.type == "prismatic":
                inertias[joint.name] += inertial.mass
            else:
                arm = cross(axis, sub(inertial.com, pose.xyz))
                about_com = x * (xx * x + 2 * (xy * y + xz * z)) + y * (yy * y + 2 * yz * z)
                inertias[joint.name] += about_com + zz * z * z + inertial.mass * dot(arm, arm)
            j = tree.moving_parent[j]
    return {name: clean(inertia) for name, inertia in inertias.items()}
