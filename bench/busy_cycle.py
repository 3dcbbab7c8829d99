"""The control cycle of nine wheels at 200 Hz in real time, alone and beside busy neighbours.

The joints are ideal, so that a cycle contains the driver, the odometry and the pace.  The
neighbours are processes that only compute, one for each processor.
"""

from __future__ import annotations

import contextlib
import gc
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from bench.figure import Figure, is_compiled
from bench.robots import drives_with, example
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.worker_processes import processors

RATE, SECONDS = 200.0, 5.0
TWIST = Twist(0.3, 0.0, 0.2)
NEIGHBOUR = "while True: pass"


def figures() -> Iterator[Figure]:
    robot = compile_file(example("9wd9ws")).model
    if not isinstance(robot, Robot):
        raise SystemExit("the example does not compile")
    robot = replace(robot, driver=replace(robot.driver, rate=RATE, arming="automatic"))
    for name, number in (("alone", 0), ("beside busy neighbours", processors())):
        with contextlib.ExitStack() as stack:
            for _ in range(number):
                neighbour = subprocess.Popen([sys.executable, "-c", NEIGHBOUR])
                stack.callback(neighbour.wait)
                stack.callback(neighbour.kill)
            off, work, skipped = _run(robot)
        yield Figure(
            f"cycle of 9 wheels at {RATE:g} Hz {name}",
            1e3 * _part(off, 0.99),
            "ms",
            None,
            "lower",
            f"99 % of {len(off)} cycles begin within it after {1e3 / RATE:g} ms, half within"
            f" {1e3 * _part(off, 0.5):.2f} ms, all within {1e3 * off[-1]:.2f} ms, {skipped} are"
            f" skipped; work of the driver {1e3 * statistics.median(work):.2f} ms, 99 % below"
            f" {1e3 * _part(work, 0.99):.2f} ms, longest {1e3 * work[-1]:.2f} ms,"
            f" {'compiled' if is_compiled() else 'interpreted'}",
        )


def _part(values: list[float], share: float) -> float:
    return values[min(int(share * len(values)), len(values) - 1)]


def _run(robot: Robot) -> tuple[list[float], list[float], int]:
    """Drives in real time.

    Returns how far the time between two cycles is off the period (s), the work of the driver in a
    cycle (s), both sorted, and the number of skipped cycles.
    """
    driven = DrivenRobot(robot, SimBase(robot))
    command = drives_with(driven, TWIST)
    begins: list[float] = []
    work: list[float] = []

    def feed(driver: BaseDriver, now: float) -> None:
        begins.append(time.perf_counter())
        command(driver, now)

    def watch(_: DrivenRobot, state: DriverState) -> None:
        work.append(time.perf_counter() - begins[-1])

    driven.feed = feed
    gc.collect()
    gc.freeze()
    driven.run(SECONDS, watch=watch)
    gc.unfreeze()
    if driven.driver.state.odometry.twist.vx < 0.9 * TWIST.vx:
        raise SystemExit(f"the robot does not drive: {driven.driver.state.hold_reason}")
    driven.shutdown()
    off = sorted(abs(b - a - driven.period) for a, b in pairwise(begins[: len(work)]))
    return off, sorted(work), driven.timing.skipped
