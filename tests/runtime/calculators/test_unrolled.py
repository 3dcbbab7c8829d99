"""The written-out estimate says what the loops say, to the last bit."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.twist_estimator import Estimation, TwistEstimator

SQUARE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
FOUR = [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(SQUARE)]


def random_wheels(rng: random.Random) -> list[WheelGeometry]:
    return [
        wheel(
            f"w{i}",
            rng.uniform(-2.0, 2.0),
            rng.uniform(-2.0, 2.0),
            rng.choice(["steered", "steered", "fixed", "swivel"]),
            heading=rng.choice([0.0, 0.3, math.pi]),
            sign=rng.choice([1.0, -1.0]),
        )
        for i in range(rng.randint(3, 9))
    ]


def states(
    wheels: list[WheelGeometry], rng: random.Random, size: float, noise: float
) -> JointStates:
    """Joints of a random motion; ``size`` 0 stands, ``noise`` is in parts of the default."""
    vx, vy, wz = (size * rng.uniform(-1.0, 1.0) for _ in range(3))
    speeds, angles = [], []
    for w in wheels:
        ux, uy = vx - wz * w.y, vy + wz * w.x
        direction = w.sign * (math.atan2(uy, ux) - w.heading) if w.steered else 0.0
        along = math.hypot(ux, uy) if w.steered else ux * math.cos(w.heading)
        speeds.append(along / w.radius * (1.0 + noise * rng.gauss(0.0, 0.01)) if w.driven else 0.0)
        angles.append(direction + (noise * rng.gauss(0.0, 0.0087) if w.steered else 0.0))
    return JointStates(0.0, speeds, angles, [0.0] * len(wheels))


def test_equal_to_the_last_bit() -> None:
    rng = random.Random(1)
    taken = 0
    for _ in range(60):
        wheels = random_wheels(rng)
        made = TwistEstimator(BaseGeometry.from_wheels(wheels))
        for size, noise in (
            (0.0, 0.0),
            (1e-3, 1.0),
            (1.0, 0.0),
            (1.0, 1.0),
            (1.0, 1.0),
            (1.0, 9.0),
        ):
            joints = states(wheels, rng, size, noise)
            assert made.estimate(joints) == made._estimate_closely(joints)
            if made._unrolled is not None:
                taken += made._unrolled(joints.speeds, joints.angles) is not None
    assert taken > 60


def test_a_suspected_wheel_is_left_to_the_loops() -> None:
    made = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    joints = states(FOUR, random.Random(1), 1.0, 0.2)
    assert made._unrolled is not None
    assert made._unrolled(joints.speeds, joints.angles) is not None
    joints.speeds = [1.3 * joints.speeds[0], *joints.speeds[1:]]
    assert made._unrolled(joints.speeds, joints.angles) is None
    assert made.estimate(joints).dropped == (0,)
    # Where none may be wrong they are tested, but not left out.
    trusting = TwistEstimator(BaseGeometry.from_wheels(FOUR), None, Estimation(faulty=0))
    assert trusting.estimate(joints) == trusting._estimate_closely(joints)
    assert trusting.estimate(joints).dropped == ()


def test_a_gyro_is_left_to_the_loops() -> None:
    made = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    joints = states(FOUR, random.Random(1), 1.0, 0.2)
    plain = made.estimate(joints)
    joints.yaw_rate = plain.twist.wz + 0.001
    assert plain.twist.wz < made.estimate(joints).twist.wz < joints.yaw_rate


@pytest.mark.parametrize(
    "wheels",
    [
        FOUR[:1],
        [wheel("a", 0.5, 0.0, "steered"), wheel("b", -0.5, 0.0, "passive"), *FOUR[:2]],
        [replace(FOUR[0], trail=0.1), *FOUR[1:]],
        [wheel(f"w{i}", x, y, "fixed") for i, (x, y) in enumerate(SQUARE)],
    ],
    ids=["rank 2", "no encoder", "a contact that moves", "skidding"],
)
def test_robots_that_it_is_not_for(wheels: list[WheelGeometry]) -> None:
    assert TwistEstimator(BaseGeometry.from_wheels(wheels))._unrolled is None


def test_a_polish_is_left_to_the_loops() -> None:
    geometry = BaseGeometry.from_wheels(FOUR)
    assert TwistEstimator(geometry, None, Estimation(polish=1))._unrolled is None
