"""Steering travel relative to the optimum, and scrub of wheels that turn to new angles."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bench.figure import Figure
from bench.robots import wheel

GROUP = "long"

if TYPE_CHECKING:
    from thorvaldc.runtime.calculators import WheelGeometry
    from thorvaldc.runtime.se2 import Twist

PI = math.pi
DIRECTIONS = 40000
SQUARE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]


def figures() -> Iterator[Figure]:
    yield from _travel()
    yield from _scrub()


# -- travel ---------------------------------------------------------------------------


def _travel() -> Iterator[Figure]:
    rng = random.Random(1)
    directions = [rng.uniform(-PI, PI) for _ in range(DIRECTIONS)]
    for limit, label in ((PI, "+-180 deg"), (math.radians(176.4), "+-176.4 deg")):
        optimum = _mean_travel(_optimal(limit), directions)
        yield Figure(
            f"steering travel, {label}",
            _mean_travel(_general(limit), directions) / optimum,
            "x optimum",
            1.01,
            "lower",
            f"general, {DIRECTIONS} independent directions; optimum by dynamic programming: "
            f"{math.degrees(optimum):.2f} deg per direction",
        )
    optimum = _mean_travel(_optimal(PI), directions)
    for name, policy in (("no reversing", _no_flip), ("reverse beyond 90 deg, wrap", _wrapping)):
        yield Figure(
            f"steering travel, {name}",
            _mean_travel(policy, directions) / optimum,
            "x optimum",
            None,
            "lower",
            "joint limits of +-180 deg, the same directions",
        )


def _mean_travel(policy: Callable[[float, float], float], directions: Sequence[float]) -> float:
    """Returns the mean travel (rad) of a joint that starts at 0 and follows these directions."""
    angle, travel = 0.0, 0.0
    for direction in directions:
        next_angle = policy(angle, direction)
        travel += abs(next_angle - angle)
        angle = next_angle
    return travel / len(directions)


def _general(limit: float) -> Callable[[float, float], float]:
    from thorvaldc.runtime.calculators.steering_branch import SteeringJoint

    geometry = replace(_wheel("w", 0.0, 0.0), lower=-limit, upper=limit)
    joint = SteeringJoint([geometry], (0,), 0.02)

    def policy(angle: float, direction: float) -> float:
        joint.choose(math.cos(direction), math.sin(direction), 0.0, angle, 0.0)
        return joint.target

    return policy


def _no_flip(angle: float, direction: float) -> float:
    return direction


def _wrapping(angle: float, direction: float) -> float:
    """Returns the nearer of two opposite directions on the circle, wrapped to +-180 deg."""
    turn = math.remainder(direction - angle, 2 * PI)
    if abs(turn) > PI / 2:
        direction += PI
    return math.remainder(direction, 2 * PI)


def _optimal(limit: float, cells: int = 720) -> Callable[[float, float], float]:
    """Returns the optimal policy, by value iteration on a grid of angles.

    h(c) + g = E [min over the angles a of a random direction of |a - c| + h(a)].
    """
    import numpy as np

    angles = (np.arange(cells) + 0.5) * (2 * PI / cells) - PI
    reachable = np.abs(angles) <= limit
    half = cells // 2
    distance = np.abs(angles[:, None] - angles[None, :])
    h = np.zeros(cells)
    for _ in range(200):
        cost_to_go = distance + np.where(reachable, h, np.inf)[None, :]
        best = np.minimum(cost_to_go[:, :half], cost_to_go[:, half:])  # half a turn apart
        best = np.where(np.isfinite(best), best, 0.0).mean(axis=1)
        h = best - best[half]
    values = [float(v) for v in h]

    def policy(angle: float, direction: float) -> float:
        def cost(a: float) -> float:
            position = (a + PI) * cells / (2 * PI) - 0.5
            cell = min(max(int(position), 0), cells - 2)
            value = values[cell] + (position - cell) * (values[cell + 1] - values[cell])
            return abs(a - angle) + value

        candidates = [direction + k * PI for k in (-1, 0, 1)]
        reachable_angles = [a for a in candidates if abs(a) <= limit + 1e-12]
        return min(reachable_angles, key=cost) if reachable_angles else angle

    return policy


# -- scrub ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Motion:
    """``scrub``: mean distance (m) that the contacts slip; ``unwanted``: distance (m) of the robot
    apart from the commanded motion."""

    scrub: float
    unwanted: float


def _scrub() -> Iterator[Figure]:
    rng = random.Random(2)
    pairs = [[_random_twist(rng) for _ in range(2)] for _ in range(60)]
    ours = [_turning(a, b, _coordinating) for a, b in pairs]
    cosine = [_turning(a, b, _by_cosine) for a, b in pairs]
    for what in ("scrub", "unwanted"):
        mean = sum(getattr(w, what) for w in ours) / len(ours)
        theirs = sum(getattr(w, what) for w in cosine) / len(cosine)
        word = "scrub while turning" if what == "scrub" else "unwanted motion while turning"
        yield Figure(
            word,
            mean / theirs,
            "x cosine rule",
            0.1 if what == "scrub" else None,
            "lower",
            f"4WD4WS from one random twist to another, steering 2 rad/s: {mean * 1000:.1f} mm "
            f"against {theirs * 1000:.1f} mm by each wheel's own cosine",
        )


def _random_twist(rng: random.Random) -> Twist:
    from thorvaldc.runtime.se2 import Twist

    return Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))


def _wheel(name: str, x: float, y: float) -> WheelGeometry:
    """Returns a wheel with slow steering and no other limit."""
    return wheel(
        name, x, y,
        lower=-PI, upper=PI, max_rate=2.0,
        max_rate_change=1e9, max_speed=100.0, max_acceleration=1e9,
    )  # fmt: skip


Step = Callable[[Sequence[float], Sequence[float]], tuple[Sequence[float], Sequence[float]]]


def _turning(before: Twist, after: Twist, rule: Callable[[Twist, Twist, float], Step]) -> _Motion:
    """Changes from one steady motion to another; the joints follow their commands immediately.

    The robot moves as the unweighted least-squares fit of its wheel velocities.
    """
    dt = 0.01
    step = rule(before, after, dt)
    speeds, angles = step([], [])
    lever2 = sum(x * x + y * y for x, y in SQUARE) / 4
    size = math.sqrt(after.vx**2 + after.vy**2 + lever2 * after.wz**2)
    scrub = unwanted = 0.0
    for _ in range(200):
        speeds, angles = step(speeds, angles)
        ux = [0.2 * v * math.cos(a) for v, a in zip(speeds, angles, strict=True)]
        uy = [0.2 * v * math.sin(a) for v, a in zip(speeds, angles, strict=True)]
        wheels = list(zip(SQUARE, ux, uy, strict=True))
        wz = sum(x * b - y * a for (x, y), a, b in wheels) / (4 * lever2)
        vx, vy = sum(ux) / 4, sum(uy) / 4
        slips = [math.hypot(vx - wz * y - a, vy + wz * x - b) for (x, y), a, b in wheels]
        scrub += sum(slips) / 4 * dt
        along = (vx * after.vx + vy * after.vy + lever2 * wz * after.wz) / size
        across2 = vx * vx + vy * vy + lever2 * wz * wz - along * along
        unwanted += math.sqrt(max(across2, 0.0)) * dt
    return _Motion(scrub, unwanted)


def _coordinating(before: Twist, after: Twist, dt: float) -> Step:
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.general import General

    positions = enumerate(SQUARE)
    geometry = BaseGeometry.from_wheels([_wheel(f"w{i}", x, y) for i, (x, y) in positions])
    calculator = General(geometry)

    def step(
        speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        if not angles:
            joints = calculator.command(before).joints
            return joints.speeds, joints.angles
        # The speeds fit the measured angles; the wheels turn afterwards.
        joints = calculator.command(after, JointStates(0.0, speeds, angles, [0.0] * 4), dt).joints
        return joints.speeds, joints.angles

    return step


def _by_cosine(before: Twist, after: Twist, dt: float) -> Step:
    """Each wheel takes the nearer of two opposite angles, slowed by the cosine of its error."""

    def velocities(twist: Twist) -> list[tuple[float, float]]:
        return [(twist.vx - twist.wz * y, twist.vy + twist.wz * x) for x, y in SQUARE]

    def step(
        speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        if not angles:
            return (
                [math.hypot(*u) / 0.2 for u in velocities(before)],
                [math.atan2(u[1], u[0]) for u in velocities(before)],
            )
        new_speeds, new_angles = [], []
        for u, angle in zip(velocities(after), angles, strict=True):
            turn = math.remainder(math.atan2(u[1], u[0]) - angle, 2 * PI)
            speed = math.hypot(*u) / 0.2
            if abs(turn) > PI / 2:
                turn, speed = math.remainder(turn + PI, 2 * PI), -speed
            new_speeds.append(speed * math.cos(turn))
            new_angles.append(angle + min(max(turn, -2.0 * dt), 2.0 * dt))
        return new_speeds, new_angles

    return step
