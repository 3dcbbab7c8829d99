"""Parameter files of the package, as rcl reads them."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from bench.filters import CASES, MIXED
from tests.backends.rcl_parameters import read
from tests.backends.ros2.packages import DISTROS, named, package_of, parameters, variant
from tests.examples import FOLDER, SAMPLED_ROBOTS, example_robot
from tests.robots import make_robot
from thorvaldc.backends.ros2_parameters import teleop, twist_mux
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.calculators import Noise
from thorvaldc.runtime.run_time_parameters import Parameters


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {prefix[:-1]: value}
    out: dict[str, Any] = {}
    for key, inner in value.items():
        out.update(flat(inner, f"{prefix}{key}."))
    return out


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_rcl_and_pyyaml_read_the_same(name: str) -> None:
    robot = example_robot(name)
    for path in package_of(robot):
        if not path.endswith(".yaml") or "gz_bridge" in path:
            continue
        text = named(robot, path)
        nodes = read(text)
        for node, content in yaml.safe_load(text).items():
            plain = flat(content["ros__parameters"])
            full = node if node.startswith("/") else f"/{node}"
            assert plain == nodes[full]
            assert all(type(value) is type(nodes[full][key]) for key, value in plain.items())


@pytest.mark.parametrize("namespace", ["", "r1"])
def test_the_name_space_is_in_the_names_of_nodes_and_frames_once(namespace: str) -> None:
    nodes = parameters(variant("4wd4ws_wide", namespace=namespace))
    start = f"/{namespace}/" if namespace else "/"
    assert all(node.startswith(start) for node in nodes)
    assert nodes[f"{start}ekf_map"]["base_link_frame"] == f"{start[1:]}base_link"
    assert nodes[f"{start}robot_state_publisher"]["frame_prefix"] == ""


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("owner", ["driver", "ekf"])
def test_base_driver_has_only_what_the_model_does_not_have(distro: str, owner: str) -> None:
    driver = parameters(variant("4wd4ws_wide", distro=distro, odom_tf=owner))["/base_driver"]
    assert driver == {
        "stamped": distro != "jazzy",
        "enable_odom_tf": owner == "driver",
        "publish_description": False,
        "autostart": True,
        "twist_covariance": "for_filters",
    }


def test_only_a_package_with_an_ekf_has_a_twist_covariance_for_filters() -> None:
    name = "2wd0ws_greenhouse"
    without = parameters(variant(name, odom_tf="driver"))
    assert not [node for node in without if "ekf" in node]
    assert "twist_covariance" not in without["/base_driver"]
    assert parameters(variant(name, odom_tf="ekf"))["/base_driver"]["twist_covariance"] == (
        "for_filters"
    )


def test_the_file_names_the_noise_with_which_an_ekf_is_consistent(tmp_path: Path) -> None:
    """``bench filters`` measures the filter with these settings."""
    file = package_of(example_robot("4wd4ws_wide"))["config/base_driver.yaml"].decode()
    settings = []
    for text in re.findall(r"noise: (\{.*\})", file):
        path = tmp_path / "robot.yaml"
        robot = (FOLDER / "4wd4ws_slim" / "robot.yaml").read_text(encoding="utf-8")
        path.write_text(robot + f"driver: {{noise: {text}}}\n", encoding="utf-8")
        model = compile_file(path).model
        assert isinstance(model, Robot)
        settings.append(Parameters.from_robot(model).noise)
    expected = [Noise(), *(CASES[kind][1] for kind in ("lasting 2 s", "white", MIXED))]
    assert [noise.correlation for noise in settings] == [noise.correlation for noise in expected]
    for noise, described in zip(settings, expected, strict=True):
        assert noise.lasting_errors == pytest.approx(described.lasting_errors, rel=0.01)
    without = package_of(variant("4wd4ws_slim", odom_tf="driver"))["config/base_driver.yaml"]
    assert b"noise" not in without


def test_process_noise_of_the_ekf_follows_from_the_limits_of_the_driver() -> None:
    robot = variant("4wd4ws_wide", odom_tf="ekf")
    driver = dataclasses.replace(
        robot.driver,
        max_linear_velocity=1.5,
        max_linear_acceleration=1.0,
        max_linear_deceleration=2.0,
        max_angular_velocity=0.5,
        max_angular_acceleration=3.0,
        max_angular_deceleration=3.0,
    )
    nodes = parameters(dataclasses.replace(robot, driver=driver))
    for name in ("/ekf_odom", "/ekf_map"):
        growth = nodes[name]["process_noise_covariance"]
        # The velocities x, y and yaw are the states 6, 7 and 11 of 15.
        assert growth == [0.0] * 6 + [6.0, 6.0, 0.0, 0.0, 0.0, 3.0] + [0.0] * 3


def test_teleoperation_has_priority_over_navigation() -> None:
    mux = flat(twist_mux(example_robot("4wd4ws_wide")))
    assert mux["topics.teleop_joy.topic"] == "teleop_joy/cmd_vel"
    assert mux["topics.auto_nav.topic"] == "auto_nav/cmd_vel"
    assert mux["topics.teleop_joy.timeout"] == mux["topics.auto_nav.timeout"] == 0.5
    stop, pause = mux["locks.safety_stop.priority"], mux["locks.auto_nav_pause.priority"]
    assert stop > mux["topics.teleop_joy.priority"] > pause > mux["topics.auto_nav.priority"]
    assert all(type(v) is int and 0 <= v <= 255 for k, v in mux.items() if k.endswith("priority"))


def test_teleop_scales_reach_the_robots_limits() -> None:
    robot = example_robot("4wd4ws_wide")
    values = flat(teleop(robot, stamped=False))
    linear, angular = robot.driver.max_linear_velocity, robot.driver.max_angular_velocity
    assert values["scale_linear_turbo.x"] == values["scale_linear_turbo.y"] == linear
    assert values["scale_angular_turbo.yaw"] == angular
    assert 0 < values["scale_linear.x"] < linear
    assert type(values["axis_linear.y"]) is int
    fixed = make_robot([(0.5, 0.4, "fixed"), (0.5, -0.4, "fixed"), (-0.5, 0.0, "swivel")])
    assert flat(teleop(fixed, stamped=False))["scale_linear_turbo.y"] == 0.0


def test_a_robot_without_wheels_has_no_empty_lists() -> None:
    robot = make_robot([])
    assert isinstance(robot, Robot)
    assert parameters(robot)["/base_driver"]
