"""Time of the base calculators and of a driver's tick, and how far simulation is from real time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

from bench.figure import EXAMPLE, Figure
from bench.robots import places, wheel


def _fastest(work: Callable[[], object], calls: int, rounds: int = 100) -> float:
    """Time (s) of a call, undisturbed: the least over rounds of their mean."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        for _ in range(calls):
            work()
        times.append((time.perf_counter() - start) / calls)
    return min(times)


def figures() -> Iterator[Figure]:
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.general import General
    from thorvaldc.runtime.se2 import Twist

    for n in (4, 6, 9):
        wheels = [wheel(f"w{i}", x, y) for i, (x, y) in enumerate(places(n))]
        calculator = General(BaseGeometry.from_wheels(wheels))
        twists = [
            Twist(0.8, 0.1 * math.sin(k), 0.3 * math.cos(k)) for k in (0.1 * j for j in range(63))
        ]
        zeros = [0.0] * n
        joints = calculator.command(twists[0]).joints
        states = JointStates(0.0, joints.speeds, joints.angles, zeros)
        turn = iter(range(10**9))

        def inverse(
            calculator: General = calculator,
            states: JointStates = states,
            turn: Iterator[int] = turn,
            twists: list[Twist] = twists,
        ) -> object:
            return calculator.command(twists[next(turn) % 63], states, 0.02)

        def odometry(calculator: General = calculator, states: JointStates = states) -> object:
            return calculator.odometry(states)

        yield Figure(
            f"calculator command, N={n}",
            _fastest(inverse, 63) * 1e6,
            "us",
            None,
            "lower",
            "general: choice of angles, rates, coordination and saturation, wheels on the move",
        )
        yield Figure(
            f"calculator odometry, N={n}",
            _fastest(odometry, 63) * 1e6,
            "us",
            None,
            "lower",
            "general: weighted least squares with covariance and rank",
        )
    yield from _simulation()


def _simulation() -> Iterator[Figure]:
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.simulation.simulation_run import Simulation

    done = compile_file(EXAMPLE)
    if done.model is None:
        raise RuntimeError("the example has faults")
    simulation = Simulation(done.model, emit(done.model, ["mjcf"], done.report))
    factors = sorted(simulation.demonstrate().real_time_factor for _ in range(5))
    yield Figure(
        "simulation of 4WD4WS",
        factors[2],
        "x real time",
        10,
        "higher",
        "its default manoeuvre through the base driver at 50 Hz in MuJoCo, median of 5",
    )
