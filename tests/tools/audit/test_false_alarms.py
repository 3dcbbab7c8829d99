"""What public repositories do on purpose: odd files, fragments, folders left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Command, thorvaldc
from tests.tools.audit.test_audit import cart, change, findings

__all__ = ["cart", "thorvaldc"]

IMPORTS = "from launch import *\nfrom launch_ros.actions import *\n"


def python(actions: str) -> str:
    body = f"    return LaunchDescription({actions})\n"
    return f"{IMPORTS}def generate_launch_description():\n{body}"


ODD = {
    "a.sdf": """<sdf><model name="x"><link name="a"><inertial><mass>x</mass><inertia><tag>1</tag>
<self>2</self></inertia></inertial><collision><geometry><mesh><tag>1</tag></mesh></geometry>
</collision></link><joint name="j" type="screw"><parent>a</parent><child>a</child></joint></model>
</sdf>""",
    "a.xml": """<mujoco><compiler eulerseq="abq"/><worldbody><body euler="1 2 3" quat="0 0 0 0">
<joint type="ball"/><inertial mass="1" diaginertia="1 2"/><geom fromto="0 0 0 0 0 0" size="1"/>
<body><geom size="x"/></body></body></worldbody></mujoco>""",
    "a.urdf": """<robot name="u"><link name="a"/><link name="b"/><link/><joint/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit lower="1"/></joint>
<joint name="k" type="planar"><parent link="b"/><child link="a"/></joint></robot>""",
    "a.launch.py": python(
        "[GroupAction(), GroupAction(**k), PushRosNamespace(), IncludeLaunchDescription(), join(),"
        " Node(parameters=[{**q, 1: -x}, *z], remappings=[('a',), x]), LaunchConfiguration(),"
        " PathJoinSubstitution(), IncludeLaunchDescription(x, launch_arguments=[('a', 'b')])]"
    ),
    "a.yaml": 'c_costmap: {ros__parameters: {footprint: "[[1, 2], [3], {}]"}}\n? [a, b]\n: 1\n',
}


def test_odd_files_are_read_as_far_as_they_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in ODD.items():
        Path(name).write_text(text, encoding="utf-8")
    assert findings(".") == [("audit-file-skipped", "a.xml", 1)]  # MuJoCo rejects the eulerseq


GROUPS = {
    "group.launch.py": "def generate_launch_description():\n    node = Node(parameters=[{"
    "'frame_id': 'laser'}])\n    return LaunchDescription([GroupAction([PushRosNamespace('x'),"
    " node])])\n",
    "group.launch.xml": '<launch><group if="x"><push-ros-namespace namespace="x"/><node pkg="x">'
    '<param name="frame_id" value="laser"/></node></group></launch>',
    "group.launch.yaml": "launch:\n- group:\n  - push_ros_namespace: {namespace: x}\n"
    "  - node: {pkg: x, param: [{name: frame_id, value: laser}]}\n",
}


@pytest.mark.parametrize("name", GROUPS)
def test_nodes_in_groups_are_read(cart: Path, name: str) -> None:
    (cart / "launch" / name).write_text(GROUPS[name], encoding="utf-8")
    assert [(code, file) for code, file, _ in findings("cart")] == [
        ("audit-frame-unknown", f"cart/launch/{name}")
    ]


FRAGMENT = """<robot name="imu"><link name="imu_link"/><joint name="imu_joint" type="fixed">
<parent link="top"/><child link="imu_link"/></joint></robot>"""


@pytest.mark.parametrize(
    "file", ["$(find cart)/urdf/imu.xacro", "imu.xacro", "package://cart/urdf/imu.xacro"]
)
def test_an_included_fragment_with_a_name_is_no_robot(cart: Path, file: str) -> None:
    change(
        cart / "urdf/cart.urdf.xacro",
        '  <link name="base_link">',
        f'<link name="top"/><joint name="t" type="fixed"><parent link="base_link"/>'
        f'<child link="top"/></joint><xacro:include filename="{file}"/>\n  <link name="base_link">',
    )
    (cart / "urdf/imu.xacro").write_text(FRAGMENT, encoding="utf-8")
    assert findings("cart") == []


def test_a_fragment_that_nothing_includes_is_judged(cart: Path) -> None:
    (cart / "urdf/imu.xacro").write_text(FRAGMENT, encoding="utf-8")
    assert findings("cart") == [("audit-description-broken", "cart/urdf/imu.xacro", 1)]


@pytest.mark.parametrize("mark", ["COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE"])
def test_folders_that_are_left_out_are_named(thorvaldc: Command, cart: Path, mark: str) -> None:
    assert "left out" not in thorvaldc("audit", "cart").out
    (cart / "config" / mark).touch()
    output = thorvaldc("audit", "cart")
    assert f"4 launch files; left out: `cart/config` ({mark})" in output.out


def test_sides_of_wheels(cart: Path) -> None:
    """A drive that exchanges its wheels, and a wheel that turns the other way."""
    controllers = cart / "config/controllers.yaml"
    change(controllers, "[left_wheel_joint]", "[x]")
    change(controllers, "[right_wheel_joint]", "[left_wheel_joint]")
    change(controllers, "[x]", "[right_wheel_joint]")
    assert findings("cart") == [("wheel-sides-exchanged", "cart/config/controllers.yaml", 10)]
    change(controllers, "[right_wheel_joint]", "[x]")
    change(controllers, "[left_wheel_joint]", "[right_wheel_joint]")
    change(controllers, "[x]", "[left_wheel_joint]")
    change(
        cart / "models/cart.sdf",
        "<child>right_wheel</child>\n      <axis><xyz>0 0 1</xyz>",
        "<child>right_wheel</child>\n      <axis><xyz>0 0 -1</xyz>",
    )
    assert findings("cart") == [("wheel-axes-opposite", "cart/models/cart.sdf", 23)]
