"""Accuracy of odometry relative to the Cramer-Rao bound, with healthy and with faulty wheels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bench.figure import Figure
from bench.random_pairs.random_pairs_calculator import RandomPairs, RandomPairsOptions
from bench.wheel_noise import (
    ROBOTS,
    Array,
    Drive,
    drive,
    estimate_all,
    geometry_of,
    random_twists,
)
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, Cov3, Pose2, Twist

GROUP = "long"

STATES = 4000
PAIRED = 500
"""Number of states for random_pairs, which takes much longer."""
FAULTS = 1000
DEAD = 500
LEVELS = {
    "1 %, 0.5 deg": Noise(),
    "0.2 %, 2 deg": Noise(speed_ratio=0.002, angle=math.radians(2.0)),
    "3 %, 1 deg": Noise(speed_ratio=0.03, angle=math.radians(1.0)),
}
NOMINAL = "1 %, 0.5 deg"
PAIRS = {
    "random_pairs as the paper says": RandomPairsOptions(special_cases=False),
    "random_pairs with special cases": RandomPairsOptions(),
}
FAULTS_OF_A_WHEEL = ("x1.1", "x1.3", "x2", "stalled", "+20 deg")


def figures() -> Iterator[Figure]:
    robots = {name: geometry_of(name) for name in ROBOTS}
    yield from _efficiency(robots)
    yield from _false_rejections(robots)
    for name, geometry in robots.items():
        if name != "2WD":  # two wheels always agree
            yield from _faults(name, geometry)
    yield from _dead_encoders(robots["4WD4WS"])
    yield from _run(robots["6WD6WS asymmetric"])


# -- twists ---------------------------------------------------------------------------


def _efficiency(robots: dict[str, BaseGeometry]) -> Iterator[Figure]:
    for level, noise in LEVELS.items():
        for name, geometry in robots.items():
            rng = np.random.default_rng(1)
            driven = drive(geometry, random_twists(geometry, STATES, rng), noise, rng)
            rows = (
                ("weighted", _estimates(geometry, noise, driven), 1.15),
                ("polished", _estimates(geometry, noise, driven, polish=2), 1.05),
                ("least squares", _least_squares(geometry, driven), None),
                *((how, _random_pairs(geometry, driven, how), None) for how in PAIRS),
            )
            for how, estimates, bound in rows:
                count = estimates.shape[1]
                part = Drive(driven.twists[:, :count], *_none(), driven.information[:count])
                yield Figure(
                    f"{how}, {name}, {level}",
                    part.efficiency(estimates),
                    "x bound",
                    bound,
                    "lower",
                    f"sqrt(NEES/3) against the Cramer-Rao bound, {count} motions",
                )


def _none() -> tuple[Array, Array]:
    return np.empty((0, 0)), np.empty((0, 0))


def _estimates(geometry: BaseGeometry, noise: Noise, driven: Drive, polish: int = 0) -> Array:
    calculator = General(geometry, GeneralOptions(polish=polish), noise)
    return estimate_all(calculator, driven.speeds, driven.angles)[0]


def _least_squares(geometry: BaseGeometry, driven: Drive) -> Array:
    estimator, still = General(geometry).estimator, [0.0] * len(geometry.wheels)
    joints = zip(driven.speeds.T.tolist(), driven.angles.T.tolist(), strict=True)
    twists = [estimator.least_squares(JointStates(0.0, *j, still)) for j in joints]
    estimates: Array = np.array(twists).T
    return estimates


def _random_pairs(geometry: BaseGeometry, driven: Drive, how: str, states: int = PAIRED) -> Array:
    calculator = RandomPairs(geometry, PAIRS[how])
    still = [0.0] * len(geometry.wheels)
    joints = zip(driven.speeds.T[:states].tolist(), driven.angles.T[:states].tolist(), strict=True)
    twists = [calculator.odometry(JointStates(0.0, *j, still)).twist for j in joints]
    estimates: Array = np.array(twists).T
    return estimates


def _false_rejections(robots: dict[str, BaseGeometry]) -> Iterator[Figure]:
    for name, geometry in robots.items():
        rng = np.random.default_rng(2)
        twists = random_twists(geometry, 5 * STATES, rng)
        driven = drive(geometry, twists, Noise(), rng)
        _, _, dropped = estimate_all(General(geometry), driven.speeds, driven.angles)
        yield Figure(
            f"false drops, {name}",
            100.0 * len(dropped) / twists.shape[1],
            "% of ticks",
            1.0,
            "lower",
            f"a healthy wheel left out, {NOMINAL}, {twists.shape[1]} motions",
        )


# -- one faulty wheel -----------------------------------------------------------------


def _faults(name: str, geometry: BaseGeometry) -> Iterator[Figure]:
    noise = Noise()
    steered = all(w.steered for w in geometry.wheels)
    for fault in FAULTS_OF_A_WHEEL:
        rng = np.random.default_rng(3)
        twists = random_twists(geometry, FAULTS, rng)
        driven = drive(geometry, twists, noise, rng)
        faulty = _apply_fault(geometry, driven, fault, rng)
        estimates, _, dropped = estimate_all(General(geometry), driven.speeds, driven.angles)
        yield Figure(
            f"one wheel {fault}, {name}",
            driven.efficiency(estimates),
            "x bound",
            1.6 if len(geometry.wheels) == 4 else 1.25,
            "lower",
            f"sqrt(NEES/3) against the bound of healthy wheels, {NOMINAL}, {FAULTS} motions; "
            f"least squares: {driven.efficiency(_least_squares(geometry, driven)):.1f}",
        )
        named = sum(dropped.get(k) == (int(i),) for k, i in enumerate(faulty))
        yield Figure(
            f"one wheel {fault} named, {name}",
            100.0 * named / FAULTS,
            "% of ticks",
            95.0 if steered else None,
            "higher",
            "only the faulty wheel is left out",
        )


def _apply_fault(
    geometry: BaseGeometry, driven: Drive, fault: str, rng: np.random.Generator
) -> Array:
    """Gives one random wheel of each state a fault, and returns the indices of these wheels."""
    candidates = [i for i, w in enumerate(geometry.wheels) if w.steered or "deg" not in fault]
    faulty = np.array(rng.choice(candidates, driven.twists.shape[1]))
    states = np.arange(len(faulty))
    if fault == "+20 deg":
        driven.angles[faulty, states] += math.radians(20.0)
    else:
        factor = 0.0 if fault == "stalled" else float(fault[1:])
        driven.speeds[faulty, states] *= factor
    return faulty


# -- two dead encoders ----------------------------------------------------------------


def _dead_encoders(geometry: BaseGeometry) -> Iterator[Figure]:
    """Two of four encoders read 0; only the commands show which ones."""
    estimator = General(geometry).estimator
    for knows in (False, True):
        rng = np.random.default_rng(8)
        healthy = drive(geometry, random_twists(geometry, DEAD, rng), Noise(), rng)
        right = wrong = 0
        nees = np.empty(DEAD)
        for k in range(DEAD):
            speeds, angles = healthy.speeds[:, k].tolist(), healthy.angles[:, k].tolist()
            dead = {int(i) for i in rng.choice(len(speeds), 2, replace=False)}
            measured = [0.0 if i in dead else v for i, v in enumerate(speeds)]
            states = JointStates(0.0, measured, angles, [0.0] * len(speeds))
            estimate = estimator.estimate(states, speeds if knows else None)
            right += set(estimate.dropped) == dead
            wrong += bool(set(estimate.dropped) - dead)
            error = healthy.twists[:, k] - np.array(estimate.twist)
            nees[k] = error @ np.linalg.solve(np.array(estimate.covariance), error) / 3.0
        how = f"4WD4WS, {DEAD} motions, {'with' if knows else 'without'} commands"
        name = "two dead encoders, " + ("commands known" if knows else "commands unknown")
        yield Figure(f"{name}: good wheels named", 100.0 * wrong / DEAD, "%", 1.0, "lower", how)
        yield Figure(f"{name}: dead ones named", 100.0 * right / DEAD, "%", None, "higher", how)
        yield Figure(f"{name}: NEES/3", float(nees.mean()), "", None, "lower", how)


# -- the paper's drive ----------------------------------------------------------------

DT, TICKS = 0.02, 3850
RUNS, LEAST_RUNS, PAIRED_RUNS = 100, 20, 5
LASTING = 2.0
"""Time constant (s) of the errors in the run with correlated errors."""
TRANSITION = 0.5
"""Time constant (s) of the change from one motion to the next."""
# (s, m/s forward, m/s to the left, rad/s): straight, sideways, diagonal and curved motions.
MANUAL = (
    (8.0, 1.2, 0.0, 0.0),
    (6.0, 1.0, 0.0, 0.5),
    (6.0, 0.9, 0.5, 0.0),
    (6.0, 0.9, -0.5, 0.0),
    (5.0, 1.1, 0.0, 0.4),
    (8.0, 1.2, 0.0, 0.02),
    (6.0, 0.0, 1.0, 0.1),
    (5.0, 1.1, 0.2, 0.5),
    (8.0, 1.2, 0.0, 0.0),
    (6.0, 1.0, 0.4, 0.4),
    (7.0, 1.1, -0.3, 0.1),
    (5.0, 1.0, 0.0, 0.5),
    (1.0, 0.0, 0.0, 0.0),
)
LENGTH = 80.2


def paper_drive() -> Array:
    """Returns twists (3, ticks) of a run of 77 s and 80.2 m with motions of all kinds."""
    commands = np.array([twist for seconds, *twist in MANUAL for _ in range(round(seconds / DT))])
    twists, current = np.empty((3, TICKS)), np.zeros(3)
    for k, twist in enumerate(commands):
        current = current + (DT / TRANSITION) * (twist - current)
        twists[:, k] = current
    twists *= LENGTH / float(np.hypot(twists[0], twists[1]).sum() * DT)
    return twists


def _run(geometry: BaseGeometry) -> Iterator[Figure]:
    twists = paper_drive()
    rng = np.random.default_rng(4)
    true = _end(twists)
    simulated = Noise(speed_floor=1e-9, slip_floor=1e-9)
    ends: dict[str, list[float]] = {how: [] for how in ("weighted", "least squares", *PAIRS)}
    nees: list[float] = []
    for run in range(RUNS):
        driven = drive(geometry, twists, simulated, rng)
        end, off = _estimated(geometry, driven, true)
        nees.append(off)
        ends["weighted"].append(_distance(end, true))
        if run < LEAST_RUNS:
            plain = _end(_least_squares(geometry, driven))
            ends["least squares"].append(_distance(plain, true))
        if run < PAIRED_RUNS:
            for how in PAIRS:
                plain = _end(_random_pairs(geometry, driven, how, TICKS))
                ends[how].append(_distance(plain, true))
    typical = {how: math.sqrt(sum(d * d for d in off) / len(off)) for how, off in ends.items()}
    conditions = "77 s, 80.2 m, 6WD6WS asymmetric, 50 Hz, 1 % and 0.5 deg"
    for how, distance in typical.items():
        yield Figure(
            f"end of the paper's run, {how}",
            distance,
            "m",
            None,
            "lower",
            f"root mean square of {len(ends[how])} runs: {conditions}",
        )
    for how, bound in zip(PAIRS, (10.0, None), strict=True):
        yield Figure(
            f"{how} over weighted",
            typical[how] / typical["weighted"],
            "x",
            bound,
            "higher",
            "end errors of the paper's run",
        )
    yield from _within("pose NEES/3", sum(nees) / RUNS / 3.0, f"{RUNS} runs: {conditions}")
    yield from _lasting(geometry, twists, true)


def _lasting(geometry: BaseGeometry, twists: Array, true: Pose2) -> Iterator[Figure]:
    """The same run with correlated errors, such as those of ground, tyres and steering play."""
    rng = np.random.default_rng(5)
    simulated = Noise(speed_floor=1e-9, slip_floor=1e-9)
    correlation = math.exp(-DT / LASTING)
    distances = []
    for _ in range(RUNS):
        errors = rng.standard_normal((2, len(geometry.wheels), TICKS))
        errors[:, :, 1:] *= math.sqrt(1.0 - correlation * correlation)
        for k in range(1, TICKS):
            errors[:, :, k] += correlation * errors[:, :, k - 1]
        driven = drive(geometry, twists, simulated, rng, errors)
        distances.append(_distance(_end(_estimates(geometry, Noise(), driven)), true))
    yield Figure(
        "end of the paper's run, lasting errors",
        math.sqrt(sum(d * d for d in distances) / RUNS),
        "m",
        None,
        "lower",
        f"errors with a time constant of {LASTING:g} s; the real robot ended 2.2 m off",
    )


def _within(name: str, value: float, how: str) -> Iterator[Figure]:
    yield Figure(f"{name}, at most", value, "", 1.2, "lower", how)
    yield Figure(f"{name}, at least", value, "", 0.8, "higher", how)


def _end(twists: Array) -> Pose2:
    pose = ORIGIN
    for vx, vy, wz in twists.T.tolist():
        pose = pose.moved(se2.exp(Twist(vx, vy, wz), DT))
    return pose


def _estimated(geometry: BaseGeometry, driven: Drive, true: Pose2) -> tuple[Pose2, float]:
    """Returns the end pose of the odometry, and its NEES."""
    twists, covariances, _ = estimate_all(General(geometry), driven.speeds, driven.angles)
    pose, covariance = ORIGIN, ZERO_COV
    for (vx, vy, wz), (a, b, c) in zip(twists.T.tolist(), covariances.tolist(), strict=True):
        twist = Twist(vx, vy, wz)
        q: Cov3 = (tuple(a), tuple(b), tuple(c))
        _, covariance = se2.integrate(covariance, twist, q, DT)
        pose = pose.moved(se2.exp(twist, DT))
    error = np.array(true.relative_to(pose))
    return pose, float(error @ np.linalg.solve(np.array(covariance), error))


def _distance(a: Pose2, b: Pose2) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)
