"""Changes the package in small ways and checks that a test fails.

    make mutants LAYER=runtime NUMBER=20 SEED=1    a sample of one layer
    make mutants LAYER=runtime ROBOTS=all             its survivors, with every test and robot too
    workshop/mutants.py --layer can --last near       only the first of the stages
    workshop/mutants.py --layer can --list            show the sample, run nothing

A mutant is the package with one change: another comparison, a sign, a number, a deleted statement,
two swapped arguments.  A mutant that no test notices is a hole in the tests, or the change makes no
difference (an equivalent mutant); a person judges.  The same seed gives the same mutants as long as
the layer does not change.

A mutant is judged in stages, and the first test that fails ends them:

    near         the tests of CI in the mirrored folder: those that execute the changed line, quick
                 ones first, then the others of their files, which may share what a fixture computed
    far          the same tests of all other folders, up to a limit; what is not run is counted
    all robots   if asked: all other tests, also the exhaustive ones, of the files that
                 execute the changed file

What the last stage notices is what the choice of robots and groups loses.  The results are kept in
``build/mutants.jsonl``: a run that ended early goes on, and the share is exact.  A noticed mutant
is judged again when its file changes, a survivor also when a test file of the stage does.  Which
tests execute a line is recorded in ``.mutants/`` by the first run (``executed_lines.py``).
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import itertools
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from code_changes import Mutant, sample
from executed_lines import (
    LEFT_OUT,
    ROOT,
    ExecutedLines,
    copy_of_the_tree,
    digest_of,
    import_dependencies,
    is_recorded,
    record,
    run_tests,
    test_files,
)

RESULTS = ROOT / "build" / "mutants.jsonl"
STAGES = NEAR, FAR, ALL_ROBOTS = "near", "far", "all robots"
TESTS_LIMIT = 120.0
"""s for all tests of one mutant in a stage, by the durations of the recording."""
BATCHES = (1.5, 20.0, TESTS_LIMIT)
"""s of tests in each process of a mutant: most mutants are noticed by the first tests."""
COLLECTION = 0.2
"""s to collect a test file."""
SLOW = 1.5
"""s; a slower test may fail by the load of the machine, and is repeated without the mutant."""


def tests_of(mutant: Mutant, executed: ExecutedLines) -> tuple[list[list[str]], int]:
    """Returns the tests of a mutant in the order in which they run, those of each process, and the
    number of those that the limit of time leaves out."""
    inner = mutant.path.relative_to("thorvaldc")
    executing: list[tuple[float, str]] = []
    beside: list[tuple[float, str]] = []
    for name, tests in executed.tests_of(mutant.path, mutant.executed):
        file = Path(name)
        is_mirrored = file.is_relative_to("tests" / inner.parent)
        far = 1.0 if inner.stem.strip("_") in file.stem else 3.0 if is_mirrored else 6.0
        # Each file has a share of the time: tests of one file notice similar mutants.
        time = {True: 0.0, False: 0.0}
        for test in sorted(executed.tests_in(name), key=executed.seconds.__getitem__):
            time[test in tests] += far * (executed.seconds[test] + 0.1)
            (executing if test in tests else beside).append((time[test in tests], test))

    batches: list[list[str]] = [[] for _ in BATCHES]
    used = [0.0 for _ in BATCHES]
    files: set[tuple[int, str]] = set()
    number = left_out = 0
    for _, test in [*sorted(executing), *sorted(beside)]:
        if test in executed.fails:  # without a mutant, too
            left_out += 1
            continue
        if number < len(BATCHES) and used[number] > BATCHES[number]:
            number += 1
        if number == len(BATCHES):
            left_out += 1
            continue
        name = test.partition("::")[0]
        used[number] += executed.seconds[test] + COLLECTION * ((number, name) not in files)
        files.add((number, name))
        batches[number].append(test)
    return list(filter(None, batches)), left_out


class UndecidedError(RuntimeError):
    """The tests of a mutant cannot run, with and without it."""


class Verdict(NamedTuple):
    """What the tests of a stage say about a mutant."""

    failure: str
    """The test that failed, or ''."""
    tests: int
    """Number of tests of the stage, without those left out."""
    left_out: int


def judge(mutant: Mutant, tree: Path, executed: ExecutedLines) -> Verdict:
    """Runs the tests of CI of a mutant in the copy ``tree``."""
    batches, left_out = tests_of(mutant, executed)
    failure = ""
    for batch in batches:
        failure = failure or _failure(mutant, tree, batch, executed.seconds)
    return Verdict(failure, sum(map(len, batches)), left_out)


def judge_with_all_robots(mutant: Mutant, tree: Path, executed: ExecutedLines) -> Verdict:
    """Runs the tests that CI leaves out, of the files that execute the file of a mutant."""
    files = [name for name, _ in executed.tests_of(mutant.path, range(0))]
    failure = ""
    for name in files:
        failure = failure or _failure(mutant, tree, [name], {}, executed.seconds)
    return Verdict(failure, len(files), 0)


def _failure(
    mutant: Mutant,
    tree: Path,
    tests: list[str],
    durations: Mapping[str, float],
    known: Collection[str] = (),
) -> str:
    """Returns the first of ``tests`` that fails with the mutant and passes without it, or ''.

    ``known``: the tests of CI, if those that it leaves out are to run.
    """
    original = (tree / mutant.path).read_text()
    seconds = [durations.get(test, TESTS_LIMIT) for test in tests]
    left_out = set(known)
    run = functools.partial(run_tests, tree, all_robots=bool(known), left_out=left_out)
    factor = 50.0 if known else 5.0
    limit, test_limit = 60.0 + factor * sum(seconds), 20.0 + factor * max(seconds)
    try:
        while True:
            _write(tree / mutant.path, mutant.apply(original))
            outcome = run(tests, limit, test_limit)
            if outcome.status in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
                return ""
            failed = outcome.failure or f"exit status {outcome.status}"
            is_test = "::" in failed  # and no file that cannot be imported
            if durations.get(failed, SLOW) < SLOW and outcome.status == 1 and is_test:
                return failed
            again = [failed] if is_test else tests
            _write(tree / mutant.path, original)
            without_mutant = run(again, limit)
            if without_mutant.status == 0:
                return failed
            if without_mutant.status == pytest.ExitCode.USAGE_ERROR:
                raise RuntimeError(f"pytest does not find all of {', '.join(again)}")
            if not is_test:
                raise UndecidedError(
                    f"{failed} without the mutant, too, of {', '.join(tests)[:500]}"
                )
            print(f"left out, fails without a mutant: {failed}", flush=True)
            left_out.add(failed)
    finally:
        _write(tree / mutant.path, original)


_moments = itertools.count(1)


def _write(file: Path, text: str) -> None:
    """Writes a file with a time of its own, so that Python does not take an older compiled one."""
    file.write_text(text)
    os.utime(file, (next(_moments), next(_moments)))


# -- results ---------------------------------------------------------------------------------------


class Results:
    """The verdicts so far, in the file ``RESULTS``."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], dict[str, Any]] = {}
        if RESULTS.exists():
            for line in RESULTS.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                self._known[entry["mutant"], entry["stage"]] = entry

    def find(self, mutant: Mutant, stage: str, tests: str) -> dict[str, Any] | None:
        """Returns the verdict that still counts: ``tests`` are the digest of the test files."""
        entry = self._known.get((_key(mutant), stage))
        return entry if entry and (entry["failure"] or entry["files"] == tests) else None

    def add(self, mutant: Mutant, stage: str, tests: str, verdict: Verdict, cpu: float) -> None:
        entry = {"mutant": _key(mutant), "stage": stage, "files": tests, "cpu": round(cpu, 1)}
        entry |= verdict._asdict()
        self._known[entry["mutant"], stage] = entry
        RESULTS.parent.mkdir(exist_ok=True)
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")


def _key(mutant: Mutant) -> str:
    digest = hashlib.sha256((ROOT / mutant.path).read_bytes()).hexdigest()
    return f"{mutant.path} {digest[:16]} {mutant.start}-{mutant.end} {mutant.text}"


# -- processes -------------------------------------------------------------------------------------

_tree: Path
_executed: ExecutedLines


def _start_recording(trees: multiprocessing.SimpleQueue[str]) -> None:
    global _tree
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # ends the forked process too
    _tree = copy_of_the_tree(Path(trees.get()))


def _start_work(trees: multiprocessing.SimpleQueue[str], files: list[str]) -> None:
    global _executed
    _start_recording(trees)
    _executed = ExecutedLines(files)


def _record(name: str) -> tuple[str, int]:
    return name, record(name, _tree)


def _work(task: tuple[Mutant, str]) -> tuple[Mutant, Verdict | str, float]:
    """Returns a mutant, the verdict or why there is none, and the seconds of CPU."""
    mutant, stage = task
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    judge_it = judge_with_all_robots if stage == ALL_ROBOTS else judge
    judged: Verdict | str
    try:
        judged = judge_it(mutant, _tree, _executed)
    except UndecidedError as error:
        judged = str(error)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return mutant, judged, cpu


def record_missing(files: list[str], jobs: int) -> None:
    missing = [name for name in files if not is_recorded(name)]
    if not missing:
        return
    print(f"recording which lines {len(missing)} test files execute", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        context = multiprocessing.get_context("fork")
        trees = context.SimpleQueue()
        for number in range(jobs):
            trees.put(f"{folder}/{number}")
        with context.Pool(jobs, _start_recording, (trees,)) as pool:
            recorded = pool.imap_unordered(_record, missing)
            for number, (name, left_out) in enumerate(recorded, 1):
                words = f", {left_out} tests LEFT OUT by the limits of time" if left_out else ""
                print(f"{number}/{len(missing)} {name}{words}", flush=True)


def run_stage(
    stage: str, mutants: list[Mutant], files: list[str], jobs: int, results: Results
) -> list[dict[str, Any] | None]:
    """Judges the mutants that have no verdict yet; returns the verdict of each, or ``None``."""
    digest = hashlib.sha256("".join(f"{f} {digest_of(f)}\n" for f in files).encode()).hexdigest()
    open_mutants = [m for m in mutants if results.find(m, stage, digest) is None]
    if open_mutants:
        record_missing(files, jobs)
        _judge_all(stage, open_mutants, files, digest, jobs, results)
    return [results.find(mutant, stage, digest) for mutant in mutants]


def _judge_all(
    stage: str, mutants: list[Mutant], files: list[str], digest: str, jobs: int, results: Results
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        context = multiprocessing.get_context("fork")
        trees = context.SimpleQueue()
        for number in range(jobs):
            trees.put(f"{folder}/{number}")
        tasks = [(mutant, stage) for mutant in mutants]
        with context.Pool(jobs, _start_work, (trees, files)) as pool:
            for mutant, verdict, cpu in pool.imap_unordered(_work, tasks):
                if isinstance(verdict, str):
                    print(f"NOT JUDGED {mutant.describe()}  {verdict}", flush=True)
                    continue
                results.add(mutant, stage, digest, verdict, cpu)
                word = f"noticed by {verdict.failure}" if verdict.failure else "open"
                print(f"{stage} {cpu:6.1f} s {mutant.describe()}  {word}", flush=True)


def run(layer: str, mutants: list[Mutant], jobs: int, last: str) -> bool:
    """Judges the mutants of a layer up to the stage ``last``; returns whether a test noticed each
    of them."""
    results = Results()
    near = [name for name in test_files() if name.startswith(f"tests/{layer}/")]
    far = [name for name in test_files() if name not in near]
    stages = {NEAR: near, FAR: far, ALL_ROBOTS: test_files()}
    left, cpu, judged = mutants, 0.0, len(mutants)
    shares = []
    left_out: Counter[Mutant] = Counter()
    for stage in STAGES[: STAGES.index(last) + 1]:
        verdicts = zip(left, run_stage(stage, left, stages[stage], jobs, results), strict=True)
        known = [(mutant, verdict) for mutant, verdict in verdicts if verdict is not None]
        cpu += sum(verdict["cpu"] for _, verdict in known)
        left_out.update({mutant: verdict["left_out"] for mutant, verdict in known})
        judged -= len(left) - len(known)
        left = [mutant for mutant, verdict in known if not verdict["failure"]]
        shares.append(f"{stage}: {len(known) - len(left)} of {len(known)}")
    for mutant in left:
        print(f"SURVIVED {mutant.describe()} ({left_out[mutant]} tests of CI not run)")
    noticed = judged - len(left)
    print(f"{layer}: {noticed / max(judged, 1):.0%} of {judged} mutants noticed ", end="")
    print(f"({'; '.join(shares)}), {cpu / max(noticed, 1):.1f} s of CPU for each of them", end="")
    print(f", {len(mutants) - judged} not judged" * (judged < len(mutants)), flush=True)
    return noticed == len(mutants)


def main() -> int:
    layers = sorted(p.parent.name for p in (ROOT / "thorvaldc").glob("*/__init__.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layer", choices=layers, action="append", help="all, if not given")
    parser.add_argument("--number", type=int, default=10, help="mutants of each layer")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--last", choices=STAGES, default=FAR, help="the last stage")
    parser.add_argument("--list", action="store_true", help="show the mutants; run no test")
    options = parser.parse_args()
    import_dependencies()
    if not options.list:
        print(f"not among the tests: {', '.join(LEFT_OUT)}", flush=True)
    status = 0
    for layer in options.layer or layers:
        mutants = sample(layer, options.number, options.seed)
        if options.list:
            print(*(mutant.describe() for mutant in mutants), sep="\n")
            continue
        status |= not run(layer, mutants, options.jobs, options.last)
    return status


if __name__ == "__main__":
    sys.exit(main())
