"""The table of targets, and backends of other packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples import FOLDER
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc import backends
from thorvaldc.backends import TargetError
from thorvaldc.compiler.pipeline import MODEL_FILE, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model.statics import standing_pose

MODULE = """
from thorvaldc.backends import Backend
from thorvaldc.model.statics.standing_pose import solve_statics

class Parts(Backend):
    name = "parts"
    summary = "the names of all links, as text"

    def emit(self, robot):
        return {"parts/parts.txt": "\\n".join(link.name for link in robot.links).encode()}

class Wheels(Backend):
    name = "wheels"
    summary = "the penetration of each wheel, as text"

    def emit(self, robot):
        contacts = solve_statics(robot).wheels
        lines = [f"{name} {contact.penetration!r}" for name, contact in contacts.items()]
        return {"wheels/wheels.txt": "\\n".join(lines).encode()}
"""


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an installed package that offers two good backends and a broken one."""
    (tmp_path / "wheel_targets.py").write_text(MODULE)
    info = tmp_path / "wheel_targets-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: wheel-targets\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[thorvaldc.backends]\nwheels = wheel_targets:Wheels\nparts = wheel_targets:Parts\n"
        "broken = wheel_targets:Gone\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "wheel_targets", raising=False)
    return tmp_path


def test_the_keys_are_the_names_of_the_backends() -> None:
    for name in backends.TARGETS:
        assert backends.load(name).name == name
    assert set(backends.DEFAULT_TARGETS) <= set(backends.TARGETS)


def test_statics_are_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[str] = []
    solve = standing_pose._equilibrium
    monkeypatch.setattr(
        standing_pose, "_equilibrium", lambda r, *rest: solved.append(r.name) or solve(r, *rest)
    )
    robot = make_robot(FOUR_STEERED)
    emit(robot, ["urdf", "can"])
    assert solved == []
    emit(robot, ["urdf", "mjcf", "sdf"])
    assert solved == [robot.name]


@pytest.mark.parametrize(
    ("name", "meant"), [("gazebo", "sdf"), ("mujoco", "mjcf"), ("ros", "ros2"), ("dbc", "can")]
)
def test_the_name_of_a_program_proposes_its_target(name: str, meant: str) -> None:
    with pytest.raises(TargetError, match=f"unknown target `{name}`; did you mean `{meant}`"):
        backends.load(name)


def test_unknown_target() -> None:
    with pytest.raises(TargetError) as caught:
        backends.load("mjfc")
    assert str(caught.value) == (
        f"unknown target `mjfc`; did you mean `mjcf`? the targets are {', '.join(backends.names())}"
    )


@pytest.mark.usefixtures("packages")
def test_backends_of_another_package() -> None:
    from thorvaldc.compiler.pipeline import compile_file

    assert {"wheels", "broken"} <= set(backends.names())
    model = compile_file(FOLDER / "4wd4ws_slim" / "robot.yaml").model
    assert model is not None
    files = emit(model, ["wheels", "parts"], Report())
    assert set(files) == {MODEL_FILE, "wheels/wheels.txt", "parts/parts.txt"}
    assert files["parts/parts.txt"].startswith(b"base_link")
    assert files["wheels/wheels.txt"].startswith(b"fl_wheel 0.00")


@pytest.mark.usefixtures("packages")
def test_a_broken_backend() -> None:
    with pytest.raises(TargetError) as caught:
        backends.load("broken")
    assert str(caught.value) == (
        "the backend of target 'broken' cannot be loaded: "
        "module 'wheel_targets' has no attribute 'Gone'"
    )


def test_broken_metadata_of_a_package(packages: Path) -> None:
    (packages / "wheel_targets-1.dist-info/entry_points.txt").write_text("[x]\nno value\n")
    assert set(backends.names()) == set(backends.TARGETS)
    with pytest.raises(TargetError, match="cannot be loaded"):
        backends.load("wheels")


def test_a_broken_backend_on_the_command_line(packages: Path) -> None:
    def thorvaldc(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "thorvaldc", *arguments],
            env={"PYTHONPATH": f"{packages}:{Path.cwd()}"},
            capture_output=True,
            text=True,
        )

    listing = thorvaldc("targets")
    assert listing.returncode == 0, listing.stderr
    assert "cannot be loaded" in " ".join(listing.stdout.split())
    assert "the penetration of each wheel" in " ".join(listing.stdout.split())
    file = str(FOLDER / "4wd4ws_slim" / "robot.yaml")
    build = thorvaldc("build", file, "--target", "broken", "-o", str(packages / "build"))
    assert build.returncode == 2
    assert "cannot be loaded" in " ".join(build.stderr.replace("│", " ").split())
