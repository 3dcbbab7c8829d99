"""Finds the tests that execute a line of the package, and runs tests in forked processes.

Each test file runs once in a process of its own with ``coverage``; the result is kept in
``.mutants/``, one folder for each test file, until the test file changes.  The context of a line is
the test; for lines that run in a set-up, in a child process of a set-up or at import it is the test
file, since other tests of the file may use the result.

A forked process has imported pytest and the dependencies, but nothing of the package: tests start
in a fraction of a second.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / ".mutants"
COPIED = (
    *("thorvaldc", "tests", "modules", "templates", "examples", "docs", "workshop", "bench"),
    *("editors", "viewer"),
)
COPIED_FILES = (
    *("pyproject.toml", "README.md", "CHANGELOG.md", "Makefile", "LICENSE", ".gitignore"),
    *(".gitattributes", ".pre-commit-hooks.yaml", "action.yml", "mkdocs.yml"),
)
ENVIRONMENTS = (".venv", ".venv-ros")
"""Environments of other programs that tests start."""
LEFT_OUT = ("tests/chaos/", "tests/packaging/", "tests/test_house_rules.py", "tests/docs/")
"""Tests of other things than the behaviour of the package, and long studies."""
DEPENDENCIES = (
    *("can", "cantools", "canopen", "collada", "gymnasium", "hypothesis", "jinja2", "jsonschema"),
    *("mcap", "msgpack", "mujoco", "numpy", "trimesh", "typer.testing", "xacro", "yaml"),
)
TEST_LIMIT = 120
"""s for one test while the lines are recorded."""
FILE_LIMIT = 300.0
"""s for all tests of a file while the lines are recorded; later tests are left out."""
BUSY = 20.0
"""All times are processor times; a process on a busy computer may need so much more real time."""
SETTINGS = """[run]
data_file = {folder}/lines
parallel = true
source = {tree}/thorvaldc
context = ${{PYTEST_CURRENT_TEST-}}
sigterm = true
disable_warnings = no-data-collected,module-not-imported,module-not-measured,couldnt-parse
"""


OPTIONS = ("-n0", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
OF_CI = "not exhaustive"
"""The marker expression of the tests of CI."""


class Outcome(NamedTuple):
    """The end of a test run: the first test that failed, or what else ended the run."""

    failure: str
    """'' if all tests passed."""
    status: int


class _Recorder:
    """A plugin of pytest: the durations of tests, the first failure, the context of coverage."""

    def __init__(
        self, measurement: coverage.Coverage | None, left_out: Collection[str] = ()
    ) -> None:
        self.measurement = measurement
        self.left_out = left_out
        self.end = cpu_seconds() + FILE_LIMIT
        self.collected = 0
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []

    def _switch(self, context: str) -> None:
        if self.measurement is not None:
            self.measurement.switch_context(context)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self.left_out:
            items[:] = [item for item in items if item.nodeid not in self.left_out]

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self.collected = len(session.items)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        before = cpu_seconds()
        result = yield
        self.seconds[item.nodeid] = cpu_seconds() - before
        return result

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self._switch(item.nodeid.partition("::")[0])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> None:
        self._switch(item.nodeid)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        self._switch(item.nodeid.partition("::")[0])
        if self.measurement is not None and cpu_seconds() > self.end:
            item.session.shouldstop = "the time limit of the file"

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)


def cpu_seconds() -> float:
    """Returns the processor time of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def import_dependencies() -> None:
    for name in DEPENDENCIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def copy_of_the_tree(folder: Path) -> Path:
    ignored = shutil.ignore_patterns("__pycache__", "node_modules")
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name, ignore=ignored, dirs_exist_ok=True)
    for name in COPIED_FILES:
        shutil.copy(ROOT / name, folder / name)
    for name in ENVIRONMENTS:
        if (ROOT / name).exists():
            (folder / name).symlink_to(ROOT / name)
    return folder


def run_tests(
    tree: Path,
    tests: Iterable[str],
    limit_s: float,
    test_limit_s: float = TEST_LIMIT,
    left_out: Collection[str] = (),
    all_robots: bool = False,
) -> Outcome:
    """Runs tests in a forked process up to the first failure, with the package of ``tree``.

    - ``left_out``: names of tests that do not run;
    - ``all_robots``: runs not only the tests of CI, and for all robots.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "result")

        def child() -> None:
            recorder = _Recorder(None, left_out)
            options = [*OPTIONS, "-x", f"--timeout={BUSY * test_limit_s:.0f}"]
            seconds = round(limit_s)  # of processor time, as in an endless loop
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 10))
            if all_robots:
                os.environ["ROBOTS"] = "all"
            else:
                options += ["-m", OF_CI]
            status = pytest.main([*options, *arguments_of(tests)], plugins=[recorder])
            failure = recorder.failed[0] if recorder.failed else ""
            result.write_text(json.dumps([failure, int(status)]))

        if not _fork(tree, child, BUSY * limit_s, Path(folder, "log")):
            return Outcome("the time limit", -1)
        if not result.exists():
            return Outcome("an end of the test process", -1)
        return Outcome(*json.loads(result.read_text()))


def arguments_of(tests: Iterable[str]) -> list[str]:
    """Returns the arguments of pytest for tests.

    pytest does not find a test by parameters such as ``[[]]``, nor by a path, which is another one
    in each copy of the tree; then all tests of its function run.
    """
    simple = re.compile(r"[^\[]+(\[[\w .,:=+-]+\])?")
    names = [test if simple.fullmatch(test) else test.partition("[")[0] for test in tests]
    return list(dict.fromkeys(names))


def _fork(tree: Path, function: Callable[[], None], limit_s: float, log: Path) -> bool:
    """Runs a function in a forked process in ``tree``; returns False if it takes too long."""
    assert "thorvaldc" not in sys.modules
    pid = os.fork()
    if pid == 0:
        try:
            os.setsid()
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            with log.open("w") as stream:
                os.dup2(stream.fileno(), 1)
                os.dup2(stream.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.chdir(tree)
            sys.path[0] = str(tree)
            os.environ["PYTHONPATH"] = str(tree)
            # Tests are compiled once for each copy of the tree, not once for each mutant.
            os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
            sys.dont_write_bytecode = False
            function()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(0)
    end = time.monotonic() + limit_s
    try:
        while os.waitpid(pid, os.WNOHANG)[0] == 0:
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True
    finally:  # also what the tests left behind
        with contextlib.suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, 0)


def test_files() -> list[str]:
    """Returns the test files whose lines are recorded."""
    names = sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests").rglob("test_*.py"))
    return [name for name in names if not name.startswith(LEFT_OUT)]


def digest_of(name: str, tree: Path = ROOT) -> str:
    return hashlib.sha256((tree / name).read_bytes()).hexdigest()


def _package(tree: Path) -> dict[str, str]:
    """Returns the digest of each file of the package."""
    files = sorted((tree / "thorvaldc").rglob("*.py"))
    names = [str(path.relative_to(tree)) for path in files]
    return {name: digest_of(name, tree) for name in names}


def is_recorded(name: str) -> bool:
    file = CACHE / name / "tests.json"
    return file.exists() and json.loads(file.read_text())["sha256"] == digest_of(name)


def record(name: str, tree: Path) -> int:
    """Runs a test file in the copy ``tree`` and stores which test executes which line.

    Returns the number of tests that the limits left out, or -1 if they ended the process.
    """
    folder = CACHE / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    settings = folder / "coveragerc"
    settings.write_text(SETTINGS.format(folder=folder, tree=tree))
    stored: dict[str, Any] = {"sha256": digest_of(name, tree), "tree": str(tree), "tests": {}}
    stored["package"] = _package(tree)
    (folder / "tests.json").write_text(json.dumps(stored))  # if the time limit ends the tests

    def child() -> None:
        os.environ.pop("PYTEST_CURRENT_TEST", None)
        measurement = coverage.Coverage(config_file=str(settings), data_suffix="main")
        os.environ["COVERAGE_PROCESS_START"] = str(settings)  # for child processes
        recorder = _Recorder(measurement)
        measurement.start()
        timeout = f"--timeout={BUSY * TEST_LIMIT:.0f}"
        options = [*OPTIONS, "-m", OF_CI, timeout, "-rN", "--tb=line"]
        pytest.main([*options, name], plugins=[recorder])
        measurement.stop()
        measurement.save()
        stored["tests"] = {
            test: [round(seconds, 3), test not in recorder.failed]
            for test, seconds in recorder.seconds.items()
        }
        stored["left_out"] = recorder.collected - len(recorder.seconds)
        (folder / "tests.json").write_text(json.dumps(stored))

    _fork(tree, child, BUSY * (FILE_LIMIT + 2.0 * TEST_LIMIT), folder / "log")
    parts = coverage.CoverageData(basename=str(folder / "all"))
    for part in sorted(folder.glob("lines.*")):
        data = coverage.CoverageData(basename=str(part))
        with contextlib.suppress(coverage.CoverageException):  # of a process that was killed
            data.read()
            parts.update(data)
        part.unlink()
    parts.write()
    left_out: int = json.loads((folder / "tests.json").read_text()).get("left_out", -1)
    return left_out


class _Recording(NamedTuple):
    """What is known of a test file."""

    lines: coverage.CoverageData
    tree: str
    package: dict[str, str]


class ExecutedLines:
    """Which tests execute which lines, as ``record`` stored it.

    To be used in the process that creates it: ``coverage`` erases its file after a fork.
    """

    def __init__(self, files: Iterable[str]) -> None:
        """``files``: the test files whose recordings are used."""
        self.seconds: dict[str, float] = {}
        self.fails: set[str] = set()
        """Tests that failed without a mutant."""
        self._recordings: dict[str, _Recording] = {}
        self._package = _package(ROOT)
        for name in files:
            if is_recorded(name):
                stored = json.loads((CACHE / name / "tests.json").read_text())
                data = coverage.CoverageData(basename=str(CACHE / name / "all"))
                data.read()
                self._recordings[name] = _Recording(data, stored["tree"], stored["package"])
                for test, (seconds, passed) in stored["tests"].items():
                    self.seconds[test] = seconds
                    if not passed:
                        self.fails.add(test)

    def tests_of(self, path: Path, lines: range) -> Iterator[tuple[str, set[str]]]:
        """Returns the test files that execute one of ``lines``, each with its tests that do.

        The set of tests is empty where only a set-up or an import executes them.  An empty range,
        and a file that has changed since, stand for all lines.
        """
        for name, recording in self._recordings.items():
            contexts = recording.lines.contexts_by_lineno(f"{recording.tree}/{path}")
            is_same = recording.package.get(str(path)) == self._package[str(path)]
            chosen = lines if lines and is_same else contexts
            executing = {c for line in chosen for c in contexts.get(line, ())}
            if executing:
                names = {context.rpartition(" (")[0] or context for context in executing}
                yield name, {test for test in names if test in self.seconds}

    def tests_in(self, name: str) -> list[str]:
        return [test for test in self.seconds if test.startswith(f"{name}::")]
