"""Runs the designs of a study in processes, and continues a study that was interrupted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc import __version__
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.design_processes import ATTEMPTS, DesignProcesses, Result
from thorvaldc.tools.study.design_search import DesignSearch
from thorvaldc.tools.study.sample_points import Design, designs_of
from thorvaldc.tools.study.study_definition import Study, value_key
from thorvaldc.tools.study.study_journal import StudyJournal
from thorvaldc.tools.study.study_table import write_table

if TYPE_CHECKING:
    from thorvaldc.tools.study.dask_cluster import DaskCluster

Pending = Mapping[str, Design]
"""Designs without a result, by their keys."""

_KILLED = {
    "status": "error",
    "code": "",
    "message": f"the process that evaluated it was killed {ATTEMPTS} times",
    "facts": {},
    "metrics": {},
}
"""Result of a design that has no other result, because its processes were killed."""


class StudyRun:
    """The designs of a study with their keys.

    The key of a design is a SHA-256 of all that its result depends on: the version of thorvaldc,
    the files, the values, the constraints, the scenarios and the objectives.

    Attributes
    ----------
    designs, keys : the designs in the order of their numbers, and their keys.  Of a search, the
        designs of the batches whose earlier batches have results.
    """

    def __init__(self, inputs: StudyInputs) -> None:
        """Raises ``MissingPackageError`` if the method of the study needs a missing package."""
        study = inputs.study
        self.inputs = inputs
        self._key_of = _Keys(study).key
        self._search = DesignSearch(study) if study.samples.method == "search" else None
        self._batch_start = 0
        self.designs: list[Design] = []
        self.keys: list[str] = []
        self._add(designs_of(study) if self._search is None else self._proposed())

    @property
    def number(self) -> int:
        """Number of the different designs; of a search the number of all that it may propose."""
        return len(set(self.keys)) if self._search is None else self.inputs.study.samples.number

    def replay(self, results: Mapping[str, dict[str, Any]]) -> None:
        """Adds the designs that a search proposes from results, by the keys of designs."""
        while self._continue(results):
            pass

    def results(
        self, journal: StudyJournal, jobs: int, cluster: DaskCluster | None = None
    ) -> Iterator[int]:
        """Evaluates the designs that the journal does not contain.

        Yields the number of finished designs after each.  The table of designs does not depend on
        ``jobs``, the number of processes, and not on ``cluster``, which replaces them.
        """
        with ExitStack() as stack:
            evaluate: Callable[[Pending], Iterator[Result]] | None = None
            if cluster is not None:
                evaluate = _on_cluster(cluster, self.inputs)
            self.replay(journal.results)
            while True:
                pending = {
                    key: design
                    for key, design in zip(self.keys, self.designs, strict=True)
                    if key not in journal.results
                }
                count = self.finished(journal.results)
                yield count
                if pending:
                    evaluate = evaluate or self._evaluation(stack, jobs, len(pending))
                    for key, result in evaluate(pending):
                        if result is None:
                            # Not on the disk: the same command tries again, with more memory.
                            journal.results[key] = _KILLED
                        else:
                            journal.append(key, result)
                        count += 1
                        yield count
                if not self._continue(journal.results):
                    return

    def finished(self, results: Mapping[str, dict[str, Any]]) -> int:
        """Returns how many of the designs have results, by the keys of designs."""
        keys = set(self.keys) if self._search is None else self.keys
        return sum(1 for key in keys if key in results)

    def _evaluation(
        self, stack: ExitStack, jobs: int, designs: int
    ) -> Callable[[Pending], Iterator[Result]]:
        """Returns the function that evaluates designs; ``stack`` ends its processes."""
        # The first batch of a search that continues may lack few results.
        jobs = min(jobs, designs if self._search is None else self.inputs.study.samples.batch)
        if jobs <= 1:
            evaluator = DesignEvaluator(self.inputs, stack)
            return lambda pending: (
                (key, evaluator.evaluate(design)) for key, design in pending.items()
            )
        processes = stack.enter_context(DesignProcesses(self.inputs, jobs))
        return lambda pending: processes.results(pending.items())

    def _continue(self, results: Mapping[str, dict[str, Any]]) -> bool:
        """Adds the next batch of a search if the last batch has results.

        Returns whether there is a new batch.
        """
        last = self.keys[self._batch_start :]
        is_complete = len(self.designs) >= self.inputs.study.samples.number
        if self._search is None or is_complete or not all(key in results for key in last):
            return False
        self._search.learn([results[key] for key in last])
        self._batch_start = len(self.designs)
        self._add(self._proposed())
        return True

    def _proposed(self) -> list[Design]:
        assert self._search is not None
        samples = self.inputs.study.samples
        return self._search.propose(min(samples.batch, samples.number - len(self.designs)))

    def _add(self, designs: Sequence[Design]) -> None:
        self.designs += designs
        self.keys += [self._key_of(design) for design in designs]

    def write_table(self, journal: StudyJournal, folder: Path) -> int:
        """Writes the table of the finished designs to a folder, and returns their number."""
        rows = [
            (number, key, design, journal.results[key])
            for number, (key, design) in enumerate(zip(self.keys, self.designs, strict=True), 1)
            if key in journal.results
        ]
        write_table(self.inputs.study, rows, folder)
        return len(rows)


def _on_cluster(cluster: DaskCluster, inputs: StudyInputs) -> Callable[[Pending], Iterator[Result]]:
    return lambda pending: cluster.results_of(inputs, pending.items())


class _Keys:
    """Computes the keys of the designs of a study."""

    def __init__(self, study: Study) -> None:
        self._variables = study.variables
        self._common = json.dumps([__version__, study.inputs, study.question()], sort_keys=True)
        self._files = {(name, text): digest for name, text, digest in study.choice_inputs}

    def key(self, design: Design) -> str:
        texts = [value_key(value) for value in design]
        files = [
            self._files.get((variable.name, text), "") if variable.choices else ""
            for variable, text in zip(self._variables, texts, strict=True)
        ]
        content = json.dumps([self._common, texts, files])
        return hashlib.sha256(content.encode()).hexdigest()
