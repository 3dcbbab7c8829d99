"""Robots written to disk by the two XML backends, and the external checkers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.backend_files import files_of
from tests.outside_tools import path_of
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Fleet, Robot


def write(files: dict[str, bytes], folder: Path) -> Path:
    for path, data in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
    return folder


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Robot], Path]:
    """A function that writes URDF and MJCF of a robot to a new folder and returns the folder."""

    def run(robot: Robot) -> Path:
        return write({**files_of(Urdf, robot), **files_of(Mjcf, robot)}, tmp_path / robot.name)

    return run


@pytest.fixture
def written_fleet(tmp_path: Path) -> Callable[[Fleet], Path]:
    def run(fleet: Fleet) -> Path:
        return write({**files_of(Urdf, fleet), **files_of(Mjcf, fleet)}, tmp_path)

    return run


@pytest.fixture
def check_urdf() -> str:
    return path_of("check_urdf")


@pytest.fixture
def ign() -> str:
    return path_of("ign")


@pytest.fixture
def cc() -> str:
    return path_of("cc")


@pytest.fixture
def shellcheck() -> str:
    return path_of("shellcheck")
