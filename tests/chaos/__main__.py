"""``python -m tests.chaos``: runs seeds, shrinks violations, replays scripts."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from tests.chaos.chaos_robots import ROBOTS
from tests.chaos.mission_generator import MissionGenerator
from tests.chaos.schedule import Schedule
from tests.chaos.seed_runner import Outcome, run_here, run_schedule
from tests.chaos.shrinker import Shrinker
from tests.chaos.taken_out import TAKEN_OUT

PROGRESS = 100
"""Missions between two lines of progress."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--seeds", default="0:100", help="first:end, or one seed")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--robot", choices=list(ROBOTS), help="only this robot")
    parser.add_argument(
        "--without", metavar="NAME", help="take a fix out: all, or a name in taken_out.py"
    )
    parser.add_argument("--shrink", action="store_true", help="shrink each violation to a script")
    parser.add_argument("--stop", type=int, default=0, metavar="N", help="end after N violations")
    parser.add_argument("--print", action="store_true", help="print the schedule of each seed")
    parser.add_argument("--folder", type=Path, help="write shrunk scripts into this folder")
    parser.add_argument(
        "--warm", type=int, default=0, metavar="N", help="run N missions first, for PyPy's compiler"
    )
    parser.add_argument("scripts", nargs="*", type=Path, help="scripts to replay")
    options = parser.parse_args()
    if options.without == "all":
        return _without_each(options)
    if options.without:
        TAKEN_OUT[options.without]()
    if options.scripts:
        return _replay(options.scripts)
    for seed in range(-options.warm, 0):
        run_here(MissionGenerator(seed).schedule())
    first, _, end = options.seeds.partition(":")
    seeds = range(int(first), int(end) if end else int(first) + 1)
    children = []
    for job in range(1, options.jobs):
        child = os.fork()
        if child == 0:
            os._exit(_run(seeds[job :: options.jobs], options))
        children.append(child)
    status = _run(seeds[0 :: options.jobs], options)
    for child in children:
        status |= os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return status


def _without_each(options: argparse.Namespace) -> int:
    """Takes out each fix in turn, and counts the seeds until its absence is noticed."""
    status = 0
    for name in TAKEN_OUT:
        print(f"without {name}:", flush=True)
        child = os.fork()
        if child == 0:
            TAKEN_OUT[name]()
            options.stop = 1
            first, _, end = options.seeds.partition(":")
            os._exit(0 if _run(range(int(first), int(end)), options) else 1)
        status |= os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return status


def _replay(paths: list[Path]) -> int:
    status = 0
    for path in paths:
        outcome = run_schedule(Schedule.from_json(path.read_text(encoding="utf-8")))
        print(f"{path.name}: {_text(outcome)}")
        status |= not outcome.holds
    return status


def _run(seeds: range, options: argparse.Namespace) -> int:
    start, cpu = time.monotonic(), time.process_time()
    simulated: Counter[str] = Counter()
    runs: Counter[str] = Counter()
    violations: Counter[tuple[str, str]] = Counter()
    for seed in seeds:
        schedule = MissionGenerator(seed, options.robot).schedule()
        if options.print:
            print(schedule.to_json())
        outcome = run_schedule(schedule)
        runs[schedule.robot] += 1
        simulated[schedule.robot] += outcome.seconds  # type: ignore[assignment]
        if runs.total() % PROGRESS == 0:
            print(f"{runs.total()} missions, seed {seed}", file=sys.stderr, flush=True)
        if outcome.holds:
            continue
        if options.without and not _holds_with_all_fixes(seed, options):
            print(f"seed {seed} violates an invariant with all fixes, too")
            continue
        violations[schedule.robot, outcome.invariant] += 1
        print(
            f"seed {seed} ({schedule.robot}, from {schedule.start}): {_text(outcome)}", flush=True
        )
        if options.shrink:
            _shrink(schedule, outcome, options.folder)
        if options.stop and violations.total() >= options.stop:
            break
    wall = time.monotonic() - start
    used = time.process_time() - cpu + _children_time()
    hours = sum(simulated.values()) / 3600.0
    print(
        f"{runs.total()} schedules, {hours:.3f} simulated hours, {violations.total()} violations;"
        f" {wall:.1f} s, {used:.1f} s of CPU,"
        f" {60.0 * hours / max(used, 1e-9):.2f} simulated hours per minute of CPU"
    )
    for robot in sorted(runs):
        found = {name: n for (r, name), n in sorted(violations.items()) if r == robot}
        print(f"  {robot}: {runs[robot]} schedules, {simulated[robot] / 3600.0:.3f} h, {found}")
    return int(bool(violations))


def _holds_with_all_fixes(seed: int, options: argparse.Namespace) -> bool:
    """Runs a seed in a new process in which nothing is taken out."""
    command = [sys.executable, "-m", "tests.chaos", "--seeds", str(seed)]
    if options.robot:
        command += ["--robot", options.robot]
    return subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 0


def _children_time() -> float:
    times = os.times()
    return times.children_user + times.children_system


def _shrink(schedule: Schedule, outcome: Outcome, folder: Path | None) -> None:
    def fails(candidate: Schedule) -> bool:
        return run_schedule(candidate).invariant == outcome.invariant

    script = Shrinker(fails).shrink(schedule)
    print(script.to_json(), _text(run_schedule(script)), flush=True)
    if folder is not None:
        name = f"{outcome.invariant.replace(' ', '_')}_{schedule.seed}.json"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(script.to_json(), encoding="utf-8")


def _text(outcome: Outcome) -> str:
    if outcome.holds:
        return f"all invariants hold for {outcome.seconds:.1f} s"
    return f"{outcome.invariant} at {outcome.time:.2f} s: {outcome.text}"


if __name__ == "__main__":
    sys.exit(main())
