"""Evaluates designs of a study in local processes; a process that is killed ends no study."""

from __future__ import annotations

import functools
import pickle
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from typing import Any

from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.sample_points import Design
from thorvaldc.tools.worker_processes import ignored_interrupts, worker_pool

WAITING_PER_PROCESS = 2
"""Number of designs that a process has at once, so that it never waits for the next."""
ATTEMPTS = 3
"""Number of processes that a design may end before it counts as failed."""

_Item = tuple[str, Design]
_Result = tuple[str, dict[str, Any] | None]


def results_of(inputs: StudyInputs, designs: Iterable[_Item], jobs: int) -> Iterator[_Result]:
    """Yields the key and the result of each design, in the order in which they finish.

    - ``designs``: key and values of each design.
    - ``jobs``: number of processes.

    If a process is killed, for example because the computer has no memory left, the designs of all
    processes are evaluated again, one after the other.  A design whose process is then killed
    ``ATTEMPTS`` times has the result ``None``.
    """
    pickled, remaining = pickle.dumps(inputs), iter(designs)
    while lost := (yield from _in_pool(pickled, remaining, jobs, jobs * WAITING_PER_PROCESS)):
        yield from _one_by_one(pickled, lost)


def _one_by_one(pickled: bytes, designs: list[_Item]) -> Iterator[_Result]:
    attempts: Counter[str] = Counter()
    while designs:
        remaining = iter(designs)
        lost = yield from _in_pool(pickled, remaining, 1, 1)
        designs = [*lost, *remaining]
        for key, _ in lost:  # one design at most
            attempts[key] += 1
            if attempts[key] == ATTEMPTS:
                designs = designs[1:]
                yield key, None


def _in_pool(
    pickled: bytes, designs: Iterator[_Item], jobs: int, most: int
) -> Generator[_Result, None, list[_Item]]:
    """Yields results until all designs are evaluated or a process is killed.

    - ``most``: number of designs that the processes have at once.

    Returns the designs that were taken from ``designs`` and have no result.
    """
    running: dict[Future[dict[str, Any]], _Item] = {}
    item: _Item | None = None
    try:
        with worker_pool(jobs) as pool:
            while True:
                while len(running) < most and (item := next(designs, None)):
                    running[_submitted(pool, pickled, item[1])] = item
                    item = None
                if not running:
                    return []
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future)[0], result
    except BrokenProcessPool:
        return [*running.values(), *([item] if item else [])]


def _submitted(pool: ProcessPoolExecutor, pickled: bytes, design: Design) -> Future[dict[str, Any]]:
    with ignored_interrupts():
        return pool.submit(_evaluate, pickled, design)


_open = ExitStack()


@functools.lru_cache(maxsize=1)
def _evaluator(pickled: bytes) -> DesignEvaluator:
    _open.close()
    return DesignEvaluator(pickle.loads(pickled), _open)


def _evaluate(pickled: bytes, design: Design) -> dict[str, Any]:
    """Evaluates a design in a worker process, which keeps its evaluator for the next design."""
    return _evaluator(pickled).evaluate(design)
