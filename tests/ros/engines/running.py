"""Starts engines, base drivers and guards of the tests, each in a process of its own."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.child_process import ChildProcess, end_at_hang_up
from tests.ros.environments import python_of, variables
from thorvaldc.model.settings import NAME_PREFIX, NAME_SPACE

GUARD = "import sys; from thorvaldc.ros.base_driver import guard; sys.exit(guard())"


def named(package: Path, namespace: str = "") -> Path:
    """Puts the names of a robot into the files of its package, as the launch files do."""
    prefix = f"{namespace}/" if namespace else ""
    for path in package.rglob("*"):
        if path.suffix in (".yaml", ".urdf", ".sdf", ".xml", ".rviz"):
            text = path.read_text(encoding="utf-8").replace(NAME_PREFIX, prefix)
            path.write_text(text.replace(NAME_SPACE, f"/{namespace}"), encoding="utf-8")
    return package


@contextlib.contextmanager
def process(distro: str, folder: Path, arguments: Sequence[str]) -> Iterator[ChildProcess]:
    """Runs a Python program with ROS 2."""
    started = ChildProcess(
        [python_of(distro), *arguments],
        env=variables(folder),
        preexec_fn=end_at_hang_up,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield started
    finally:
        started.end()


def engine(
    distro: str, folder: Path, physics: str, file: Path, packages: Sequence[Path], *options: str
) -> contextlib.AbstractContextManager[ChildProcess]:
    """Runs the engine with packages in one world."""
    from tests.outside_tools import path_of_dart_python

    python = path_of_dart_python() if physics == "dart" else sys.executable
    arguments = ["-m", "tests.ros.engines.gazebo_engine", "--physics", physics]
    arguments += ["--python", python, "--file", str(file), *options, *map(str, packages)]
    return process(distro, folder, arguments)


def node(
    distro: str,
    folder: Path,
    package: Path,
    namespace: str = "",
    guard: bool = False,
    dialect: str = "gazebo",
) -> contextlib.AbstractContextManager[ChildProcess]:
    """Runs the base driver of a package, or its guard, as the launch files start it."""
    values: dict[str, Any] = {"model_file": str(package / "config" / "model.json")}
    values |= {"joint_topics": dialect, "use_sim_time": True}
    if not guard:
        values |= {"base": "topics", "stamped": False}
    arguments = ["-c", GUARD] if guard else ["-m", "thorvaldc.ros.base_driver"]
    arguments.append("--ros-args")
    for name, value in values.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace}"]
    return process(distro, folder, arguments)


@contextlib.contextmanager
def interrupted_after(first: ChildProcess, other: ChildProcess) -> Iterator[None]:
    """Ends a process by SIGINT as soon as another one has ended, as ``launch`` does."""

    def interrupt() -> None:
        first.wait()
        other.send_signal(signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    try:
        yield
    finally:
        first.end()
        thread.join()


def end(started: ChildProcess) -> dict[str, Any]:
    """Ends an engine, and returns its report."""
    started.send_signal(signal.SIGTERM)
    out, err = started.communicate(timeout=300)
    assert started.returncode == 0, err
    report: dict[str, Any] = json.loads(out)
    return report
