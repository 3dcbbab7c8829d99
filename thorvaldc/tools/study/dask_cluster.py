"""Evaluates designs of a study on the workers of a Dask cluster."""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import logging
import math
import operator
import os
import pickle
import platform
import queue
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any

import thorvaldc
from thorvaldc.cli.exits import OutsideError
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model.plugins import data_folder
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.study_definition import Design

# -- on a worker ------------------------------------------------------------------------------

_PACKAGES = ("mujoco", "numpy", "trimesh", "dask", "distributed")
_SEARCH_PATHS = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")
"""Environment variables by which xacro files find others."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """All that must be equal on each computer, so that a design has one result.

    - ``programs``: name and version of each program; of thorvaldc also a hash of its files.  With
      xacro files also the name and value of each environment variable that they need.
    - ``files``: path and SHA-256 of each file of the study; without a file, the hash is empty.
    """

    programs: tuple[tuple[str, str], ...]
    files: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, paths: Sequence[str]) -> Surroundings:
        """Returns the surroundings on this computer, with the files of the given paths."""
        programs = _programs()
        if any(path.endswith(".xacro") for path in paths):
            programs += tuple((name, os.environ.get(name, "(not set)")) for name in _SEARCH_PATHS)
        return cls(programs, tuple((path, _file_hash(path)) for path in paths))

    def difference(self) -> str:
        """Returns what differs on this computer, worker or scheduler, or an empty text."""
        here = Surroundings.of([path for path, _ in self.files])
        for (name, expected), (_, present) in zip(self.programs, here.programs, strict=True):
            if expected != present:
                return f"has {name} {present}; the study has {name} {expected}"
        for (path, expected), (_, present) in zip(self.files, here.files, strict=True):
            if expected != present:
                return f"has another file {path}" if present else f"has no file {path}"
        return ""


@dataclass(frozen=True, slots=True)
class ChunkResults:
    """Results of the designs of one task.

    - ``worker``: address of the worker.
    - ``difference``: what differs on the worker, or empty.  If not empty, there are no results.
    - ``seconds``: wall time of the designs (s), without the check and the start of the evaluator.
    """

    worker: str
    difference: str
    results: list[dict[str, Any]]
    seconds: float


def evaluate(pickled: bytes, designs: Sequence[Design]) -> ChunkResults:
    """Evaluates designs as a task of a worker, which keeps its evaluator for the next task.

    ``pickled``: the ``StudyInputs`` and the ``Surroundings`` of the study.
    """
    from distributed import get_worker

    address = get_worker().address
    with _lock:
        return _context.run(_evaluate, address, pickled, designs)


# An evaluator keeps its mesh workers and xacro expansions in variables of the context, and Dask
# runs each task in a context of its own.  All tasks of a process therefore run in one context of
# ours, one after the other, also if the worker has several threads.
_context = copy_context()
_lock = threading.Lock()
_open = ExitStack()
atexit.register(_context.run, _open.close)


def _evaluate(address: str, pickled: bytes, designs: Sequence[Design]) -> ChunkResults:
    difference, evaluator = _checked_evaluator(pickled)
    if difference or evaluator is None:
        _checked_evaluator.cache_clear()  # somebody may mend the worker
        return ChunkResults(address, difference, [], 0.0)
    start = time.perf_counter()
    results = [evaluator.evaluate(design) for design in designs]
    return ChunkResults(address, "", results, time.perf_counter() - start)


@functools.lru_cache(maxsize=1)
def _checked_evaluator(pickled: bytes) -> tuple[str, DesignEvaluator | None]:
    _open.close()
    inputs, surroundings = pickle.loads(pickled)
    difference = surroundings.difference()
    return difference, None if difference else DesignEvaluator(inputs, _open)


def _programs() -> tuple[tuple[str, str], ...]:
    """Returns the name and version of each program that a result depends on."""
    python = ".".join(platform.python_version_tuple()[:2])
    own = f"{thorvaldc.__version__} ({_program_hash()})"
    packages = tuple((name, _version(name)) for name in _PACKAGES)
    return (("Python", python), ("thorvaldc", own), *packages)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(not installed)"


@functools.cache
def _program_hash() -> str:
    """Returns the hash of the program and of the module library."""
    digest = hashlib.sha256()
    package = Path(thorvaldc.__file__).parent
    folders = ((package, "*.py"), (data_folder("modules"), "*"))
    for folder, pattern in folders:
        for path in sorted(folder.rglob(pattern)):
            name = path.relative_to(folder).as_posix()
            if path.is_file() and "__pycache__" not in name:
                digest.update(f"{name}\0{_file_hash(os.fspath(path))}\0".encode())
    return digest.hexdigest()[:12]


def _file_hash(path: str) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


CONNECT = 5.0
"""Time for the first connection to the scheduler (s)."""
RECONNECT = 120.0
"""Time after which a scheduler that went away counts as gone (s)."""
TASK = 1.0
"""Wanted duration of a task (s).  A scheduler needs about 1 ms per task."""
MOST_DESIGNS = 1000
"""Largest number of designs in a task."""
WAITING_PER_WORKER = 2
"""Number of tasks that a worker has at once, so that it never waits for the next."""
_PERIOD = 1.0  # s, between two looks at the workers and the connection
_ANSWER = 60.0  # s, for an answer of the scheduler

_Item = tuple[str, Design]
_Result = tuple[str, dict[str, Any] | None]


class ClusterError(OutsideError):
    """Raised if the cluster cannot evaluate the study.  ``str()`` says what to do."""


class _ConnectionLostError(Exception):
    """Raised if the scheduler went away."""


@dataclass(slots=True)
class _Batch:
    """Designs on their way.

    - ``again``: designs whose task was lost with the scheduler.
    - ``suspects``: designs whose task has ended too many workers; one of them alone is tried again.
    - ``left``: number of designs in ``remaining``, or 0 if it is not known.
    """

    pickled: bytes
    remaining: Iterator[_Item]
    left: int
    again: list[_Item] = field(default_factory=list)
    suspects: list[_Item] = field(default_factory=list)
    running: dict[Any, list[_Item]] = field(default_factory=dict)

    def take(self, number: int) -> list[_Item]:
        """Returns the next designs, at most ``number``."""
        taken, self.again = self.again[:number], self.again[number:]
        fresh = list(islice(self.remaining, number - len(taken)))
        self.left = max(self.left - len(fresh), 0)
        return [*taken, *fresh]


class DaskCluster:
    """A connection to a Dask cluster, which lives as long as its ``with`` block.

    - ``address``: address of the scheduler, such as ``tcp://host:8786``.
    - ``files``: the files of the study, which each worker must have at the same paths.
    - ``tell``: function that tells the user about a lost connection and missing workers.
    """

    def __init__(self, address: str, files: Iterable[Path], tell: Callable[[str], None]) -> None:
        self.address = address
        self.tell = tell
        self._surroundings = Surroundings.of(sorted({os.path.abspath(path) for path in files}))
        self._dask = load_distributed()
        self._client: Any = None
        self._workers, self._looked = 0, -math.inf
        self._seconds_per_design = 0.0
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def __enter__(self) -> DaskCluster:
        try:
            self._connect()
        except (OSError, ValueError) as error:
            self._close()
            raise ClusterError(
                f"there is no Dask scheduler at {self.address} ({_first_line(error)}): start one"
                " with `dask scheduler` and workers with `dask worker"
                f" {self.address} --nthreads 1`, or correct --scheduler"
            ) from None
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._close()

    def results_of(self, inputs: StudyInputs, designs: Iterable[_Item]) -> Iterator[_Result]:
        """Yields the key and the result of each design, in the order in which they finish.

        The designs of a worker that died are evaluated again.  A design that has ended the workers
        of several attempts, also alone, has the result ``None``.  Raises ``ClusterError`` if a
        worker differs or the scheduler stays away.
        """
        content = pickle.dumps((_absolute(inputs), self._surroundings))
        batch = _Batch(content, iter(designs), operator.length_hint(designs))
        try:
            while True:
                try:
                    yield from self._evaluate(batch)
                    return
                except _ConnectionLostError:
                    batch.again += [item for items in batch.running.values() for item in items]
                    batch.running.clear()
                    self._reconnect()
        finally:
            if batch.running:  # Ctrl-C, or an error
                with contextlib.suppress(Exception):
                    self._client.cancel(list(batch.running), force=True)

    # -- tasks ----------------------------------------------------------------------

    def _evaluate(self, batch: _Batch) -> Iterator[_Result]:
        while True:
            self._submit(batch)
            if not batch.running:
                return
            try:
                future = self._done.get(timeout=_PERIOD)
            except queue.Empty:
                if self._client.status != "running":
                    raise _ConnectionLostError from None
                continue
            if future in batch.running:
                yield from self._results(batch, future)

    def _submit(self, batch: _Batch) -> None:
        """Gives each worker its tasks, and each suspect to the cluster alone."""
        workers = self._worker_count()
        while len(batch.running) < max(workers, 1) * WAITING_PER_WORKER:
            items = batch.take(self._chunk(batch, workers))
            if not items:
                break
            self._start(batch, items)
        if not batch.running and batch.suspects:
            self._start(batch, [batch.suspects.pop(0)])

    def _chunk(self, batch: _Batch, workers: int) -> int:
        if not self._seconds_per_design:
            return 1
        number = min(int(TASK / self._seconds_per_design), MOST_DESIGNS)
        if batch.left:  # towards the end smaller, so that all workers finish together
            number = min(number, batch.left // (2 * WAITING_PER_WORKER * max(workers, 1)))
        return max(number, 1)

    def _start(self, batch: _Batch, items: list[_Item]) -> None:
        with self._lost_connection():
            values = [design for _, design in items]
            future = self._client.submit(evaluate, batch.pickled, values, pure=False)
        batch.running[future] = items
        future.add_done_callback(self._done.put)

    def _results(self, batch: _Batch, future: Any) -> Iterator[_Result]:
        items = batch.running[future]
        if future.status not in ("finished", "error"):
            raise _ConnectionLostError
        try:
            with self._lost_connection():
                chunk: ChunkResults = future.result(timeout=_ANSWER)
        except self._dask.KilledWorker:
            del batch.running[future]
            if len(items) == 1 and not batch.running and not batch.again and not batch.left:
                yield items[0][0], None
            else:
                batch.suspects += items
            return
        except (ImportError, AttributeError, pickle.UnpicklingError) as error:
            raise ClusterError(_cannot_load(f"a worker of {self.address}", error)) from None
        if chunk.difference:
            raise ClusterError(_differs(f"the worker {chunk.worker}", chunk.difference))
        del batch.running[future]
        self._seconds_per_design = max(chunk.seconds / len(items), 1e-6)
        yield from zip((key for key, _ in items), chunk.results, strict=True)

    # -- connection -----------------------------------------------------------------

    def _connect(self) -> None:
        """Connects to the scheduler, and checks the scheduler and its workers.

        Raises ``OSError`` or ``ValueError`` if there is no scheduler.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # other versions: `_check` says it with the computer
            self._client = self._dask.Client(
                self.address, timeout=CONNECT, set_as_default=False, name="thorvaldc"
            )
        with self._lost_connection(ConnectionError):
            self._check_versions(self._client.get_versions())
            here = replace(self._surroundings, files=())
            answers = {"scheduler": self._on_scheduler(here)}
            answers |= self._client.run(
                Surroundings.difference, self._surroundings, on_error="return"
            )
        for name, answer in answers.items():
            computer = f"the scheduler {self.address}" if name == "scheduler" else f"worker {name}"
            if isinstance(answer, OSError):  # it went away during the check
                continue
            if isinstance(answer, BaseException):
                raise ClusterError(_cannot_load(computer, answer))
            if answer:
                raise ClusterError(_differs(computer, answer))

    def _on_scheduler(self, surroundings: Surroundings) -> Any:
        try:
            return self._client.run_on_scheduler(Surroundings.difference, surroundings)
        except (ImportError, AttributeError) as error:
            return error

    def _check_versions(self, versions: dict[str, Any]) -> None:
        """Checks the versions that Dask itself needs before any function of ours can run."""

        def version_of(part: dict[str, Any], package: str) -> str:
            text = str(part["packages"].get(package))
            return ".".join(text.split(".")[:2]) if package == "python" else text

        others = {f"the scheduler {self.address}": versions["scheduler"]}
        others |= {f"the worker {name}": part for name, part in versions["workers"].items()}
        for computer, part in others.items():
            if not isinstance(part, dict):
                continue
            for package in ("python", "dask", "distributed"):
                expected = version_of(versions["client"], package)
                present = version_of(part, package)
                if expected != present:
                    text = f"has {package} {present}; the study has {package} {expected}"
                    raise ClusterError(_differs(computer, text))

    def _reconnect(self) -> None:
        self.tell(f"lost the scheduler {self.address}; trying again for {RECONNECT:g} s")
        self._close()
        end = time.monotonic() + RECONNECT
        while True:
            try:
                self._connect()
                self._looked = -math.inf
                self.tell(f"connected to {self.address} again")
                return
            except (OSError, ValueError):
                self._close()
                if time.monotonic() > end:
                    raise ClusterError(
                        f"the scheduler {self.address} went away and was not back after"
                        f" {RECONNECT:g} s; all finished designs are on the disk: start the"
                        " scheduler and its workers, and the same command continues"
                    ) from None
                time.sleep(_PERIOD)

    def _worker_count(self) -> int:
        """Returns the number of workers, at most ``_PERIOD`` old."""
        if time.monotonic() - self._looked > _PERIOD:
            before, first = self._workers, self._looked == -math.inf
            with self._lost_connection():
                self._workers = len(self._client.nthreads())
            self._looked = time.monotonic()
            if not self._workers and (before or first):
                self.tell(
                    f"{self.address} has no workers; waiting for"
                    f" `dask worker {self.address} --nthreads 1`"
                )
        return self._workers

    @contextlib.contextmanager
    def _lost_connection(self, kind: type[Exception] = _ConnectionLostError) -> Iterator[None]:
        """Turns the exceptions of a lost connection into one."""
        try:
            yield
        except (OSError, self._dask.CancelledError, TimeoutError) as error:
            raise kind(_first_line(error)) from None
        except RuntimeError as error:  # the client has closed itself
            if self._client.status == "running":
                raise
            raise kind(_first_line(error)) from None

    def _close(self) -> None:
        if self._client is not None:
            with contextlib.suppress(Exception):
                self._client.close(timeout=2)
            self._client = None


def load_distributed() -> Any:
    """Returns the package distributed, and silences it.  Raises ``ClusterError`` without it."""
    try:
        import distributed
    except ImportError:
        raise ClusterError(
            f"--scheduler needs distributed, which is not installed: {install_command('cluster')}"
        ) from None
    # What the user has to know, this module says in one line.
    for name in ("distributed", "distributed.client", "distributed.core", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return distributed


def _absolute(inputs: StudyInputs) -> StudyInputs:
    """Returns the inputs with absolute paths, because a worker runs in another folder."""
    study = inputs.study
    scenarios = tuple((name, path.absolute()) for name, path in study.scenarios)
    return replace(
        inputs,
        study=replace(study, robot=study.robot.absolute(), scenarios=scenarios),
        library=tuple(folder.absolute() for folder in inputs.library),
    )


def _differs(computer: str, text: str) -> str:
    return (
        f"{computer} {text}: each worker needs the same programs, and the files of the study at"
        " the same paths; see docs/studies-on-a-cluster.md"
    )


def _cannot_load(computer: str, error: BaseException) -> str:
    return (
        f"{computer} cannot run thorvaldc ({_first_line(error)}): install the same version there,"
        " also for the scheduler"
    )


def _first_line(error: BaseException) -> str:
    return str(error).split("\n")[0] or type(error).__name__
