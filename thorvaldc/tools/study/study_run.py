"""A run of a study: its designs in order, the journal of their results, and the best design.

On a terminal, the run shows a bar, and a plot of the Pareto front so far.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import typer

from thorvaldc import __version__
from thorvaldc.cli.diagnostic_output import Progress, has_color, message
from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.options import library_folders
from thorvaldc.cli.robot_file import compile_and_show
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.diagnostics import files
from thorvaldc.tools.study import design_evaluation as evaluation
from thorvaldc.tools.study import study_definition as definition
from thorvaldc.tools.study.design_text import value_text
from thorvaldc.tools.study.study_definition import Design, Objective, Study
from thorvaldc.tools.study.study_results import front, objective_columns, write_table

if TYPE_CHECKING:
    from rich.live import Live

    from thorvaldc.tools.study.dask_cluster import DaskCluster


try:
    import fcntl
except ImportError:  # on Windows, two runs of one study are not kept apart
    fcntl = None  # type: ignore[assignment]

JOURNAL = "journal.jsonl"
_DIGITS = 16


class StudyBusyError(OutsideError):
    """Raised if another run writes the journal."""


class StudyJournal:
    """A file with one line per finished design: a checksum, and the result as JSON.

    A line is written by one system call.  A line that a killed process has left incomplete, or
    whose checksum is wrong, counts as not written.
    """

    def __init__(self, folder: Path) -> None:
        """Opens or creates the journal in a folder, and reads its results.

        Raises ``OSError`` if the file cannot be opened and ``StudyBusyError`` if another process
        has opened it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        self._file = os.open(folder / JOURNAL, flags, 0o644)
        try:
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise StudyBusyError(f"another run writes {folder / JOURNAL}") from None
        self.results = read_results(folder)
        size = os.fstat(self._file).st_size
        if size and os.pread(self._file, 1, size - 1) != b"\n":
            os.write(self._file, b"\n")  # ends the incomplete line of a killed process

    def append(self, key: str, result: dict[str, Any]) -> None:
        """Writes the result of a design, by the key of the design."""
        text = json.dumps({"key": key, **result}, ensure_ascii=False, separators=(",", ":"))
        data = text.encode()
        files.append_whole(self._file, _checksum(data) + b" " + data + b"\n")
        self.results[key] = result

    def close(self) -> None:
        os.close(self._file)


def read_results(folder: Path) -> dict[str, dict[str, Any]]:
    """Returns the results in the journal of a folder by the keys of the designs."""
    results: dict[str, dict[str, Any]] = {}
    with (folder / JOURNAL).open("rb") as file:
        for line in file:
            checksum, _, data = line.rstrip(b"\n").partition(b" ")
            if line.endswith(b"\n") and checksum == _checksum(data):
                result = files.read_json(data)
                results[result.pop("key")] = result
    return results


def _checksum(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest()[:_DIGITS].encode()


Pending = Mapping[str, Design]
"""Designs without a result, by their keys."""

_KILLED = {
    "status": "error",
    "code": "",
    "message": f"the process that evaluated it was killed {evaluation.ATTEMPTS} times",
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

    def __init__(self, inputs: evaluation.StudyInputs) -> None:
        """Raises ``MissingPackageError`` if the method of the study needs a missing package."""
        study = inputs.study
        self.inputs = inputs
        self._common = json.dumps([__version__, study.inputs, study.question()], sort_keys=True)
        self._files = {(name, text): digest for name, text, digest in study.choice_inputs}
        self._search = definition.DesignSearch(study) if study.samples.method == "search" else None
        self._batch_start = 0
        self.designs: list[Design] = []
        self.keys: list[str] = []
        self._add(definition.designs_of(study) if self._search is None else self._proposed())

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
            evaluate: Callable[[Pending], Iterator[evaluation.Result]] | None = None
            if cluster is not None:
                evaluate = lambda pending: cluster.results_of(self.inputs, pending.items())  # noqa: E731
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
    ) -> Callable[[Pending], Iterator[evaluation.Result]]:
        """Returns the function that evaluates designs; ``stack`` ends its processes."""
        # The first batch of a search that continues may lack few results.
        jobs = min(jobs, designs if self._search is None else self.inputs.study.samples.batch)
        if jobs <= 1:
            evaluator = evaluation.DesignEvaluator(self.inputs, stack)
            return lambda pending: (
                (key, evaluator.evaluate(design)) for key, design in pending.items()
            )
        processes = evaluation.DesignProcesses(self.inputs, jobs, stack)
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
        self.keys += [self._key(design) for design in designs]

    def _key(self, design: Design) -> str:
        texts = [definition.value_key(value) for value in design]
        files = [
            self._files.get((variable.name, text), "") if variable.choices else ""
            for variable, text in zip(self.inputs.study.variables, texts, strict=True)
        ]
        content = json.dumps([self._common, texts, files])
        return hashlib.sha256(content.encode()).hexdigest()

    def write_table(self, journal: StudyJournal, folder: Path) -> int:
        """Writes the table of the finished designs to a folder, and returns their number."""
        rows = [
            (number, key, design, journal.results[key])
            for number, (key, design) in enumerate(zip(self.keys, self.designs, strict=True), 1)
            if key in journal.results
        ]
        write_table(self.inputs.study, rows, folder)
        return len(rows)


def plan_study(file: str, library: Sequence[str], trust: bool) -> StudyRun | None:
    """Compiles a study file and selects its designs.

    Prints the errors of the study file and returns ``None`` if it has any.  Raises
    ``typer.BadParameter`` if the file is no study.
    """
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return None
    study = compilation.tool_document
    if not isinstance(study, Study):
        raise typer.BadParameter(f"{file} is no study", param_hint="'STUDY'")
    text = study.robot.read_text(encoding="utf-8")
    folders, files = tuple(library_folders(library)), tuple(compilation.files.values())
    return StudyRun(evaluation.StudyInputs(study, text, folders, trust, files))


def parse_scheduler(text: str) -> str:
    """Returns the address of a Dask scheduler, or an empty text without one.

    Raises ``typer.BadParameter`` unless it is ``tcp://HOST:PORT`` or ``tls://HOST:PORT``, and
    ``ClusterError`` if Dask is not installed.
    """
    if not text:
        return ""
    try:
        parts = urlsplit(text)
        is_address = bool(parts.hostname and parts.port and not parts.path)
    except ValueError:  # of the port
        is_address = False
    if not is_address or parts.scheme not in ("tcp", "tls"):
        raise typer.BadParameter(
            f"{text} is no address such as tcp://host:8786", param_hint="'--scheduler'"
        )
    from thorvaldc.tools.study.dask_cluster import load_distributed

    load_distributed()
    return text


def open_cluster(address: str, run: StudyRun) -> AbstractContextManager[DaskCluster | None]:
    """Opens the Dask cluster of an address, or none without an address."""
    if not address:
        return nullcontext()
    # Dask is imported only for a study on a cluster.
    from thorvaldc.tools.study.dask_cluster import DaskCluster

    return DaskCluster(address, run.inputs.files, message)


_HEADER = "# Design "


@dataclass(frozen=True, slots=True)
class Winner:
    """The best design of a study.

    - ``number``: number of the design, from 1 on.
    - ``result``: its result, as in the journal.
    """

    number: int
    design: Design
    result: dict[str, Any]


def find_winner(
    run: StudyRun, results: dict[str, dict[str, Any]], objective: Objective
) -> Winner | None:
    """Returns the best design for an objective, or ``None`` if no design has the status ``ok``.

    Of equal designs, the one with the smallest number is the best.
    """
    best: tuple[float, Winner] | None = None
    for number, (key, design) in enumerate(zip(run.keys, run.designs, strict=True), 1):
        result = results.get(key)
        value = None if result is None else objective.value_of(result)
        if result is None or result["status"] != "ok" or value is None:
            continue
        rank = objective.rank(value)
        if best is None or rank < best[0]:
            best = rank, Winner(number, design, result)
    return None if best is None else best[1]


def winner_text(run: StudyRun, winner: Winner, by: Objective, study_file: str) -> str:
    """Returns the text of the robot file of a design.

    The text is that of the study's robot file with the values of the design.  A comment at the
    start states the study, the values, the numbers and the version.
    """
    study = run.inputs.study
    lines = [
        f"{_HEADER}{winner.number} of the study {study.name} ({study_file}), best by {by.name};"
        f" thorvaldc {__version__}"
    ]
    for variable, value in zip(study.variables, winner.design, strict=True):
        lines.append(f"#   {variable.name}: {value_text(value)}")
    facts = winner.result["facts"]
    lines += [f"#   {c.name}: {facts[c.fact]:.6g}" for c in study.constraints]
    for objective in study.objectives:
        value = objective.value_of(winner.result)
        lines.append(f"#   {objective.name}: {value:.6g} ({objective.goal})")
    lines.append("# Constraints and objectives are in SI units, angles in rad.")
    return "\n".join(lines) + "\n" + evaluation.robot_text(run.inputs, winner.design)


def write_winner(path: Path, text: str, run: StudyRun) -> Compilation:
    """Writes the robot file, and returns its compilation at its place.

    A file with errors, for example because a relative path of it does not exist there, is not
    written.  Raises ``OutsideError`` if ``path`` is a file that no study has written.
    """
    if path.exists() and not path.read_text("utf-8", "replace").startswith(_HEADER):
        raise OutsideError(f"will not overwrite {path}, which no study has written")
    with unsaved_texts({os.path.realpath(path): text.encode()}):
        compilation = compile_file(path, library=run.inputs.library, trust=run.inputs.trust)
    if not compilation.report.has_errors:
        files.write_file(path, text)
    return compilation


PERIOD = 0.5
"""Least time (s) between two plots."""
LEAST_SIZE = (50, 16)
"""Columns and lines of the smallest terminal with a plot."""
MOST_SIZE = (90, 20)
"""Columns and lines of the largest plot, without its frame."""
AROUND = (16, 7)
"""Columns and lines beside and around a plot: frame, title, axes, legend and bar."""
PASSED, ON_FRONT = ".", "*"


class StudyProgress:
    """The progress of a study on stderr, which is shown only on a terminal.

    A study with several objectives has a plot of the first two, from two designs with the status
    ``ok`` on.  Without the package uniplot, on a small terminal, or if the terminal has no Unicode,
    there is only the bar.
    """

    def __init__(self, run: StudyRun) -> None:
        study = run.inputs.study
        self._run = run
        self._bar = Progress(run.number, "designs")
        self._objectives = study.objectives
        self._columns = objective_columns(study)
        self._results_read = 0
        self._points: list[tuple[float, ...]] = []  # values of the objectives
        self._front: list[tuple[float, ...]] = []
        self._next_plot = 0.0
        self._live: Live | None = None
        self._has_plot = self._bar.active and len(study.objectives) > 1 and _can_plot()

    def show(self, finished: int, results: Mapping[str, Mapping[str, Any]]) -> None:
        """Shows the number of finished designs and their front.

        ``results``: results by the keys of designs, in the order in which they finished.
        """
        if not self._has_plot:
            self._bar.show(finished)
            return
        if time.monotonic() < self._next_plot:
            return
        self._read(results)
        plot = self._plot()
        if self._live is None and not plot:
            self._bar.show(finished)
            return
        self._draw(f"{plot}{self._bar.line(finished)}")
        self._next_plot = time.monotonic() + PERIOD

    def clear(self) -> None:
        """Erases the progress from the terminal."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        self._bar.clear()

    def _read(self, results: Mapping[str, Mapping[str, Any]]) -> None:
        """Adds the results that are new since the last call, so that a plot of many is quick."""
        points, keys = [], set(self._run.keys)
        for key, result in itertools.islice(results.items(), self._results_read, None):
            if key in keys and result["status"] == "ok":
                values = [each.value_of(result) for each in self._objectives]
                points.append(tuple(value for value in values if value is not None))
        self._results_read = len(results)
        self._points += (p for p in points if len(p) == len(self._objectives))
        candidates = self._front + [p for p in points if len(p) == len(self._objectives)]
        ranks = [
            [objective.rank(value) for objective, value in zip(self._objectives, p, strict=True)]
            for p in candidates
        ]
        self._front = [candidates[index] for index in front(ranks)]

    def _plot(self) -> str:
        """Returns the plot as text with a newline at its end, or an empty text without one."""
        columns, lines = shutil.get_terminal_size()
        fits = columns >= LEAST_SIZE[0] and lines >= LEAST_SIZE[1]
        if len(self._points) < 2 or not fits:
            return ""
        try:
            return self._plot_text(columns, lines)
        except Exception:
            # A plot must not end a study of hours, for example with values that overflow.
            return ""

    def _plot_text(self, columns: int, lines: int) -> str:
        import uniplot

        x, y = self._columns[:2]
        text: str = uniplot.plot_to_string(
            [[point[1] for point in points] for points in (self._points, self._front)],
            [[point[0] for point in points] for points in (self._points, self._front)],
            width=min(columns - AROUND[0], MOST_SIZE[0]),
            height=min(lines - AROUND[1], MOST_SIZE[1]),
            title=f"{y.title} against {x.title}"[: columns - AROUND[0]],
            legend_labels=["ok", "front"],
            color=["blue", "red"] if has_color(sys.stderr) else False,
            # Characters tell the front apart without colours.
            character_set="ascii",
            force_ascii_characters=[PASSED, ON_FRONT],
            line_length_hard_cap=columns - 1,
            x_gridlines=[],
            y_gridlines=[],
        )
        return text.rstrip("\n") + "\n"

    def _draw(self, text: str) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        if self._live is None:
            self._bar.clear()
            self._live = Live(
                console=Console(stderr=True, highlight=False),
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        content = Text.from_ansi(text)
        content.no_wrap = True
        self._live.update(content, refresh=True)


def _can_plot() -> bool:
    try:
        import rich.live  # noqa: F401
        import uniplot  # noqa: F401
    except ImportError:
        return False
    return "utf" in (sys.stderr.encoding or "").lower()
