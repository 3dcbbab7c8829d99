"""Evaluates designs of a study: in this process, or on the workers of Dask.

A design is compiled, its constraints are checked and its scenarios driven.  A worker that is
killed, for example because the computer has no memory left, does not end the study.
"""

from __future__ import annotations

import atexit
import copy
import functools
import hashlib
import logging
import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import copy_context
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any

import thorvaldc
from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import OutsideError
from thorvaldc.comparison.difference_text import value_text
from thorvaldc.compiler.pipeline import compile_robot, many_compilations
from thorvaldc.compiler.result import Compilation, SourceFile
from thorvaldc.compiler.scenario.scenario_compilation import compile_scenario
from thorvaldc.compiler.source.overrides import read_changes
from thorvaldc.diagnostics import Diagnostic, DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.masses import PurchaseFacts, purchase_of
from thorvaldc.model.facts.robot_facts import fact_quantity, fact_sections, json_value
from thorvaldc.model.plugins import data_folder
from thorvaldc.simulation.worker_processes import become_worker, ignored_interrupts
from thorvaldc.tools.study.designs import required
from thorvaldc.tools.study.study_document import MEASURE, Design, StudyPlan, fact_values

Measure = Callable[[Robot], Mapping[str, float]]
"""A function of a program that returns numbers of a design by their names."""

_STATUS_OF_CODE = {
    "simulation-tipped": "tipped",
    "simulation-diverged": "diverged",
    "expectation-failed": "expectation",
}


class DesignEvaluator:
    """Evaluates designs of a study one after the other.

    The designs share the parsed files, the xacro expansions, the buses of equal devices and the
    mesh workers.  ``stack``: the mesh workers end when it is closed.
    """

    def __init__(self, plan: StudyPlan, measure: Measure | None, stack: ExitStack) -> None:
        stack.enter_context(many_compilations())
        self._plan, self._measure = plan, measure
        self._sources: dict[Path, SourceFile] = {}

    def evaluate(self, design: Design) -> dict[str, Any]:
        """Returns the result of a design as JSON values.

        The keys are ``status``, ``code``, ``message``, ``facts`` by path, and ``metrics`` by
        scenario.  A design never raises an exception: a design that cannot be compiled or driven is
        a result with the first error.
        """
        row: dict[str, Any] = {"status": "ok", "code": "", "message": "", "facts": {}}
        row["metrics"] = {}
        try:
            self._evaluate(design, row)
        except DiagnosticError as error:
            _set_error(row, error.diagnostic)
        except (Exception, SystemExit) as error:
            # One design among thousands must not end a study of hours, whatever its error is.
            row.update(status="error", message=f"{type(error).__name__}: {error}")
        return row

    def _evaluate(self, design: Design, row: dict[str, Any]) -> None:
        plan = self._plan
        source = self._source(plan.robot, plan.changes(design))
        compilation = compile_robot(source, plan.library, plan.trust)
        robot = compilation.model
        if not isinstance(robot, Robot):
            _set_error(row, compilation.report.errors[0])
            return
        purchase = purchase_of(robot)
        row["facts"] = facts_of(plan, robot, purchase)
        if message := self._broken_constraint(row["facts"], purchase):
            row.update(status="constraint", message=message)
            return
        for name, path in plan.scenarios:
            source = self._source(path, plan.changes(design, name))
            if not self._drive(name, source, compilation, row):
                return
        if self._measure is not None:
            numbers = dict(self._measure(robot))
            row["metrics"][MEASURE] = {name: _finite(value) for name, value in numbers.items()}
            for objective in plan.objectives:
                if objective.metric and objective.value_of(row) is None:
                    row.update(status="error", message=f"the design has no {objective.metric}")

    def _source(self, path: Path, changes: Mapping[str, object]) -> SourceFile:
        """Returns a file with other values; it is parsed once."""
        if path not in self._sources:
            self._sources[path] = SourceFile(path, path.name, path.parent)
        source = copy.copy(self._sources[path])
        source.shape = copy.deepcopy(source.shape)
        source.change(read_changes(changes))
        return source

    def _broken_constraint(self, facts: dict[str, float | None], purchase: PurchaseFacts) -> str:
        for constraint in self._plan.constraints:
            value, quantity = facts[constraint.fact], fact_quantity(constraint.fact)
            if value is None:
                message = f"{constraint.name}: the design has no {constraint.fact}"
                if quantity != si.MONEY:
                    return message
                return f"{message}: {purchase.no_price or f'its prices are in {purchase.currency}'}"
            text = functools.partial(value_text, unit=quantity.unit)
            least, most = constraint.at_least, constraint.at_most
            if least is not None and value < least:
                return f"{constraint.name} is {text(value)}, less than {text(least)}"
            if most is not None and value > most:
                return f"{constraint.name} is {text(value)}, more than {text(most)}"
        return ""

    def _drive(
        self, name: str, source: SourceFile, robot: Compilation, row: dict[str, Any]
    ) -> bool:
        """Runs a scenario, adds its metrics, and returns whether the design passed it."""
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        compilation = compile_scenario(source, lambda part: robot, self._plan.robot)
        if compilation.scenario is None:
            _set_error(row, compilation.report.errors[0])
            return False
        report = Report()
        files = simulation_files(compilation.scenario.fleet)
        result = ScenarioSimulation(compilation.scenario, files).play(
            report, hashed=False, ends_early=True
        )
        (metrics,) = result.metrics.values()
        row["metrics"][name] = {metric: _finite(value) for metric, value in metrics.items()}
        if not result.passed:
            errors = sorted(report.errors, key=lambda e: e.code.name == "expectation-failed")
            _set_error(row, errors[0])
        return result.passed


def facts_of(plan: StudyPlan, robot: Robot, purchase: PurchaseFacts) -> dict[str, float | None]:
    """Returns the facts that a study needs.

    A price in another currency than that of the study's robot is ``None``, because nobody can
    compare it.
    """
    paths = sorted(plan.facts)
    sections = fact_sections(robot, {path.partition(".")[0] for path in paths})
    values = dict(fact_values({name: json_value(part) for name, part in sections.items()}))
    if purchase.currency != plan.currency:
        values = {path: v for path, v in values.items() if fact_quantity(path) != si.MONEY}
    return {path: values.get(path) for path in paths}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _set_error(row: dict[str, Any], diagnostic: Diagnostic) -> None:
    status = _STATUS_OF_CODE.get(diagnostic.code.name, "error")
    row.update(status=status, code=diagnostic.code.number, message=diagnostic.message)


# -- on the workers of Dask ---------------------------------------------------------------

# An evaluator keeps its mesh workers and xacro expansions in variables of the context, and Dask
# runs each task in a context of its own.  All tasks of a process therefore run in one context of
# ours, one after the other, also if the worker has several threads.
_context = copy_context()
_lock = threading.Lock()
_open = ExitStack()
atexit.register(_context.run, _open.close)


def surroundings(plan: StudyPlan) -> dict[str, str]:
    """Returns all that must be equal on each computer, so that a design has one result.

    These are the versions of the programs, the hash of thorvaldc and of its module library, the
    folders in which xacro files find others, and the SHA-256 of each file and mesh of the study.
    """
    digest = hashlib.sha256()
    package, modules = Path(thorvaldc.__file__).parent, data_folder("modules")
    for path in sorted({*package.rglob("*.py"), *modules.rglob("*.*")}):
        digest.update(file_hash(path).encode())
    parts = {"thorvaldc": f"{thorvaldc.__version__} ({digest.hexdigest()[:12]})"}
    parts |= {name: metadata.version(name) for name in ("mujoco", "numpy", "trimesh")}
    parts |= {name: os.environ.get(name, "") for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")}
    return parts | {path: file_hash(path) for path, _ in plan.files} | dict(read_meshes(plan))


def read_meshes(plan: StudyPlan) -> tuple[tuple[str, str], ...]:
    """Compiles the robot, and returns its meshes as ``meshes_of`` does."""
    source = SourceFile(plan.robot, plan.robot.name, plan.robot.parent)
    return meshes_of(compile_robot(source, plan.library, plan.trust).model)


def meshes_of(robot: object) -> tuple[tuple[str, str], ...]:
    """Returns the name and the SHA-256 of each mesh of a robot."""
    meshes = robot.meshes if isinstance(robot, Robot) else ()
    return tuple((f"the mesh {mesh.name}", mesh.sha256) for mesh in meshes)


def file_hash(path: str | Path) -> str:
    """Returns the SHA-256 of a file, or an empty text if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def evaluate_on_worker(
    pickled: bytes, expected: dict[str, str], design: Design
) -> tuple[str, dict[str, Any]]:
    """Evaluates a design as a task of a worker, which keeps its evaluator for the next task.

    Returns what differs on the worker, or an empty text, and the result.
    """
    with _lock:
        return _context.run(_evaluate, pickled, tuple(expected.items()), design)


def _evaluate(
    pickled: bytes, expected: tuple[tuple[str, str], ...], design: Design
) -> tuple[str, dict[str, Any]]:
    evaluator, difference = _evaluator(pickled, expected)
    if difference:
        _evaluator.cache_clear()  # somebody may mend the worker
        return difference, {}
    return "", evaluator.evaluate(design)


@functools.lru_cache(maxsize=1)
def _evaluator(
    pickled: bytes, expected: tuple[tuple[str, str], ...]
) -> tuple[DesignEvaluator, str]:
    import cloudpickle

    _open.close()
    plan, measure = cloudpickle.loads(pickled)
    here, difference = surroundings(plan), ""
    for name, value in expected:
        if here.get(name) != value:
            difference = f"{name} {here.get(name) or '(missing)'}; the study has {value}"
            break
    return DesignEvaluator(plan, measure, _open), difference


def results_on_dask(
    plan: StudyPlan,
    measure: Measure | None,
    pending: Mapping[str, Design],
    client: Any,
) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """Yields the key and the result of each design, in the order in which they finish.

    The designs of a worker that died are evaluated again.  A design that has ended the workers of
    several attempts, also alone, has the result ``None``.  Raises ``OutsideError`` if a worker
    differs or the scheduler goes away.
    """
    distributed, cloudpickle = required("distributed"), required("cloudpickle")
    pickled, expected = cloudpickle.dumps((plan, measure)), surroundings(plan)
    remaining, running = iter(pending.items()), dict[Any, tuple[str, Design]]()
    suspects: list[tuple[str, Design]] = []
    finished = distributed.as_completed(loop=client.loop)

    def submit(key: str, design: Design, /, **options: Any) -> None:
        future = client.submit(evaluate_on_worker, pickled, expected, design, **options)
        running[future] = key, design
        finished.add(future)

    try:
        for key, design in islice(remaining, MOST_TASKS):
            submit(key, design, pure=False)
        for future in finished:
            key, design = running[future]
            try:
                difference, result = future.result()
            except distributed.KilledWorker:
                # The worker may have ended because of another design: each one is tried alone.
                if future.key.startswith("alone"):
                    yield key, None
                else:
                    suspects.append((key, design))
            else:
                if difference:
                    raise OutsideError(
                        f"a worker has {difference}: each worker needs the same programs, and the"
                        " files of the study at the same paths; see docs/studies-on-a-cluster.md"
                    )
                yield key, result
            del running[future]
            for key, design in islice(remaining, 1):
                submit(key, design, pure=False)
            if not running and suspects:
                key, design = suspects.pop()
                submit(key, design, key=f"alone-{key}")
    except (OSError, distributed.client.FutureCancelledError) as error:
        raise OutsideError(
            f"the connection to the Dask scheduler is lost ({type(error).__name__}): all finished"
            " designs are on the disk, and the same command continues"
        ) from None
    finally:
        with suppress(Exception):
            client.cancel(list(running), force=True)


def _local_worker_plugin(distributed: Any) -> Any:
    """Returns the plugin by which a process of Dask ends with this one, and ignores Ctrl-C."""

    class LocalWorker(distributed.WorkerPlugin):  # type: ignore[misc]
        def setup(self, worker: object) -> None:
            become_worker()

    return LocalWorker()


def _local_cluster(distributed: Any, jobs: int) -> Any:
    try:
        return distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",  # any free port
            silence_logs=logging.CRITICAL,
        )
    except RuntimeError:
        raise OutsideError(
            "the processes cannot start: a program with several jobs calls `run` below"
            " `if __name__ == '__main__':`"
        ) from None


MOST_TASKS = 2_000
"""Number of designs that the scheduler has at once."""


@contextmanager
def dask_client(scheduler: str, jobs: int) -> Iterator[Any]:
    """Opens a connection to a Dask scheduler, or with no address to processes of this computer.

    Raises ``OutsideError`` if there is no scheduler at the address.
    """
    distributed, dask = required("distributed"), required("dask")
    # What the user has to know, we say in one line.
    for name in ("distributed", "distributed.client", "distributed.core", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.worker.profile.enabled": False}))
        cluster = None
        if not scheduler:
            with ignored_interrupts():
                cluster = _local_cluster(distributed, jobs)
            scheduler = stack.enter_context(cluster).scheduler_address
        try:
            client = distributed.Client(scheduler, timeout=5, set_as_default=False)
        except (OSError, ValueError) as error:
            raise OutsideError(
                f"there is no Dask scheduler at {scheduler} ({type(error).__name__}): start one"
                f" with `dask scheduler`, and workers with `dask worker {scheduler} --nthreads 1`"
            ) from None
        stack.enter_context(client)
        if cluster is not None:
            client.register_plugin(_local_worker_plugin(distributed))
        if not client.nthreads():
            message(f"{scheduler} has no workers; waiting for `dask worker {scheduler}`")
        yield client
