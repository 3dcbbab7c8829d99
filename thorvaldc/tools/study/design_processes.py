"""Evaluates designs of a study in local processes; a process that is killed ends no study."""

from __future__ import annotations

import functools
import pickle
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from types import TracebackType
from typing import Any

from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.sample_points import Design

WAITING_PER_PROCESS = 2
"""Number of designs that a process has at once, so that it never waits for the next."""
ATTEMPTS = 3
"""Number of processes that a design may end before it counts as failed."""

_Item = tuple[str, Design]
Result = tuple[str, dict[str, Any] | None]
"""Key of a design, and its result or ``None``."""


class DesignProcesses:
    """Processes that evaluate designs of a study, for several batches of designs.

    - ``jobs``: number of processes.  The first designs start them.

    To be used in a ``with`` block, which ends the processes.
    """

    def __init__(self, inputs: StudyInputs, jobs: int) -> None:
        self._pickled = pickle.dumps(inputs)
        self._jobs = jobs
        self._stack = ExitStack()
        self._pool: ProcessPoolExecutor | None = None
        self._processes = 0

    def __enter__(self) -> DesignProcesses:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def results(self, designs: Iterable[_Item]) -> Iterator[Result]:
        """Yields the key and the result of each design, in the order in which they finish.

        - ``designs``: key and values of each design.

        If a process is killed, for example because the computer has no memory left, the designs of
        all processes are evaluated again, one after the other.  A design whose process is then
        killed ``ATTEMPTS`` times has the result ``None``.
        """
        remaining = iter(designs)
        while lost := (yield from self._evaluated(remaining, self._jobs)):
            yield from self._one_by_one(lost)

    def _one_by_one(self, designs: list[_Item]) -> Iterator[Result]:
        attempts: Counter[str] = Counter()
        while designs:
            remaining = iter(designs)
            lost = yield from self._evaluated(remaining, 1)
            designs = [*lost, *remaining]
            for key, _ in lost:  # one design at most
                attempts[key] += 1
                if attempts[key] == ATTEMPTS:
                    designs = designs[1:]
                    yield key, None

    def _evaluated(
        self, designs: Iterator[_Item], processes: int
    ) -> Generator[Result, None, list[_Item]]:
        """Yields results until all designs are evaluated or a process is killed.

        Returns the designs that were taken from ``designs`` and have no result.
        """
        most = 1 if processes == 1 else processes * WAITING_PER_PROCESS
        running: dict[Future[dict[str, Any]], _Item] = {}
        item: _Item | None = None
        try:
            pool = self._open_pool(processes)
            while True:
                while len(running) < most and (item := next(designs, None)):
                    running[_submitted(pool, self._pickled, item[1])] = item
                    item = None
                if not running:
                    return []
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future)[0], result
        except BrokenProcessPool:
            self._close_pool()
            return [*running.values(), *([item] if item else [])]

    def _open_pool(self, processes: int) -> ProcessPoolExecutor:
        if self._pool is None or self._processes != processes:
            self._close_pool()
            self._pool = self._stack.enter_context(worker_pool(processes))
            self._processes = processes
        return self._pool

    def _close_pool(self) -> None:
        self._pool = None
        self._stack.close()


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
