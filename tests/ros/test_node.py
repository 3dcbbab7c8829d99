"""The ROS 2 node, driven by a second process with the real rclpy of two distributions."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.child_process import ChildProcess
from tests.examples import example_robot
from tests.ros.environments import DISTROS, python_of, variables
from thorvaldc.compiler.pipeline import emit

pytestmark = [pytest.mark.parametrize("distro", DISTROS), pytest.mark.xdist_group("ros")]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with the model and the MJCF files of a robot with parameter sets."""
    folder = tmp_path_factory.mktemp("build")
    for path, data in emit(example_robot("2wd0ws_greenhouse"), ["mjcf", "urdf"]).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return folder


@contextmanager
def node(distro: str, build: Path, folder: Path, **parameters: Any) -> Iterator[ChildProcess]:
    """Runs the node with parameters in a process."""
    values = {"model_file": str(build / "model.json"), **parameters}
    arguments = [f"-p{name}:={json.dumps(value)}" for name, value in values.items()]
    command = [python_of(distro), "-m", "thorvaldc.ros.base_driver", "--ros-args", *arguments]
    process = ChildProcess(
        [part for a in command for part in ([a[:2], a[2:]] if a.startswith("-p") else [a])],
        env=variables(folder),
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.end()


def run_client(distro: str, program: str, folder: Path, *arguments: object) -> None:
    """Runs a program of the tests with the Python of a distribution."""
    result = subprocess.run(
        [python_of(distro), "-m", f"tests.ros.{program}", *map(str, arguments)],
        env=variables(folder),
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert result.returncode == 0, result.stderr


def end(process: ChildProcess) -> str:
    """Ends a node by SIGTERM and returns what it has written."""
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    return str(err)


def test_node_with_ideal_joints(distro: str, build: Path, tmp_path: Path) -> None:
    options = {"base": "ideal", "autostart": False, "stamped": False}
    with node(distro, build, tmp_path, **options) as process:
        run_client(distro, "drive_ideal", tmp_path, process.pid)
        end(process)
