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

from tests.child_process import ChildProcess, end_at_hang_up
from tests.cli.test_bus import running
from tests.examples import example_robot
from tests.ros.environments import DISTROS, each_distro, python_of, require_messages, variables
from tests.simulation.bus.robots import cia402_robot
from tests.simulation.sensors.rover import ALL_SENSORS, simulation
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model.model_json import to_json

pytestmark = each_distro()


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with the model and the MJCF files of a robot with parameter sets."""
    folder = tmp_path_factory.mktemp("build")
    for path, data in emit(example_robot("2wd0ws_greenhouse"), ["mjcf", "urdf"]).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return folder


@contextmanager
def node(
    distro: str, build: Path, folder: Path, space: str = "", **parameters: Any
) -> Iterator[ChildProcess]:
    """Runs the node with parameters in a process."""
    values = {"model_file": str(build / "model.json"), **parameters}
    command = [python_of(distro), "-m", "thorvaldc.ros.base_driver", "--ros-args"]
    for name, value in values.items():
        command += ["-p", f"{name}:={json.dumps(value)}"]
    if space:
        command += ["-r", f"__ns:={space}"]
    process = ChildProcess(
        command,
        env=variables(folder),
        preexec_fn=end_at_hang_up,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.end()


def run_client(distro: str, program: str, folder: Path, *arguments: object) -> str:
    """Runs a program of the tests with the Python of a distribution, and returns its output."""
    result = subprocess.run(
        [python_of(distro), "-m", f"tests.ros.{program}", *map(str, arguments)],
        env=variables(folder),
        capture_output=True,
        text=True,
        check=False,
        timeout=550,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def end(process: ChildProcess) -> str:
    """Ends a node by SIGTERM and returns what it has written."""
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    return str(err)


@pytest.mark.slow
def test_the_nodes_use_no_name_of_rclpy(distro: str, tmp_path: Path) -> None:
    run_client(distro, "node_names", tmp_path)


def test_battery_messages(distro: str, tmp_path: Path) -> None:
    run_client(distro, "battery_messages", tmp_path)


@pytest.mark.slow
def test_an_error_while_the_node_is_activated_closes_the_robot(
    distro: str, build: Path, tmp_path: Path
) -> None:
    run_client(distro, "failing_activation", tmp_path, build / "model.json")


@pytest.mark.slow
def test_an_error_of_one_node_leaves_no_robot_of_the_others_running(
    distro: str, build: Path, tmp_path: Path
) -> None:
    run_client(distro, "failing_stop", tmp_path, build / "model.json")


@pytest.mark.slow
def test_node_with_ideal_joints(distro: str, build: Path, tmp_path: Path) -> None:
    options = {"base": "ideal", "autostart": False, "stamped": False}
    with node(distro, build, tmp_path, **options) as process:
        run_client(distro, "drive_ideal", tmp_path, process.pid)
        end(process)


@pytest.mark.slow
def test_bad_requests_are_refused_while_the_robot_drives(
    distro: str, build: Path, tmp_path: Path
) -> None:
    with node(distro, build, tmp_path, base="ideal", stamped=False) as process:
        run_client(distro, "bad_requests", tmp_path)
        end(process)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "numbers", "pause"),
    [("ideal", [signal.SIGHUP], 0.0), ("bus", [signal.SIGHUP, signal.SIGQUIT], 0.1)],
    ids=["ideal", "bus"],
)
def test_end_signals_stop_the_robot_in_order(
    distro: str,
    build: Path,
    tmp_path: Path,
    base: str,
    numbers: list[signal.Signals],
    pause: float,
) -> None:
    """Further signals do not cut off the stop, and the last odometry is at rest."""
    with running(tmp_path, str(build / "model.json"), "--channel", "end"):
        for number in numbers:
            options = {"base": base, "bus": "sim:end", "stamped": False}
            with node(distro, build, tmp_path, **options) as process:
                run_client(distro, "drive_to_the_end", tmp_path, process.pid, int(number), pause)
                _, err = process.communicate(timeout=300)
            assert process.returncode == 0, (number, err)
            assert "Traceback" not in err


@pytest.mark.slow
def test_node_with_mujoco_and_its_clock(distro: str, build: Path, tmp_path: Path) -> None:
    options = {"base": "mujoco", "publish_clock": True, "stamped": True}
    options["publish_description"] = True
    with node(distro, build, tmp_path, space="/r1", **options) as process:
        run_client(distro, "drive_mujoco", tmp_path)
        end(process)


@pytest.mark.slow
def test_sensors_of_mujoco(distro: str, tmp_path: Path) -> None:
    wall = "world: {obstacles: {wall: {shape: box, xyz: [4.5, 0, 0], size: [1, 30, 3]}}}\n"
    simulated = simulation(tmp_path, wall, ALL_SENSORS)
    for path, data in emit(simulated.scenario.fleet, ["mjcf", "ros2"]).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(data)
    options = {"base": "mujoco", "publish_clock": True, "stamped": True, "world": str(tmp_path)}
    config = tmp_path / "rover" / "ros2" / "config"
    with node(distro, config, tmp_path, space="/rover", **options) as process:
        run_client(distro, "read_sensors", tmp_path)
        end(process)


@pytest.mark.slow
def test_node_on_a_bus(distro: str, build: Path, tmp_path: Path) -> None:
    """After a kill the drives stop by themselves, and the next node is disarmed."""
    with running(tmp_path, str(build / "model.json"), "--channel", "r"):
        options = {"base": "bus", "bus": "sim:r", "stamped": False}
        with node(distro, build, tmp_path, **options) as process:
            run_client(distro, "drive_bus", tmp_path, "moves")
            process.kill()
            _, log = process.communicate(timeout=300)
            assert log.count("(TV880 bus-stopped, see `thorvaldc explain TV880`)") == 1, log
        with node(distro, build, tmp_path, **options) as process:
            run_client(distro, "drive_bus", tmp_path)
            end(process)


@pytest.mark.slow
def test_clock_of_another_node(distro: str, build: Path, tmp_path: Path) -> None:
    with node(distro, build, tmp_path, base="ideal", stamped=False, use_sim_time=True) as process:
        run_client(distro, "drive_with_clock", tmp_path)
        end(process)


@pytest.mark.slow
def test_a_robot_in_mujoco_follows_the_clock_of_another_robot(
    distro: str, build: Path, tmp_path: Path
) -> None:
    """It has the name space of its node, and ends in order while the clock stands."""
    options = {"base": "mujoco", "use_sim_time": True, "stamped": False}
    options["use_node_namespace"] = True
    with node(distro, build, tmp_path, space="/r2", **options) as process:
        run_client(distro, "follow_clock", tmp_path)
        end(process)


@pytest.mark.slow
def test_stamped_twists(distro: str, build: Path, tmp_path: Path) -> None:
    options = {"base": "ideal", "stamped": True, "twist_covariance": "for_filters"}
    with node(distro, build, tmp_path, **options) as process:
        run_client(distro, "drive_stamped", tmp_path)
        assert end(process).count("`auto_nav` have a stamp of zero: they count as sent now") == 1


@pytest.mark.slow
def test_two_robots_in_one_process(distro: str, build: Path, tmp_path: Path) -> None:
    model = tmp_path / "one_of_many.json"  # the name of the file does not matter
    model.write_bytes((build / "model.json").read_bytes())
    command = [python_of(distro), "-m", "tests.ros.two_nodes", str(model)]
    process = ChildProcess(command, env=variables(tmp_path), stderr=subprocess.PIPE, text=True)
    try:
        run_client(distro, "drive_one_of_two", tmp_path)
        end(process)
    finally:
        process.end()


@pytest.mark.slow
def test_relay_of_frames_and_transform(distro: str, tmp_path: Path) -> None:
    require_messages(distro, "can_msgs")
    require_messages(distro, "tf2_msgs")
    robot = cia402_robot()
    for path, data in emit(robot, ["can"]).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(data)
    with running(tmp_path, "model.json", "--channel", "relay"):
        options = {"base": "bus", "bus": "sim:relay", "stamped": False}
        with node(distro, tmp_path, tmp_path, **options) as process:
            run_client(distro, "relay_frames", tmp_path)
            end(process)


@pytest.mark.slow
def test_node_with_a_virtual_bus(distro: str, build: Path, tmp_path: Path) -> None:
    if distro != DISTROS[-1]:
        pytest.skip("the base `virtual` shares the code of `bus`; one distribution is enough")
    with node(distro, build, tmp_path, base="virtual", stamped=False) as process:
        run_client(distro, "drive_bus", tmp_path, "moves")
        end(process)


@pytest.mark.slow
def test_data_and_settings_of_devices(distro: str, tmp_path: Path) -> None:
    require_messages(distro, "control_msgs")
    (tmp_path / "model.json").write_bytes(to_json(example_robot("4wd4ws_wide")).encode())
    with node(distro, tmp_path, tmp_path, base="virtual", stamped=False) as process:
        run_client(distro, "read_devices", tmp_path)
        end(process)  # while the robot drives


@pytest.mark.slow
def test_mission_over_topics_follows_the_path_of_the_mission_without_ros(
    distro: str, build: Path, tmp_path: Path
) -> None:
    result = json.loads(run_client(distro, "mission", tmp_path, build / "model.json"))
    assert result["length"] > 1.0
    assert result["distance"] < 1e-3


WRONG_PARAMETERS: list[tuple[dict[str, Any], str]] = [
    ({"model_file": "/nowhere/model.json"}, "error: cannot read /nowhere/model.json: No such"),
    ({"model_file": "/"}, "error: model_file is /, a folder; expected the model.json of"),
    ({"base": "gazebo"}, "error: base is 'gazebo'; expected ideal, mujoco, virtual, bus, topics"),
    ({"twist_covariance": "best"}, "twist_covariance is 'best'; expected measured, for_filters"),
    ({"base": "bus", "bus": "sim:nobody"}, "error: cannot use the bus `sim:nobody`: "),
    ({"rate": 10.0}, "error: rate is 10 Hz; the model has 50 Hz: change `driver.rate`"),
    ({"max_linear_velocity": 5.0}, "max_linear_velocity"),
    ({"max_linear_velocity": 1e6}, "max_linear_velocity"),
    ({"max_angular_acceleration": 99.0}, "max_angular_acceleration"),
    ({"command_timeout": 60.0}, "command_timeout"),
    ({"parameter_set": "rails"}, "has no parameter set `rails`; did you mean `rail`?"),
]


@pytest.mark.slow
def test_wrong_parameters_are_one_line(distro: str, build: Path, tmp_path: Path) -> None:
    defaults = {"model_file": str(build / "model.json"), "base": "ideal"}
    cases = json.dumps([{**defaults, **parameters} for parameters, _ in WRONG_PARAMETERS])
    answers = json.loads(run_client(distro, "wrong_parameters", tmp_path, cases))
    for (parameters, message), (status, error) in zip(WRONG_PARAMETERS, answers, strict=True):
        assert status == 1, parameters
        assert message in error, parameters
        assert len(error.splitlines()) == 1, error


@pytest.mark.slow
def test_a_node_without_a_model_ends_with_one_line(
    distro: str, build: Path, tmp_path: Path
) -> None:
    with node(distro, build, tmp_path, base="ideal", model_file="") as process:
        _, err = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "error: the parameter model_file is missing: --ros-args -p model" in err
    assert "Traceback" not in err
