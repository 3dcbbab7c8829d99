"""The pose in which a robot stands at rest on level ground.

It is where the gravity of all links, the springs and the contact forces of the
wheels balance, found by Newton's method over the base's height, roll and pitch and
the joints with springs or free to turn under wheels.  The stiffness matrix has the
shape of the joint tree and is factored like a mass matrix, so the cost grows linearly
with the robot.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.model import Joint, Pose, Vec3, Wheel
from thorvaldc.model.spatial import (
    clean,
    quat_from_axis_angle,
    quat_multiply,
    quat_normalize,
    rotate,
    sub,
)
from thorvaldc.model.statics.joint_tree import Tree
from thorvaldc.model.statics.mass_matrix import BranchSparse, inverse_weights
from thorvaldc.model.statics.wheel_contact import (
    WheelContact,
    ellipsoid,
    normal_force,
    penetration_under,
    slope,
)

GRAVITY = 9.81
_MAX_ITERATIONS = 60


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


class _Footing(NamedTuple):
    """A wheel in the common frame at home: which group carries it, where, and how it rolls."""

    group: int
    centre: Vec3
    axis: Vec3
    radius: float
    inverse_weight: float


class _Stance:
    """The robot as rigid groups on springs and pivots, the base free in height, roll and pitch.

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
        matrix = BranchSparse(self.paths)
        for g in range(1, len(self.parent)):
            matrix.rows[g + 2][-1] = self.joints[g - 1].stiffness
        bx, by, _ = forces.frames[0][0]
        for footing, p, (x, y) in zip(self.footings, forces.depths, forces.points, strict=True):
            k = 2.0 * slope(p, footing.inverse_weight)
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
    compliant = _compliant(tree)
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
        wheels[wheel.name] = ellipsoid(wheel, p, normal_force(p, weight), lean)
    return Rest(base, positions, carried, wheels, found is not None)


def _compliant(tree: Tree) -> list[Joint]:
    """The joints that load moves: those with a spring, and free ones that wheels hang on.

    Not the wheels' own axles, which level ground does not turn.
    """
    robot = tree.robot
    held = {actuator.joint for actuator in robot.actuators}
    carrying: set[int] = set()
    for wheel in robot.wheels:
        held.update(n for n in (wheel.spin_joint, wheel.steering_joint, wheel.swivel_joint) if n)
        lump = tree.lump[tree.index[wheel.link]]
        while lump:
            carrying.add(lump)
            lump = tree.moving_parent[lump]
    return [
        joint
        for lump, joint in enumerate(tree.moving, 1)
        if joint.mimic is None
        and (
            joint.stiffness > 0.0
            or (
                lump in carrying
                and joint.name not in held
                and joint.type in ("revolute", "continuous")
            )
        )
    ]


def spin_axis(tree: Tree, wheel: Wheel) -> Vec3:
    """The wheel's spin axis, from the right to the left, in the wheel link's frame."""
    joint = tree.robot.links[tree.child[wheel.spin_joint]]
    spin = tree.joint[wheel.spin_joint]
    if joint.name == wheel.link:
        return spin.axis
    relative = tree.poses[tree.index[wheel.link]].inverse() * tree.poses[tree.index[joint.name]]
    return relative.rotate(spin.axis)
