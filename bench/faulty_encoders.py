"""Is the covariance of the twist right if encoders are wrong, or wheels spin on a slowed robot?

A Monte Carlo study over robots with two to six wheels, of which k have a fault.  The share of
samples outside of the 99.9 % ellipsoid of the reported covariance must not exceed 1 %: an estimate
may be inaccurate, but not wrong and sure.  ``broken_world`` has the same with physics.

The wheels follow their commands.  Faults:

- dead: the encoder reads 0;
- reversed: it reads the opposite speed;
- half: it reads half of the speed;
- stuck: it reads any constant speed up to 1 m/s;
- held: the wheel turns as commanded, and the robot and all other wheels stand;
- slowed: the same, and the robot and the other wheels move at a share of the commands;
- radius: one wheel is 5 % smaller than stated.  Its encoder agrees with its command, and five
  standard deviations of one of few measurements can stay unnoticed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench.figure import Figure
from bench.wheel_noise import drive, random_twists
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise, WheelGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator

GROUP = "long"

SAMPLES = 1000
FAULTS = ("dead", "reversed", "half", "stuck", "held", "slowed")
SPINNING = ("held", "slowed")
"""Faults in which the wheels with a fault spin; not all wheels can, unseen."""
WRONG_RADIUS = 1.05
STUCK_SPEED = 1.0
_BOUND = 16.266
"""99.9 % quantile of the chi-square distribution with 3 degrees of freedom."""
# (x, y) of the wheels, m; the fixed wheels of a robot are on one axle.
_LAYOUTS = {
    "2 steered": ("ss", [(0.5, 0.4), (-0.5, -0.4)]),
    "3 steered": ("sss", [(0.6, 0.0), (-0.4, 0.5), (-0.4, -0.5)]),
    "4 steered": ("ssss", [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]),
    "5 steered": ("sssss", [(0.8, 0.0), (0.3, 0.5), (0.3, -0.5), (-0.6, 0.5), (-0.6, -0.5)]),
    "6 steered": (
        "ssssss",
        [(1.0, 0.6), (0.9, -0.6), (0.2, 0.7), (-0.1, -0.7), (-1.0, 0.6), (-0.8, -0.6)],
    ),
    "2 fixed": ("ff", [(0.0, 0.4), (0.0, -0.4)]),
    "3 fixed": ("fff", [(0.0, 0.5), (0.0, 0.0), (0.0, -0.5)]),
    "2 fixed, 1 steered": ("ffs", [(-0.5, 0.4), (-0.5, -0.4), (0.5, 0.0)]),
    "2 fixed, 2 steered": ("ffss", [(-0.5, 0.4), (-0.5, -0.4), (0.5, 0.4), (0.5, -0.4)]),
}


class Share(NamedTuple):
    """Shares of the samples, in percent, and the mean of NEES/3.

    - ``outside``: the true twist is outside of the 99.9 % ellipsoid.
    - ``named``: exactly the faulty wheels are left out.
    - ``wrong``: a healthy wheel is left out.
    - ``silent``: a sample outside without a left out wheel or a suspect.
    """

    outside: float
    named: float
    wrong: float
    silent: float
    nees: float


def robots() -> dict[str, BaseGeometry]:
    """Returns the geometries of all robots by name."""
    return {
        name: BaseGeometry.from_wheels(
            [
                _wheel(i, x, y, kind == "s")
                for i, (kind, (x, y)) in enumerate(zip(*layout, strict=True))
            ]
        )
        for name, layout in _LAYOUTS.items()
    }


def figures() -> Iterator[Figure]:
    for name, geometry in robots().items():
        for fault in FAULTS:
            most = len(geometry.wheels) - (fault in SPINNING)
            shares = [study(geometry, fault, k, SAMPLES) for k in range(1, most + 1)]
            each = ", ".join(f"{s.outside:.1f}" for s in shares)
            how = (
                f"99.9 % ellipsoid, largest of k = 1 to {len(shares)} wheels ({each}), "
                f"{SAMPLES} motions each; NEES/3 up to {max(s.nees for s in shares):.2f}; "
                f"a good wheel left out: {max(s.wrong for s in shares):.1f} %"
            )
            worst = max(s.outside for s in shares)
            yield Figure(f"{fault} wheels, {name}: outside", worst, "%", 1.0, "lower", how)
        share = study(geometry, "radius", 1, SAMPLES)
        how = f"one radius 5 % off, {SAMPLES} motions; NEES/3 {share.nees:.2f}"
        yield Figure(f"wrong radius, {name}: outside", share.outside, "%", None, "lower", how)


def study(
    geometry: BaseGeometry, fault: str, faulty: int, samples: int, *, gyro: bool = False
) -> Share:
    """Returns the shares of random motions in which ``faulty`` random wheels have a fault."""
    rng = np.random.default_rng(11)
    wheels, noise = geometry.wheels, Noise()
    estimator = TwistEstimator(geometry)
    driven = drive(geometry, random_twists(geometry, samples, rng), noise, rng)
    counts, nees = np.zeros(4), 0.0
    for k in range(samples):
        speeds, angles = driven.speeds[:, k].tolist(), driven.angles[:, k].tolist()
        commanded, true = [*speeds], driven.twists[:, k]
        chosen = {int(i) for i in rng.choice(len(wheels), faulty, replace=False)}
        if fault in SPINNING:
            moves = 0.0 if fault == "held" else float(rng.uniform(0.0, 0.9))
            speeds = [v if i in chosen else moves * v for i, v in enumerate(speeds)]
            true = moves * true
        else:
            for i in chosen:
                commanded[i], speeds[i] = _with_fault(fault, speeds[i], wheels[i].radius, rng)
        states = JointStates(0.0, speeds, angles, [0.0] * len(wheels))
        if gyro:
            states.yaw_rate = float(true[2] + rng.normal(0.0, noise.gyro))
        estimate = estimator.estimate(states, commanded)
        error = true - np.array(estimate.twist)
        square = float(error @ np.linalg.solve(np.array(estimate.covariance), error))
        outside, left_out = square > _BOUND, set(estimate.dropped)
        silent = outside and not (left_out or estimate.suspects or estimate.sliding)
        counts += outside, left_out == chosen, bool(left_out - chosen), silent
        nees += square / 3.0
    return Share(*(100.0 * counts / samples).tolist(), nees / samples)


def _with_fault(
    fault: str, speed: float, radius: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Returns the commanded and the measured speed (rad/s) of a wheel that turns at ``speed``."""
    if fault == "radius":
        return speed * WRONG_RADIUS, speed * WRONG_RADIUS
    if fault == "stuck":
        return speed, float(rng.uniform(-STUCK_SPEED, STUCK_SPEED)) / radius
    return speed, {"dead": 0.0, "reversed": -1.0, "half": 0.5}[fault] * speed


def _wheel(number: int, x: float, y: float, steered: bool) -> WheelGeometry:
    return WheelGeometry(
        name=f"w{number}",
        x=x,
        y=y,
        heading=0.0,
        sign=1.0,
        trail=0.0,
        lateral=0.0,
        radius=0.2,
        driven=True,
        steered=steered,
        swivel=False,
        encoder=True,
        max_speed=7.5,
        max_acceleration=7.5,
        lower=-math.pi if steered else None,
        upper=math.pi if steered else None,
        max_rate=4.0 if steered else math.inf,
        max_rate_change=20.0 if steered else math.inf,
    )
