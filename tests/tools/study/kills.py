"""``python -m tests.tools.study.kills 30``: kills at random instants; the table has the same bytes.

At each instant, one process is killed by SIGKILL: a local process of the study, a Dask worker, the
Dask scheduler or the study itself.  What was killed is started again, the study ends with the same
command, and the bytes of its table are compared with those of an undisturbed study.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import chdir
from pathlib import Path

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD
from tests.tools.study.dask_processes import ROOT, DaskProcesses

DESIGNS = 60
VICTIMS = ("local process", "study", "worker", "scheduler", "study on a cluster")
DEADLINE = 500.0
"""Time for a study, also with what is started again (s)."""
COMMAND = (sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml")
STUDY = """\
thorvaldc: 1
study: track
robot: good.yaml
variables:
  track: {{paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}}
constraints:
  tip_over: {{fact: stability.angles.left, at_least: 40 deg}}
scenarios: {{go: {{scenario: drive.yaml}}}}
objectives:
  energy: {{metric: go.energy, goal: minimise}}
samples: {{method: random, number: {designs}, seed: 3}}
"""
DRIVE = """\
thorvaldc: 1
scenario: drive
robots: {good: {robot: good.yaml}}
duration: 0.4 s
script: [{at: 0, vx: 0.5 m/s}]
"""


class KilledStudy:
    """A study in the current folder, whose processes are killed."""

    def __init__(self, random_instants: random.Random, designs: int = DESIGNS) -> None:
        self.random, self.designs = random_instants, designs
        for name, text in (
            ("good", GOOD),
            ("study", STUDY.format(designs=designs)),
            ("drive", DRIVE),
        ):
            Path(f"{name}.yaml").write_text(text, encoding="utf-8")
        start = time.monotonic()
        self._finish("whole", "-j", "1")
        self.duration = time.monotonic() - start
        self.whole = Path("whole/designs.parquet").read_bytes()

    def has_same_bytes_after(self, victim: str, folder: str) -> tuple[bool, int]:
        """Kills a victim once at a random instant, and runs the study to its end.

        Returns whether the table is the undisturbed one, and the number of designs that were
        finished at the kill.
        """
        instant = self.random.randrange(1, self.designs * 3 // 4), self.random.uniform(0.0, 0.2)
        if victim in VICTIMS[:2]:
            finished = self._kill_local(victim, folder, instant)
            self._finish(folder, "-j", "2")
        else:
            finished = self._kill_on_cluster(victim, folder, instant)
        return Path(folder, "designs.parquet").read_bytes() == self.whole, finished

    def _kill_local(self, victim: str, folder: str, instant: tuple[int, float]) -> int:
        with self._start(folder, "-j", "2") as study:
            _wait(study, folder, *instant)
            if victim == "study":
                study.kill()
            elif children := _children(study.pid):
                os.kill(self.random.choice(children), signal.SIGKILL)
            finished = _finished(folder)
            study.wait(DEADLINE)
            assert victim == "study" or study.returncode == 0
        return finished

    def _kill_on_cluster(self, victim: str, folder: str, instant: tuple[int, float]) -> int:
        dask = DaskProcesses(2)
        address = ("--scheduler", dask.address)
        try:
            with self._start(folder, *address) as study:
                _wait(study, folder, *instant)
                finished = _finished(folder)
                if victim == "worker":
                    self.random.choice(dask.workers).kill()
                    dask.start_worker()
                elif victim == "scheduler":
                    dask.scheduler.kill()
                    dask.scheduler.wait()
                    dask.start_scheduler()
                    for _ in range(2):
                        dask.start_worker()
                else:
                    study.kill()
                study.wait(DEADLINE)
            assert victim in VICTIMS[-2:] or study.returncode == 0, victim
            self._finish(folder, *address)
        finally:
            dask.close()
        return finished

    def _finish(self, folder: str, *options: str) -> None:
        with self._start(folder, *options) as study:
            assert study.wait(DEADLINE) == 0, "the study has failed"

    def _start(self, folder: str, *options: str) -> ChildProcess:
        return ChildProcess(
            [*COMMAND, "-o", folder, *options],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )


def _wait(process: ChildProcess, folder: str, designs: int, seconds: float) -> None:
    """Waits until a number of designs is finished, and then for a time (s)."""
    while process.poll() is None and _finished(folder) < designs:
        time.sleep(0.002)
    time.sleep(seconds)


def _finished(folder: str) -> int:
    journal = Path(folder, "journal.log")
    return journal.read_bytes().count(b'"key":') if journal.exists() else 0


def _children(parent: int) -> list[int]:
    """Returns the processes of a local study: children that Python has spawned."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [
        int(child)
        for child in children
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.tools.study.kills", description=__doc__)
    parser.add_argument("number", type=int, help="number of instants")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--victim", choices=VICTIMS, help="only this one")
    options = parser.parse_args()
    different: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        study = KilledStudy(random.Random(options.seed))
        print(f"undisturbed: {study.duration:.1f} s")
        for number in range(options.number):
            victim = options.victim or VICTIMS[number % len(VICTIMS)]
            start = time.monotonic()
            same, finished = study.has_same_bytes_after(victim, f"killed{number}")
            different[victim] += not same
            print(
                f"{number + 1} {victim}: killed with {finished} of {DESIGNS} designs finished,"
                f" {'same bytes' if same else 'OTHER BYTES'}, {time.monotonic() - start:.1f} s",
                flush=True,
            )
    print(f"{options.number} kills, {different.total()} tables with other bytes")
    return 1 if different.total() else 0


if __name__ == "__main__":
    sys.exit(main())
