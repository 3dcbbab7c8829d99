"""Time of the calculators beside robotpy-wpimath, the C++ library for Python, in one run."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from bench.figure import Figure, least_times
from bench.robots import places, wheel

TICKS = 126
REPEATS = 8
"""Times round the same ticks in a measurement, so that caches are warm for all alike."""
ROUNDS = 50


def figures() -> Iterator[Figure]:
    try:
        import wpimath.kinematics  # noqa: F401
    except ImportError:
        print(
            "robotpy-wpimath is missing, and with it the figures beside it: pip install '.[bench]'",
            file=sys.stderr,
        )
        return
    for n in (4, 6):
        yield from _beside(n)


def _beside(n: int) -> Iterator[Figure]:
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.general import General
    from thorvaldc.runtime.calculators.kinematics import Kinematics
    from thorvaldc.runtime.se2 import Twist

    geometry = BaseGeometry.from_wheels(
        [wheel(f"w{i}", x, y) for i, (x, y) in enumerate(places(n))]
    )
    plain, made = Kinematics(geometry), General(geometry)
    peer = Wpimath(places(n))

    def bare(twist: Twist, states: JointStates) -> None:
        plain.inverse(*twist)
        plain.least_squares(states.speeds, states.angles)

    def choosing(twist: Twist, states: JointStates) -> None:
        made.command(twist)
        made.odometry(states)

    def driving(twist: Twist, states: JointStates) -> None:
        made.command(twist, states, 0.02)
        made.odometry(states)

    twists = [
        Twist(0.8, 0.1 * math.sin(a), 0.3 * math.cos(a))
        for a in (math.tau * k / TICKS for k in range(TICKS))
    ]
    # The joints follow within a tick; what is measured is the second time round.
    zeros = (0.0,) * n
    states = [JointStates(0.0, zeros, zeros, zeros)]
    for twist in (*twists, *twists):
        joints = made.command(twist, states[-1], 0.02).joints
        rates = [(a - b) / 0.02 for a, b in zip(joints.angles, states[-1].angles, strict=True)]
        states.append(JointStates(0.0, joints.speeds, joints.angles, rates))
    ticks = list(zip(twists, states[TICKS:], strict=False))
    objects = [(peer.chassis(t), peer.states(s.speeds, s.angles)) for t, s in ticks]
    times = least_times(
        [
            _over(ticks, bare),
            _over(objects, peer.objects),
            _over(ticks, choosing),
            _over([(t, s.speeds, s.angles) for t, s in ticks], peer.floats),
            _over(ticks, driving),
            _over([(t, s.speeds, s.angles) for t, s in ticks], peer.choosing),
        ],
        ROUNDS,
    )
    ns = [time / TICKS / REPEATS * 1e9 for time in times]

    def figure(name: str, k: int, bound: float | None, how: str) -> Figure:
        said = how.format(f"{ns[k]:.0f} ns", f"{ns[k + 1]:.0f} ns")
        return Figure(f"{name}, N={n}", ns[k] / ns[k + 1], "x wpimath", bound, "lower", said)

    yield figure(
        "inverse + least squares", 0, 1.0,
        "bare: {} against {} of robotpy-wpimath through its objects",
    )  # fmt: skip
    yield figure(
        "tick", 2, 1.0,
        "choice of angles, weighted estimate, covariance, chi-square of each wheel: {} "
        "against {} of robotpy-wpimath's inverse and odometry, floats in and out",
    )  # fmt: skip
    yield figure(
        "driver's tick", 4, None,
        "the same with the limits of steering and motors and coordinated wheels: {} "
        "against {} of robotpy-wpimath with desaturate, optimize and cosineScale",
    )  # fmt: skip


def _over(inputs: Sequence[Any], work: Callable[..., object]) -> Callable[[], None]:
    def run() -> None:
        for _ in range(REPEATS):
            for given in inputs:
                work(*given)

    return run


class Wpimath:
    """The same through robotpy-wpimath; angles in rad, speeds in rad/s of wheels of 0.2 m."""

    def __init__(self, wheels: Sequence[tuple[float, float]]) -> None:
        from wpimath import geometry, kinematics

        cls = {4: kinematics.SwerveDrive4Kinematics, 6: kinematics.SwerveDrive6Kinematics}
        self._kinematics = cls[len(wheels)](*[geometry.Translation2d(x, y) for x, y in wheels])
        self._chassis = kinematics.ChassisSpeeds
        self._state = kinematics.SwerveModuleState
        self._rotation = geometry.Rotation2d

    def chassis(self, twist: Sequence[float]) -> Any:
        return self._chassis(*twist)

    def states(self, speeds: Sequence[float], angles: Sequence[float]) -> Any:
        state, rotation = self._state, self._rotation
        return tuple([state(0.2 * v, rotation(a)) for v, a in zip(speeds, angles, strict=True)])

    def objects(self, chassis: Any, states: Any) -> None:
        self._kinematics.toSwerveModuleStates(chassis)
        self._kinematics.toChassisSpeeds(states)

    def floats(
        self, twist: Sequence[float], speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[list[float], list[float], float, float, float]:
        asked = self._kinematics.toSwerveModuleStates(self._chassis(*twist))
        found = self._kinematics.toChassisSpeeds(self.states(speeds, angles))
        return (
            [s.speed / 0.2 for s in asked],
            [s.angle.radians() for s in asked],
            found.vx,
            found.vy,
            found.omega,
        )

    def choosing(
        self, twist: Sequence[float], speeds: Sequence[float], angles: Sequence[float]
    ) -> tuple[list[float], list[float], float, float, float]:
        made = self._kinematics
        asked = made.desaturateWheelSpeeds(made.toSwerveModuleStates(self._chassis(*twist)), 1.5)
        states = self.states(speeds, angles)
        for goal, now in zip(asked, states, strict=True):
            goal.optimize(now.angle)
            goal.cosineScale(now.angle)
        found = made.toChassisSpeeds(states)
        return (
            [s.speed / 0.2 for s in asked],
            [s.angle.radians() for s in asked],
            found.vx,
            found.vy,
            found.omega,
        )
