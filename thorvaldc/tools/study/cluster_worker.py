"""Evaluates designs of a study on a worker of a Dask cluster."""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import pickle
import platform
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from contextvars import copy_context
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import thorvaldc
from thorvaldc.model.plugins import data_folder
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs
from thorvaldc.tools.study.sample_points import Design

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

    def difference_here(self) -> str:
        """Returns what differs on this computer, or an empty text."""
        here = Surroundings.of([path for path, _ in self.files])
        for (name, expected), (_, present) in zip(self.programs, here.programs, strict=True):
            if expected != present:
                return f"has {name} {present}; the study has {name} {expected}"
        for (path, expected), (_, present) in zip(self.files, here.files, strict=True):
            if expected != present:
                return f"has another file {path}" if present else f"has no file {path}"
        return ""


def difference(surroundings: Surroundings) -> str:
    """Returns what differs on this worker or scheduler, or an empty text."""
    return surroundings.difference_here()


@dataclass(frozen=True, slots=True)
class ClusterInputs:
    """All that a worker needs to evaluate the designs of a study."""

    inputs: StudyInputs
    surroundings: Surroundings


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

    ``pickled``: the ``ClusterInputs``.
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
    content: ClusterInputs = pickle.loads(pickled)
    difference = content.surroundings.difference_here()
    return difference, None if difference else DesignEvaluator(content.inputs, _open)


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
