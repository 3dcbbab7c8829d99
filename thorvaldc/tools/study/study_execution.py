"""Runs the designs of a study in processes, and continues a study that was interrupted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from thorvaldc import __version__
from thorvaldc.compiler.study.study_definition import Study, value_key
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.design_processes import ATTEMPTS, results_of
from thorvaldc.tools.study.sample_points import Design, designs_of
from thorvaldc.tools.study.study_journal import StudyJournal
from thorvaldc.tools.study.study_table import write_table

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
    """

    def __init__(self, inputs: StudyInputs) -> None:
        self.inputs = inputs
        self.designs = designs_of(inputs.study)
        keys = _Keys(inputs.study)
        self.keys = [keys.key(design) for design in self.designs]

    def results(self, journal: StudyJournal, jobs: int) -> Iterator[int]:
        """Evaluates the designs that the journal does not contain.

        Yields the number of finished designs after each.  The table of designs does not depend on
        ``jobs``, the number of processes.
        """
        pending = {
            key: design
            for key, design in zip(self.keys, self.designs, strict=True)
            if key not in journal.results
        }
        count = len(set(self.keys)) - len(pending)
        yield count
        if jobs <= 1 or len(pending) <= 1:
            with ExitStack() as stack:
                evaluator = DesignEvaluator(self.inputs, stack)
                for key, design in pending.items():
                    journal.append(key, evaluator.evaluate(design))
                    count += 1
                    yield count
            return
        for key, result in results_of(self.inputs, pending.items(), min(jobs, len(pending))):
            if result is None:
                # Not on the disk: the same command tries again, perhaps with more memory.
                journal.results[key] = _KILLED
            else:
                journal.append(key, result)
            count += 1
            yield count

    def write_table(self, journal: StudyJournal, folder: Path) -> int:
        """Writes the table of the finished designs to a folder, and returns their number."""
        rows = [
            (number, key, design, journal.results[key])
            for number, (key, design) in enumerate(zip(self.keys, self.designs, strict=True), 1)
            if key in journal.results
        ]
        write_table(self.inputs.study, rows, folder)
        return len(rows)


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
