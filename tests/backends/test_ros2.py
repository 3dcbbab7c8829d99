"""Parameter files, read back with the rules of rcl's parser and by PyYAML."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from tests.backend_files import files_of
from tests.backends.rcl_parameters import RclError, read, value_of
from tests.buses import robot_with_bus
from tests.robots import FOUR_STEERED, SPAN, make_robot
from thorvaldc.backends.ros2 import Ros2
from thorvaldc.backends.ros2_parameter_file import ParameterError, parameter_file
from thorvaldc.backends.urdf import Urdf
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model.robot import Bus, CalculatorChoice, Robot

EXAMPLES = Path(__file__).parents[2] / "examples"

FILES = ("base_driver", "twist_mux", "teleop_twist_joy", "robot_state_publisher")


def emit(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node, as rcl reads them."""
    nodes: dict[str, dict[str, Any]] = {}
    for data in files_of(Ros2, robot).values():
        for node, parameters in read(data.decode()).items():
            assert node not in nodes
            nodes[node] = parameters
    return nodes


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {prefix[:-1]: value}
    out: dict[str, Any] = {}
    for key, inner in value.items():
        out.update(flat(inner, f"{prefix}{key}."))
    return out


@pytest.fixture(scope="module")
def nodes() -> dict[str, dict[str, Any]]:
    return emit(robot_with_bus())


def test_files_and_nodes(nodes: dict[str, dict[str, Any]]) -> None:
    assert list(files_of(Ros2, robot_with_bus())) == [f"ros2/config/{f}.yaml" for f in FILES]
    assert list(nodes) == [
        "/base_driver",
        "/twist_mux",
        "/teleop_twist_joy_node",
        "/robot_state_publisher",
    ]


def test_rcl_and_pyyaml_read_the_same(nodes: dict[str, dict[str, Any]]) -> None:
    for data in files_of(Ros2, robot_with_bus()).values():
        for node, content in yaml.safe_load(data).items():
            plain = flat(content["ros__parameters"])
            assert plain == nodes["/" + node]
            for name, value in plain.items():
                assert type(value) is type(nodes["/" + node][name])


def test_base_driver_has_the_originals_parameters(nodes: dict[str, dict[str, Any]]) -> None:
    driver = nodes["/base_driver"]
    assert driver["rate"] == 50.0
    assert driver["command_timeout"] == 0.5
    assert (driver["can_interface_type"], driver["can_interface_name"]) == ("socketcan", "can0")
    assert driver["simple_sim"] is False
    assert (driver["tf_prefix"], driver["odom_frame_id"], driver["enable_odom_tf"]) == (
        "",
        "odom",
        True,
    )
    assert driver["twist_covariance"] == [0.001] * 5 + [0.03]
    assert driver["base_calculator"] == "general"
    assert driver["max_linear_velocity"] == 1.5


def test_wheel_lists_have_the_order_of_the_wheels(nodes: dict[str, dict[str, Any]]) -> None:
    robot = robot_with_bus()
    driver = nodes["/base_driver"]
    lists = {k.removeprefix("wheels."): v for k, v in driver.items() if k.startswith("wheels.")}
    for key, values in lists.items():
        assert len(values) == len(robot.wheels), key
    for i, wheel in enumerate(robot.wheels):
        assert lists["names"][i] == wheel.name
        assert lists["propulsion_joints"][i] == wheel.spin_joint
        assert lists["steering_joints"][i] == (wheel.steering_joint or "")
        for key in ("x", "y", "heading", "trail", "radius", "width", "driven", "steered"):
            assert lists[key][i] == getattr(wheel, key)
        spin, steering = robot.actuator_of(wheel.spin_joint), wheel.steering_joint
        assert lists["max_velocity"][i] == (spin.max_velocity if spin else 0.0)
        assert lists["steering_limited"][i] is (steering is not None)
        assert lists["steering_upper"][i] == (robot.joint(steering).upper if steering else 0.0)


def test_named_radii_have_an_entry_for_each_wheel() -> None:
    robot = robot_with_bus()
    double = dataclasses.replace(robot.wheels[0], radii=(("floor", 0.2), ("rail", 0.15)))
    parameters = emit(dataclasses.replace(robot, wheels=(double, *robot.wheels[1:])))[
        "/base_driver"
    ]
    assert parameters["wheels.radii.rail"] == [0.15, 0.2, 0.2]
    assert parameters["wheels.radii.floor"] == [0.2, 0.2, 0.2]


def test_calculator_options_and_several_buses() -> None:
    robot = robot_with_bus()
    parameters = emit(
        dataclasses.replace(
            robot,
            calculator=CalculatorChoice("mine", (("n", True), ("gain", 1e-7), ("label", "y"))),
            buses=(*robot.buses, Bus("implement", 250_000, 0.02, (), (), SPAN)),
        )
    )["/base_driver"]
    assert parameters["base_calculator"] == "mine"
    assert parameters["base_calculator_options.n"] is True
    assert parameters["base_calculator_options.gain"] == 1e-7
    assert parameters["base_calculator_options.label"] == "y"
    assert parameters["can_bus_names"] == ["main", "implement"]
    assert parameters["can_interface_names"] == ["can0", "can1"]


def test_teleoperation_has_priority_over_navigation(nodes: dict[str, dict[str, Any]]) -> None:
    mux = nodes["/twist_mux"]
    assert mux["topics.teleop_joy.topic"] == "teleop_joy/cmd_vel"
    assert mux["topics.auto_nav.topic"] == "auto_nav/cmd_vel"
    assert mux["topics.teleop_joy.priority"] > mux["topics.auto_nav.priority"]
    assert mux["topics.teleop_joy.timeout"] == mux["topics.auto_nav.timeout"] == 0.5
    stop, pause = mux["locks.safety_stop.priority"], mux["locks.auto_nav_pause.priority"]
    assert stop > mux["topics.teleop_joy.priority"] > pause > mux["topics.auto_nav.priority"]
    assert all(type(v) is int and 0 <= v <= 255 for k, v in mux.items() if k.endswith("priority"))


def test_teleop_scales_reach_the_robots_limits(nodes: dict[str, dict[str, Any]]) -> None:
    teleop = nodes["/teleop_twist_joy_node"]
    assert teleop["scale_linear_turbo.x"] == teleop["scale_linear_turbo.y"] == 1.5
    assert teleop["scale_angular_turbo.yaw"] == 1.5
    assert 0 < teleop["scale_linear.x"] < 1.5
    assert type(teleop["axis_linear.y"]) is int
    fixed = emit(make_robot([(0.5, 0.4, "fixed"), (0.5, -0.4, "fixed"), (-0.5, 0.0, "swivel")]))
    assert fixed["/teleop_twist_joy_node"]["scale_linear_turbo.y"] == 0.0
    assert fixed["/teleop_twist_joy_node"]["scale_linear_turbo.x"] == 1.5


def test_description_is_the_urdf_itself(nodes: dict[str, dict[str, Any]]) -> None:
    robot = robot_with_bus()
    publisher = nodes["/robot_state_publisher"]
    assert publisher["robot_description"].encode() == files_of(Urdf, robot)["urdf/robot.urdf"]
    assert publisher["frame_prefix"] == ""


def test_name_space_is_in_node_and_joint_names_once() -> None:
    nodes = emit(dataclasses.replace(robot_with_bus(), namespace="r1"))
    assert all(name.startswith("/r1/") for name in nodes)
    driver, publisher = nodes["/r1/base_driver"], nodes["/r1/robot_state_publisher"]
    description = ElementTree.fromstring(publisher["robot_description"])
    joints = {joint.get("name") for joint in description.iter("joint")}
    links = {link.get("name") for link in description.iter("link")}
    named = driver["wheels.propulsion_joints"] + driver["wheels.steering_joints"]
    assert {name for name in named if name} <= joints
    assert f"{driver['tf_prefix']}/{driver['base_frame_id']}" in links
    assert publisher["frame_prefix"] == ""


def test_a_robot_without_wheels_has_no_empty_lists() -> None:
    robot = dataclasses.replace(make_robot(FOUR_STEERED), wheels=(), actuators=())
    driver = emit(robot)["/base_driver"]
    assert not [name for name in driver if name.startswith("wheels")]


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*/robot.yaml")), ids=lambda p: p.parent.name)
def test_examples(path: Path) -> None:
    """rcl accepts the files of every example; every driven joint is a joint of the description."""
    robot = compile_file(path).model
    assert isinstance(robot, Robot)
    nodes = emit(robot)
    description = ElementTree.fromstring(nodes["/robot_state_publisher"]["robot_description"])
    joints = {joint.get("name") for joint in description.iter("joint")}
    driver = nodes["/base_driver"]
    named = driver["wheels.propulsion_joints"] + driver["wheels.steering_joints"]
    assert {name for name in named if name} <= joints
    assert sum(driver["wheels.driven"]) == sum(a.role == "propulsion" for a in robot.actuators)
    assert sum(driver["wheels.steered"]) == sum(a.role == "steering" for a in robot.actuators)
    assert driver["max_linear_velocity"] > 0.0


# -- the writer ----------------------------------------------------------------------

TRAPS = [
    "y", "N", "yes", "off", "nan", "inf", "INF", "NaN", "Infinity", "1e3", "1e-3", "+1e5", "09",
    "0x1p3", "+inf", "-nan", "017", "1:30", "null", "~", "", " ", "a: b", "- a", "#", "*a", "&a",
    "!x", "%", "@", "`", '"', "'", "\\", "\\n", "line\nbreak", "tab\t", "\x00", "\x7f", "\x85",
    "\u2028", "\ufeff", "æøå", "ロボット", "🚜", "{a}", "[a]", "trailing ",
]  # fmt: skip


@pytest.mark.parametrize("text", TRAPS)
def test_text_stays_text(text: str) -> None:
    text_of_file = parameter_file({"node": {"a": text, "b": [text, text]}})
    assert read(text_of_file)["/node"] == {"a": text, "b": [text, text]}
    assert yaml.safe_load(text_of_file) == {
        "node": {"ros__parameters": {"a": text, "b": [text, text]}}
    }


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_stays_text(text: str) -> None:
    assert read(parameter_file({"node": {"a": text}}))["/node"]["a"] == text


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(1e-05)
@example(1e22)
@example(-0.0)
@example(5e-324)
def test_any_real_stays_that_real(value: float) -> None:
    text_of_file = parameter_file({"node": {"a": value}})
    expected = value if abs(value) >= sys.float_info.min else 0.0
    for reading in (
        read(text_of_file)["/node"]["a"],
        yaml.safe_load(text_of_file)["node"]["ros__parameters"]["a"],
    ):
        assert type(reading) is float
        assert reading == expected


@given(st.integers(-(1 << 63), (1 << 63) - 1))
def test_any_integer_stays_that_integer(value: int) -> None:
    assert read(parameter_file({"node": {"a": value}}))["/node"] == {"a": value}


@pytest.mark.parametrize("key", ["y", "n", "on", "no", "null", "9a", "a b", "a-b", "ø", "true"])
def test_keys_stay_text(key: str) -> None:
    text_of_file = parameter_file({"node": {key: {key: 1}}})
    assert read(text_of_file)["/node"] == {f"{key}.{key}": 1}
    assert yaml.safe_load(text_of_file)["node"]["ros__parameters"] == {key: {key: 1}}


def test_a_repeated_list_is_not_an_alias() -> None:
    values = [1.0, 2.0]
    assert read(parameter_file({"node": {"a": values, "b": values}}))["/node"]["b"] == values


@pytest.mark.parametrize(
    "value", [None, [], [1, 2.0], [True, 1], [[1]], {}, math.nan, math.inf, 1 << 63, [None]]
)
def test_values_that_rcl_rejects_are_errors(value: Any) -> None:
    with pytest.raises(ParameterError, match="node"):
        parameter_file({"node": {"a": value}})


@pytest.mark.parametrize("node", ["", "a b", "1a", "a-b", "/", "a//b", "a/"])
def test_bad_node_names_are_errors(node: str) -> None:
    with pytest.raises(ParameterError):
        parameter_file({node: {"a": 1}})


# -- the reader of the tests ----------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y", True), ("off", False), ("017", 15), ("0x10", 16), ("1:30", "1:30"), ("null", "null"),
        ("1e3", 1000.0), ("09", 9.0), ("0x1p3", 8.0), ("+1e5", 1e5), ("inf", math.inf), ("5", 5),
        ("1e-310", "1e-310"), ("abc", "abc"), ("1.5", 1.5),
    ],
)  # fmt: skip
def test_reader_finds_the_type_as_rcl_does(text: str, expected: object) -> None:
    reading = value_of(text, False)
    assert reading == expected
    assert type(reading) is type(expected)


@pytest.mark.parametrize(
    "text",
    [
        "n: {ros__parameters: {a: &x [1], b: *x}}",
        "n: {ros__parameters: {a: [[1]]}}",
        "n: {ros__parameters: {a: [1, 2.0]}}",
        "n: {ros__parameters: {a: }}",
        "n-1: {ros__parameters: {a: 1}}",
        "n: {a: 1}",
        "ros__parameters: {a: 1}",
        "n: {ros__parameters: {a: []}}",
    ],
)
def test_reader_rejects_as_rcl_does(text: str) -> None:
    with pytest.raises(RclError):
        read(text)
