"""The pose in which a robot stands at rest on level ground, and the load of each wheel.

The unknowns q of the standing pose are the height of the base, the rotations of the base about the
world's x and y axes, and the positions of the compliant joints. A joint with a spring is compliant:
it moves under the weight of the robot. A passive joint that carries wheels, such as the joint of a
rocker, is also compliant. Equilibrium of the generalised forces r(q) on the unknowns q:

    r(q) = sum over wheels f_w(q) l_w + weights - springs = 0,   l_w = dz_w / dq.

The symbols are:

- f_w: contact force of wheel w as a function of its penetration p_w, see ``wheel_contact``.
- l_w: lift of the contact point of wheel w for a unit change of each unknown. The lift of a wheel
  for the height of the base is 1. With the base position b and the contact point (x, y), the lift
  is y - b_y for the rotation of the base about x, and b_x - x for the rotation about y. The lift
  for a prismatic joint with the axis a is a_z. The lift for a hinge joint with the axis a at the
  point o is a_x (y - o_y) - a_y (x - o_x).

Raising a wheel by dz reduces its penetration by 2 dz. Stiffness matrix:

    K = -dr/dq = sum over wheels 2 f'(p_w) l_w l_w^T + diag(spring stiffnesses).

The stiffness matrix K neglects that the lifts l_w change with the unknowns q. Newton's method finds
the step dq of the unknowns by solving K dq = r with the stiffness matrix K and the residual r. An
element of the stiffness matrix K is nonzero only if both unknowns move a common wheel. The
stiffness matrix K therefore has the sparsity of the joint tree and is factored like a mass matrix.
The time to factor the stiffness matrix grows linearly with the number of branches of the joint
tree. Every element of a Newton step for the standing pose is limited to 0.05 m or 0.05 rad. If a
Newton step does not decrease the largest residual, the step is halved until the residual decreases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.model import Joint, Pose, Robot, Vec3, Wheel, spatial
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.statics import joint_tree, wheel_contact
from thorvaldc.model.statics.mass_matrix import BranchSparse, inverse_weights
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.sums import float_sum

_MAX_ITERATIONS = 600
"""Most robots need 5 to 10 iterations. Stiff contacts allow only small rotations of swing arms in
one iteration: arms that turn by 0.25 rad need about 300."""
_MAX_HALVINGS = 12
_MAX_STEP = 0.05  # m or rad
_DIFFERENCE = 1e-7  # m or rad


class Statics(NamedTuple):
    """A robot at rest on level ground: pose, wheel contacts and inertia on each joint.

    - ``base``: pose of ``base_link`` in the world.
    - ``positions``: maps the name of every movable joint to its position in rad or m.
    - ``inertias``: maps the name of every movable joint to the inertia of all carried links about
      the joint axis in kg m^2. For a prismatic joint, the value in ``inertias`` is the carried mass
      in kg.
    - ``wheels``: maps the name of each wheel to its contact.
    - ``settled``: true if the robot has an equilibrium.

    A robot that tips over on level ground has no equilibrium. If the robot has no equilibrium,
    ``base`` is the identity and the wheel contacts are computed from the wheel loads of the model.
    """

    base: Pose
    positions: dict[str, float]
    inertias: dict[str, float]
    wheels: dict[str, wheel_contact.WheelContact]
    settled: bool


class _Footing(NamedTuple):
    """A wheel in the home pose of the robot, with positions and directions in ``base_link``.

    ``group`` is the number of the rigid group of links to which the wheel belongs.
    """

    group: int
    centre: Vec3
    axis: Vec3
    radius: float
    inverse_weight: float


class _Forces(NamedTuple):
    """The generalised forces on the robot at one pose, and the geometry for a Newton step.

    - ``residual``: generalised force on each unknown, in N or N m.
    - ``depths``: penetration of each footing in m.
    - ``tilts``: vertical component of each footing's spin axis.
    - ``points``: x and y of each footing's contact point in m.
    - ``frames``: origin and axis of the joint above each rigid group.
    """

    residual: list[float]
    depths: list[float]
    tilts: list[float]
    points: list[tuple[float, float]]
    frames: list[tuple[Vec3, Vec3]]

    def size(self) -> float:
        """Return the largest absolute generalised force, in N or N m."""
        return max(abs(r) for r in self.residual)


class _Stance(joint_tree.RigidGroups):
    """The robot as rigid groups of links, connected by its compliant joints.

    Unknown 0 of the standing pose is the height of the base. Unknowns 1 and 2 of the standing pose
    are the rotations of the base about the world's x and y axes. Unknown 2 + g of the standing pose
    is the position of the compliant joint that carries the rigid group number g.
    """

    def __init__(
        self,
        tree: joint_tree.JointTree,
        compliant: list[Joint],
        wheels: list[tuple[Wheel, Vec3, float]],
    ) -> None:
        """Divide the links of the joint tree into rigid groups.

        ``wheels`` lists each wheel with its spin axis and its effective inverse weight.
        """
        super().__init__(tree, compliant)
        self.weight = self.total_mass * spatial.GRAVITY
        self.paths = [[0], [0, 1], [0, 1, 2]]
        for g in range(1, len(self.parent)):
            self.paths.append([*self.paths[self.parent[g] + 2], g + 2])
        self.footings: list[_Footing] = []
        for wheel, axis, inverse_weight in wheels:
            pose = tree.pose[wheel.link]
            group = self.group_of(wheel.link)
            self.footings.append(
                _Footing(group, pose.xyz, pose.rotate(axis), wheel.radius, inverse_weight)
            )

    def evaluate(self, base: Pose, positions: list[float]) -> _Forces:
        """Return the generalised forces for a base pose and compliant joint positions."""
        transforms, frames = self.place(base, positions)
        # Vertical force on each rigid group of links, and its moments about the world's x and y
        # axes.
        vertical = [-m * spatial.GRAVITY for m in self.mass]
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
            # The direction from the wheel centre to the lowest point of the wheel's middle circle
            # is -z, projected onto the plane normal to the spin axis.
            cos = math.sqrt(max(1.0 - az * az, 1e-9))
            x += footing.radius * ax * az / cos
            y += footing.radius * ay * az / cos
            p = 2.0 * (footing.radius * cos - z)
            f = wheel_contact.normal_force(p, footing.inverse_weight)
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
            residual.append(force - joint.stiffness * (positions[g - 1] - joint.spring_reference))
        return _Forces(residual, depths, tilts, points, frames)

    def step(self, base: Pose, positions: list[float], forces: _Forces) -> list[float] | None:
        """Return the Newton step for the base pose and the compliant joint positions.

        ``forces`` belong to this base pose and these positions. Returns ``None`` if the stiffness
        matrix is singular.
        """
        matrix = BranchSparse(self.paths)
        for g in range(1, len(self.parent)):
            matrix.rows[g + 2][-1] = self.joints[g - 1].stiffness
        bx, by, _ = base.xyz
        for footing, p, (x, y) in zip(self.footings, forces.depths, forces.points, strict=True):
            k = 2.0 * wheel_contact.contact_stiffness(p, footing.inverse_weight)
            path = self.paths[footing.group + 2]
            lift = [1.0, y - by, bx - x]
            lift += [
                joint_tree.lift(self.joints[unknown - 3], forces.frames[unknown - 2], x, y)
                for unknown in path[3:]
            ]
            for i, unknown in enumerate(path):
                row = matrix.rows[unknown]
                a = k * lift[i]
                for m in range(i + 1):
                    row[m] += a * lift[m]
        return matrix.solve(forces.residual) if matrix.factor() else None

    def settle(
        self, base: Pose, positions: list[float]
    ) -> tuple[Pose, list[float], _Forces] | None:
        """Return the base pose, joint positions and generalised forces in equilibrium.

        The search for the equilibrium starts with the given base pose and joint positions. Returns
        ``None`` if Newton's method finds no equilibrium.
        """
        forces = self.evaluate(base, positions)
        tolerance = 1e-10 * max(self.weight, 1.0)
        for _ in range(_MAX_ITERATIONS):
            if forces.size() < tolerance:
                return base, positions, forces
            step = self.step(base, positions, forces)
            if step is None or max(map(abs, step)) > 1e3:
                return None
            length = min(1.0, _MAX_STEP / max(max(map(abs, step)), 1e-12))
            for _ in range(_MAX_HALVINGS):
                new_base, new_positions = self.moved(base, positions, [length * v for v in step])
                new_forces = self.evaluate(new_base, new_positions)
                if new_forces.size() < forces.size():
                    break
                length /= 2
            else:  # no improvement: the residual is rounding error, or this is no equilibrium
                return (base, positions, forces) if forces.size() < 1e-6 * self.weight else None
            base, positions, forces = new_base, new_positions, new_forces
        return None

    def moved(
        self, base: Pose, positions: list[float], step: Sequence[float]
    ) -> tuple[Pose, list[float]]:
        """Return the base pose and the joint positions after a step of the unknowns."""
        return _moved(base, step), [a + b for a, b in zip(positions, step[3:], strict=True)]


class _PassiveStance(_Stance):
    """A robot with passive or coupled joints.

    The unknowns of the standing pose are the height and the rotations of the base, and the
    coordinates of the joints (``joint_tree``). The weight of a body on passive joints has a
    part in their stiffness, which the contacts do not have: a body that hangs below its axis is
    held by it. The stiffness matrix is therefore computed from differences of the forces.
    """

    def __init__(
        self,
        tree: joint_tree.JointTree,
        coordinates: Sequence[joint_tree.Coordinate],
        wheels: list[tuple[Wheel, Vec3, float]],
    ) -> None:
        owner = {m.joint.name: (k, m.ratio) for k, c in enumerate(coordinates) for m in c.members}
        super().__init__(tree, [joint for joint in tree.moving if joint.name in owner], wheels)
        self.owners = [owner[joint.name] for joint in self.joints]
        self.size = 3 + len(coordinates)

    def evaluate(self, base: Pose, positions: list[float]) -> _Forces:
        """Return the generalised forces on the coordinates."""
        forces = super().evaluate(base, positions)
        residual = forces.residual[:3] + [0.0] * (self.size - 3)
        for force, (k, ratio) in zip(forces.residual[3:], self.owners, strict=True):
            residual[3 + k] += ratio * force
        return forces._replace(residual=residual)

    def moved(
        self, base: Pose, positions: list[float], step: Sequence[float]
    ) -> tuple[Pose, list[float]]:
        """Return the base pose and the joint positions after a step of the coordinates."""
        return _moved(base, step[:3]), [
            q + ratio * step[3 + k] for q, (k, ratio) in zip(positions, self.owners, strict=True)
        ]

    def step(self, base: Pose, positions: list[float], forces: _Forces) -> list[float] | None:
        """Return the Newton step, or ``None`` if the stiffness matrix is singular."""
        columns = []
        for k in range(self.size):
            ends = []
            for h in (_DIFFERENCE, -_DIFFERENCE):
                step = [h if i == k else 0.0 for i in range(self.size)]
                ends.append(self.evaluate(*self.moved(base, positions, step)).residual)
            columns.append([(b - a) / (2.0 * _DIFFERENCE) for a, b in zip(*ends, strict=True)])
        rows = [
            [*(column[i] for column in columns), force] for i, force in enumerate(forces.residual)
        ]
        return _solve(rows)


def _solve(rows: list[list[float]]) -> list[float] | None:
    """Return the solution of a system of linear equations by Gaussian elimination.

    ``rows`` are the rows of the matrix, each with the right-hand side at its end. Returns ``None``
    for a singular matrix.
    """
    n = len(rows)
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        if rows[i][i] == 0.0:
            return None
        for k in range(n):
            factor = rows[k][i] / rows[i][i]
            if k != i and factor != 0.0:
                rows[k] = [b - factor * a for a, b in zip(rows[i], rows[k], strict=True)]
    return [row[n] / row[i] for i, row in enumerate(rows)]


def _moved(base: Pose, step: Sequence[float]) -> Pose:
    """Return the pose of the base after a Newton step of ``step[0]`` m in height and of
    ``step[1:3]`` rad about x and y."""
    angle = math.hypot(step[1], step[2])
    x, y, z = base.xyz
    quat = base.quat
    if angle > 0.0:
        turn = spatial.quat_from_axis_angle((step[1] / angle, step[2] / angle, 0.0), angle)
        quat = spatial.quat_normalize(spatial.quat_multiply(turn, quat))
    return Pose((x, y, z + step[0]), quat)


def _joint_home(joint: Joint, initial: float = 0.0) -> float:
    """Return the position of a joint in the home pose.

    The home position of a joint is ``initial``, or the nearest limit if the joint cannot reach it.
    """
    low = -math.inf if joint.lower is None else joint.lower
    high = math.inf if joint.upper is None else joint.upper
    return min(max(initial, low), high)


@once_per_model
def solve_statics(robot: Robot) -> Statics:
    """Return the statics of a robot that stands on level ground under its own weight."""
    tree = joint_tree.tree_of(robot)
    weights, inertias = inverse_weights(
        tree, robot.inertial.com, [wheel.link for wheel in robot.wheels]
    )
    weights = [max(w, 1e-9) for w in weights]
    softened = wheel_contact.softened_weights(weights, [wheel.load for wheel in robot.wheels])
    damping_ratios = [
        spatial.clean(wheel_contact.SOLREF[1] * math.sqrt(soft / w))
        for soft, w in zip(softened, weights, strict=True)
    ]
    axes = [spin_axis(tree, wheel) for wheel in robot.wheels]
    initial = {servo.joint: servo.initial for servo in robot.joint_servos}
    positions = {
        joint.name: _joint_home(joint, initial.get(joint.name, 0.0)) for joint in tree.moving
    }
    for joint in tree.moving:
        if joint.mimic is not None:
            positions[joint.name] = spatial.clean(
                joint.mimic.multiplier * positions.get(joint.mimic.joint, 0.0) + joint.mimic.offset
            )
    wheels = list(zip(robot.wheels, axes, softened, strict=True))
    stance, equilibrium = _equilibrium(robot, tree, positions, wheels)
    if equilibrium is not None:
        base, compliant_positions, forces = equilibrium
        base = base.clean()
        positions |= {
            j.name: spatial.clean(q)
            for j, q in zip(stance.joints, compliant_positions, strict=True)
        }
        depths, tilts = forces.depths, forces.tilts
    else:
        base = Pose()
        tilts = [footing.axis[2] for footing in stance.footings]
        depths = [
            wheel_contact.penetration_under(wheel.load, weight) for wheel, _, weight in wheels
        ]
    contacts = {}
    for (wheel, axis, weight), depth, tilt, damping_ratio in zip(
        wheels, depths, tilts, damping_ratios, strict=True
    ):
        p = max(depth, 0.0)
        # The base of a standing robot is typically tilted by about 1e-5 rad. A wheel that is tilted
        # by less than 1e-4 rad counts as upright.
        camber = tilt if abs(tilt) > 1e-4 else 0.0
        contact = wheel_contact.contact_ellipsoid(
            wheel, axis, p, wheel_contact.normal_force(p, weight), camber
        )
        contacts[wheel.name] = contact._replace(damping_ratio=damping_ratio)
    return Statics(base, positions, inertias, contacts, equilibrium is not None)


def _equilibrium(
    robot: Robot,
    tree: joint_tree.JointTree,
    positions: dict[str, float],
    wheels: list[tuple[Wheel, Vec3, float]],
) -> tuple[_Stance, tuple[Pose, list[float], _Forces] | None]:
    """Return the stance of a robot and its equilibrium, or ``None`` for one that falls over.

    ``positions`` are the home positions of the joints, which the function replaces by the limits
    that hold passive joints. The joints of the stance move under the weight of the robot: joints
    with springs, and passive joints. The spin joint of a wheel is not among them, because level
    ground does not turn a wheel.
    """
    standing = standing_of(robot)
    coordinates = joint_tree.coordinates_of(
        tree, robot.wheels, joint_tree.held_joints(robot), sprung=True
    )
    is_passive = any(not c.is_sprung or len(c.members) > 1 for c in coordinates)
    start, starts = Pose(), {}
    if standing is not None and is_passive:
        start, starts = standing.base, standing.positions
        positions |= {name: spatial.clean(starts[name]) for name in standing.at_limit}
        coordinates = [c for c in coordinates if c.members[0].joint.name not in standing.at_limit]
        moving = {member.joint.name for c in coordinates for member in c.members}
    else:
        moving = {j.name for j in tree.moving if j.mimic is None and j.stiffness > 0.0}
    # The positions of the joints that move are measured from 0. The others are at home.
    home = {name: q for name, q in positions.items() if name not in moving and q != 0.0}
    if home:
        tree = tree.at(home)
    if standing is not None and is_passive:
        stance: _Stance = _PassiveStance(tree, coordinates, wheels)
    else:
        stance = _Stance(tree, [joint for joint in tree.moving if joint.name in moving], wheels)
    if not wheels or stance.weight <= 0.0 or (standing is not None and not standing.stands):
        return stance, None
    n = len(wheels)
    softness = float_sum(weight for _, _, weight in wheels) / n
    x, y, z = start.xyz
    base = Pose(
        (x, y, z - wheel_contact.penetration_under(stance.weight / n, softness) / 2), start.quat
    )
    return stance, stance.settle(
        base, [starts.get(joint.name, _joint_home(joint)) for joint in stance.joints]
    )


def spin_axis(tree: joint_tree.JointTree, wheel: Wheel) -> Vec3:
    """Return the spin axis of a wheel in the link frame of the wheel.

    The spin axis points from the right to the left side of the robot.
    """
    spin = tree.joints[wheel.spin_joint]
    if spin.child == wheel.link:
        return spin.axis
    relative = tree.pose[wheel.link].inverse() * tree.pose[spin.child]
    return relative.rotate(spin.axis)
