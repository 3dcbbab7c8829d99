"""What every backend must do.  The suite runs over all targets, built-in and plugged-in.

A new backend is tested from the day on which it is in the table of ``thorvaldc.backends``.
"""

from __future__ import annotations

import builtins
import datetime
import hashlib
import io
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest

from tests.backend_files import files_of
from tests.backends.plans import ROBOTS as PLANS
from tests.backends.plans import grafted
from tests.buses import robot_with_bus
from tests.examples import FLEETS, example_fleet, example_robot, sampled
from tests.robots import FOUR_STEERED, make_robot
from tests.slow import mostly_slow
from thorvaldc import backends
from thorvaldc.backends import Backend
from thorvaldc.diagnostics import CODES
from thorvaldc.model import Fleet, Link, Placement, Pose, Robot
from thorvaldc.model.model_json import to_json
from thorvaldc.model.statics.standing_pose import solve_statics

TARGETS = backends.names()
ODD_TEXT = 'Schöne Grüße, "100 %" <b>&amp; \\ ]]> 日本 --'
FOUR = make_robot(FOUR_STEERED)
ROBOTS: dict[str, Robot] = {
    "four_steered": FOUR,
    "with_a_bus": robot_with_bus(),
    "suspended_casters": make_robot(
        [(0.4, 0.3, "fixed"), (0.4, -0.3, "fixed"), (-0.4, 0.0, "swivel")], suspended=True
    ),
    "one_wheel": make_robot([(0.5, 0.0, "steered")], calculator="one_wheel"),
    "no_wheels": make_robot([]),
    "tips_over": make_robot([(0.5, 0.1, "fixed"), (0.5, -0.1, "fixed")]),
    "tiny": make_robot(FOUR_STEERED, radius=0.001, width=0.001, body_mass=1e-3),
    "huge": make_robot(FOUR_STEERED, radius=0.6, width=0.5, body_mass=1e6),
    "name_space": replace(robot_with_bus(), namespace="r1"),
    "odd_text": replace(robot_with_bus(), description=ODD_TEXT, urdf_extensions=("<a/>", "<b/>")),
    "link_named_world": replace(
        FOUR,
        links=tuple(
            replace(link, name="world") if link.name == "frame_body" else link
            for link in FOUR.links
        ),
        joints=tuple(
            replace(
                joint,
                parent="world" if joint.parent == "frame_body" else joint.parent,
                child="world" if joint.child == "frame_body" else joint.child,
            )
            for joint in FOUR.joints
        ),
    ),
    "only_a_base": replace(
        make_robot([]), links=(Link("base_link", "", None, (), (), FOUR.span),), joints=()
    ),
    "many_parts_and_meshes": grafted(3),
    "cambered": PLANS["cambered"],
    "mixed_radii": PLANS["mixed_radii"],
    "example": example_robot("9wd9ws"),
}
RESERVED = {"model.json", "manifest.json"}
DATES = [
    re.compile(datetime.date.today().strftime(form).encode())
    for form in ("%Y-%m-%d", "%d.%m.%Y", "%m-%d-%Y", "%m/%d/%Y", "%d %b %Y", "%b %d %Y", "%B %Y")
]


@pytest.fixture(params=TARGETS)
def backend(request: pytest.FixtureRequest) -> type[Backend]:
    return type(backends.load(request.param))


SAMPLE = sampled(
    ROBOTS,
    ["example", "link_named_world", "name_space", "odd_text", "only_a_base", "suspended_casters"],
)


@pytest.fixture(params=SAMPLE)
def robot(request: pytest.FixtureRequest) -> Robot:
    return ROBOTS[request.param]


def check_files(files: Mapping[str, bytes]) -> None:
    """Check paths and contents, as every build needs them."""
    assert all(type(data) is bytes for data in files.values())
    for path in files:
        parts = PurePosixPath(path).parts
        assert path == "/".join(parts), f"{path} is not a normal POSIX path"
        assert path not in RESERVED, f"{path} belongs to the compiler"
        assert not path.startswith("/")
        assert ".." not in parts
        assert not re.search(r'[\\:*?"<>|\x00-\x1f]', path), f"{path} is no name on every system"
    assert len({path.casefold() for path in files}) == len(files), "paths differ by case only"
    folders = {str(parent) for path in files for parent in PurePosixPath(path).parents}
    assert not folders & set(files), "a path is a file and a folder"
    here = [str(Path.cwd()), str(Path.home()), str(Path(backends.__file__).parent)]
    for path, data in files.items():
        for folder in here:
            assert folder.encode() not in data or len(folder) < 3, f"{path} names {folder}"
        for date in DATES:
            assert not date.search(data), f"{path} has a date"


def check_purity(
    backend: type[Backend], robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> dict[str, bytes]:
    """Check that a second call gives the same bytes, with the outside world out of reach."""
    model = to_json(robot)
    files = backend().emit(robot)
    diagnostics = list(backend().unsupported(robot))

    def unreachable(*_: object, **__: object) -> object:
        raise AssertionError("a backend reads no file, clock, random number or environment")

    with monkeypatch.context() as patch:
        for module, names in (
            (builtins, ("open",)),
            (io, ("open",)),
            (os, ("getenv", "getcwd", "listdir", "scandir", "stat", "urandom")),
            (time, ("time", "time_ns", "localtime", "gmtime", "strftime")),
            (random, ("random", "randint", "choice", "uniform")),
        ):
            for name in names:
                patch.setattr(module, name, unreachable)
        again = backend().emit(robot)
        diagnostics_again = list(backend().unsupported(robot))
    assert again == files
    assert list(again) == list(files)
    assert diagnostics_again == diagnostics
    assert to_json(robot) == model, "the backend changed the model"
    return files


def check_fleet(backend: type[Backend], fleet: Fleet) -> None:
    """Check that the fleet has each robot's own files in a folder of its name."""
    files = files_of(backend, fleet)
    check_files(files)
    for placement in fleet.placements:
        for path, data in files_of(backend, placement.robot).items():
            assert files[f"{placement.name}/{path}"] == data
    assert files_of(backend, fleet) == files


@pytest.mark.parametrize("name", TARGETS)
def test_class(name: str) -> None:
    backend = backends.load(name)
    assert backend.name == name
    assert 10 <= len(backend.summary) <= 100
    assert "\n" not in backend.summary


def test_every_target_of_a_robot(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pure, correct paths, files that several targets write are equal; statics are only read."""
    files_of_all: dict[str, bytes] = {}
    for name in TARGETS:
        backend = backends.load(name)
        files = check_purity(type(backend), robot, monkeypatch)
        check_files(files)
        assert files, f"the target {name} has no file"
        for path, data in files.items():
            assert files_of_all.setdefault(path, data) == data, f"{path} of {name}"
    check_files(files_of_all)
    # The targets only read the statics, of which there are one for each robot.
    assert solve_statics(replace(robot)) == solve_statics(robot)


def test_fleet(backend: type[Backend]) -> None:
    robots = [replace(robot_with_bus(), namespace="a"), replace(grafted(4), namespace="b")]
    poses = [Pose(), Pose((3.0, 0.0, 0.0))]
    placements = [
        Placement(robot.namespace, pose, robot) for robot, pose in zip(robots, poses, strict=True)
    ]
    check_fleet(backend, Fleet("two", "", tuple(placements)))


@pytest.mark.parametrize("name", mostly_slow(FLEETS))
def test_example_fleet(name: str, backend: type[Backend]) -> None:
    check_fleet(backend, example_fleet(name))


def test_unsupported(backend: type[Backend], robot: Robot) -> None:
    for diagnostic in backend().unsupported(robot):
        assert CODES[diagnostic.code.name] is diagnostic.code
        code = diagnostic.code.number
        if backend.name in backends.TARGETS:
            assert code.startswith("TV6"), "codes of backends are TV6xx"
        else:
            assert not code.startswith("TV"), "another package has a prefix of its own"
        assert diagnostic.code.severity != "error", "what a format lacks does not stop a build"
        assert diagnostic.span is not None


def test_hash_seed_and_imports() -> None:
    """The same bytes for every ``PYTHONHASHSEED``, without simulator, bus and numpy.

    The targets from ``ros2`` on have templates and load jinja2.
    """
    script = (
        "import hashlib, sys\n"
        "from tests.backend_files import files_of\n"
        "from tests.buses import robot_with_bus\n"
        "from tests.robots import FOUR_STEERED, make_robot\n"
        "from thorvaldc import backends\n"
        "for name in backends.TARGETS:\n"
        "    digest = hashlib.sha256()\n"
        "    for robot in (robot_with_bus(), make_robot(FOUR_STEERED, suspended=True)):\n"
        "        files = files_of(type(backends.load(name)), robot)\n"
        "        digest.update(repr(list(files.items())).encode())\n"
        "    print(name, digest.hexdigest())\n"
        "    heavy = {'mujoco', 'can', 'numpy', 'yaml', 'trimesh'}\n"
        "    heavy |= {'jinja2'} if name in ('urdf', 'mjcf', 'sdf') else set()\n"
        "    assert not heavy & set(sys.modules)\n"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", script],
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": "."},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(outputs) == 1


@pytest.mark.parametrize("name", backends.TARGETS)
def test_the_page_of_commands_names_it(name: str) -> None:
    text = (Path(__file__).parents[2] / "docs/commands.md").read_text()
    for entry in {path.split("/")[0] for path in backends.load(name).emit(robot_with_bus())}:
        assert re.search(rf"`{re.escape(entry)}[/`]", text), "the list of a build's files"
    assert re.search(rf"--target [\w,]*\b{name}\b", text), "the list of commands"


# -- the suite detects bad backends -----------------------------------------------------------


class Bad(Backend):
    name = "bad"
    summary = "the base of bad backends"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {"bad/file": b"same"}


class ReadsTheClock(Bad):
    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {"bad/file": str(time.time()).encode()}


class ReadsAFile(Bad):
    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {"bad/file": Path(__file__).read_bytes()}


class CountsItsCalls(Bad):
    calls = 0

    def emit(self, robot: Robot) -> dict[str, bytes]:
        CountsItsCalls.calls += 1
        return {"bad/file": str(self.calls).encode()}


@pytest.mark.parametrize("bad", [ReadsTheClock, ReadsAFile, CountsItsCalls])
def test_impure_backends_fail(bad: type[Backend], monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AssertionError):
        check_purity(bad, FOUR, monkeypatch)


@pytest.mark.parametrize(
    "files",
    [
        {"/etc/bad": b""},
        {"bad/../../file": b""},
        {"bad\\file": b""},
        {"./bad": b""},
        {"bad//file": b""},
        {"model.json": b""},
        {"bad/file": "text"},
        {"bad/File": b"", "bad/file": b""},
        {"bad": b"", "bad/file": b""},
        {"bad/file": f"written in {Path.cwd()}".encode()},
        {"bad/file": f"CreationDate={datetime.date.today():%m-%d-%Y}".encode()},
    ],
)
def test_bad_files_fail(files: Mapping[str, bytes]) -> None:
    with pytest.raises(AssertionError):
        check_files(files)


def test_a_fleet_without_a_robot_s_own_files_fails() -> None:
    class Forgets(Bad):
        def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
            return {"bad/scene": hashlib.sha256(fleet.name.encode()).digest()}

    with pytest.raises((AssertionError, KeyError)):
        check_fleet(Forgets, Fleet("one", "", (Placement("a", Pose(), FOUR),)))
