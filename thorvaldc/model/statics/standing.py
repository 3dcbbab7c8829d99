"""Whether gravity and level ground hold every body of a robot, and the wheel loads that follow.

The bodies are rigid. The unknowns are the height of the base, its rotations about the world's x and
y axes, and the coordinates of the passive joints (``joint_tree``). A wheel is a circle of its
radius, whose lowest point has the height h_i(q) above the ground. The potential energy is

    E(q) = sum of m g z + sum of k (q - q_ref)^2 / 2    (weights and springs).

The robot stands where E has a strict minimum under h_i(q) >= 0 and the limits of the joints:

- **Equilibrium.** No motion d with h_i + J_i d >= 0 lowers the energy to first order: the linear
  program min g . d has the solution 0, where g and J_i are the gradients of E and h_i. Its
  multipliers N_i >= 0 are wheel loads that balance the robot, g = sum N_i J_i + forces of limits.
- **Stability.** The curvature of E - sum N_i h_i is positive for every motion that keeps the loaded
  contacts. Otherwise the motion is a mechanism: nothing brings the robot back.

A robot that is not in equilibrium with all joints at position 0 moves. Repeated linear programs
with a trust region follow it down to its equilibrium, for example to the limits of its joints. A
robot that finds none before it has turned over falls. Friction counts as nothing: it wears, and a
jolt overcomes it.

Loads. The balances leave the loads open if there are more loaded wheels than balances. The loads
then have the least sum of squares, as in ``static_loads``: those of equal tyres under a rigid
robot. A real wheel can carry any load in ``load_ranges``, depending on ground, tyres and frame.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.model import Joint, Pose, Robot, Vec3, Wheel, spatial
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.statics import joint_tree as trees
from thorvaldc.model.statics.static_loads import (
    least_squares_loads,
    maximize,
    null_space,
    spring_reference,
    static_loads,
)
from thorvaldc.model.sums import float_sum

_LARGEST_STEP, _SMALLEST_STEP = 0.05, 1e-7  # rad or m
_MAX_STEPS = 400
_EQUILIBRIUM = 1e-8
"""Decrease of the energy over the weight (m) in one step below which the robot is at rest."""
_LOADED = 1e-6  # share of the weight
_CURVATURE = 1e-4
"""Smallest curvature of the energy over the weight (m) of a stable pose: a body whose centre of
mass is less than 0.1 mm below its axis hangs in balance."""
_FALLEN = math.radians(45.0)
_TILT = math.radians(1.0)
"""Change of the tilt from which a robot has another pose."""
_TURNED = math.radians(120.0)
_SLID = 1.0  # m


class Standing(NamedTuple):
    """How a robot stands at rest on level ground.

    - ``stands``: true if the robot has a stable and unique standing pose.
    - ``mechanism``: names of the joints that move if the robot falls, the leaders of couplings
      first; empty for a robot that stands.
    - ``positions``: position of each passive joint in rad or m, by name.
    - ``at_limit``: names of the joints that a limit holds, with all joints coupled to them.
    - ``base``: pose of ``base_link`` in the world.
    - ``tilt``: angle of ``base_link`` from the vertical in rad.
    - ``loads``: load of each wheel in N.
    - ``balances``: rows whose products with the loads of all balanced robots are equal.
    - ``bounds``, ``slacks``: rows whose products with other loads may exceed those with ``loads``
      by the slack: a limit pushes and does not pull.
    """

    stands: bool
    mechanism: tuple[str, ...]
    positions: dict[str, float]
    at_limit: frozenset[str]
    base: Pose
    tilt: float
    loads: list[float]
    balances: list[list[float]]
    bounds: list[list[float]]
    slacks: list[float]


class _State(NamedTuple):
    """A pose of the robot with the values and gradients that belong to it.

    - ``values``: the coordinates.
    - ``heights``, ``jacobian``: height of each wheel above the ground, and its gradient.
    - ``energy``, ``gradient``: potential energy in J, and its gradient.
    """

    base: Pose
    values: list[float]
    heights: list[float]
    jacobian: list[list[float]]
    energy: float
    gradient: list[float]


class _Wheel(NamedTuple):
    group: int
    centre: Vec3
    axis: Vec3
    radius: float


class _Body:
    """The robot as a function of the pose of its base and of its coordinates."""

    def __init__(
        self,
        tree: trees.JointTree,
        wheels: Sequence[Wheel],
        coordinates: Sequence[trees.Coordinate],
    ) -> None:
        self.coordinates = coordinates
        owner = {
            member.joint.name: (k, member)
            for k, coordinate in enumerate(coordinates)
            for member in coordinate.members
        }
        self.groups = trees.RigidGroups(
            tree, [joint for joint in tree.moving if joint.name in owner]
        )
        self.owners = [owner[joint.name] for joint in self.groups.joints]
        self.wheels = []
        for wheel in wheels:
            spin, group = tree.joints[wheel.spin_joint], self.groups.group_of(wheel.link)
            if spin.type == "continuous":
                axis = tree.pose[spin.child].rotate(spin.axis)
                self.wheels.append(_Wheel(group, tree.pose[wheel.link].xyz, axis, wheel.radius))
            else:  # a foot
                self.wheels.append(_Wheel(group, (*wheel.contact_point, 0.0), (0.0, 1.0, 0.0), 0.0))
        self.paths = [self.groups.path_of(g) for g in range(len(self.groups.parent))]
        self.weight = self.groups.total_mass * spatial.GRAVITY
        self.limits = [coordinate.limits() for coordinate in coordinates]

    def start(self) -> _State:
        """Return the pose in which the search starts: all coordinates at 0, or as near to it as
        their limits allow, and the lowest wheel on the ground."""
        return self.at(Pose(), [min(max(0.0, low), high) for low, high in self.limits])

    def positions(self, values: Sequence[float]) -> list[float]:
        """Return the position of each joint of the groups, in rad or m."""
        return [member.ratio * values[k] + member.offset for k, member in self.owners]

    def at(self, base: Pose, values: list[float]) -> _State:
        """Return the state with given coordinates, lowered or raised to the ground."""
        heights = self._heights(base, values)[0]
        # The height of the base is the one unknown that needs no search: a robot in the air falls
        # until the lowest wheel touches, and one in the ground is lifted.
        x, y, z = base.xyz
        base = Pose((x, y, z - min(heights)), base.quat)
        heights, points, transforms, frames = self._heights(base, values)
        jacobian = [
            self._lift(wheel.group, x, y, base, frames)
            for wheel, (x, y) in zip(self.wheels, points, strict=True)
        ]
        gradient = [0.0] * (3 + len(values))
        energy = 0.0
        for g, (mass, com) in enumerate(zip(self.groups.mass, self.groups.com, strict=True)):
            x, y, z = transforms[g].apply(com)
            energy += mass * spatial.GRAVITY * z
            # Weight has no horizontal component, so only the lift of the centre of mass does work.
            for k, lift in enumerate(self._lift(g, x, y, base, frames)):
                gradient[k] += mass * spatial.GRAVITY * lift
        for joint, (k, member), q in zip(
            self.groups.joints, self.owners, self.positions(values), strict=True
        ):
            stretch = q - joint.spring_reference
            energy += joint.stiffness * stretch * stretch / 2.0
            gradient[3 + k] += member.ratio * joint.stiffness * stretch
        return _State(base, values, heights, jacobian, energy, gradient)

    def moved(self, state: _State, step: Sequence[float]) -> tuple[Pose, list[float]]:
        """Return the base pose and the coordinates after a step of the unknowns."""
        x, y, z = state.base.xyz
        angle = math.hypot(step[1], step[2])
        quat = state.base.quat
        if angle > 0.0:
            # A rotation about the world's axes, and none about z: yaw changes no height.
            turn = spatial.quat_from_axis_angle((step[1] / angle, step[2] / angle, 0.0), angle)
            quat = spatial.quat_normalize(spatial.quat_multiply(turn, quat))
        values = [a + b for a, b in zip(state.values, step[3:], strict=True)]
        return Pose((x, y, z + step[0]), quat), values

    def lagrangian(self, base: Pose, values: list[float], loads: Sequence[float]) -> float:
        """Return the energy minus the work of constant wheel loads in J."""
        heights, _, transforms, _ = self._heights(base, values)
        parts = [-load * height for load, height in zip(loads, heights, strict=True)]
        for mass, com, transform in zip(self.groups.mass, self.groups.com, transforms, strict=True):
            parts.append(mass * spatial.GRAVITY * transform.apply(com)[2])
        for joint, q in zip(self.groups.joints, self.positions(values), strict=True):
            parts.append(joint.stiffness * (q - joint.spring_reference) ** 2 / 2.0)
        return float_sum(parts)

    def _heights(
        self, base: Pose, values: Sequence[float]
    ) -> tuple[list[float], list[tuple[float, float]], list[Pose], list[tuple[Vec3, Vec3]]]:
        """Return heights and contact points of the wheels, and the placed groups."""
        transforms, frames = self.groups.place(base, self.positions(values))
        heights, points = [], []
        for wheel in self.wheels:
            transform = transforms[wheel.group]
            x, y, z = transform.apply(wheel.centre)
            ax, ay, az = transform.rotate(wheel.axis)
            # The lowest point of a tilted circle: the radius along the steepest direction in the
            # wheel's plane. With the unit axis a, this direction is (a_x a_z, a_y a_z, a_z^2 - 1)
            # / cos with cos^2 = 1 - a_z^2. The bound keeps a wheel that lies flat from a division
            # by zero.
            cos = math.sqrt(max(1.0 - az * az, 1e-9))
            heights.append(z - wheel.radius * cos)
            points.append((x + wheel.radius * ax * az / cos, y + wheel.radius * ay * az / cos))
        return heights, points, transforms, frames

    def _lift(
        self, group: int, x: float, y: float, base: Pose, frames: Sequence[tuple[Vec3, Vec3]]
    ) -> list[float]:
        """Return how far each unknown lifts the point (x, y) of a group, per rad or m."""
        lift = [1.0, y - base.xyz[1], base.xyz[0] - x] + [0.0] * len(self.coordinates)
        for g in self.paths[group]:
            k, member = self.owners[g - 1]
            joint = self.groups.joints[g - 1]
            lift[3 + k] += member.ratio * trees.lift(joint, frames[g], x, y)
        return lift


def _fall(body: _Body, state: _State, radius: float) -> tuple[list[float], list[float]]:
    """Return the step within ``radius`` that lowers the energy most, and the wheel loads in N."""
    # The simplex method knows only non-negative variables, so each unknown d is the difference of
    # two: d = d+ - d-. Rows: no contact sinks into the ground, -J_i d <= h_i; each unknown stays
    # within the trust region and within the limits of its joint.
    n = len(state.gradient)
    rows, bounds = [], []
    for lift, height in zip(state.jacobian, state.heights, strict=True):
        rows.append([-v for v in lift] + list(lift))
        bounds.append(height)
    for k in range(n):
        low, high = -math.inf, math.inf
        if k >= 3:
            low, high = (limit - state.values[k - 3] for limit in body.limits[k - 3])
        for column, bound in ((k, high), (n + k, -low)):
            rows.append([1.0 if j == column else 0.0 for j in range(2 * n)])
            bounds.append(min(radius, bound))
    # In units of the weight, the tolerances of the simplex method suit every size of robot.
    scale = 1.0 / body.weight
    objective = [-scale * v for v in state.gradient] + [scale * v for v in state.gradient]
    solution, multipliers = maximize(objective, rows, bounds)
    step = [a - b for a, b in zip(solution[:n], solution[n:], strict=True)]
    return step, [body.weight * value for value in multipliers[: len(state.heights)]]


def _settle(body: _Body) -> tuple[_State, list[float] | None]:
    """Return the state in which the robot comes to rest, and wheel loads that balance it.

    The loads are ``None`` for a robot that falls over.
    """
    state, radius = body.start(), _LARGEST_STEP
    for _ in range(_MAX_STEPS):
        step, loads = _fall(body, state, radius)
        decrease = -float_sum(a * b for a, b in zip(state.gradient, step, strict=True))
        if decrease < _EQUILIBRIUM * body.weight or radius < _SMALLEST_STEP:
            return state, loads
        after = body.at(*body.moved(state, step))
        # The linear program ignores curvature. A step that reaches less than a tenth of the
        # promised decrease went too far, and is tried again in half the radius.
        if after.energy > state.energy - 0.1 * decrease:
            radius /= 2.0
            continue
        state, radius = after, min(2.0 * radius, _LARGEST_STEP)
        if _tilt(state.base) > _FALLEN or _has_turned(body, state):
            break
    return state, None


def _tilt(base: Pose) -> float:
    return math.acos(max(-1.0, min(1.0, base.rotate((0.0, 0.0, 1.0))[2])))


def _has_turned(body: _Body, state: _State) -> bool:
    """Return whether a joint that carries a wheel has moved further than any suspension does."""
    carriers = {g for wheel in body.wheels for g in body.paths[wheel.group]}
    for g, (joint, q) in enumerate(
        zip(body.groups.joints, body.positions(state.values), strict=True), 1
    ):
        if abs(q) > (_SLID if joint.type == "prismatic" else _TURNED * (1 if g in carriers else 2)):
            return True
    return False


def _softest_motion(
    body: _Body, state: _State, loads: Sequence[float], fixed: Collection[int]
) -> tuple[list[float], float]:
    """Return the motion that keeps the loaded contacts with the least curvature of the energy.

    The motion is a unit vector of the unknowns; it is empty if no motion keeps the contacts. The
    curvature is in J.

    - ``fixed``: numbers of the unknowns that limits hold.
    """
    n = len(state.gradient)
    constraints = [
        lift
        for lift, load in zip(state.jacobian, loads, strict=True)
        if load > _LOADED * body.weight
    ]
    constraints += [[1.0 if j == k else 0.0 for j in range(n)] for k in sorted(fixed)]
    motions = null_space(constraints, n)
    if not motions:
        return [], math.inf
    vector, least = _least_eigenvector(_curvatures(body, state, loads, motions))
    motion = [
        float_sum(w * unit[k] for w, unit in zip(vector, motions, strict=True)) for k in range(n)
    ]
    return motion, least


def _least_eigenvector(matrix: list[list[float]]) -> tuple[list[float], float]:
    """Return the eigenvector of the least eigenvalue of a symmetric matrix, by Jacobi's method."""
    n = len(matrix)
    a = [list(row) for row in matrix]
    vectors = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    for _ in range(50):
        largest = max((abs(a[i][j]) for i in range(n) for j in range(i)), default=0.0)
        if largest <= 1e-12 * max(abs(a[i][i]) for i in range(n)):
            break
        for p in range(n):
            for q in range(p + 1, n):
                if a[p][q] == 0.0:
                    continue
                # The rotation in the plane of p and q that makes the entry (p, q) zero.
                angle = 0.5 * math.atan2(2.0 * a[p][q], a[q][q] - a[p][p])
                c, s = math.cos(angle), math.sin(angle)
                for row in (*a, *vectors):
                    row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
                for k in range(n):
                    a[p][k], a[q][k] = c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]
    least = min(range(n), key=lambda i: a[i][i])
    return [row[least] for row in vectors], a[least][least]


def _curvatures(
    body: _Body, state: _State, loads: Sequence[float], motions: Sequence[Sequence[float]]
) -> list[list[float]]:
    """Return the second derivatives of the Lagrangian for each pair of motions, in J."""
    # Central differences with h = 1 mm or 1 mrad: the energy is smooth, and rounding (1e-16 of the
    # energy over h^2) stays far below the smallest curvature that counts as stable.
    h = 1e-3

    def value(*terms: tuple[float, Sequence[float]]) -> float:
        step = [
            float_sum(factor * unit[k] for factor, unit in terms)
            for k in range(len(state.gradient))
        ]
        return body.lagrangian(*body.moved(state, step), loads)

    centre = value((0.0, motions[0]))
    pure = [(value((h, unit)) - 2.0 * centre + value((-h, unit))) / (h * h) for unit in motions]
    rows = [[0.0] * len(motions) for _ in motions]
    for i, first in enumerate(motions):
        rows[i][i] = pure[i]
        for j in range(i):
            # Polarization: the curvature along u + v is that of u plus that of v plus twice the
            # mixed one.
            second = motions[j]
            both = value((h, first), (h, second)) - 2.0 * centre + value((-h, first), (-h, second))
            rows[i][j] = rows[j][i] = (both / (h * h) - pure[i] - pure[j]) / 2.0
    return rows


def _moving_joints(body: _Body, motion: Sequence[float]) -> tuple[str, ...]:
    """Return the names of the joints that take part in a motion, leaders first."""
    largest = max((abs(v) for v in motion), default=0.0)
    return tuple(
        member.joint.name
        for coordinate, v in zip(body.coordinates, motion, strict=True)
        if abs(v) > 0.02 * largest
        for member in coordinate.members
    )


def find_standing(
    tree: trees.JointTree, wheels: Sequence[Wheel], stopped: Collection[str], *, sprung: bool
) -> Standing | None:
    """Return how a robot stands, or ``None`` for a robot without passive joints.

    A robot without mass or with less than three wheels also gives ``None``: other checks report it.

    - ``stopped``: names of the joints that motors and servos hold.
    - ``sprung``: false leaves the joints with springs at position 0, as if they were rigid. The
      rest positions of the springs follow from the loads of this robot.
    """
    coordinates = trees.coordinates_of(tree, wheels, stopped, sprung=sprung)
    if not coordinates or len(wheels) < 3:
        return None
    body = _Body(tree, wheels, coordinates)
    if body.weight <= 0.0:
        return None
    state, loads = _settle(body)
    positions = dict(
        zip([joint.name for joint in body.groups.joints], body.positions(state.values), strict=True)
    )
    tilt = _tilt(state.base)
    if loads is None:
        moved = _moving_joints(body, state.values)
        return Standing(
            False, moved, positions, frozenset(), state.base, tilt, [0.0] * len(wheels), [], [], []
        )
    loads, forces, signs = _balance(body, state, loads)
    fixed = {k for k, force in forces.items() if force > _LOADED * body.weight}
    motion, curvature = _softest_motion(body, state, loads, fixed)
    stable = curvature > _CURVATURE * body.weight
    return Standing(
        stable,
        () if stable else _moving_joints(body, motion[3:]),
        positions,
        frozenset(member.joint.name for k in fixed for member in coordinates[k - 3].members),
        state.base,
        tilt,
        loads,
        [[row[k] for row in state.jacobian] for k in range(len(state.gradient)) if k not in signs],
        [[sign * row[k] for row in state.jacobian] for k, sign in signs.items()],
        [max(force, 0.0) for force in forces.values()],
    )


class _Balance(NamedTuple):
    """Wheel loads that balance a robot, and the unknowns at limits with the forces of the limits.

    A force is positive if the limit pushes the joint back into its range.
    """

    loads: list[float]
    forces: dict[int, float]
    signs: dict[int, float]


def _balance(body: _Body, state: _State, loads: list[float]) -> _Balance:
    """Return the wheel loads with the least sum of squares that balance the robot.

    A limit pushes in one direction only. An unknown at a limit that would have to pull is free.

    - ``loads``: loads that balance the robot; they are returned if the search finds no others.
    """
    signs = {}
    for k, (low, high) in enumerate(body.limits, 3):
        value = state.values[k - 3]
        if min(value - low, high - value) < _SMALLEST_STEP:
            signs[k] = 1.0 if value - low < _SMALLEST_STEP else -1.0
    free = dict(signs)
    while True:
        balances = [
            ([row[k] for row in state.jacobian], state.gradient[k])
            for k in range(len(state.gradient))
            if k not in free
        ]
        balancing = _non_negative_loads(balances, state.heights, body.weight) or loads
        forces = {
            k: sign
            * (
                state.gradient[k]
                - float_sum(n * row[k] for n, row in zip(balancing, state.jacobian, strict=True))
            )
            for k, sign in signs.items()
        }
        # A limit that pulls does not act: its joint is free, and must be balanced by the wheels
        # alone. Each round frees at least one unknown, so that the loop ends.
        pulled = [k for k in free if forces[k] < -_LOADED * body.weight]
        if not pulled:
            return _Balance(balancing, forces, signs)
        for k in pulled:
            del free[k]


def _non_negative_loads(
    balances: Sequence[tuple[list[float], float]], heights: Sequence[float], weight: float
) -> list[float] | None:
    """Return loads of the wheels on the ground that satisfy all balances, or ``None``."""
    active = [i for i, height in enumerate(heights) if height < _LARGEST_STEP / 100]
    while active:
        solution = least_squares_loads([([row[i] for i in active], v) for row, v in balances])
        # The ground does not pull: the wheel with the most negative load lifts off, and the others
        # share its load. This active-set method ends after at most one round for each wheel.
        lowest = min(range(len(active)), key=lambda k: solution[k])
        if solution[lowest] >= -1e-9 * weight:
            loads = [0.0] * len(heights)
            for i, load in zip(active, solution, strict=True):
                loads[i] = max(load, 0.0)
            errors = [
                abs(float_sum(a * b for a, b in zip(row, loads, strict=True)) - value)
                for row, value in balances
            ]
            return loads if max(errors) < 1e-4 * weight else None
        del active[lowest]
    return None


def spring_loads(
    tree: trees.JointTree,
    joints: Sequence[Joint],
    wheels: Sequence[Wheel],
    stopped: Collection[str],
) -> tuple[list[Joint], list[float]]:
    """Return the joints with the rest positions of their springs, and the wheel loads in N.

    The springs hold their joints at 0 under the loads that the robot has with rigid springs. If
    passive joints let the robot lean, the springs give way a little more.

    - ``stopped``: names of the joints that motors and servos hold.
    """
    standing = find_standing(tree, wheels, stopped, sprung=False)
    body = tree.inertial()
    if standing is not None:
        loads = standing.loads
    elif body.mass > 0.0:
        loads = static_loads([wheel.contact_point for wheel in wheels], body)
    else:
        loads = [0.0] * len(wheels)
    loads = [spatial.clean(load) for load in loads]
    joints = [
        replace(joint, spring_reference=spring_reference(joint, tree, wheels, loads))
        if joint.stiffness > 0.0
        else joint
        for joint in joints
    ]
    is_sprung = any(joint.stiffness > 0.0 for joint in joints)
    if standing is not None and is_sprung and any(standing.positions.values()):
        sprung_tree = trees.JointTree(list(tree.links.values()), joints)
        sprung = find_standing(sprung_tree, wheels, stopped, sprung=True)
        loads = sprung.loads if sprung is not None else loads
    return joints, loads


@once_per_model
def stands_without_couplings(robot: Robot) -> bool:
    """Return whether a robot stands in the same pose if no joint follows another one, as in a
    format that cannot say so; true for a robot that does not stand anyway."""
    standing = standing_of(robot)
    if standing is None or not any(joint.mimic for joint in robot.joints):
        return True
    joints = tuple(replace(joint, mimic=None) for joint in robot.joints)
    free = standing_of(replace(robot, joints=joints))
    assert free is not None  # its joints give way too
    return not standing.stands or (free.stands and free.tilt < standing.tilt + _TILT)


@once_per_model
def standing_of(robot: Robot) -> Standing | None:
    """Return how a robot stands on its springs, or ``None`` for one without passive joints."""
    return find_standing(trees.tree_of(robot), robot.wheels, trees.held_joints(robot), sprung=True)
