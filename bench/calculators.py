"""Time of a command and of the odometry of a base calculator, and of a simulation."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator

from bench.figure import EXAMPLE, Figure, in_turns
from bench.robots import wheel, wheel_positions


def _fastest(work: Callable[[], object], calls: int, rounds: int = 100) -> float:
    """Least time (s) of a call over all rounds; other programs on the machine only add time."""
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
        wheels = [wheel(f"w{i}", x, y) for i, (x, y) in enumerate(wheel_positions(n))]
        calculator = General(BaseGeometry.from_wheels(wheels))
        twists = [
            Twist(0.8, 0.1 * math.sin(k), 0.3 * math.cos(k)) for k in (0.1 * j for j in range(63))
        ]
        zeros = [0.0] * n
        joints = calculator.command(twists[0]).joints
        states = JointStates(0.0, joints.speeds, joints.angles, zeros)
        counter = iter(range(10**9))

        def inverse(
            calculator: General = calculator,
            states: JointStates = states,
            counter: Iterator[int] = counter,
            twists: list[Twist] = twists,
        ) -> object:
            return calculator.command(twists[next(counter) % 63], states, 0.02)

        def odometry(calculator: General = calculator, states: JointStates = states) -> object:
            return calculator.odometry(states)

        yield Figure(
            f"calculator command, N={n}",
            _fastest(inverse, 63) * 1e6,
            "us",
            None,
            "lower",
            "general: choice of angles, rates, coordination and saturation, while wheels steer",
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

    compilation = compile_file(EXAMPLE)
    if compilation.model is None:
        raise RuntimeError("the example has errors")
    simulation = Simulation(
        compilation.model, emit(compilation.model, ["mjcf"], compilation.report)
    )
    seconds = simulation.demonstrate().simulated
    (times,) = in_turns(simulation.demonstrate, rounds=5)
    yield Figure(
        "simulation of 4WD4WS",
        seconds / statistics.median(times),
        "x real time",
        10,
        "higher",
        "its default manoeuvre through the driver at 50 Hz in MuJoCo, processor time, median of 5",
        timed=True,
    )
