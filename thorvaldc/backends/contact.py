"""How a robot stands in MuJoCo's soft contact, in closed form and without MuJoCo.

A wheel sinks into the ground until the contact carries its load.  At rest the
normal force of MuJoCo's constraint is (documentation, "Computation", solver
parameters)

    f = a_ref / R,   a_ref = k d(p) p,   R = (1 - d(p)) / d(p) * A,
    k = 1 / (d_max^2 timeconst^2 dampratio^2),

with p the penetration, d(p) the impedance curve of ``solimp`` and A the
``body_invweight0`` of the wheel's body: a third of the trace of J M^-1 J^T,
J the Jacobian of the body's centre of mass, M the mass matrix at joint
positions 0.  M is factored as L^T D L over the joint tree (Featherstone, Rigid
Body Dynamics Algorithms, 2008, ch. 6), so the cost grows linearly with the
number of wheels.

MuJoCo puts the contact point half of the penetration above the lowest point,
so a wheel rolls on less than its collision radius.  Every wheel is therefore
grown until that point lies on a circle of ``Wheel.radius`` in the wheel's
middle plane, for which

    p = 2 (radius cos(camber) - height of the centre).

The settled pose is where the gravity of all links, the springs and these
forces balance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.backends.tree import Tree
from thorvaldc.model import Joint, Pose, Vec3, Wheel
from thorvaldc.model.spatial import (
    add,
    clean,
    cross,
    dot,
    quat_from_axis_angle,
    quat_multiply,
    quat_normalize,
    rotate,
    sub,
)

GRAVITY = 9.81
SOLREF = (0.01, 1.0)
SOLIMP = (0.02, 0.95, 0.002)

_STIFFNESS = 1.0 / (SOLIMP[1] * SOLREF[0] * SOLREF[1]) ** 2
_MIN_COS_CAMBER = 0.2
_MAX_ITERATIONS = 60


class WheelContact(NamedTuple):
    """The ellipsoid that stands for a wheel on the ground, in the wheel link's frame.

    ``radius`` and ``half_width`` are its half axes in m, ``offset`` (m) is how far its
    centre lies from the link's origin along the spin axis.  ``penetration`` in
    m and ``force`` in N are those of the settled robot.
    """

    radius: float
    half_width: float
    offset: float
    penetration: float
    force: float


class Rest(NamedTuple):
    """A robot at rest on level ground.

    ``base`` is the pose of ``base_link``; ``positions`` holds the position of every
    movable joint in rad or m.  ``carried`` is the inertia about each movable joint's
    axis of all that it carries (kg m^2; for a prismatic one its mass in kg).
    ``settled`` is false where no equilibrium was found (a robot that falls
    over): then ``base`` is where the file puts it.
    """

    base: Pose
    positions: dict[str, float]
    carried: dict[str, float]
    wheels: dict[str, WheelContact]
    settled: bool


def impedance(penetration: float) -> float:
    """``d(p)`` of ``solimp`` with MuJoCo's default midpoint 0.5 and power 2."""
    d0, d1, width = SOLIMP
    x = penetration / width
    if x >= 1.0:
        return d1
    y = 2.0 * x * x if x <= 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2
    return d0 + y * (d1 - d0)


def normal_force(penetration: float, inverse_weight: float) -> float:
    """Force in N at rest, for ``inverse_weight`` (1/kg) of the wheel's body."""
    if penetration <= 0.0:
        return 0.0
    d = impedance(penetration)
    return _STIFFNESS * penetration * d * d / ((1.0 - d) * inverse_weight)


def _slope(penetration: float, inverse_weight: float) -> float:
    """Derivative of ``normal_force``; never zero, so that a lifted wheel can come down."""
    p = max(penetration, 1e-6)
    d0, d1, width = SOLIMP
    d = impedance(p)
    x = p / width
    rise = 0.0 if x >= 1.0 else (d1 - d0) / width * 4.0 * (x if x <= 0.5 else 1.0 - x)
    scale = _STIFFNESS / inverse_weight
    return scale * (d * d / (1 - d) + p * rise * d * (2 - d) / (1 - d) ** 2)


def penetration_under(force: float, inverse_weight: float) -> float:
    """The penetration in m at which the contact carries ``force`` N."""
    if force <= 0.0:
        return 0.0
    low, high = 0.0, 1e-3
    while normal_force(high, inverse_weight) < force:
        high *= 2.0
    p = high
    for _ in range(_MAX_ITERATIONS):
        error = normal_force(p, inverse_weight) - force
        if error > 0.0:
            high = p
        else:
            low = p
        step = p - error / _slope(p, inverse_weight)
        if not low < step < high:
            step = (low + high) / 2
        if abs(step - p) < 1e-15:
            break
        p = step
    return p


# -- the mass matrix -------------------------------------------------------------


class _BranchSparse:
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
    """MuJoCo's translational ``body_invweight0`` (1/kg) of the links, and ``Rest.carried``.

    ``tree.poses`` must be those at joint positions 0.  ``links`` are indices in the model.
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
    matrix = _BranchSparse(paths)
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


# -- the settled pose --------------------------------------------------------------


class _Footing(NamedTuple):
    """A wheel in the common frame at home: which group carries it, where, and how it rolls."""

    group: int
    centre: Vec3
    axis: Vec3
    radius: float
    inverse_weight: float


class _Stance:
    """The robot as rigid groups on springs, with the base free in height, roll and pitch.

    Freedoms 0..2 are the base's height and its rotation about x and y of the
    world; freedom 2 + g is the joint above group g.
    """

    def __init__(self, tree: Tree, compliant: list[Joint], footings: list[_Footing]) -> None:
        self.footings = footings
        self.joints = compliant
        number = {joint.name: g for g, joint in enumerate(compliant, 1)}
        group_of_lump = [0] * (len(tree.moving) + 1)
        self.parent = [0] * (len(compliant) + 1)
        for j, joint in enumerate(tree.moving, 1):
            above = group_of_lump[tree.moving_parent[j]]
            group_of_lump[j] = number.get(joint.name, above)
            if joint.name in number:
                self.parent[number[joint.name]] = above
        self.group_of_lump = group_of_lump
        self.frames: list[tuple[Vec3, Vec3]] = [((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
        for joint in compliant:
            pose = tree.poses[tree.child[joint.name]]
            self.frames.append((pose.xyz, pose.rotate(joint.axis)))
        mass = [0.0] * len(self.parent)
        moment = [(0.0, 0.0, 0.0)] * len(self.parent)
        for index in tree.order:
            inertial = tree.robot.links[index].inertial
            if inertial is not None:
                g = group_of_lump[tree.lump[index]]
                x, y, z = tree.poses[index].apply(inertial.com)
                mx, my, mz = moment[g]
                m = inertial.mass
                mass[g] += m
                moment[g] = (mx + m * x, my + m * y, mz + m * z)
        self.mass = mass
        self.com: list[Vec3] = [
            (p[0] / m, p[1] / m, p[2] / m) if m > 0.0 else (0.0, 0.0, 0.0)
            for m, p in zip(mass, moment, strict=True)
        ]
        self.weight = sum(mass) * GRAVITY
        self.paths = [[0], [0, 1], [0, 1, 2]]
        for g in range(1, len(self.parent)):
            self.paths.append([*self.paths[self.parent[g] + 2], g + 2])

    def evaluate(self, base: Pose, s: list[float]) -> _Forces:
        """Generalised forces (N, N m) at that pose, and what a Newton step needs."""
        transforms = [base]
        frames: list[tuple[Vec3, Vec3]] = [(base.xyz, (0.0, 0.0, 1.0))]
        for g in range(1, len(self.parent)):
            above = transforms[self.parent[g]]
            origin, axis = self.frames[g]
            frames.append((above.apply(origin), above.rotate(axis)))
            if self.joints[g - 1].type == "prismatic":
                x, y, z = axis
                d = s[g - 1]
                transforms.append(Pose(above.apply((d * x, d * y, d * z)), above.quat))
            else:
                q = quat_from_axis_angle(axis, s[g - 1])
                shift = sub(origin, rotate(q, origin))
                transforms.append(
                    Pose(above.apply(shift), quat_normalize(quat_multiply(above.quat, q)))
                )
        vertical = [-m * GRAVITY for m in self.mass]
        about_x: list[float] = []
        about_y: list[float] = []
        for t, c, f in zip(transforms, self.com, vertical, strict=True):
            x, y, _ = t.apply(c)
            about_x.append(y * f)
            about_y.append(-x * f)
        depths: list[float] = []
        tilts: list[float] = []
        points: list[tuple[float, float]] = []
        for footing in self.footings:
            t = transforms[footing.group]
            x, y, z = t.apply(footing.centre)
            ax, ay, az = t.rotate(footing.axis)
            # The lowest point of the wheel's middle circle lies along -z made normal to the axis.
            cos = math.sqrt(max(1.0 - az * az, 1e-9))
            x += footing.radius * ax * az / cos
            y += footing.radius * ay * az / cos
            p = 2.0 * (footing.radius * cos - z)
            f = normal_force(p, footing.inverse_weight)
            vertical[footing.group] += f
            about_x[footing.group] += y * f
            about_y[footing.group] -= x * f
            depths.append(p)
            tilts.append(az)
            points.append((x, y))
        for g in range(len(self.parent) - 1, 0, -1):
            up = self.parent[g]
            vertical[up] += vertical[g]
            about_x[up] += about_x[g]
            about_y[up] += about_y[g]
        bx, by, _ = base.xyz
        residual = [
            vertical[0],
            about_x[0] - by * vertical[0],
            about_y[0] + bx * vertical[0],
        ]
        for g in range(1, len(self.parent)):
            joint = self.joints[g - 1]
            (ox, oy, _), (ax, ay, az) = frames[g]
            if joint.type == "prismatic":
                force = az * vertical[g]
            else:
                force = ax * (about_x[g] - oy * vertical[g]) + ay * (about_y[g] + ox * vertical[g])
            residual.append(force - joint.stiffness * (s[g - 1] - joint.spring_reference))
        return _Forces(residual, depths, tilts, points, frames)

    def step(self, forces: _Forces) -> list[float] | None:
        """The Newton step; ``None`` where the stance has no stiffness in some direction."""
        matrix = _BranchSparse(self.paths)
        for g in range(1, len(self.parent)):
            matrix.rows[g + 2][-1] = self.joints[g - 1].stiffness
        bx, by, _ = forces.frames[0][0]
        for footing, p, (x, y) in zip(self.footings, forces.depths, forces.points, strict=True):
            k = 2.0 * _slope(p, footing.inverse_weight)
            path = self.paths[footing.group + 2]
            lift = [1.0, y - by, bx - x]
            for dof in path[3:]:
                (ox, oy, _), (ax, ay, az) = forces.frames[dof - 2]
                prismatic = self.joints[dof - 3].type == "prismatic"
                lift.append(az if prismatic else ax * (y - oy) - ay * (x - ox))
            for i, dof in enumerate(path):
                row = matrix.rows[dof]
                a = k * lift[i]
                for m in range(i + 1):
                    row[m] += a * lift[m]
        return matrix.solve(forces.residual) if matrix.factor() else None


class _Forces(NamedTuple):
    residual: list[float]
    depths: list[float]
    tilts: list[float]
    points: list[tuple[float, float]]
    frames: list[tuple[Vec3, Vec3]]

    def size(self) -> float:
        return max(abs(r) for r in self.residual)


def _moved(base: Pose, step: list[float]) -> Pose:
    angle = math.hypot(step[1], step[2])
    x, y, z = base.xyz
    quat = base.quat
    if angle > 0.0:
        turn = quat_from_axis_angle((step[1] / angle, step[2] / angle, 0.0), angle)
        quat = quat_normalize(quat_multiply(turn, quat))
    return Pose((x, y, z + step[0]), quat)


def _settle(stance: _Stance, sink: float) -> tuple[Pose, list[float], _Forces] | None:
    """Base, positions of the compliant joints and the forces; ``None``: it does not stand.

    The search starts with the base ``sink`` m under its place at joint positions 0.
    """
    base, s = Pose((0.0, 0.0, -sink)), [joint_home(joint) for joint in stance.joints]
    forces = stance.evaluate(base, s)
    tolerance = 1e-10 * max(stance.weight, 1.0)
    for _ in range(_MAX_ITERATIONS):
        if forces.size() < tolerance:
            return base, s, forces
        step = stance.step(forces)
        if step is None or max(map(abs, step)) > 1e3:
            return None
        length = min(1.0, 0.05 / max(max(map(abs, step)), 1e-12))
        for _ in range(12):
            tried = [length * v for v in step]
            new_base = _moved(base, tried)
            new_s = [a + b for a, b in zip(s, tried[3:], strict=True)]
            new_forces = stance.evaluate(new_base, new_s)
            if new_forces.size() < forces.size():
                break
            length /= 2
        else:
            return (base, s, forces) if forces.size() < 1e-6 * stance.weight else None
        base, s, forces = new_base, new_s, new_forces
    return None


def joint_home(joint: Joint) -> float:
    """Position of a joint in the ``home`` pose: 0, or the nearest that its limits allow."""
    low = -math.inf if joint.lower is None else joint.lower
    high = math.inf if joint.upper is None else joint.upper
    return min(max(0.0, low), high)


def _ellipsoid(wheel: Wheel, penetration: float, force: float, tilt: float) -> WheelContact:
    """The ellipsoid that touches on the wheel's own circle; ``tilt``: spin axis, z component."""
    cos = math.sqrt(max(1.0 - tilt * tilt, 0.0))
    half = wheel.width / 2
    rolling = wheel.radius + penetration / 2
    if cos < _MIN_COS_CAMBER:
        return WheelContact(clean(rolling), half, 0.0, clean(penetration), clean(force))
    # Half axes a (radial) and b (axial); lowest point at radius a^2 cos/H and
    # b^2 sin/H along the axis, H^2 = a^2 cos^2 + b^2 sin^2; the contact half of
    # the penetration above it.  Radius of the contact = wheel.radius gives a,
    # its place along the axis = 0 gives the offset.
    at = wheel.radius + penetration / 2 * cos
    slant = half * tilt / cos
    a = at * math.sqrt((1.0 + math.sqrt(1.0 + 4.0 * (slant / at) ** 2)) / 2.0)
    height = math.hypot(a * cos, half * tilt)
    offset = (half * half / height - penetration / 2) * tilt
    return WheelContact(clean(a), half, clean(offset), clean(penetration), clean(force))


def rest(tree: Tree) -> Rest:
    """Let the robot of ``tree`` (at joint positions 0) settle on level ground under gravity."""
    robot = tree.robot
    wheel_links = [tree.index[wheel.link] for wheel in robot.wheels]
    weights, carried = inverse_weights(tree, wheel_links)
    weights = [max(w, 1e-9) for w in weights]
    positions = {joint.name: joint_home(joint) for joint in tree.moving}
    for joint in tree.moving:
        if joint.mimic is not None:
            positions[joint.name] = clean(
                joint.mimic.multiplier * positions.get(joint.mimic.joint, 0.0) + joint.mimic.offset
            )
    compliant = [j for j in tree.moving if j.stiffness > 0.0 and j.mimic is None]
    # At home with the compliant joints at 0: they are what the stance moves.
    held = {j.name for j in compliant}
    home = tree.at({n: q for n, q in positions.items() if n not in held and q != 0.0})
    footings: list[_Footing] = []
    stance = _Stance(home, compliant, footings)
    for wheel, link, weight in zip(robot.wheels, wheel_links, weights, strict=True):
        pose = home.poses[link]
        axis = pose.rotate(spin_axis(tree, wheel))
        group = stance.group_of_lump[tree.lump[link]]
        footings.append(_Footing(group, pose.xyz, axis, wheel.radius, weight))
    found = None
    if footings and stance.weight > 0.0:
        n = len(footings)
        sink = penetration_under(stance.weight / n, sum(weights) / n) / 2
        found = _settle(stance, sink)
    if found is not None:
        base, s, forces = found
        base = base.clean()
        positions |= {j.name: clean(q) for j, q in zip(compliant, s, strict=True)}
        depths, tilts = forces.depths, forces.tilts
    else:
        base = Pose()
        tilts = [footing.axis[2] for footing in footings]
        depths = [
            penetration_under(wheel.load, weight)
            for wheel, weight in zip(robot.wheels, weights, strict=True)
        ]
    wheels = {}
    for wheel, weight, depth, tilt in zip(robot.wheels, weights, depths, tilts, strict=True):
        p = max(depth, 0.0)
        # The body leans by some 1e-5 rad; a wheel that is upright is to stay so in the file.
        lean = tilt if abs(tilt) > 1e-4 else 0.0
        wheels[wheel.name] = _ellipsoid(wheel, p, normal_force(p, weight), lean)
    return Rest(base, positions, carried, wheels, found is not None)


def spin_axis(tree: Tree, wheel: Wheel) -> Vec3:
    """The wheel's spin axis, from the right to the left, in the wheel link's frame."""
    joint = tree.robot.links[tree.child[wheel.spin_joint]]
    spin = tree.joint[wheel.spin_joint]
    if joint.name == wheel.link:
        return spin.axis
    relative = tree.poses[tree.index[wheel.link]].inverse() * tree.poses[tree.index[joint.name]]
    return relative.rotate(spin.axis)
