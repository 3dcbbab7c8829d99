"""What it costs to record a run: time beside the run without, and the size of the file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from bench.figure import Figure, least_times
from bench.mission import SECONDS, TWISTS
from bench.robots import built, example
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.manoeuvre import Segment
from thorvaldc.runtime.mcap_record import McapRecorder
from thorvaldc.runtime.record import CsvRecorder, Recorder, recording
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.simulation import Simulation

ROUNDS = 5


def figures() -> Iterator[Figure]:
    robot, files = built(example("6wd6ws_asymmetric"))
    simulation = Simulation(robot, files)
    plan = [Segment(7.0 * i, Twist(*twist)) for i, twist in enumerate(TWISTS)]
    with tempfile.TemporaryDirectory() as folder:
        mcap, csv = Path(folder, "run.mcap"), Path(folder, "run.csv")

        def run(make: Callable[[], Recorder] | None = None) -> None:
            if make is None:
                simulation.run(SECONDS, plan)
                return
            recorder = make()
            simulation.run(SECONDS, plan, watch=recording([recorder]))
            recorder.close()

        ways = [
            run,
            lambda: run(lambda: McapRecorder(mcap, simulation.robots, GROUPS)),
            lambda: run(lambda: CsvRecorder(csv, simulation.robots, GROUPS)),
        ]
        plain, as_mcap, as_csv = least_times(ways, ROUNDS)
        sizes = [path.stat().st_size / SECONDS / 1000.0 for path in (mcap, csv)]
    ticks = SECONDS * robot.driver.rate
    yield Figure(
        "a recorded run over a plain one",
        as_mcap / plain,
        "",
        2.0,
        "lower",
        f"MCAP of a 6WD6WS at {robot.driver.rate:g} Hz, all groups, {SECONDS:g} s in"
        f" {as_mcap:.2f} s, {1e6 * (as_mcap - plain) / ticks:.0f} us a tick,"
        f" {sizes[0]:.0f} kB/s; CSV {as_csv / plain:.2f}, {1e6 * (as_csv - plain) / ticks:.0f}"
        f" us a tick, {sizes[1]:.0f} kB/s",
    )
