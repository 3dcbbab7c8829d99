"""Tests of the processes that read files of others: how many start, and how each of them ends."""

from __future__ import annotations

import functools
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.child_process import ChildProcess, is_running
from tests.compiler.extras.xacro_files import HEAD, STL
from tests.slow import mostly_slow
from thorvaldc.backends import TARGETS
from thorvaldc.compiler.extras import xacro_expand
from thorvaldc.compiler.pipeline import compile_file, emit, load
from thorvaldc.compiler.sandbox import worker_process
from thorvaldc.compiler.shapes import mesh_formats, meshes

ROBOT = """\
thorvaldc: 1
name: robot
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1, width: 0.9}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
extras:
  - {xacro: a.xacro}
"""
ENDLESS_XACRO = HEAD + "<link name='${len([0 for i in range(10**11) if not i+1])}'/></robot>"
MESHES = HEAD + "".join(
    f'<link name="m{i}"><collision><geometry><mesh filename="m{i}.{suffix}"/></geometry>'
    f'</collision></link><joint name="j{i}" type="fixed"><parent link="frame_body"/>'
    f'<child link="m{i}"/></joint>'
    for i, suffix in enumerate(["stl", "obj", "off", "stl", "off"])
)
POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
OBJ = "\n".join(
    [*(f"v {x} {y} {z}" for x, y, z in POINTS), "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
)
ROOT = Path(__file__).parents[3]


def write(folder: Path, xacro: str) -> Path:
    (folder / "a.xacro").write_text(xacro, encoding="utf-8")
    (folder / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    return folder / "robot.yaml"


def off(size: float) -> str:
    lines = ["OFF", "4 4 6", *(" ".join(str(size * n) for n in p) for p in POINTS)]
    return "\n".join([*lines, *(f"3 {a} {b} {c}" for a, b, c in FACES), ""])


def test_a_build_starts_at_most_three_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One for the xacro files, one for STL and OBJ files, and one for all other meshes."""
    started: list[subprocess.Popen[bytes]] = []
    start = worker_process._start

    def counted() -> subprocess.Popen[bytes]:
        started.append(start())
        return started[-1]

    monkeypatch.setattr(worker_process, "_start", counted)
    robot = write(tmp_path, MESHES + "</robot>")
    for i in (0, 3):
        (tmp_path / f"m{i}.stl").write_bytes(STL)
    (tmp_path / "m1.obj").write_text(OBJ, encoding="utf-8")
    for i in (2, 4):
        (tmp_path / f"m{i}.off").write_text(off(0.1 * i), encoding="utf-8")
    compilation = compile_file(robot)
    assert not compilation.report.has_errors, [d.message for d in compilation.report]
    assert len(started) == 3
    assert [process.returncode for process in started] == [-signal.SIGKILL] * 3
    compile_file(robot)  # the meshes are kept; the xacro file is expanded again
    assert len(started) == 4


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_worker_ends_with_its_parent(tmp_path: Path, end: signal.Signals) -> None:
    robot = write(tmp_path, ENDLESS_XACRO)
    process = ChildProcess(
        [sys.executable, "-m", "thorvaldc", "check", str(robot)], stderr=subprocess.DEVNULL
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    deadline = time.monotonic() + 30.0
    worker = ""
    while not worker and time.monotonic() < deadline:
        time.sleep(0.02)
        worker = children.read_text().strip()
    status = Path(f"/proc/{worker}/stat")
    while time.monotonic() < deadline:  # until it has computed for 0.5 s
        fields = status.read_text().rpartition(")")[2].split()
        if int(fields[11]) > 50:
            break
        time.sleep(0.02)
    process.send_signal(end)
    process.wait(timeout=300)
    deadline = time.monotonic() + 9.5  # the limit of processor time would be 10 s
    while is_running(worker) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(worker)


@pytest.mark.parametrize("robot", mostly_slow([None, ROOT / "examples/4wd2ws_tall/robot.yaml"]))
def test_a_system_without_processes_gives_the_same_files(
    robot: Path | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A web browser starts no processes; ``None``: a robot with meshes of its own."""
    if robot is None:
        for i in (0, 3):
            (tmp_path / f"m{i}.stl").write_bytes(STL)
        for i in (2, 4):
            (tmp_path / f"m{i}.off").write_text(off(0.1 * i), encoding="utf-8")
        (tmp_path / "m1.obj").write_text(OBJ, encoding="utf-8")
        robot = write(tmp_path, MESHES + "</robot>")
    folder, with_processes = Path.cwd(), load(robot)
    monkeypatch.setattr(worker_process, "_start", None)
    here = functools.partial(worker_process.limited_worker, has_processes=False)
    monkeypatch.setattr(worker_process, "limited_worker", here)
    monkeypatch.setattr(xacro_expand, "limited_worker", here)
    meshes._read.cache_clear()
    targets = [*TARGETS]
    assert emit(load(robot), targets) == emit(with_processes, targets)
    assert Path.cwd() == folder


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (MemoryError(), "needs more memory than there is"),
        (RecursionError(), "is nested too deeply"),
        (KeyError("x"), "ended its reader"),
    ],
)
def test_a_worker_without_a_process_reports_what_ends_it(
    fault: Exception, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answer(request: object, data: bytes) -> None:
        raise fault

    monkeypatch.setattr(mesh_formats, "answer", answer)
    limits = worker_process.WorkerLimits(1.0, 1, 1 << 20)
    with (
        worker_process.limited_worker(mesh_formats.__name__, limits, has_processes=False) as worker,
        pytest.raises(worker_process.WorkerLimitError, match=text),
    ):
        worker.ask({})


@pytest.mark.parametrize(
    ("printed", "text"),
    [
        ("'[' * 100_000", "ended its reader process"),  # nested more deeply than Python reads
        ("'[{}, 2000000]'", "more than 1 MB"),
    ],
)
def test_the_answer_of_a_hostile_process_is_an_error(
    printed: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [sys.executable, "-c", f"print({printed}); input()"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    monkeypatch.setattr(worker_process, "_start", lambda: ChildProcess(command, **pipes))
    limits = worker_process.WorkerLimits(100.0, 1, 1 << 20, answer_bytes=1 << 20)
    with (
        worker_process.limited_worker("none", limits) as worker,
        pytest.raises(worker_process.WorkerLimitError, match=text),
    ):
        worker.ask({})
