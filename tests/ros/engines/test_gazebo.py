"""The base driver drives generated robots in an engine that speaks the topics of Gazebo.

Gazebo itself cannot run here: ``gazebo_engine`` stands for it, over DART and over MuJoCo.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros2.packages import write
from tests.examples import SAMPLED_ROBOTS, example_fleet, example_robot
from tests.ros.engines import running
from tests.ros.environments import DISTROS, each_distro
from tests.ros.test_node import run_client
from tests.slow import mostly_slow
from thorvaldc.backends.ros2_parts import WORLD_FRAME
from thorvaldc.compiler.pipeline import emit

FIRST = pytest.mark.parametrize(
    "distro", [pytest.param(DISTROS[0], marks=pytest.mark.xdist_group(f"ros-{DISTROS[0]}"))]
)
"""One distribution is enough for the generated files, which are the same in each."""
STEERED = "4wd4ws_wide"

LOCKSTEP = ("--lockstep", "--factor", "0")
SLOWLY = ("--factor", "0.25")
"""On a busy computer, commands arrive too late for the time of a simulation at full speed."""
RATIO = 0.003
"""Largest error of the odometry, as a share of the path; that of the base `mujoco` is 0.0017."""
YAW = 0.008
"""Largest error of the yaw in rad."""
# SDF 1.9 has no couplings of joints, so that this robot would tip over its free rockers.
COUPLED = ("rocker_bogie",)
ZERO = (0.0, 0.0, 0.0)


def scene(physics: str, folder: Path, package: Path) -> Path:
    """Returns the file with the scene or world of a build."""
    dart = package / "sdf" / "world.sdf"
    return dart if physics == "dart" else folder / "mjcf" / "scene.xml"


def build(name: str, folder: Path) -> Path:
    """Builds the package of an example, and returns its folder."""
    write(folder, emit(example_robot(name), ["ros2", "mjcf"]))
    return running.named(folder / "ros2")


def mission(
    distro: str,
    folder: Path,
    physics: str,
    package: Path,
    seconds: float,
) -> dict[str, Any]:
    """Drives one robot, and returns the errors of its odometry and the report of the engine."""
    file = scene(physics, package.parent, package)
    with (
        running.engine(distro, folder, physics, file, [package], *LOCKSTEP) as engine,
        running.node(distro, folder, package),
    ):
        out = run_client(distro, "engines.mission", folder, seconds, "-")
        report = running.end(engine)
    result: dict[str, Any] = json.loads(out)["-"]
    return {**result, **report}


def check(result: dict[str, Any], shortest: float) -> None:
    assert result["fault"] == ""
    assert result["path"] > shortest
    assert result["distance"] < RATIO * result["path"], result
    assert result["yaw"] < YAW, result


def engines() -> Iterator[Any]:
    """Yields each distribution with each engine; CI runs each of both once."""
    for distro, physics in itertools.product(DISTROS, ("dart", "mujoco")):
        is_in_ci = (distro == DISTROS[0]) == (physics == "dart")
        marks = [pytest.mark.slow if is_in_ci else pytest.mark.exhaustive]
        marks.append(pytest.mark.xdist_group(f"ros-{distro}"))
        yield pytest.param(distro, physics, marks=marks)


@pytest.mark.parametrize(("distro", "physics"), list(engines()))
def test_a_steered_robot_drives_and_knows_where_it_is(
    distro: str, physics: str, tmp_path: Path
) -> None:
    result = mission(distro, tmp_path, physics, build(STEERED, tmp_path), 12.0)
    check(result, 3.0)
    assert result["complete"] > 0.9 * result["cycles"]


@FIRST
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SAMPLED_ROBOTS if name != STEERED])
def test_every_example_drives(distro: str, name: str, tmp_path: Path) -> None:
    physics = "mujoco" if name in COUPLED else "dart"
    result = mission(distro, tmp_path, physics, build(name, tmp_path), 12.0)
    check(result, 2.0)


@each_distro()
@pytest.mark.parametrize("physics", mostly_slow(["dart", "mujoco"], 0, 1))
def test_a_fleet_drives_in_one_world(distro: str, physics: str, tmp_path: Path) -> None:
    fleet = example_fleet("fleet_of_four")
    write(tmp_path, emit(fleet, ["ros2", "mjcf", "sdf"]))
    names = [placement.name for placement in fleet.placements]
    packages = [running.named(tmp_path / name / "ros2", name) for name in names]
    places = [[*p.pose.xyz[:2], p.pose.rpy()[2]] for p in fleet.placements]
    with contextlib.ExitStack() as stack:
        options = ("--namespaces", ",".join(names), "--places", json.dumps(places), *LOCKSTEP)
        file = tmp_path / "ros2" / "sdf" / "world.sdf"
        if physics == "mujoco":
            file = tmp_path / "mjcf" / "scene.xml"
        started = running.engine(distro, tmp_path, physics, file, packages, *options)
        engine = stack.enter_context(started)
        for name, package in zip(names, packages, strict=True):
            stack.enter_context(running.node(distro, tmp_path, package, name))
        results = json.loads(run_client(distro, "engines.mission", tmp_path, 8.0, ",".join(names)))
        running.end(engine)
    assert list(results) == names
    for (name, result), place in zip(results.items(), places, strict=True):
        check(result, 1.0)
        # The odometry begins at zero, the true pose at the place of the robot in the world.
        for topic, frame, start in (
            ("true", WORLD_FRAME, place),
            ("measured", f"{name}/odom", ZERO),
        ):
            assert result[topic][0] == frame
            assert result[topic][1][:2] == pytest.approx(start[:2], abs=0.05)
            assert abs(math.remainder(result[topic][1][2] - start[2], math.tau)) < 0.02


# -- the engine notices what is wrong in the files -------------------------------------------------


def replaced(file: str, pattern: str, text: str, count: int = 1) -> Callable[[Path], None]:
    def change(package: Path) -> None:
        path = package / file
        before = path.read_text(encoding="utf-8")
        after = re.sub(pattern, text, before, count=count)
        assert after != before
        path.write_text(after, encoding="utf-8")

    return change


WRONG_FILES = [
    (replaced("config/gz_bridge.yaml", r'gz_topic_name: "fl_\w+', "\\g<0>s"), "no system has"),
    (replaced("config/gz_bridge.yaml", "Float64", "Float32"), "std_msgs/msg/Float32"),
    (replaced("config/gz_bridge.yaml", "ROS_TO_GZ", "GZ_TO_ROS"), "no system has"),
    (replaced("config/gz_bridge.yaml", "gz.msgs.Model", "gz.msgs.Pose"), "no system has"),
    (replaced("config/gz_bridge.yaml", "GZ_TO_ROS", "BIDIRECTIONAL"), "no system has"),
    (replaced("config/gz_bridge.yaml", "gz.msgs.LaserScan", "gz.msgs.Laser"), "no system has"),
    (replaced("config/gz_bridge.yaml", "  direction", "  lazy: true\n\\g<0>"), "an entry with"),
    (replaced("sdf/model.sdf", "<topic>joint_states", "<topic>states"), "topic joint_states"),
    (replaced("sdf/model.sdf", "<odom_topic>.*</odom_topic>", ""), "topic odometry/true"),
    (replaced("sdf/model.sdf", "<topic>fl_", "<topic>left_"), "no system has the topic fl_"),
    (replaced("sdf/model.sdf", "<joint_name>fl_", "<joint_name>x_"), "no joint x_"),
    (
        replaced("sdf/model.sdf", r"<p_gain>(.+)</p_gain>", r"<gain>\1</gain>"),
        "JointPositionController reads no gain",
    ),
    (replaced("sdf/model.sdf", "systems::JointC", "systems::WheelC"), "no system "),
]


@FIRST
@pytest.mark.parametrize("case", mostly_slow(WRONG_FILES, 0, 3))
def test_the_engine_refuses_files_that_do_not_fit(
    distro: str, case: tuple[Callable[[Path], None], str], tmp_path: Path
) -> None:
    change, message = case
    package = build(STEERED, tmp_path)
    change(package)
    file = scene("mujoco", tmp_path, package)
    with running.engine(distro, tmp_path, "mujoco", file, [package]) as engine:
        _, err = engine.communicate(timeout=300)
    assert engine.returncode == 1
    assert message in err


@FIRST
@pytest.mark.parametrize(
    "change",
    mostly_slow(
        [
            replaced("sdf/model.sdf", "<radius>0.2</radius>", "<radius>0.19</radius>", 0),
            replaced("sdf/model.sdf", "<xyz>0 1 0</xyz>", "<xyz>0 -1 0</xyz>", 0),
            replaced("sdf/model.sdf", "<xyz>0 0 1</xyz>", "<xyz>0 0 -1</xyz>", 0),
            replaced("sdf/model.sdf", r"<p_gain>\d", "<p_gain>-1"),
            replaced("sdf/model.sdf", "<cmd_max>", "<cmd_max>0.000"),
            replaced("sdf/model.sdf", r"<velocity>[5-9][\d.]+<", "<velocity>1<", 0),
            replaced("sdf/model.sdf", r"<effort>\d+<", "<effort>0.1<", 0),
        ],
        0,
        1,
    ),
    ids=[
        *("radius of a wheel", "sign of an axis", "sign of a steering axis", "sign of a gain"),
        *("torque of a controller", "speed of the drives", "torque of the joints"),
    ],
)
def test_a_robot_of_changed_files_loses_its_way(
    distro: str, change: Callable[[Path], None], tmp_path: Path
) -> None:
    package = build(STEERED, tmp_path)
    change(package)
    with pytest.raises(AssertionError):
        check(mission(distro, tmp_path, "dart", package, 12.0), 3.0)


@each_distro()
@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "guarded", "launched"),
    [
        (signal.SIGTERM, False, False),
        (signal.SIGKILL, True, True),
        (signal.SIGSTOP, True, False),
        pytest.param(signal.SIGKILL, True, False, marks=pytest.mark.exhaustive),
    ],
    ids=["ended", "killed in a launch", "frozen", "killed"],
)
def test_the_robot_stops_when_its_driver_ends(
    distro: str, number: signal.Signals, guarded: bool, launched: bool, tmp_path: Path
) -> None:
    """``launched``: the launch ends the guard as soon as the driver has ended."""
    package = build(STEERED, tmp_path)
    file = scene("mujoco", tmp_path, package)
    with contextlib.ExitStack() as stack:
        stack.enter_context(running.engine(distro, tmp_path, "mujoco", file, [package], *SLOWLY))
        driver = stack.enter_context(running.node(distro, tmp_path, package))
        if guarded:
            guard = stack.enter_context(running.node(distro, tmp_path, package, guard=True))
        if launched:
            stack.enter_context(running.interrupted_after(driver, guard))
        out = run_client(distro, "engines.kill", tmp_path, driver.pid, int(number))
    result = json.loads(out)
    assert abs(result["speed"]) < 0.01
    assert result["time"] < 1.5


@FIRST
@pytest.mark.slow
def test_a_robot_stands_after_a_pause_and_after_a_reset(distro: str, tmp_path: Path) -> None:
    package = build(STEERED, tmp_path)
    file = scene("mujoco", tmp_path, package)
    with (
        running.engine(distro, tmp_path, "mujoco", file, [package], *SLOWLY),
        running.node(distro, tmp_path, package),
    ):
        result = json.loads(run_client(distro, "engines.interrupt", tmp_path))
    assert abs(result["paused"]) < 0.01, result
    assert abs(result["reset"]) < 0.01, result
    assert "jumped back by" in result["after_reset"], result
