"""A study on one process of Dask and on two, with the start of the processes.

The processor times contain the messages of processes that wait, so that other programs change them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.figure import Figure, processor_time
from bench.study import SECONDS, example_study
from thorvaldc.tools.study import Study
from thorvaldc.tools.study.designs import designs_of
from thorvaldc.tools.study.evaluation import dask_client, results_on_dask

DESIGNS = 48


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        study = example_study(Path(name), DESIGNS)
        (wall, processor), (wall_2, processor_2) = (_times(study, jobs) for jobs in (1, 2))
        yield Figure(
            "a study on two processes of Dask",
            processor_2 / processor,
            "",
            1.5,
            "lower",
            f"processor time relative to one process, {processor_2:.1f} s and {processor:.1f} s"
            f" for {DESIGNS} designs of {SECONDS:g} s, with the start of the processes;"
            f" wall time {wall_2:.1f} s and {wall:.1f} s",
            timed=True,
        )


def _times(study: Study, jobs: int) -> tuple[float, float]:
    """Returns the wall time and the processor time (s) of the designs on some processes."""
    wall, processor = time.perf_counter(), processor_time()
    pending = {str(number): design for number, design in enumerate(designs_of(study.plan))}
    with dask_client("", jobs) as client:
        results = dict(results_on_dask(study.plan, None, pending, client))
    if len(results) != DESIGNS or None in results.values():
        raise SystemExit("designs are missing")
    return time.perf_counter() - wall, processor_time() - processor
