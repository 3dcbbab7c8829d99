"""A study on one worker and on two: processes of this computer, and workers of Dask.

Wall times contain the start of local processes and of the evaluator on each worker of Dask, but not
the start of these workers.  Processor times contain all; those of Dask also the messages of workers
that wait, so that other programs change them, and they have no bound.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from distributed import LocalCluster

from bench.figure import Figure, processor_time
from bench.study import SECONDS, example_study
from thorvaldc.tools.study.dask_cluster import DaskCluster
from thorvaldc.tools.study.design_evaluation import StudyInputs
from thorvaldc.tools.study.study_run import StudyJournal, StudyRun

DESIGNS = 48


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = example_study(folder, DESIGNS)
        text = study.robot.read_text(encoding="utf-8")
        inputs = StudyInputs(study, text, (), trust=False, files=(study.robot,))
        for kind, measure, bound in (("local", _local, 1.5), ("Dask", _dask, None)):
            (wall, processor), (wall_2, processor_2) = (
                measure(inputs, folder / f"{kind}{workers}", workers) for workers in (1, 2)
            )
            yield Figure(
                f"a study on two workers, {kind}",
                processor_2 / processor,
                "",
                bound,
                "lower",
                f"processor time relative to one worker, {processor_2:.1f} s and {processor:.1f} s"
                f" for {DESIGNS} designs of {SECONDS:g} s, with the start of the workers;"
                f" wall time {wall_2:.1f} s and {wall:.1f} s",
                timed=True,
            )


def _local(inputs: StudyInputs, folder: Path, workers: int) -> tuple[float, float]:
    start = processor_time()
    wall = _wall_time(inputs, folder, workers, None)
    return wall, processor_time() - start


def _dask(inputs: StudyInputs, folder: Path, workers: int) -> tuple[float, float]:
    start = processor_time()
    options = {"threads_per_worker": 1, "dashboard_address": None}
    with (
        LocalCluster(n_workers=workers, **options) as cluster,  # type: ignore[no-untyped-call]
        DaskCluster(cluster.scheduler_address, inputs.files, print) as dask,
    ):
        wall = _wall_time(inputs, folder, workers, dask)
    return wall, processor_time() - start


def _wall_time(
    inputs: StudyInputs, folder: Path, workers: int, cluster: DaskCluster | None
) -> float:
    start = time.perf_counter()
    with closing(StudyJournal(folder)) as journal:
        for _ in StudyRun(inputs).results(journal, workers, cluster):
            pass
        if len(journal.results) != DESIGNS:
            raise SystemExit("designs are missing")
    return time.perf_counter() - start
