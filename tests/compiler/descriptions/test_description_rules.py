"""The rules about links and joints, in robots and in their extras."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc import compile
from thorvaldc.compiler.descriptions.description_rules import right_name

ROBOT = """
thorvaldc: 1
name: r
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
  battery:
    type: battery/enclosure
    mount: {parent: frame, xyz: [0, 397 mm, 70 mm]}
extras: [{xacro: tool.urdf, parent: frame, xyz: [-0.3, 0, 0.3]}]
"""
TOOL = """<robot name="tool">
<link name="plate">
  <inertial>
    <mass value="4"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <collision><geometry><box size="0.2 0.3 0.1"/></geometry></collision>
</link>
<joint name="swing" type="revolute">
  <parent link="plate"/><child link="arm"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="10" velocity="2"/>
</joint>
<link name="arm">
  <inertial>
    <mass value="2"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <collision><geometry><cylinder radius="0.04" length="0.1"/></geometry></collision>
</link>
</robot>
"""


def diagnostics_of(folder: Path, tool: str, robot: str = ROBOT) -> list[tuple[str, str, int]]:
    (folder / "robot.yaml").write_text(robot, encoding="utf-8")
    (folder / "tool.urdf").write_text(tool, encoding="utf-8")
    report = compile(folder / "robot.yaml").report
    return [(d.code.name, d.span.file, d.span.line) for d in report if d.span is not None]


def test_a_plausible_extra_has_no_warning(tmp_path: Path) -> None:
    assert diagnostics_of(tmp_path, TOOL) == []


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ('ixx="0.02" iyy="0.02" izz="0.03"', 'ixx="9" iyy="9" izz="9"', "inertia-too-large", 5),
        ('izz="0.03"', 'izz="0.05"', "extra-inertia", 5),
        ('mass value="2"', 'mass value="400"', "density-implausible", 15),
        ('mass value="2"', 'mass value="2e-4"', "inertia-too-large", 16),
        ('ixx="1e-3" iyy="1e-3" izz="1e-3"', 'ixx="0" iyy="0" izz="0"', "extra-inertia", 16),
        ('mass value="2"', 'mass value="-2"', "extra-inertia", 15),
        ('lower="-3" upper="3"', 'lower="-3" upper="170"', "angle-unit", 11),
        ('size="0.2 0.3 0.1"', 'size="200 300 100"', "length-unit", 7),
    ],
)
def test_an_implausible_extra(tmp_path: Path, old: str, new: str, code: str, line: int) -> None:
    assert old in TOOL
    found = diagnostics_of(tmp_path, TOOL.replace(old, new, 1))
    assert (code, str(tmp_path / "tool.urdf"), line) in found or (code, "tool.urdf", line) in found


def test_exchanged_sides_of_modules(tmp_path: Path) -> None:
    robot = ROBOT.replace("front_left", "x").replace("front_right", "front_left")
    codes = [
        code
        for code, _, _ in diagnostics_of(
            tmp_path, TOOL, robot.replace("frame.x", "frame.front_right")
        )
    ]
    assert codes == ["wheel-sides-exchanged"]


TRAILER = """<robot name="trailer">
<link name="bed"/>
<joint name="left" type="continuous">
  <parent link="bed"/><child link="wheel_l"/><origin xyz="-0.9 0.4 -0.3"/><axis xyz="0 1 0"/>
</joint>
<joint name="right" type="continuous">
  <parent link="bed"/><child link="wheel_r"/><origin xyz="-0.9 -0.4 -0.3"/><axis xyz="0 1 0"/>
</joint>
<link name="wheel_l">WHEEL</link>
<link name="wheel_r">WHEEL</link>
</robot>
""".replace(
    "WHEEL",
    '<inertial><mass value="3"/><inertia ixx="0.04" iyy="0.06" izz="0.04"/></inertial><collision>'
    '<origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.2" length="0.1"/></geometry>'
    "</collision>",
)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("", "", None),
        ('0 1 0"/>\n</joint>\n<link', '0 -1 0"/>\n</joint>\n<link', "wheel-axes-opposite"),
        ("-0.9 0.4", "-0.9 -0.9", "wheel-sides-exchanged"),
    ],
)
def test_sides_and_axes_of_an_extra(tmp_path: Path, old: str, new: str, code: str | None) -> None:
    assert old in TRAILER
    found = [c for c, _, _ in diagnostics_of(tmp_path, TRAILER.replace(old, new, 1))]
    assert [c for c in found if c.startswith("wheel-")] == ([code] if code else [])


def test_names_of_pairs() -> None:
    pairs = {
        "left_wheel_joint": "right_wheel_joint",
        "wheel_Left": "wheel_Right",
        "fl_drive_axle": "fr_drive_axle",
        "rear_l": "rear_r",
        "wheel_rl_joint": "wheel_rr_joint",
    }
    assert {name: right_name(name) for name in pairs} == pairs
    assert right_name("lift") is None
    assert right_name("tool_wheel") is None


def test_a_link_without_shapes_is_not_judged_by_its_size(tmp_path: Path) -> None:
    tool = TOOL.replace('<collision><geometry><box size="0.2 0.3 0.1"/></geometry></collision>', "")
    assert diagnostics_of(tmp_path, tool.replace('mass value="4"', 'mass value="400"')) == []
