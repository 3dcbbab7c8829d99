"""Cost of recording a run: computing time compared with the plain run, and file size."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from bench.figure import Figure, in_turns
from bench.mission import manoeuvres, mission
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model.scenario import GROUPS
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.recorder import Recorder, record_ticks
from thorvaldc.simulation.simulation_run import Simulation

ROUNDS = 5
RATE = 50.0  # Hz, of the driver


def figures() -> Iterator[Figure]:
    scenario = mission(RATE)
    simulation = Simulation(scenario.fleet, emit(scenario.fleet, ["mjcf"]))
    seconds, plan = scenario.duration, manoeuvres(scenario)
    with tempfile.TemporaryDirectory() as folder:
        mcap, csv = Path(folder, "run.mcap"), Path(folder, "run.csv")

        def run(make: Callable[[], Recorder] | None = None) -> None:
            if make is None:
                simulation.run(seconds, plan)
                return
            recorder = make()
            simulation.run(seconds, plan, on_tick=record_ticks([recorder]))
            recorder.close()

        times = in_turns(
            run,
            lambda: run(lambda: McapRecorder(mcap, [*simulation.robots.items()], GROUPS)),
            lambda: run(lambda: CsvRecorder(csv, [*simulation.robots.items()], GROUPS)),
            rounds=ROUNDS,
        )
        plain, as_mcap, as_csv = map(statistics.median, times)
        sizes = [path.stat().st_size / seconds / 1000.0 for path in (mcap, csv)]
    ticks = seconds * RATE
    yield Figure.ratio(
        "a recorded run, relative to a plain one",
        2.0,
        zip(times[1], times[0], strict=True),
        f"MCAP of a 6WD6WS at {RATE:g} Hz, all groups, {seconds:g} s in"
        f" {as_mcap:.2f} s, {1e6 * (as_mcap - plain) / ticks:.0f} us per tick,"
        f" {sizes[0]:.0f} kB/s; CSV {as_csv / plain:.2f}, {1e6 * (as_csv - plain) / ticks:.0f}"
        f" us per tick, {sizes[1]:.0f} kB/s",
    )
