"""``python -m tests.fuzz``: runs commands on hostile files and judges what they do."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from tests.fuzz.generator import case_of, kinds
from tests.fuzz.judge import case_folder, judge, prepare

PROGRESS = 200
"""Cases between two lines of progress."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seeds", default="0:1000", help="first:end, or one seed")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--kind", help="only this kind of file")
    parser.add_argument("--show", action="store_true", help="print the output of every case")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write the files of the case here")
    options = parser.parse_args()
    first, _, end = options.seeds.partition(":")
    seeds = range(int(first), int(end) if end else int(first) + 1)
    if options.keep is not None:
        return _keep(seeds, options.keep)
    kinds()  # every job would make the files again
    prepare()
    with tempfile.TemporaryDirectory(prefix="thorvaldc_fuzz_") as folder:
        Path(folder).chmod(0o755)
        children = []
        for job in range(options.jobs):
            child = os.fork()
            if child == 0:
                status = 1
                try:
                    status = _run(seeds[job :: options.jobs], options, Path(folder), job)
                except BaseException:
                    traceback.print_exc()
                finally:
                    os._exit(status)
            children.append(child)
        statuses = [os.waitpid(child, 0)[1] for child in children]
        parts = [
            json.loads(path.read_text(encoding="utf-8"))
            for path in sorted(Path(folder).glob("job*.json"))
        ]
    if any(statuses):
        print("a job ended early", file=sys.stderr)
        return 1
    return _report(parts)


def _keep(seeds: range, folder: Path) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        case = case_of(seed)
        with case_folder(case, folder) as made:
            kept = folder / str(seed)
            (made / "work").rename(kept)
        print(f"cd {kept} && thorvaldc {case.command}    # {case.kind.name}: {case.description}")
    return 0


def _run(seeds: range, options: argparse.Namespace, folder: Path, job: int) -> int:
    start = time.monotonic()
    counts: Counter[str] = Counter()
    statuses: Counter[str] = Counter()
    cpu, violations = 0.0, 0
    memory, slowest = (0, 0, ""), (0.0, 0, "")
    for seed in seeds:
        case = case_of(seed)
        if options.kind not in (None, case.kind.name):
            continue
        verdict = judge(case, folder)
        counts[case.kind.name] += 1
        statuses[str(verdict.status)] += 1
        cpu += verdict.cpu
        memory = max(memory, (verdict.memory, seed, case.kind.name))
        slowest = max(slowest, (verdict.cpu, seed, case.kind.name))
        if counts.total() % PROGRESS == 0:
            print(f"{counts.total()} cases, seed {seed}", file=sys.stderr, flush=True)
        title = f"seed {seed} ({case.kind.name}, {case.description}): {case.command}"
        if options.show:
            print(f"{title}\n{verdict.output}{verdict.cpu:.2f} s {verdict.memory / 1e6:.0f} MB")
        if verdict.violations:
            violations += 1
            tail = "\n".join("    " + line[:200] for line in verdict.output.splitlines()[-8:])
            print(f"{title}\n  {'; '.join(verdict.violations)}\n{tail}", flush=True)
    (folder / f"job{job}.json").write_text(
        json.dumps(
            {
                "counts": counts,
                "statuses": statuses,
                "cpu": cpu,
                "wall": time.monotonic() - start,
                "violations": violations,
                "memory": memory,
                "slowest": slowest,
            }
        )
    )
    return 0


def _report(parts: list[dict[str, Any]]) -> int:
    def total(key: str) -> Counter[str]:
        counter: Counter[str] = Counter()
        for part in parts:
            counter.update(part[key])
        return counter

    counts, statuses = total("counts"), total("statuses")
    cpu = sum(part["cpu"] for part in parts)
    violations = sum(part["violations"] for part in parts)
    memory = max(part["memory"] for part in parts)
    slowest = max(part["slowest"] for part in parts)
    for name, number in sorted(counts.items()):
        print(f"  {name}: {number}")
    print(f"exit statuses: {dict(sorted(statuses.items()))}")
    print(
        f"{counts.total()} cases, {violations} violations; {cpu:.0f} s of CPU,"
        f" {60 * counts.total() / max(cpu, 1e-9):.0f} cases per minute of CPU"
    )
    print(f"most memory: {memory[0] / 1e6:.0f} MB (seed {memory[1]}, {memory[2]})")
    print(f"slowest: {slowest[0]:.1f} s of CPU (seed {slowest[1]}, {slowest[2]})")
    return int(bool(violations))


if __name__ == "__main__":
    sys.exit(main())
