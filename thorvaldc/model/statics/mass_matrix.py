"""MuJoCo's inverse weights, from the mass matrix over the joint tree.

The mass matrix M at joint positions 0 is built from composite inertias and factored as
L^T D L (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6); a row has
entries for the freedoms above it only, so the cost grows linearly with the
number of branches.
"""

from __future__ import annotations

from thorvaldc.model import Vec3
from thorvaldc.model.spatial import add, clean, cross, dot, sub
from thorvaldc.model.statics.joint_tree import Tree


class BranchSparse:
    """A symmetric matrix over the degrees of freedom of a tree, and its L^T D L factors.

    Row i holds the entries for the freedoms on the path from the root to i, i
    last; the others of the upper triangle are zero.
    """

    def __init__(self, paths: list[list[int]]) -> None:
        self.paths = paths
        self.rows = [[0.0] * len(path) for path in paths]

    def factor(self) -> bool:
        """Replace the rows by L, with 1/D last.  False where a pivot vanishes."""
        good = True
        for i in range(len(self.rows) - 1, -1, -1):
            row, path = self.rows[i], self.paths[i]
            pivot = row[-1]
            if pivot <= 1e-12:
                # A freedom without inertia: held in place rather than infinitely light.
                good = False
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
        return good

    def quadratic(self, path: list[int], column: list[float]) -> float:
        """``j^T M^-1 j`` for a vector that is nonzero along ``path`` only."""
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
        """``M^-1 b`` for a full vector."""
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


# Moment of momentum and momentum of a body as linear functions of its motion:
# (m, mcx, mcy, mcz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) about the common origin.
_Spatial = list[float]


def _spatial(tree: Tree, link: int, origin: Vec3) -> _Spatial | None:
    inertial = tree.robot.links[link].inertial
    if inertial is None:
        return None
    placed = inertial.transformed(tree.poses[link])
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


def _momentum(body: _Spatial, w: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
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


def inverse_weights(tree: Tree, links: list[int]) -> tuple[list[float], dict[str, float]]:
    """MuJoCo's translational ``body_invweight0`` (1/kg), and the inertias that joints carry.

    ``tree.poses`` must be those at joint positions 0; ``links`` are indices in the model.
    A body's inverse weight is a third of the trace of J M^-1 J^T, J the Jacobian
    of its centre of mass.  The second value maps the name of each movable joint to the
    inertia about its axis of all that it carries (kg m^2; a mass in kg where it slides).
    """
    robot = tree.robot
    origin = robot.inertial.com
    parent_of = tree.moving_parent
    count = len(tree.moving)
    composite: list[_Spatial] = [[0.0] * 10 for _ in range(count + 1)]
    for index in tree.order:
        body = _spatial(tree, index, origin)
        if body is not None:
            lump = composite[tree.lump[index]]
            for k in range(10):
                lump[k] += body[k]
    for j in range(count, 0, -1):
        mine, above = composite[j], composite[parent_of[j]]
        for k in range(10):
            above[k] += mine[k]
    motions: list[tuple[Vec3, Vec3]] = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    paths = [_BASE_PATH[: k + 1] for k in range(6)]
    for j in range(1, count + 1):
        joint = tree.moving[j - 1]
        pose = tree.poses[tree.child[joint.name]]
        axis = pose.rotate(joint.axis)
        if joint.type == "prismatic":
            motions.append(((0.0, 0.0, 0.0), axis))
        else:
            motions.append((axis, cross(sub(pose.xyz, origin), axis)))
        above_path = _BASE_PATH if parent_of[j] == 0 else paths[parent_of[j] + 5]
        paths.append([*above_path, j + 5])
    matrix = BranchSparse(paths)
    for k in range(3):
        unit = _UNIT[k]
        linear, _ = _momentum(composite[0], (0.0, 0.0, 0.0), unit)
        matrix.rows[k] = list(linear[: k + 1])
        linear, angular = _momentum(composite[0], unit, (0.0, 0.0, 0.0))
        matrix.rows[k + 3] = [*linear, *angular[: k + 1]]
    carried: dict[str, float] = {}
    for j in range(1, count + 1):
        linear, angular = _momentum(composite[j], *motions[j])
        row = [*linear, *angular]
        for dof in paths[j + 5][6:]:
            w, v = motions[dof - 5]
            row.append(dot(w, angular) + dot(v, linear))
        carried[tree.moving[j - 1].name] = clean(row[-1])
        row[-1] += tree.moving[j - 1].armature
        matrix.rows[j + 5] = row
    matrix.factor()
    out = []
    for index in links:
        inertial = robot.links[index].inertial
        pose = tree.poses[index]
        point = sub(pose.xyz if inertial is None else pose.apply(inertial.com), origin)
        lump_index = tree.lump[index]
        path = _BASE_PATH if lump_index == 0 else paths[lump_index + 5]
        columns = [*_UNIT, *(cross(unit, point) for unit in _UNIT)]
        for dof in path[6:]:
            w, v = motions[dof - 5]
            columns.append(add(v, cross(w, point)))
        out.append(sum(matrix.quadratic(path, [c[axis] for c in columns]) for axis in range(3)) / 3)
    return out, carried
