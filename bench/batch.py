"""Many runs: one result whatever runs it, and how fast processes are."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.figure import EXAMPLE, ROOT, Figure, processor_time, python
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.source.overrides import parse_choices
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.scenario_sweep import Sweep
from thorvaldc.simulation.worker_processes import processors

SCENARIO = ROOT / "examples" / "scenarios" / "field_edge.yaml"
RUNS, SECONDS = 48, 20
MANY = f"""thorvaldc: 1
scenario: many
robots: {{cart: {{robot: {EXAMPLE}}}}}
duration: {SECONDS} s
script: [{{at: 0, vx: 0.8 m/s, wz: 0.2 rad/s}}]
"""


def figures() -> Iterator[Figure]:
    yield _repeats()
    with TemporaryDirectory() as folder:
        path = Path(folder, "many.yaml")
        path.write_text(MANY, encoding="utf-8")
        yield from _processes(path)


def _repeats() -> Figure:
    """How many different hashes two runs and two other processes give."""
    done = compile_file(SCENARIO)
    if done.scenario is None:
        raise SystemExit(f"{SCENARIO} does not compile")
    simulation = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"]))
    found = [simulation.play(Report()).hash for _ in range(2)]
    for seed in ("1", "2"):
        said = subprocess.run(
            python("-m", "thorvaldc", "sim", str(SCENARIO), "--json"),
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        )
        found.append(json.loads(said.stdout)["hash"])
    return Figure(
        "results of one scenario",
        len(set(found)),
        "",
        1,
        "lower",
        "different hashes of every number of every tick: two runs in this process, one each in"
        f" two others with other PYTHONHASHSEEDs, of {SCENARIO.stem}",
    )


def _processes(path: Path) -> Iterator[Figure]:
    frictions = ",".join(f"{0.5 + 0.5 * k / RUNS:.3f}" for k in range(RUNS))
    sweep = Sweep(path, dict([parse_choices(f"world.friction={frictions}")]))
    hashes, rates, work = set(), [], []
    for jobs in dict.fromkeys((1, processors())):
        started, before = time.perf_counter(), processor_time()
        runs = sorted(sweep.runs(jobs), key=lambda run: run.number)
        rates.append(RUNS * SECONDS / (time.perf_counter() - started))
        work.append(processor_time() - before)
        hashes.add(tuple(run.result["hash"] if run.result else "" for run in runs))
    yield Figure(
        "results of one sweep",
        len(hashes),
        "",
        1,
        "lower",
        f"different lists of hashes of {RUNS} runs in one process and over all processors",
    )
    yield Figure(
        "sweep over processes",
        rates[-1],
        "s/s",
        None,
        "higher",
        f"simulated time over time, {RUNS} runs of {SECONDS} s of 4WD4WS with driver and"
        f" odometry, {processors()} processes; one: {rates[0]:.4g}",
    )
    yield Figure(
        "processor time of processes",
        work[-1] / work[0],
        "",
        1.5,
        "lower",
        f"of those {RUNS} runs over {processors()} processes, over that in one, which took"
        f" {work[0]:.3g} s: what it costs to begin them",
        timed=True,
    )
