"""Time to compile, step and drive N equal robots in one scene, as a function of N."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np

from bench.figure import Figure, in_turns
from bench.robots import example
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Fleet
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment
from thorvaldc.simulation.simulation_run import Simulation

GRIDS = {1: (1, 1), 10: (2, 5), 100: (10, 10)}
"""Rows and columns of the grid by the number of robots."""
SECONDS = 0.5
PLAN = (Segment(0.0, Twist(0.8, 0.1, 0.1)), Segment(0.25, Twist(0.8, -0.2, -0.2)))
ROUNDS = 9


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        paths = {number: _document(Path(folder), number) for number in GRIDS}
        compiles = [_compiling(path) for path in paths.values()]
        yield _growth(
            "compiling a fleet of 100",
            in_turns(*compiles, rounds=3),
            1e3,
            "ms",
            "compile and emit of all four targets",
        )
        loops = [_Loops(path) for path in paths.values()]
    works = [work for loop in loops for work in (loop.whole, loop.bare)]
    times = in_turns(*works, rounds=ROUNDS)
    whole, bare = times[::2], times[1::2]
    ticks, steps = loops[0].ticks, loops[0].steps
    yield _growth(
        "a step of 100 robots",
        bare,
        1e6 / ticks / steps,
        "us",
        "mj_step alone, driving 4WD4WS robots",
    )
    yield _growth(
        "a tick of 100 robots",
        whole,
        1e6 / ticks,
        "us",
        f"{steps} steps of physics, and the driver and odometry of each robot, 50 Hz;"
        f" {100 * statistics.median(bare[-1]) / statistics.median(whole[-1]):.0f} % of it is"
        " mj_step",
    )


def _document(folder: Path, number: int) -> Path:
    rows, columns = GRIDS[number]
    path = folder / f"{number}.yaml"
    path.write_text(
        "thorvaldc: 1\nname: many\nrobots:\n"
        f"  r: {{robot: {example('4wd4ws_wide')},"
        f" grid: {{rows: {rows}, columns: {columns}, spacing: 3 m}}}}\n",
        encoding="utf-8",
    )
    return path


def _compiling(path: Path) -> Callable[[], object]:
    return lambda: emit(_fleet(path), DEFAULT_TARGETS)


def _fleet(path: Path) -> Fleet:
    model = compile_file(path).model
    if not isinstance(model, Fleet):
        raise SystemExit(f"{path} does not compile")
    return model


class _Loops:
    """A run of a fleet, and the same physics steps without the drivers."""

    def __init__(self, path: Path) -> None:
        fleet = _fleet(path)
        self.simulation = Simulation(fleet, simulation_files(fleet))
        if self.simulation.scene is None:
            raise SystemExit("there is no scene")
        self.scene = self.simulation.scene
        controls: list[np.ndarray] = []
        last = fleet.placements[-1].name

        def keep(loop: ControlLoop) -> None:
            if loop.name == last:
                controls.append(self.scene.data.ctrl.copy())

        self.simulation.run(SECONDS, PLAN, on_tick=keep)
        self.controls = controls[:-1]
        self.ticks = len(self.controls)
        self.steps = round(SECONDS / self.ticks / self.scene.timestep)

    def whole(self) -> None:
        self.simulation.run(SECONDS, PLAN)

    def bare(self) -> None:
        self.scene.reset()
        model, data = self.scene.model, self.scene.data
        for control in self.controls:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, self.steps)


def _growth(name: str, times: list[list[float]], scale: float, unit: str, what: str) -> Figure:
    medians = zip(GRIDS, map(statistics.median, times), strict=True)
    each = ", ".join(f"{n}: {t / n * scale:.3g}" for n, t in medians)
    return Figure.ratio(
        name,
        1.15,
        [(large, 10 * small) for _, small, large in zip(*times, strict=True)],
        f"relative to ten times that of 10; {what}; {unit} per robot in scenes of {each}",
    )
