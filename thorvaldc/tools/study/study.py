"""A study: its designs in order, the journal of their results, the table, and the best design."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import multiprocessing
import os
import runpy
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc import __version__
from thorvaldc.cli.exits import OutsideError
from thorvaldc.compiler.pipeline import Source, compile_error, compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.source.node import yaml_text
from thorvaldc.diagnostics import DiagnosticError, files
from thorvaldc.tools.study import evaluation
from thorvaldc.tools.study.designs import (
    DesignSearch,
    designs_of,
    new_optuna_study,
    required,
    trial_of,
)
from thorvaldc.tools.study.study_document import MEASURE, Design, StudyPlan
from thorvaldc.tools.study.study_results import best_designs, table_of, write_table

if TYPE_CHECKING:
    from pandas import DataFrame

try:
    import fcntl
except ImportError:  # on Windows, two runs of one study are not kept apart
    fcntl = None  # type: ignore[assignment]

JOURNAL = "journal.log"
ROBOT_HEAD = 3
"""Lines of ``Study.robot_text`` before the values of the design."""
_KILLED = {
    "status": "error",
    "code": "",
    "message": "the process that evaluated it was killed several times",
    "facts": {},
    "metrics": {},
}
"""Result of a design that has no other result, because its processes were killed."""


class Study:
    """Many designs of one robot: compiled, compared with constraints, and driven in scenarios.

    Parameters
    ----------
    source : path of a study file, its text, or its content as a mapping of Python, whose paths
        begin in the working folder; or the ``Compilation`` of one of them.
    measure : function that gets the robot of each design and returns numbers by their names.  An
        objective uses them as ``metric: measure.NAME``.
    library, trust : see ``thorvaldc.compile``.

    Raises ``CompileError`` with all errors of the study.

    >>> from thorvaldc.tools.study import Study
    >>> Study("examples/studies/track_on_a_slope/study.yaml")
    <Study track_on_a_slope: 32 designs of robot.yaml>
    """

    def __init__(
        self,
        source: Source | Compilation,
        *,
        measure: evaluation.Measure | None = None,
        library: Sequence[Path | str] = (),
        trust: bool = False,
    ) -> None:
        compilation = (
            source
            if isinstance(source, Compilation)
            else compile_file(source, library=library, trust=trust)
        )
        plan = compilation.tool_document
        if not isinstance(plan, StudyPlan):
            if compilation.model is not None:
                compilation.report.add("other-document", "expected a study, got another document")
            raise compile_error(compilation.report, compilation.sources)
        # The study file itself is a list of questions: the designs depend on what they ask.
        paths = {os.path.realpath(path) for path in compilation.files.values()}
        paths -= {os.path.realpath(compilation.files[name]) for name in list(compilation.files)[:1]}
        self.plan = replace(
            plan,
            robot=plan.robot.absolute(),
            scenarios=tuple((name, path.absolute()) for name, path in plan.scenarios),
            library=tuple(Path(folder).absolute() for folder in library),
            trust=trust,
            files=tuple(
                (path, evaluation.file_hash(path)) for path in sorted(paths) if os.path.exists(path)
            ),
            meshes=evaluation.meshes_of(compilation.model),
        )
        self.measure = measure
        measured = [o.name for o in plan.objectives if o.metric.partition(".")[0] == MEASURE]
        if measured and measure is None:
            raise DiagnosticError(
                "study-value",
                f"the objective `{measured[0]}` is a number of a function, and there is none",
                hint="in Python, give the function to the study: Study(FILE, measure=FUNCTION)",
            )
        texts = [__version__, self.plan.question(), _hash_of(measure)]
        self._question = json.dumps(texts)

    def __repr__(self) -> str:
        return f"<Study {self.plan.name}: {len(self)} designs of {self.plan.robot.name}>"

    def __len__(self) -> int:
        """Number of designs, of a search the number that it proposes."""
        return self.plan.number if self.plan.method == "search" else len(designs_of(self.plan))

    def run(
        self,
        folder: Path | str = "",
        *,
        jobs: int = 1,
        scheduler: str = "",
        progress: bool = False,
    ) -> DataFrame:
        """Evaluates the designs that the journal does not contain, and returns the table of all.

        The table does not depend on the number of processes, nor on interruptions.

        Parameters
        ----------
        folder : folder of the journal and the table; by default ``study/NAME``.
        jobs : number of processes.
        scheduler : address of a Dask scheduler, such as ``tcp://host:8786``, in place of processes.
        progress : whether a bar of tqdm shows the progress.

        Raises ``OutsideError`` without a package of the extra ``study``, if another run writes the
        journal, or if the scheduler is not there or goes away.
        """
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            # A process that reads the program of its parent again must not run it again.
            raise SystemExit("a program calls `run` below `if __name__ == '__main__':`")
        for package in ("optuna", "pandas", "pyarrow"):  # before any work
            required(package)
        present = {path: evaluation.file_hash(path) for path, _ in self.plan.files}
        present |= dict(evaluation.read_meshes(self.plan))
        for path, sha256 in (*self.plan.files, *self.plan.meshes):
            if present.get(path) != sha256:
                raise OutsideError(f"{path} has changed since the study was read: read it again")
        folder = self.results_folder(folder)
        finished: dict[str, dict[str, Any]] = {}
        designs: list[tuple[str, Design]] = []
        table = None
        with ExitStack() as stack:
            bar = stack.enter_context(
                required("tqdm.auto").tqdm(total=len(self), unit="design", disable=not progress)
            )
            journal = stack.enter_context(_Journal(folder, self.plan))
            finished.update(journal.results)
            evaluate: Any = None
            try:
                for batch in self._batches(finished):
                    designs += batch
                    pending = {key: design for key, design in batch if key not in finished}
                    bar.update(len(batch) - len(pending))
                    if pending and evaluate is None:
                        evaluate = self._evaluation(stack, scheduler, min(jobs, len(pending)))
                    for key, result in evaluate(pending) if pending else ():
                        if result is None:
                            # Not on the disk: the same command tries again, with more memory.
                            finished[key] = _KILLED
                        else:
                            journal.append(key, pending[key], result)
                            finished[key] = result
                        bar.update()
            finally:
                rows = [
                    (number, key, design, finished[key])
                    for number, (key, design) in enumerate(designs, 1)
                    if key in finished
                ]
                if rows:
                    table = table_of(self.plan, rows)
                    write_table(table, folder)
        assert table is not None  # a study has a design
        return table

    def results_folder(self, folder: Path | str = "") -> Path:
        """Returns the folder of the results: the given one, or ``study/NAME``."""
        return Path(folder) if folder else Path("study") / self.plan.name

    def robot_text(self, design: Design, name: str, folder: Path) -> str:
        """Returns the text of a robot file that extends the robot file of the study by a design.

        ``name``: name of the robot; ``folder``: folder of the new file.
        """
        robot = self.plan.robot
        path = os.path.relpath(os.path.realpath(robot.parent), os.path.realpath(folder))
        extended, changes = Path(path, robot.name).as_posix(), self.plan.changes(design)
        entries = {"extends": extended, "name": changes.pop("name", name), **changes}
        return "thorvaldc: 1\n" + "".join(f"{k}: {yaml_text(v)}\n" for k, v in entries.items())

    def best(self, table: DataFrame, by: str = "") -> Any:
        """Returns the row of the best design for an objective, or ``None`` if none is ``ok``.

        ``by``: name of the objective, by default the first one.  Raises ``ValueError``.
        """
        objectives = {objective.name: objective for objective in self.plan.objectives}
        if by and by not in objectives:
            raise ValueError(f"there is no objective {by!r}; there are {', '.join(objectives)}")
        objective = objectives[by or next(iter(objectives))]
        best = best_designs(table).sort_values(
            [objective.name, "sample"], ascending=[not objective.maximise, True]
        )
        return None if best.empty else best.iloc[0]

    def optuna_study(self, folder: Path | str = "") -> Any:
        """Returns the results in a folder as a study of Optuna, for ``optuna.visualization``."""
        study = new_optuna_study(self.plan)
        with _Journal(self.results_folder(folder), self.plan) as journal:
            for batch in self._batches(journal.results):
                for key, design in batch:
                    if key in journal.results:
                        study.add_trial(trial_of(self.plan, design, journal.results[key]))
        return study

    # -- the designs in order -----------------------------------------------------------

    def _batches(
        self, results: Mapping[str, Mapping[str, Any]]
    ) -> Iterator[list[tuple[str, Design]]]:
        """Yields the designs with their keys: all, or of a search batch by batch.

        A batch of a search needs the results of the last one; without them there is none.
        """
        if self.plan.method != "search":
            yield [(self._key(design), design) for design in designs_of(self.plan)]
            return
        search, left = DesignSearch(self.plan), self.plan.number
        while left > 0:
            designs = search.propose(min(self.plan.batch, left))
            left -= len(designs)
            batch = [(self._key(design), design) for design in designs]
            yield batch
            if not all(key in results for key, _ in batch):
                return
            search.learn([results[key] for key, _ in batch])

    def _key(self, design: Design) -> str:
        """Returns a hash of all that the result of a design depends on."""
        return hashlib.sha256(f"{self._question}{json.dumps(design)}".encode()).hexdigest()

    def _evaluation(self, stack: ExitStack, scheduler: str, jobs: int) -> Any:
        """Returns the function that evaluates designs; ``stack`` ends its processes."""
        if scheduler or jobs > 1:
            client = stack.enter_context(evaluation.dask_client(scheduler, jobs))
            return lambda pending: evaluation.results_on_dask(
                self.plan, self.measure, pending, client
            )
        evaluator = evaluation.DesignEvaluator(self.plan, self.measure, stack)
        return lambda pending: ((k, evaluator.evaluate(design)) for k, design in pending.items())


def study_of_program(path: str) -> Study:
    """Runs a Python file, and returns the study that it makes.

    Raises ``OutsideError`` with the line of an error in the file.
    """
    sys.path.insert(0, os.path.dirname(os.path.abspath(path)))  # as Python does
    try:
        names = runpy.run_path(path)
    except (Exception, SystemExit) as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == path]
        line = lines[-1] if lines else getattr(error, "lineno", 0)
        raise OutsideError(f"{path}:{line}: {type(error).__name__}: {error}") from None
    studies = {id(value): value for value in names.values() if isinstance(value, Study)}
    if len(studies) != 1:
        raise OutsideError(f"{path} has {len(studies)} studies; give one to a name: study = ...")
    return next(iter(studies.values()))


def _hash_of(function: object) -> str:
    """Returns a hash of a function with the values that it refers to, on which results depend."""
    if function is None:
        return ""
    content = required("cloudpickle").dumps(function)
    with suppress(OSError, TypeError):  # of a module, whose functions are pickled by their names
        content += inspect.getsource(function).encode()  # type: ignore[arg-type]
    return hashlib.sha256(content).hexdigest()


class _Journal:
    """The results of finished designs, in a journal of Optuna: `optuna-dashboard` shows it.

    A line is written by one system call.  Lines from the first one on that a power cut has damaged
    are removed, and their designs are evaluated again.
    """

    def __init__(self, folder: Path, plan: StudyPlan) -> None:
        """Opens the journal for a run.  Raises ``OutsideError`` if another run writes it."""
        storages = required("optuna.storages")
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / JOURNAL
        self._file = path.open("ab")
        try:
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise OutsideError(f"another run writes {path}") from None
        _remove_damaged_lines(path)
        backend = storages.journal.JournalFileBackend(os.fspath(path), _NoLock())
        try:
            storage = storages.JournalStorage(backend)
        except Exception as error:  # of Optuna, for lines of another program
            self._file.close()
            message = f"{path} is no journal of a study ({error!r}): remove it"
            raise OutsideError(message) from None
        self.results: dict[str, dict[str, Any]] = {
            trial.user_attrs["key"]: trial.user_attrs["result"]
            for study in storage.get_all_studies()
            for trial in storage.get_all_trials(study._study_id, deepcopy=False)
            if "result" in trial.user_attrs
        }
        # After a change of the study file, the same journal has another study of Optuna.
        self._plan = plan
        self._name, self._storage = f"{plan.name} {plan.identity()[:8]}", storage

    def __enter__(self) -> _Journal:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def append(self, key: str, design: Design, result: dict[str, Any]) -> None:
        """Writes the result of a design, by the key of the design."""
        self._study.add_trial(trial_of(self._plan, design, result, {"key": key, "result": result}))

    @functools.cached_property
    def _study(self) -> Any:
        return new_optuna_study(self._plan, storage=self._storage, study_name=self._name)


class _NoLock:
    """No lock within one run: `_Journal.open` locks the file for its whole time."""

    def acquire(self) -> bool:
        return True

    def release(self) -> None:
        pass


def _remove_damaged_lines(path: Path) -> None:
    with path.open("r+b") as file:
        length = 0
        for line in file:
            try:
                if not line.endswith(b"\n"):
                    break
                if "op_code" not in files.read_json(line):
                    break
            except (ValueError, TypeError):
                break
            length += len(line)
        file.truncate(length)
