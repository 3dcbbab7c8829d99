"""Robots written to disk by the two XML backends, and the external checkers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.backend_files import files_of
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


def checker(program: str, package: str) -> str:
    """Return the path of a program; without it, skip the test, or fail if ``CI`` is set."""
    program_path = shutil.which(program)
    if program_path is None:
        reason = f"{program} is not installed (Debian package {package})"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return program_path


@pytest.fixture
def check_urdf() -> str:
    return checker("check_urdf", "liburdfdom-tools")


@pytest.fixture
def ign() -> str:
    return checker("ign", "ignition-tools, libsdformat-dev")


@pytest.fixture
def cc() -> str:
    return checker("cc", "gcc")


@pytest.fixture
def shellcheck() -> str:
    return checker("shellcheck", "shellcheck")
