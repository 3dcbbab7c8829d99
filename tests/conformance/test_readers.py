"""Every example and 20 random robots in each reader of MJCF and URDF that research uses."""

from __future__ import annotations

import json
import math
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from tests.backend_files import files_of
from tests.backends.conftest import write
from tests.backends.plans import grafted
from tests.conformance.reader_table import COLUMNS, MJCF, PAGE, READERS, URDF, Reader, with_table
from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.outside_tools import path_in_environment, path_of_drake_python, path_of_warp_python
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Robot

# In one process: Warp compiles its kernels once, for more than a minute.
pytestmark = pytest.mark.xdist_group("readers")
PROGRAMS = Path(__file__).with_name("readers")
SEEDS = 4
STATES = 3
DRIVEN = "4wd4ws_wide"


@cache
def robots() -> dict[str, Robot]:
    return {name: example_robot(name) for name in SAMPLED_ROBOTS} | {
        f"random {seed}": grafted(seed) for seed in range(SEEDS)
    }


def run(python: str | Path, program: str, jobs: Sequence[dict[str, Any]]) -> list[Any]:
    process = subprocess.run(
        [str(python), str(PROGRAMS / program)],
        input=json.dumps(jobs),
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    results: list[Any] = json.loads(process.stdout)
    return results


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("readers")
    for name, robot in robots().items():
        write({**files_of(Urdf, robot), **files_of(Mjcf, robot)}, path / name)
    return path


def states(robot: Robot) -> list[dict[str, float]]:
    """Positions of the joints: first all at 0, then random ones."""
    rng = random.Random(robot.name)
    names = [robot.prefix + joint.name for joint in robot.joints if joint.type != "fixed"]
    return [{}] + [{name: rng.uniform(-1.0, 1.0) for name in names} for _ in range(STATES - 1)]


def read(reader: Reader, folder: Path) -> dict[str, Any]:
    """The results of a reader by robot."""
    python = path_in_environment(
        reader.python, f"{reader.name} is not installed (.ci/run shows how)"
    )
    jobs = []
    for name, robot in robots().items():
        path = folder / name / reader.file
        if reader.program == "drake_mjcf_reader.py":
            path = with_obj_meshes(path)
        at = states(robot)[: 1 if reader.program == "usd_reader.py" else None]
        jobs.append({"path": str(path), "states": at})
    return dict(zip(robots(), run(python, reader.program, jobs), strict=True))


def with_obj_meshes(path: Path) -> Path:
    """A copy with OBJ files in place of STL files, which Drake does not read."""
    text = path.read_text(encoding="utf-8")
    for stl in sorted((path.parents[1] / "meshes").glob("*.stl")):
        trimesh.load(stl).export(stl.with_suffix(".obj"))
    copy = path.with_name("robot_obj.xml")
    copy.write_text(text.replace('.stl"', '.obj"'), encoding="utf-8")
    return copy


@pytest.fixture(scope="module")
def expected(folder: Path) -> dict[str, Any]:
    """What the MuJoCo of the tests reads; ``tests/backends/agreement.py`` compares it with the
    model."""
    jobs = [
        {"path": str(folder / name / MJCF), "states": states(robot)}
        for name, robot in robots().items()
    ]
    results = dict(zip(robots(), run(sys.executable, "mujoco_reader.py", jobs), strict=True))
    for name, result in results.items():
        gains = {
            e.get("joint"): [float(e.get("kp", "nan")), float(e.get("kv", "nan"))]
            for e in ElementTree.parse(folder / name / MJCF).getroot().iterfind("actuator/*")
        }
        assert result["actuators"].keys() == gains.keys()
        # MuJoCo computes the damping of steering; MuJoCo 3.14 does it in another way.
        result["actuators"] = gains
    return results


def differences(a: Any, b: Any, tolerance: float, where: str) -> list[str]:
    """Differences of ``b`` from ``a``; where ``a`` states no number (NaN), ``b`` may have any."""
    if isinstance(a, dict):
        if a.keys() != b.keys():
            return [f"{where}: {sorted(a.keys() ^ b.keys())}"]
        found = [differences(a[k], b[k], tolerance, f"{where}, {k}") for k in a]
        return [line for lines in found for line in lines]
    one, two = np.asarray(a, float), np.asarray(b, float)
    scale = max(1.0, float(np.nanmax(np.abs(one), initial=0.0)))
    gap = np.abs(one - two)
    agree = (gap <= tolerance * scale) | np.isnan(one)
    return [] if agree.all() else [f"{where}: {a} and {b}"]


def without_lost(reader: Reader, path: Path, column: str, value: dict[str, Any]) -> dict[str, Any]:
    """What MuJoCo reads, without what the reader loses as ``notes`` say."""
    root = ElementTree.parse(path).getroot()
    if column == "contacts":
        if reader.file == URDF:
            return Counter(geometry[0].tag for geometry in root.iterfind("link/collision/geometry"))
        lost = "ellipsoid" if reader.program == "usd_reader.py" else None
        return {kind: number for kind, number in value.items() if kind != lost}
    if reader.program == "drake_mjcf_reader.py" and column == "actuators":
        return {str(e.get("joint")): value[str(e.get("joint"))] for e in root.iter("position")}
    return value


def compare(reader: Reader, path: Path, good: dict[str, Any], result: dict[str, Any]) -> list[str]:
    found = []
    for column, cell in zip(COLUMNS, reader.cells, strict=True):
        if column in ("mass", "inertia", "poses"):
            for i, state in enumerate(result["states"]):
                assert not isinstance(cell, str)
                for key in (column,) if column != "inertia" else ("com", "inertia"):
                    found += differences(
                        good["states"][i][key], state[key], cell, f"state {i}, {key}"
                    )
        elif isinstance(cell, str):
            found += [f"{column}: read, but the table says: {cell}"] if column in result else []
        else:
            value = without_lost(reader, path, column, good[column])
            found += differences(value, result[column], cell, column)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_reader(reader: Reader, folder: Path, expected: dict[str, Any]) -> None:
    results = read(reader, folder)
    wrong = {}
    for name, robot in robots().items():
        result = results[name]
        if reader.program == "dm_control_reader.py" and robot.namespace:
            assert "reserved for scoping" in result["error"]
            continue
        assert "error" not in result, (name, result)
        assert result["states"][0]["mass"] == pytest.approx(robot.inertial.mass, rel=1e-6)
        if lines := compare(reader, folder / name / reader.file, expected[name], result):
            wrong[name] = lines[:5]
        if reader.program == "dart_urdf_reader.py":
            # No other link gets the 1 kg of DART.
            extra = result["plain_mass"] - robot.inertial.mass
            assert extra == pytest.approx(1.0, abs=1e-6), name
        if reader.program == "usd_reader.py":
            assert result["actuator_count"] == len(expected[name]["actuators"])
    assert wrong == {}


@pytest.mark.slow
def test_drake_refuses_stl_meshes(folder: Path) -> None:
    """The reason why Drake reads a copy with OBJ files."""
    (reader,) = (reader for reader in READERS if reader.program == "drake_mjcf_reader.py")
    (result,) = run(
        path_of_drake_python(),
        reader.program,
        [{"path": str(folder / DRIVEN / MJCF), "states": [{}]}],
    )
    assert ".obj format" in result["error"]


@pytest.mark.slow
def test_warp_drives_as_mujoco(folder: Path) -> None:
    """1 s straight, and 1 s on the spot with steered wheels."""
    (reader,) = (reader for reader in READERS if reader.program == "warp_reader.py")
    python = path_of_warp_python()
    robot = robots()[DRIVEN]
    straight, turn = {}, {}
    for wheel in robot.wheels:
        drive, steering = (
            next(a.name for a in robot.actuators if a.joint == joint)
            for joint in (wheel.spin_joint, wheel.steering_joint)
        )
        straight[drive] = 4.0
        # The wheel rolls across the line to the middle of the robot.
        angle = math.remainder(math.atan2(wheel.x, -wheel.y) - wheel.heading, math.tau)
        back = abs(angle) > math.pi / 2
        turn[steering] = wheel.steering_sign * (
            math.remainder(angle + math.pi, math.tau) if back else angle
        )
        turn[drive] = -2.0 if back else 2.0
    path = str(folder / DRIVEN / "mjcf/scene.xml")
    (result,) = run(
        python, reader.program, [{"path": path, "states": [], "drives": [straight, turn]}]
    )
    for name, (there, here) in zip(("straight", "turn"), result["driven"], strict=True):
        assert there[:3] == pytest.approx(here[:3], abs=1e-4), name
        assert there[3:] == pytest.approx(here[3:], abs=1e-4), name
    forward, spun = (here for _, here in result["driven"])
    assert forward[0] > 0.3
    assert 2.0 * math.atan2(spun[6], spun[3]) > 0.1


def test_the_comparison_notices_each_change(folder: Path, expected: dict[str, Any]) -> None:
    reader = READERS[0]
    good = expected[DRIVEN]
    path = folder / DRIVEN / MJCF
    assert compare(reader, path, good, good) == []
    for column in COLUMNS:
        changed = json.loads(json.dumps(good))
        place = changed["states"][1] if column in ("mass", "inertia", "poses") else changed
        place[column] = moved(place[column])
        assert compare(reader, path, good, changed) != [], column


def moved(value: Any) -> Any:
    """The value with its last number changed."""
    if isinstance(value, dict):
        last = list(value)[-1]
        return {**value, last: moved(value[last])}
    if isinstance(value, list):
        return [moved(value[0]), *value[1:]]
    return value + 1e-3


def test_the_page_has_the_table() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert with_table(page) == page, "python -m tests.conformance.reader_table"
