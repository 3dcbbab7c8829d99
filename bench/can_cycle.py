"""The control cycle in real time, on a simulated bus in another process: nine drives at 50 Hz."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from bench.figure import ROOT, Figure
from bench.robots import drives_with, example
from thorvaldc.can.open_interface import open_interfaces
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.pace import Timing
from thorvaldc.runtime.se2 import Twist

SECONDS = float(os.environ.get("CAN_CYCLE_SECONDS", "20"))
TWIST = Twist(0.3, 0.0, 0.2)
MOST_FAULTS = 10


def figures() -> Iterator[Figure]:
    path = example("9wd9ws")
    robot = compile_file(path).model
    if not isinstance(robot, Robot):
        raise SystemExit(f"{path} does not compile")
    with tempfile.TemporaryDirectory() as folder, _bus(str(path), folder) as channel:
        driven, work, faults = _run(robot, channel)
    base, timing = driven.base, driven.timing
    # The pause between two drives is not a cycle.
    gaps = [gap for a, b in pairwise(timing.starts) if (gap := b - a) < 1.0]
    spread = statistics.pstdev(gaps)
    off = sorted(abs(gap - driven.period) for gap in gaps)
    connection = base.connections[0]
    said = (
        f"9WD9WS at {1.0 / driven.period:g} Hz for {SECONDS:g} s of driving,"
        f" {timing.cycles} cycles,"
        f" {connection.receiver.received / timing.starts[-1]:.0f} frames/s received;"
        f" bus and driver share {os.cpu_count()} cores"
    )
    yield Figure("CAN cycle, mean", 1e3 * statistics.fmean(gaps), "ms", None, "lower", said)
    yield Figure(
        "CAN cycle, spread",
        1e3 * spread,
        "ms",
        None,
        "lower",
        f"standard deviation of the cycle; 99 % within {1e3 * off[int(0.99 * len(off))]:.2f} ms,"
        f" worst {1e3 * off[-1]:.2f} ms",
    )
    yield Figure(
        "CAN cycle, deadlines missed",
        timing.overruns,
        "",
        None,
        "lower",
        f"of {timing.cycles} cycles, {timing.skipped} of them skipped; started late by"
        f" {1e3 * timing.latest:.2f} ms at the most; {base.incomplete} not sent whole,"
        f" {connection.receiver.dropped} events dropped;"
        f" {len(faults)} times stopped and reset{': ' + faults[0] if faults else ''}",
    )
    work.sort()
    yield Figure(
        "CAN cycle, work",
        1e3 * statistics.median(work),
        "ms",
        10.0,
        "lower",
        f"median from its start until all frames are sent, 99 % below"
        f" {1e3 * work[int(0.99 * len(work))]:.2f} ms, longest {1e3 * work[-1]:.2f} ms",
        timed=True,
    )


def _run(robot: Robot, channel: str) -> tuple[DrivenRobot, list[float], list[str]]:
    """Drives for ``SECONDS``; returns driven, cycle times, and reset faults."""
    interfaces = open_interfaces(f"sim:{channel}", robot)
    clock = next(iter(interfaces.values()))
    robot = replace(robot, driver=replace(robot.driver, arming="automatic"))
    base = CanBase(robot, interfaces)
    driven = DrivenRobot(robot, base, clock, keep_starts=True)
    work: list[float] = []

    def watch(_: DrivenRobot, state: DriverState) -> None:
        work.append(clock.now - state.time)

    driven.feed = drives_with(driven, TWIST)
    gc.collect()
    gc.freeze()
    remaining, faults = SECONDS, []
    starting, driving = Timing(), driven.timing
    while remaining > 0.0:
        driven.pace.timing = starting
        driven.run(clock.now + 30.0, stop=lambda: driven.ready or base.state is BaseState.FAULT)
        if base.state is BaseState.FAULT and len(faults) < MOST_FAULTS:
            faults.append(base.state_machine.reason)
            driven.reset()
            continue
        if not driven.ready:
            raise SystemExit(f"the robot is {base.state.value}: {base.state_machine.reason}")
        driven.pace.timing, start = driving, clock.now
        driven.run(start + remaining, watch=watch, stop=lambda: not driven.ready)
        remaining -= clock.now - start
        if not driven.ready:
            # On a busy machine the bus or the driver may wait too long.
            driven.pace.timing = starting
            driven.run(clock.now + 1.0)
    driven.shutdown()
    gc.unfreeze()
    return driven, work, faults


@contextlib.contextmanager
def _bus(path: str, folder: str) -> Iterator[str]:
    """Runs `thorvaldc bus` in its own process; yields the name of its channel."""
    socket = os.path.join(folder, "bus.sock")
    process = subprocess.Popen(
        [sys.executable, "-m", "thorvaldc", "bus", path, "--channel", socket, "--json"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        line = process.stdout.readline() if process.stdout is not None else ""
        if not line:
            raise SystemExit("the simulated bus does not start")
        time.sleep(0.5)
        yield str(json.loads(line)[0]["channel"])
    finally:
        process.terminate()
        process.communicate(timeout=20)
