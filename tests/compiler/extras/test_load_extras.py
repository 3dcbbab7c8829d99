"""Tests of valid extras: links, joints, meshes, packages and placement."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.compiler.extras.xacro_files import (
    BOX,
    HEAD,
    INERTIAL,
    LINKS,
    SENSOR,
    STL,
    load,
    load_one,
    mesh,
)
from thorvaldc.diagnostics import Span
from thorvaldc.model import Box, Cylinder, MeshShape, Sphere


def test_a_root_link_is_mounted_on_the_parent_at_its_pose(tmp_path: Path) -> None:
    entry = ", parent: frame.top, xyz: [100 mm, 0, 0.2], rpy: [0, 0, 90 deg]"
    loaded = load_one(tmp_path, f'<link name="mast">{BOX}</link>', entry)
    assert loaded.codes == []
    joint = loaded.joint("mast_mount")
    assert (joint.type, joint.parent, joint.child) == ("fixed", "frame_body", "mast")
    assert joint.pose.xyz == (0.1, 0.0, 0.7)
    assert joint.pose.rpy() == pytest.approx((0.0, 0.0, 1.570796327))
    assert loaded.link("mast").span.file == "a.xacro"
    assert loaded.link("mast").span.line == 3


def test_an_unusual_number_of_a_pose_is_reported_with_a_unit(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '<link name="mast"/>', ", xyz: [0, 285, 0]")
    assert (loaded.only.code.name, loaded.only.span and loaded.only.span.line) == (
        "number-without-unit",
        1,
    )
    assert "`285 mm`" in (loaded.only.hint or "")


def test_the_pose_is_relative_to_the_frame_of_the_port(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '<link name="mast"/>', ", parent: frame.side, xyz: [1, 0, 0]")
    assert loaded.joint("mast_mount").pose.xyz == pytest.approx((0.0, 2.0, 0.0))


def test_a_sensor_macro_with_parent_and_origin_block(tmp_path: Path) -> None:
    body = """
<xacro:arg name="parent" default="base_link"/>
<xacro:include filename="sensors/laser.xacro"/>
<xacro:laser name="front" parent="$(arg parent)"><origin xyz="1 0 0.5" rpy="0 0 0"/></xacro:laser>
<xacro:laser name="back" parent="front" size="0.2"><origin xyz="-2 0 0"/></xacro:laser>
</robot>"""
    loaded = load(
        tmp_path,
        "- {xacro: a.xacro, args: {parent: frame_body}}",
        a_xacro=HEAD + body,
        sensors__laser_xacro=SENSOR,
    )
    assert loaded.codes == []
    assert [link.name for link in loaded.parts.links] == ["front", "back"]
    assert [joint.name for joint in loaded.parts.joints] == ["front_joint", "back_joint"]
    joint = loaded.joint("front_joint")
    assert (joint.parent, joint.pose.xyz) == ("frame_body", (1.0, 0.0, 0.5))
    back = loaded.link("back")
    assert back.visuals[0].shape == Cylinder(0.1, 0.2)
    assert back.visuals[0].pose.xyz == (0.0, 0.0, 0.1)
    assert back.visuals[0].color == (0.1, 0.2, 0.3, 1.0)
    assert back.collisions[0].shape == Sphere(0.1)
    assert back.inertial is not None
    assert back.inertial.com == (0.0, 0.0, 0.1)
    assert back.inertial.inertia == pytest.approx((0.02, 0.01, 0.02, 0.0, 0.0, 0.0))
    assert back.span == Span("sensors/laser.xacro", 11, 3, 11, 8)
    assert loaded.parts.urdf_extensions[1].startswith(
        '<gazebo reference="back"><sensor name="back"'
    )


def test_a_file_reads_the_environment_variables_of_its_entry_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DISTRO", "of the user")
    body = """
<xacro:property name="version" value="$(env ROS_VERSION)"/>
<xacro:if value="${version == 2}"><link name="ros_2"/></xacro:if>
<xacro:if value="$(env USE_SIM)"><link name="simulated"/></xacro:if>
<link name="distro_$(optenv ROS_DISTRO none)"/>
<link name="version_$(optenv ROS_VERSION none)"/>
"""
    loaded = load_one(tmp_path, body, ", env: {ROS_VERSION: 2, USE_SIM: true}")
    assert loaded.codes == []
    names = [link.name for link in loaded.parts.links]
    assert names == ["ros_2", "simulated", "distro_none", "version_2"]


CAMERA = (
    HEAD.replace("<robot", '<robot xmlns:sensor="http://example.com/sensor"')
    + """
<xacro:include filename="$(find camera_pkg)/urdf/materials.xacro"/>
<xacro:include filename="$(find camera_pkg)/urdf/none.xacro" optional="true"/>
<xacro:macro name="camera" params="parent *origin name:=camera add_plug:=false frames:=^">
  <xacro:arg name="simulation" default="$(optenv SIMULATION gazebo)"/>
  <xacro:property name="M_PI" value="3.1415926535897931"/>
  <joint name="${name}_joint" type="fixed">
    <xacro:insert_block name="origin"/>
    <parent link="${parent}"/>
    <child link="${name}_screw"/>
  </joint>
  <link name="${name}_screw"/>
  <joint name="${name}_body_joint" type="fixed">
    <origin xyz="0.01 0 0.0125" rpy="0 0 0"/>
    <parent link="${name}_screw"/><child link="${name}_body"/>
  </joint>
  <link name="${name}_body">
    <visual>
      <!-- the mesh's own axes -->
      <origin xyz="0 0 0" rpy="${M_PI/2} 0 ${M_PI/2}"/>
      <geometry>
        <!-- <box size="1 1 1"/> -->
        <mesh filename="package://camera_pkg/meshes/body.stl" scale="0.001 0.001 0.001"/>
      </geometry>
      <material name="camera/aluminium"/>
    </visual>
  </link>
  <xacro:if value="${frames}">
    <joint name="${name}_optical_joint" type="fixed">
      <origin xyz="0 0 0" rpy="${-M_PI/2} 0 ${-M_PI/2}"/>
      <parent link="${name}_body"/><child link="${name}_optical"/>
    </joint>
    <link name="${name}_optical"/>
  </xacro:if>
  <xacro:if value="${add_plug}"><link name="never"/></xacro:if>
  <xacro:if value="${'$(arg simulation)' == 'gazebo'}">
    <gazebo reference="${name}_body"><sensor:camera name="${name}"/></gazebo>
  </xacro:if>
</xacro:macro>
</robot>
"""
)


def test_a_camera_package_as_published(tmp_path: Path) -> None:
    """A package with its folder as name, an empty base_link for its own test, and namespaces."""
    test = (
        HEAD
        + """
<xacro:arg name="name" default="camera"/>
<xacro:property name="frames" value="true"/>
<xacro:include filename="$(find camera_pkg)/urdf/camera.xacro"/>
<link name="base_link"/>
<xacro:camera name="$(arg name)" parent="base_link"><origin xyz="0 0 1" rpy="0 0 0"/></xacro:camera>
</robot>"""
    )
    materials = '<material name="camera/aluminium"><color rgba="0.5 0.5 0.5 1"/></material></robot>'
    loaded = load(
        tmp_path,
        "- {xacro: camera_pkg/urdf/test.urdf.xacro, args: {name: cam}}",
        **{
            "camera_pkg__urdf__test.urdf_xacro": test,
            "camera_pkg__urdf__camera_xacro": CAMERA,
            "camera_pkg__urdf__materials_xacro": HEAD + materials,
            "camera_pkg__meshes__body_stl": STL,
        },
    )
    assert loaded.codes == []
    names = [link.name for link in loaded.parts.links]
    assert names == ["cam_screw", "cam_body", "cam_optical"]
    assert loaded.joint("cam_joint").parent == "base_link"
    visual = loaded.link("cam_body").visuals[0]
    assert visual.color == (0.5, 0.5, 0.5, 1.0)
    assert isinstance(visual.shape, MeshShape)
    assert visual.shape.scale == (0.001, 0.001, 0.001)
    (gazebo,) = loaded.parts.urdf_extensions
    assert 'xmlns:sensor="http://example.com/sensor"' in gazebo


def test_conditions_recursive_macros_namespaces_and_python(tmp_path: Path) -> None:
    body = """
<xacro:include filename="tools.xacro" ns="tools"/>
<xacro:property name="sizes" value="${dict(a=0.1, b=0.2)}"/>
<xacro:macro name="row" params="n">
  <xacro:if value="${n > 0}">
    <link name="post_${n}"><visual><geometry>
      <box size="${tools.width} ${sizes['b']} ${max(1, n)}"/></geometry></visual></link>
    <xacro:row n="${n - 1}"/>
  </xacro:if>
  <xacro:unless value="${n > 0}"><xacro:tools.end/></xacro:unless>
</xacro:macro>
<xacro:row n="3"/>
<![CDATA[ text ]]>
</robot>"""
    tools = HEAD + '<xacro:property name="width" value="0.7"/>'
    tools += '<xacro:macro name="end"><link name="end"/></xacro:macro></robot>'
    loaded = load(tmp_path, "- xacro: a.xacro", a_xacro=HEAD + body, tools_xacro=tools)
    assert loaded.codes == []
    assert [link.name for link in loaded.parts.links] == ["post_3", "post_2", "post_1", "end"]
    assert loaded.link("post_3").visuals[0].shape == Box((0.7, 0.2, 3.0))


def test_joints_of_every_type_with_their_limits(tmp_path: Path) -> None:
    body = f"""
<link name="a">{INERTIAL}</link><link name="b">{INERTIAL}</link><link name="c">{INERTIAL}</link>
<joint name="pan" type="revolute"><parent link="frame_body"/><child link="a"/>
 <origin xyz="0 0 1"/><axis xyz="0 0 2"/><limit lower="-1" upper="2" effort="3" velocity="4"/>
 <dynamics damping="0.5" friction="0.25"/></joint>
<joint name="spin" type="continuous"><parent link="a"/><child link="b"/></joint>
<joint name="lift" type="prismatic"><parent link="b"/><child link="c"/>
 <limit upper="0.5" effort="3" velocity="4"/><mimic joint="pan" multiplier="-0.5"/></joint>
"""
    loaded = load_one(tmp_path, body)
    assert loaded.codes == []
    pan = loaded.joint("pan")
    assert (pan.axis, pan.lower, pan.upper) == ((0.0, 0.0, 1.0), -1.0, 2.0)
    assert (pan.effort, pan.velocity, pan.damping, pan.friction) == (3.0, 4.0, 0.5, 0.25)
    assert loaded.joint("spin").axis == (1.0, 0.0, 0.0)
    lift = loaded.joint("lift")
    assert (lift.lower, lift.upper) == (0.0, 0.5)
    assert lift.mimic is not None
    assert (lift.mimic.joint, lift.mimic.multiplier, lift.mimic.offset) == ("pan", -0.5, 0.0)


def test_several_roots_and_a_joint_to_the_robot_in_one_file(tmp_path: Path) -> None:
    body = """
<link name="a"/><link name="b"/><link name="base_link"/><link name="c"/>
<joint name="j" type="fixed"><parent link="base_link"/><child link="c"/></joint>
"""
    loaded = load_one(tmp_path, body, ", xyz: [0, 0, 1]")
    assert loaded.codes == []
    assert sorted((j.name, j.parent) for j in loaded.parts.joints) == [
        ("a_mount", "frame_body"),
        ("b_mount", "frame_body"),
        ("j", "base_link"),
    ]


def test_an_extra_can_be_mounted_on_an_earlier_one(tmp_path: Path) -> None:
    loaded = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.urdf, parent: mast}]",
        a_xacro=HEAD + '<link name="mast"/></robot>',
        b_urdf='<robot name="b"><link name="cam"/><!-- $(not evaluated) --></robot>',
    )
    assert loaded.codes == []
    assert loaded.joint("cam_mount").parent == "mast"


def test_the_same_file_twice_with_other_arguments(tmp_path: Path) -> None:
    loaded = load(
        tmp_path,
        "[{xacro: a.xacro, args: {n: l}}, {xacro: a.xacro, args: {n: r, h: 2}}]",
        a_xacro=HEAD
        + '<xacro:arg name="n" default=""/><xacro:arg name="h" default="1"/>'
        + '<link name="$(arg n)"><visual><geometry><sphere radius="$(arg h)"/></geometry>'
        + "</visual></link></robot>",
    )
    assert loaded.codes == []
    assert [link.visuals[0].shape for link in loaded.parts.links] == [Sphere(1.0), Sphere(2.0)]


@pytest.mark.parametrize(
    "name",
    [
        "meshes/part.stl",
        "file://meshes/part.stl",
        "file://$(find parts_description)/meshes/part.stl",
        "$(find parts_description)/meshes/part.stl",
        "package://parts_description/meshes/part.stl",
    ],
)
def test_meshes_by_every_kind_of_path(tmp_path: Path, name: str) -> None:
    loaded = load(
        tmp_path,
        "- {xacro: a.xacro, packages: {parts_description: .}}",
        a_xacro=HEAD + mesh(name, ' scale="0.5 0.5 -0.5"') + "</robot>",
        meshes__part_stl=STL,
    )
    assert loaded.codes == []
    (part_mesh,) = loaded.parts.meshes
    assert loaded.link("m").visuals[0].shape == MeshShape(part_mesh.name, (0.5, 0.5, -0.5))


def test_packages_in_parent_folders(tmp_path: Path) -> None:
    loaded = load(
        tmp_path,
        "- xacro: ws/src/my_sensors/urdf/a.xacro",
        ws__src__my_sensors__urdf__a_xacro=HEAD
        + '<xacro:include filename="$(find other)/b.xacro"/>'
        + mesh("package://sensors_pkg/part.stl")
        + "</robot>",
        ws__src__my_sensors__package_xml="<package><name>sensors_pkg</name></package>",
        ws__src__my_sensors__part_stl=STL,
        ws__src__other__package_xml="<package><name>other</name></package>",
        ws__src__other__b_xacro=HEAD + '<link name="b"/></robot>',
    )
    assert loaded.codes == []
    assert [link.name for link in loaded.parts.links] == ["b", "m"]
    assert loaded.link("b").span.file == "ws/src/other/b.xacro"


def test_packages_by_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/none:{tmp_path}/inst")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}/old")
    loaded = load(
        tmp_path / "robot",
        "- xacro: a.xacro",
        a_xacro=HEAD
        + '<xacro:include filename="$(find one)/o.xacro"/>'
        + '<xacro:include filename="package://two/t.xacro"/></robot>',
        **{
            "..__inst__share__one__o_xacro": HEAD + '<link name="o"/></robot>',
            "..__old__two__t_xacro": HEAD + '<link name="t"/></robot>',
        },
    )
    assert loaded.codes == []
    assert [link.name for link in loaded.parts.links] == ["o", "t"]
    assert loaded.link("t").span.file == "package://two/t.xacro"


def test_a_package_that_is_not_found_names_who_asked_and_the_cure(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '\n<xacro:include filename="$(find nope)/x.xacro"/>')
    assert loaded.codes == ["extra-package"]
    assert (loaded.only.span or LINKS["base_link"]).line == 4
    assert "nope" in loaded.only.message
    assert "packages: {nope:" in (loaded.only.hint or "")
    loaded = load_one(tmp_path, "\n\n" + mesh("package://nope/x.stl"))
    assert loaded.codes == ["extra-package"]
    assert (loaded.only.span or LINKS["base_link"]).line == 5


def test_extensions_contain_no_absolute_path(tmp_path: Path) -> None:
    body = '<link name="a"/><gazebo reference="a"><mesh>file://$(find p)/m.dae</mesh></gazebo>'
    loaded = load_one(tmp_path, body, ", packages: {p: .}")
    assert loaded.codes == []
    (text,) = loaded.parts.urdf_extensions
    assert "package://p/m.dae" in text
    assert str(tmp_path) not in text


ARM = """
<xacro:arg name="tf_prefix" default=""/>
<xacro:property name="p" value="$(arg tf_prefix)"/>
<link name="world"/>
<joint name="${p}base_joint" type="fixed">
  <origin xyz="0 0 0.1"/><parent link="world"/><child link="${p}base_link"/>
</joint>
<link name="${p}base_link">BODY</link>
<joint name="${p}shoulder" type="revolute">
  <limit lower="-1" upper="1" effort="10" velocity="1"/>
  <parent link="${p}base_link"/><child link="${p}arm"/>
</joint>
<link name="${p}arm">INERTIAL</link>
</robot>
""".replace("BODY", BOX.replace("1 2 3", "1 1 1") + INERTIAL).replace("INERTIAL", INERTIAL)


def test_an_empty_link_world_stands_for_the_mounting_position(tmp_path: Path) -> None:
    entries = (
        "- {xacro: arm.xacro, args: {tf_prefix: left_}, parent: frame.top, xyz: [0, 0, 0.2]}\n"
        "- {xacro: arm.xacro, args: {tf_prefix: right_}, parent: frame.side}\n"
    )
    loaded = load(tmp_path, entries, arm_xacro=HEAD + ARM)
    assert loaded.codes == []
    names = ["left_base_link", "left_arm", "right_base_link", "right_arm"]
    assert [link.name for link in loaded.parts.links] == names
    joint = loaded.joint("left_base_joint")
    assert (joint.parent, joint.child) == ("frame_body", "left_base_link")
    assert joint.pose.xyz == pytest.approx((0.0, 0.0, 0.8))
    assert loaded.joint("right_base_joint").pose.xyz == pytest.approx((0.0, 1.0, 0.1))


def test_a_second_base_link_names_the_argument_for_a_prefix(tmp_path: Path) -> None:
    loaded = load(tmp_path, "- {xacro: arm.xacro}", arm_xacro=HEAD + ARM)
    assert loaded.codes == ["extra-name-duplicate"]
    hints = [d.hint for d in loaded.report]
    assert hints == ["set the argument `tf_prefix` of the xacro file: `args: {tf_prefix: ...}`"]
