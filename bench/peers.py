"""Time of a calculator's tick relative to robotpy-wpimath (C++ with Python bindings)."""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from bench.figure import Figure, in_turns, is_compiled
from bench.robots import wheel, wheel_positions

TICKS = 126
REPEATS = 8
"""Repetitions of the same ticks in one measurement, so that all caches are warm."""
ROUNDS = 20


def figures() -> Iterator[Figure]:
    try:
        import wpimath.kinematics  # noqa: F401
    except ImportError:
        print(
            "robotpy-wpimath is not installed, so its figures are left out: pip install '.[bench]'",
            file=sys.stderr,
        )
        return
    for n in (4, 6):
        yield from _compare(n)


def _compare(n: int) -> Iterator[Figure]:
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.general import General
    from thorvaldc.runtime.se2 import Twist

    geometry = BaseGeometry.from_wheels(
        [wheel(f"w{i}", x, y) for i, (x, y) in enumerate(wheel_positions(n))]
    )
    calculator = General(geometry)
    peer = Wpimath(wheel_positions(n))

    def inverse_and_odometry(twist: Twist, states: JointStates) -> None:
        calculator.command(twist)
        calculator.odometry(states)

    def driver_tick(twist: Twist, states: JointStates) -> None:
        calculator.command(twist, states, 0.02)
        calculator.odometry(states)

    twists = [
        Twist(0.8, 0.1 * math.sin(a), 0.3 * math.cos(a))
        for a in (math.tau * k / TICKS for k in range(TICKS))
    ]
    # The joints follow within a tick; the first round brings them into a steady motion.
    zeros = (0.0,) * n
    states = [JointStates(0.0, zeros, zeros, zeros)]
    for twist in (*twists, *twists):
        joints = calculator.command(twist, states[-1], 0.02).joints
        rates = [(a - b) / 0.02 for a, b in zip(joints.angles, states[-1].angles, strict=True)]
        states.append(JointStates(0.0, joints.speeds, joints.angles, rates))
    ticks = list(zip(twists, states[TICKS:], strict=False))
    inputs = [(t, s.speeds, s.angles) for t, s in ticks]
    times = in_turns(
        _repeated(ticks, inverse_and_odometry),
        _repeated(inputs, peer.inverse_and_odometry),
        _repeated(ticks, driver_tick),
        _repeated(inputs, peer.driver_tick),
        rounds=ROUNDS,
    )
    ns = [f"{statistics.median(each) / TICKS / REPEATS * 1e9:.0f} ns" for each in times]

    def figure(name: str, k: int, bound: float | None, how: str) -> Figure:
        pairs = zip(times[k], times[k + 1], strict=True)
        method = how.format(ns[k], ns[k + 1])
        return Figure.ratio(f"{name}, N={n}", bound, pairs, method, unit="x wpimath")

    yield figure(
        "tick", 0, 1.5,
        "choice of angles, weighted estimate, covariance, chi-square of each wheel: {} "
        "against {} of robotpy-wpimath's inverse and odometry, floats in and out",
    )  # fmt: skip
    yield figure(
        "driver's tick", 2, 0.6 if is_compiled() else None,
        "the same with the limits of steering and motors and coordinated wheels: {} "
        "against {} of robotpy-wpimath with desaturate, optimize and cosineScale",
    )  # fmt: skip


def _repeated(inputs: Sequence[Any], work: Callable[..., object]) -> Callable[[], None]:
    def run() -> None:
        for _ in range(REPEATS):
            for arguments in inputs:
                work(*arguments)

    return run


class Wpimath:
    """The same computations with robotpy-wpimath; rad, and rad/s of wheels of radius 0.2 m."""

    def __init__(self, wheels: Sequence[tuple[float, float]]) -> None:
        from wpimath import geometry, kinematics

        cls = {4: kinematics.SwerveDrive4Kinematics, 6: kinematics.SwerveDrive6Kinematics}
        self._kinematics = cls[len(wheels)](*[geometry.Translation2d(x, y) for x, y in wheels])
        self._chassis = kinematics.ChassisSpeeds
        self._state = kinematics.SwerveModuleState
        self._rotation = geometry.Rotation2d

    def _states(self, speeds: Sequence[float], angles: Sequence[float]) -> Any:
        state, rotation = self._state, self._rotation
        return tuple([state(0.2 * v, rotation(a)) for v, a in zip(speeds, angles, strict=True)])

    def inverse_and_odometry(
        self, twist: Sequence[float], speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[list[float], list[float], float, float, float]:
        targets = self._kinematics.toSwerveModuleStates(self._chassis(*twist))
        twist_estimate = self._kinematics.toChassisSpeeds(self._states(speeds, angles))
        return (
            [s.speed / 0.2 for s in targets],
            [s.angle.radians() for s in targets],
            twist_estimate.vx,
            twist_estimate.vy,
            twist_estimate.omega,
        )

    def driver_tick(
        self, twist: Sequence[float], speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[list[float], list[float], float, float, float]:
        kinematics = self._kinematics
        targets = kinematics.desaturateWheelSpeeds(
            kinematics.toSwerveModuleStates(self._chassis(*twist)), 1.5
        )
        states = self._states(speeds, angles)
        for goal, now in zip(targets, states, strict=True):
            goal.optimize(now.angle)
            goal.cosineScale(now.angle)
        twist_estimate = kinematics.toChassisSpeeds(states)
        return (
            [s.speed / 0.2 for s in targets],
            [s.angle.radians() for s in targets],
            twist_estimate.vx,
            twist_estimate.vy,
            twist_estimate.omega,
        )
