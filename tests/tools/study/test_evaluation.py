"""Studies on a Dask cluster: the same bytes as on this computer, and one line for each fault."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import distributed
import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import Command
from tests.cli.conftest import thorvaldc as thorvaldc_command
from tests.slow import mostly_slow
from tests.tools.study.dask_processes import ROOT, DaskProcesses
from tests.tools.study.kills import VICTIMS, KilledStudy
from tests.tools.study.test_studies import DRIVE, STUDY, journal_lines
from thorvaldc.tools.study import Study, evaluation

pytestmark = [
    pytest.mark.xdist_group("dask"),
    # Warnings of Dask and of the event loop that it leaves to the garbage collection.
    pytest.mark.filterwarnings("ignore"),
]
run = pytest.fixture(name="run")(thorvaldc_command.__wrapped__)  # type: ignore[attr-defined]


@pytest.fixture
def dask(run: Command) -> Iterator[DaskProcesses]:
    processes = DaskProcesses()
    try:
        yield processes
    finally:
        processes.close()


def study_with_scenario(number: int) -> None:
    Path("drive.yaml").write_text(DRIVE)
    text = STUDY.replace("objectives:", "scenarios: {go: {scenario: drive.yaml}}\nobjectives:")
    text = text.replace("light: {fact: mass", "energy: {metric: go.energy")
    Path("study.yaml").write_text(
        text.replace("grid, number: 81", f"random, number: {number}, seed: 3")
    )


def wait_for_a_result() -> None:
    """Waits for the first finished design."""
    end = time.monotonic() + 300
    while time.monotonic() < end and not journal_lines("dask"):
        time.sleep(0.01)


def table(folder: str) -> bytes:
    return Path(folder, "designs.parquet").read_bytes()


@pytest.mark.slow
def test_a_cluster_gives_the_same_table(run: Command, dask: DaskProcesses) -> None:
    """Also a worker with several threads, although a design needs its process for itself."""
    study_with_scenario(8)
    dask.start_worker(threads=4)
    dask.start_worker()
    result = run("study", "run", "study.yaml", "--scheduler", dask.address, "-o", "dask")
    assert result.status == 0, result.err
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "one").status == 0
    assert table("dask") == table("one")


@pytest.mark.slow
def test_workers_die_and_join(run: Command, dask: DaskProcesses) -> None:
    Path("study.yaml").write_text(STUDY.replace("number: 81", "number: 60"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "one").status == 0
    command = [sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml", "-o", "dask"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with ChildProcess([*command, "--scheduler", dask.address], env=environment) as study:
        first = dask.start_worker()
        wait_for_a_result()
        first.send_signal(signal.SIGKILL)
        dask.start_worker()
        assert study.wait(300) == 0
    assert table("dask") == table("one")


@pytest.mark.slow
def test_an_interrupt_leaves_no_tasks_and_the_study_continues(
    run: Command, dask: DaskProcesses
) -> None:
    Path("study.yaml").write_text(STUDY.replace("number: 81", "number: 200"))
    dask.start_worker()
    command = [sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml", "-o", "dask"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with ChildProcess(
        [*command, "--scheduler", dask.address], env=environment, stderr=subprocess.PIPE, text=True
    ) as study:
        wait_for_a_result()
        study.send_signal(signal.SIGINT)
        _, error = study.communicate(timeout=300)
    assert study.returncode == 130
    assert "continue" in error
    assert "Traceback" not in error
    tasks, end = -1, time.monotonic() + 300
    with distributed.Client(dask.address, set_as_default=False) as client:
        while tasks != 0 and time.monotonic() < end:
            tasks = client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
    assert tasks == 0
    assert journal_lines("dask") < 200
    continued = run("study", "run", "study.yaml", "--scheduler", dask.address, "-o", "dask")
    assert continued.status == 0, continued.err
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "one").status == 0
    assert table("dask") == table("one")


@pytest.mark.slow
def test_a_scheduler_that_is_not_there(run: Command) -> None:
    Path("study.yaml").write_text(STUDY)
    result = run("study", "run", "study.yaml", "--scheduler", "tcp://127.0.0.1:9")
    assert result.status == 3
    assert "there is no Dask scheduler at tcp://127.0.0.1:9" in result.err
    assert "dask worker tcp://127.0.0.1:9" in result.err


@pytest.mark.slow
def test_a_scheduler_that_goes_away(run: Command, dask: DaskProcesses) -> None:
    """The study ends and says what to do."""
    Path("study.yaml").write_text(STUDY)
    command = [sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml", "-o", "dask"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with ChildProcess(
        [*command, "--scheduler", dask.address], env=environment, stderr=subprocess.PIPE, text=True
    ) as study:
        dask.start_worker()
        wait_for_a_result()
        os.killpg(dask.scheduler.pid, signal.SIGKILL)
        _, error = study.communicate(timeout=300)
    assert study.returncode == 3
    assert "Traceback" not in error
    assert "the same command continues" in error
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "one").status == 0
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "dask").status == 0
    assert table("dask") == table("one")


OTHER_VERSIONS = (
    ("import thorvaldc as t; t.__version__ = '0.0.7'", "has thorvaldc 0.0.7 ("),
    (
        "import importlib.metadata as m; v = m.version\n"
        "m.version = lambda name: '0.0.7' if name == 'mujoco' else v(name)",
        "has mujoco 0.0.7; the study has ",
    ),
)


@pytest.mark.parametrize(
    "version", mostly_slow(OTHER_VERSIONS, quick=0, slow=1), ids=["thorvaldc", "mujoco"]
)
def test_a_worker_with_another_version(
    run: Command, dask: DaskProcesses, version: tuple[str, str]
) -> None:
    """What differs on a worker is named, also if it joins later."""
    change, message = version
    Path("study.yaml").write_text(STUDY)
    Path("sitecustomize.py").write_text(change)
    dask.start_worker(PYTHONPATH=f".{os.pathsep}{ROOT}")
    result = run("study", "run", "study.yaml", "--scheduler", dask.address)
    assert result.status == 3
    assert message in result.err, result.err


def test_surroundings_have_the_files(run: Command, tmp_path: Path) -> None:
    same, other = tmp_path / "same.yaml", tmp_path / "other.xacro"
    for path in (same, other):
        path.write_text("a")
    files = tuple((str(path), evaluation.file_hash(path)) for path in (same, other))
    plan = replace(Study(STUDY).plan, files=files)
    before = evaluation.surroundings(plan)
    other.write_text("b")
    after = evaluation.surroundings(plan)
    assert [name for name in before if before[name] != after[name]] == [str(other)]
    other.unlink()
    assert evaluation.surroundings(plan)[str(other)] == ""


@pytest.mark.parametrize("victim", mostly_slow(VICTIMS[3:], quick=0, slow=1))
def test_a_kill_changes_no_byte(run: Command, victim: str) -> None:
    """One instant of each kind; ``python -m tests.tools.study.kills 30`` kills more often."""
    assert KilledStudy(random.Random(victim), designs=12).has_same_bytes_after(victim, "out")[0]
