"""Extras: other people's xacro files as links and joints, their faults at their lines."""

from __future__ import annotations

import math
import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from thorvaldc.compiler.extras import xacro_expand
from thorvaldc.compiler.extras.extras import Attachment, ExtraParts, load_extras
from thorvaldc.compiler.geometry.meshes import binary_stl
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Diagnostic, Report, Span
from thorvaldc.model import Box, Cylinder, Joint, Link, MeshShape, Pose, Sphere

LINKS = {"base_link": Span("robot.yaml"), "frame_body": Span("robot.yaml", 3)}
JOINTS = {"frame_mount": Span("robot.yaml", 3)}
HEAD = '<?xml version="1.0"?>\n<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="extra">\n'


@dataclass
class Loaded:
    parts: ExtraParts
    report: Report

    @property
    def codes(self) -> list[str]:
        return [d.code.name for d in self.report]

    @property
    def only(self) -> Diagnostic:
        (found,) = self.report
        return found

    def link(self, name: str) -> Link:
        return next(link for link in self.parts.links if link.name == name)

    def joint(self, name: str) -> Joint:
        return next(joint for joint in self.parts.joints if joint.name == name)


def attach(text: str | None) -> Attachment | None:
    return {
        None: Attachment("frame_body", Pose()),
        "frame": Attachment("frame_body", Pose()),
        "frame.side": Attachment(
            "frame_body", Pose.from_xyz_rpy((0.0, 1.0, 0.0), (0.0, 0.0, math.pi / 2))
        ),
        "frame.top": Attachment("frame_body", Pose((0.0, 0.0, 0.5))),
    }.get(text)


def load(folder: Path, entries: str, **files: str | bytes) -> Loaded:
    """Extras of a robot.yaml in ``folder``; ``mast_xacro="..."`` writes ``mast.xacro``."""
    for name, data in files.items():
        stem, _, suffix = name.rpartition("_")
        path = folder.joinpath(*f"{stem}.{suffix}".split("__"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    report = Report()
    node = read_text(entries.encode(), "robot.yaml", report)
    assert node is not None, list(report)
    assert isinstance(node.value, tuple)
    parts = load_extras(
        node.value, folder, links=LINKS, joints=JOINTS, attach=attach, report=report
    )
    return Loaded(parts, report)


def one(folder: Path, body: str, entry: str = "") -> Loaded:
    """A single file ``a.xacro``; its body starts on line 3."""
    return load(folder, f"- {{xacro: a.xacro{entry}}}", a_xacro=f"{HEAD}{body}</robot>\n")


TRIANGLES = [
    ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
]
STL = binary_stl(TRIANGLES)

BOX = '<visual><geometry><box size="1 2 3"/></geometry></visual>'
INERTIAL = (
    '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)


# -- what is read -------------------------------------------------------------------


def test_a_robot_without_extras_pays_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xacro_expand, "expand", None)
    report = Report()
    parts = load_extras([], tmp_path, links={}, joints={}, attach=attach, report=report)
    assert parts == ExtraParts()


def test_a_root_link_hangs_on_the_parent_at_its_place(tmp_path: Path) -> None:
    entry = ", parent: frame.top, xyz: [100 mm, 0, 0.2], rpy: [0, 0, 90 deg]"
    found = one(tmp_path, f'<link name="mast">{BOX}</link>', entry)
    assert found.codes == []
    joint = found.joint("mast_mount")
    assert (joint.type, joint.parent, joint.child) == ("fixed", "frame_body", "mast")
    assert joint.pose.xyz == (0.1, 0.0, 0.7)
    assert joint.pose.rpy() == pytest.approx((0.0, 0.0, 1.570796327))
    assert found.link("mast").span.file == "a.xacro"
    assert found.link("mast").span.line == 3


def test_the_place_is_given_in_the_axes_of_the_port(tmp_path: Path) -> None:
    found = one(tmp_path, '<link name="mast"/>', ", parent: frame.side, xyz: [1, 0, 0]")
    assert found.joint("mast_mount").pose.xyz == pytest.approx((0.0, 2.0, 0.0))


SENSOR = (
    HEAD
    + """
<xacro:macro name="laser" params="name parent size:=0.1 *origin">
  <xacro:property name="r" value="${size / 2}"/>
  <joint name="${name}_joint" type="fixed">
    <xacro:insert_block name="origin"/>
    <parent link="${parent}"/>
    <child link="${name}"/>
  </joint>
  <link name="${name}">
    <visual>
      <origin xyz="0 0 ${r}"/>
      <geometry><cylinder radius="${r}" length="${size}"/></geometry>
      <material name="dark"/>
    </visual>
    <collision><geometry><sphere radius="${r}"/></geometry></collision>
    <inertial>
      <origin xyz="0 0 0.1" rpy="0 0 ${pi/2}"/>
      <mass value="0.5"/>
      <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <gazebo reference="${name}"><sensor type="ray" name="${name}"><!-- c --></sensor></gazebo>
</xacro:macro>
<material name="dark"><color rgba="0.1 0.2 0.3 1"/></material>
</robot>
"""
)


def test_a_sensor_macro_with_parent_and_origin_block(tmp_path: Path) -> None:
    body = """
<xacro:arg name="parent" default="base_link"/>
<xacro:include filename="sensors/laser.xacro"/>
<xacro:laser name="front" parent="$(arg parent)"><origin xyz="1 0 0.5" rpy="0 0 0"/></xacro:laser>
<xacro:laser name="back" parent="front" size="0.2"><origin xyz="-2 0 0"/></xacro:laser>
</robot>"""
    found = load(
        tmp_path,
        "- {xacro: a.xacro, args: {parent: frame_body}}",
        a_xacro=HEAD + body,
        sensors__laser_xacro=SENSOR,
    )
    assert found.codes == []
    assert [link.name for link in found.parts.links] == ["front", "back"]
    assert [joint.name for joint in found.parts.joints] == ["front_joint", "back_joint"]
    joint = found.joint("front_joint")
    assert (joint.parent, joint.pose.xyz) == ("frame_body", (1.0, 0.0, 0.5))
    back = found.link("back")
    assert back.visuals[0].shape == Cylinder(0.1, 0.2)
    assert back.visuals[0].pose.xyz == (0.0, 0.0, 0.1)
    assert back.visuals[0].color == (0.1, 0.2, 0.3, 1.0)
    assert back.collisions[0].shape == Sphere(0.1)
    assert back.inertial is not None
    assert back.inertial.com == (0.0, 0.0, 0.1)
    assert back.inertial.inertia == pytest.approx((0.2, 0.1, 0.2, 0.0, 0.0, 0.0))
    assert back.span == Span("sensors/laser.xacro", 11, 3, 11, 8)
    assert found.parts.urdf_extensions[1].startswith('<gazebo reference="back"><sensor name="back"')


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
    """Its own package by the folder's name, an empty base_link for its own test, name spaces."""
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
    found = load(
        tmp_path,
        "- {xacro: camera_pkg/urdf/test.urdf.xacro, args: {name: cam}}",
        **{
            "camera_pkg__urdf__test.urdf_xacro": test,
            "camera_pkg__urdf__camera_xacro": CAMERA,
            "camera_pkg__urdf__materials_xacro": HEAD + materials,
            "camera_pkg__meshes__body_stl": STL,
        },
    )
    assert found.codes == []
    names = [link.name for link in found.parts.links]
    assert names == ["cam_screw", "cam_body", "cam_optical"]
    assert found.joint("cam_joint").parent == "base_link"
    visual = found.link("cam_body").visuals[0]
    assert visual.color == (0.5, 0.5, 0.5, 1.0)
    assert isinstance(visual.shape, MeshShape)
    assert visual.shape.scale == (0.001, 0.001, 0.001)
    (gazebo,) = found.parts.urdf_extensions
    assert 'xmlns:sensor="http://example.com/sensor"' in gazebo


def test_conditions_loops_of_macros_name_spaces_and_python(tmp_path: Path) -> None:
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
    found = load(tmp_path, "- xacro: a.xacro", a_xacro=HEAD + body, tools_xacro=tools)
    assert found.codes == []
    assert [link.name for link in found.parts.links] == ["post_3", "post_2", "post_1", "end"]
    assert found.link("post_3").visuals[0].shape == Box((0.7, 0.2, 3.0))


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
    found = one(tmp_path, body)
    assert found.codes == []
    pan = found.joint("pan")
    assert (pan.axis, pan.lower, pan.upper) == ((0.0, 0.0, 1.0), -1.0, 2.0)
    assert (pan.effort, pan.velocity, pan.damping, pan.friction) == (3.0, 4.0, 0.5, 0.25)
    assert found.joint("spin").axis == (1.0, 0.0, 0.0)
    lift = found.joint("lift")
    assert (lift.lower, lift.upper) == (0.0, 0.5)
    assert lift.mimic is not None
    assert (lift.mimic.joint, lift.mimic.multiplier, lift.mimic.offset) == ("pan", -0.5, 0.0)


def test_several_roots_and_an_own_joint_in_one_file(tmp_path: Path) -> None:
    body = """
<link name="a"/><link name="b"/><link name="base_link"/><link name="c"/>
<joint name="j" type="fixed"><parent link="base_link"/><child link="c"/></joint>
"""
    found = one(tmp_path, body, ", xyz: [0, 0, 1]")
    assert found.codes == []
    assert sorted((j.name, j.parent) for j in found.parts.joints) == [
        ("a_mount", "frame_body"),
        ("b_mount", "frame_body"),
        ("j", "base_link"),
    ]


def test_an_extra_may_hang_on_an_earlier_one(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.urdf, parent: mast}]",
        a_xacro=HEAD + '<link name="mast"/></robot>',
        b_urdf='<robot name="b"><link name="cam"/><!-- $(not evaluated) --></robot>',
    )
    assert found.codes == []
    assert found.joint("cam_mount").parent == "mast"


def test_the_same_file_twice_with_other_arguments(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        "[{xacro: a.xacro, args: {n: l}}, {xacro: a.xacro, args: {n: r, h: 2}}]",
        a_xacro=HEAD
        + '<xacro:arg name="n" default=""/><xacro:arg name="h" default="1"/>'
        + '<link name="$(arg n)"><visual><geometry><sphere radius="$(arg h)"/></geometry>'
        + "</visual></link></robot>",
    )
    assert found.codes == []
    assert [link.visuals[0].shape for link in found.parts.links] == [Sphere(1.0), Sphere(2.0)]


# -- meshes and packages ------------------------------------------------------------


def mesh(name: str, more: str = "") -> str:
    shape = f'<geometry><mesh filename="{name}"{more}/></geometry>'
    return f'<link name="m"><visual>{shape}</visual></link>'


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
    found = load(
        tmp_path,
        "- {xacro: a.xacro, packages: {parts_description: .}}",
        a_xacro=HEAD + mesh(name, ' scale="0.5 0.5 -0.5"') + "</robot>",
        meshes__part_stl=STL,
    )
    assert found.codes == []
    (only,) = found.parts.meshes
    assert found.link("m").visuals[0].shape == MeshShape(only.name, (0.5, 0.5, -0.5))


def test_packages_by_the_folders_around(tmp_path: Path) -> None:
    found = load(
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
    assert found.codes == []
    assert [link.name for link in found.parts.links] == ["b", "m"]
    assert found.link("b").span.file == "ws/src/other/b.xacro"


def test_packages_by_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/none:{tmp_path}/inst")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}/old")
    found = load(
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
    assert found.codes == []
    assert [link.name for link in found.parts.links] == ["o", "t"]
    assert found.link("t").span.file == "package://two/t.xacro"


def test_a_package_that_is_not_found_names_who_asked_and_the_cure(tmp_path: Path) -> None:
    found = one(tmp_path, '\n<xacro:include filename="$(find nope)/x.xacro"/>')
    assert found.codes == ["extra-package"]
    assert (found.only.span or LINKS["base_link"]).line == 4
    assert "nope" in found.only.message
    assert "packages: {nope:" in (found.only.hint or "")
    found = one(tmp_path, "\n\n" + mesh("package://nope/x.stl"))
    assert found.codes == ["extra-package"]
    assert (found.only.span or LINKS["base_link"]).line == 5


def test_extensions_carry_no_path_of_this_machine(tmp_path: Path) -> None:
    body = '<link name="a"/><gazebo reference="a"><mesh>file://$(find p)/m.dae</mesh></gazebo>'
    found = one(tmp_path, body, ", packages: {p: .}")
    assert found.codes == []
    (text,) = found.parts.urdf_extensions
    assert "package://p/m.dae" in text
    assert str(tmp_path) not in text


# -- faults ---------------------------------------------------------------------------


def link_with(inertial: str) -> str:
    return f'<link name="a"><inertial>\n{inertial}\n</inertial></link>'


def inertia(mass: str, ixx: str = "1", iyy: str = "1", izz: str = "1", ixy: str = "0") -> str:
    entries = f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="0" iyz="0"'
    return f'<mass value="{mass}"/>\n<inertia {entries}/>'


def joint(inner: str, kind: str = "fixed", name: str = "j") -> str:
    return f'<link name="a">{INERTIAL}</link>\n<joint name="{name}" type="{kind}">\n{inner}</joint>'


ENDS = '<parent link="frame_body"/><child link="a"/>'


@pytest.mark.parametrize(
    ("body", "code", "line", "words"),
    [
        ("<link name='a'>\n<visual></link>", "extra-xml", 4, "mismatched"),
        ("<link\n name='${1 +}'/>", "extra-expansion", 3, "1 +"),
        ("<link/>\n<link name='a'><visual name='${x}'/></link>", "extra-expansion", 4, "'x'"),
        ("<xacro:if value='maybe'>\n<link name='a'/></xacro:if>", "extra-expansion", 3, "maybe"),
        ("\n<xacro:lazer name='a'/>", "extra-expansion", 4, "lazer"),
        ("\n<xacro:include filename='none.xacro'/>", "extra-expansion", 4, "none.xacro"),
        ("<link name='$(arg size)'/>", "extra-argument", 3, "`size`"),
        ("<link name='$(env HOME)'/>", "extra-expansion", 3, "HOME"),
        ("<link name='${open(1)}'/>", "extra-expansion", 3, "open"),
        ("<link/>", "extra-element", 3, "name"),
        ("<link name='a'><visual/></link>", "extra-element", 3, "geometry"),
        ("<link name='a'><visual><geometry/></visual></link>", "extra-element", 3, "geometry"),
        (
            "<link name='a'><visual><geometry>\n<capsule r='1'/></geometry></visual></link>",
            "extra-element",
            4,
            "capsule",
        ),
        ("<link name='a'/><link name='a'/>", "extra-name-duplicate", 3, "`a`"),
        (f"<link name='frame_body'>\n{BOX}</link>", "extra-name-duplicate", 3, "frame_body"),
        (joint(ENDS, name="frame_mount"), "extra-name-duplicate", 4, "frame_mount"),
        (joint("<child link='a'/>"), "extra-element", 4, "parent"),
        (
            joint("<parent link='frame_boddy'/><child link='a'/>"),
            "extra-link-unknown",
            4,
            "frame_boddy",
        ),
        (joint(ENDS + "<mimic joint='x'/>", "continuous"), "extra-link-unknown", 4, "`x`"),
        (
            joint("<parent link='a'/><child link='frame_body'/>"),
            "extra-two-parents",
            4,
            "frame_body",
        ),
        (
            joint(ENDS) + f"\n<joint name='k' type='fixed'>{ENDS}</joint>",
            "extra-two-parents",
            6,
            "`a`",
        ),
        (joint("<parent link='a'/><child link='a'/>"), "extra-cycle", 4, "a -> a"),
        (joint(ENDS, "floating"), "extra-joint-type", 4, "floating"),
        (joint(ENDS, "ball"), "extra-joint-type", 4, "ball"),
        (joint(ENDS, ""), "extra-joint-type", 4, "no type"),
        (joint(ENDS, "revolute"), "extra-joint-limits", 4, "limit"),
        (
            joint(ENDS + "\n<limit lower='1' upper='0' effort='1' velocity='1'/>", "revolute"),
            "extra-joint-limits",
            6,
            "1",
        ),
        (
            joint(ENDS + "\n<limit effort='-1' velocity='1'/>", "prismatic"),
            "extra-joint-limits",
            6,
            "-1",
        ),
        (joint(ENDS + "\n<axis xyz='0 0 0'/>", "continuous"), "extra-number", 6, "axis"),
        (joint(ENDS + "\n<origin xyz='0 0'/>"), "extra-number", 6, "2 numbers"),
        (joint(ENDS + "\n<origin xyz='0, 0, 1'/>"), "extra-number", 6, "0,"),
        (joint(ENDS + "\n<origin rpy='0 0 nan'/>"), "extra-number", 6, "nan"),
        (
            "<link name='a'><visual><geometry>\n<box size='1 0 1'/></geometry></visual></link>",
            "extra-number",
            4,
            "0 m",
        ),
        (link_with(inertia("-1")), "extra-inertia", 4, '"-1">: value must be at least 0 kg'),
        (link_with(inertia("1", izz="2.1")), "extra-inertia", 5, "2.1"),
        (link_with(inertia("1", ixy="1.5")), "extra-inertia", 5, "negative"),
        (link_with(inertia("0")), "extra-inertia", 4, "no mass"),
        (link_with(inertia("x")), "extra-number", 4, "`x`"),
        (link_with('<mass value="1"/>'), "extra-element", 3, "inertia"),
        (joint(ENDS, "continuous").replace(INERTIAL, ""), "extra-massless", 3, "no mass"),
        (
            joint(ENDS, "continuous").replace(INERTIAL, "")
            + f"<link name='b'>{INERTIAL}</link><joint name='k' type='continuous'>"
            "<parent link='a'/><child link='b'/></joint>",
            "extra-massless",
            3,
            "no mass",
        ),
        ("<link name='a'>\n<visul/></link>", "extra-left-out", 4, "visul"),
        ("<link name='a'/><macro name='x'/>", "extra-left-out", 3, "macro"),
        ("<link name='a' nome='b'/>", "extra-left-out", 3, "nome"),
        (
            "<link name='a'>" + BOX.replace("</v", "<material name='x'/></v") + "</link>",
            "extra-material",
            3,
            "`x`",
        ),
        (mesh("\nnone.stl"), "mesh-missing", 3, "none.stl"),
        (mesh("http://x.y/none.stl"), "mesh-missing", 3, "http"),
        (mesh("a.blend"), "mesh-format", 3, "blend"),
    ],
)
def test_a_fault_is_reported_at_its_line(
    tmp_path: Path, body: str, code: str, line: int, words: str
) -> None:
    found = one(tmp_path, body)
    assert found.codes[0] == code, [d.message for d in found.report]
    first = next(iter(found.report))
    assert first.span is not None
    assert (first.span.file, first.span.line) == ("a.xacro", line)
    assert words in first.message
    assert str(tmp_path) not in first.message + (first.hint or "")


def test_a_fault_in_a_macro_tells_where_it_was_called(tmp_path: Path) -> None:
    inner = (
        HEAD + '\n<xacro:macro name="m" params="n">\n' + mesh("none.stl") + "</xacro:macro></robot>"
    )
    outer = HEAD + '<xacro:include filename="m.xacro"/>\n<xacro:m n="1"/></robot>'
    found = load(tmp_path, "- xacro: a.xacro", a_xacro=outer, m_xacro=inner)
    assert found.codes == ["mesh-missing"]
    assert str(found.only.span).startswith("m.xacro:5:")
    found = load(
        tmp_path,
        "- xacro: a.xacro",
        a_xacro=outer,
        m_xacro=inner.replace("none.stl", "${1/0}"),
    )
    assert found.codes == ["extra-expansion"]
    assert str(found.only.span).startswith("m.xacro:5:")
    assert ("a.xacro", 4) in [(label.span.file, label.span.line) for label in found.only.labels]


def test_a_broken_property_is_named_where_it_is_defined(tmp_path: Path) -> None:
    found = one(tmp_path, '<xacro:property name="w" value="${2 * q}"/>\n<link name="${w}"/>')
    assert found.codes == ["extra-expansion"]
    assert found.only.span is not None
    assert found.only.span.line == 4
    assert any(label.span.line == 3 and "`w`" in label.text for label in found.only.labels)


def test_a_macro_called_without_its_prefix(tmp_path: Path) -> None:
    found = one(tmp_path, '<link name="a"/><xacro:macro name="lidar"/><lidar/>')
    assert found.codes == ["extra-left-out"]
    assert "<xacro:lidar" in (found.only.hint or "")


def test_macros_alone_are_told_how_to_be_called(tmp_path: Path) -> None:
    found = load(tmp_path, "- xacro: laser.xacro", laser_xacro=SENSOR)
    assert found.codes == ["extra-empty"]
    assert '<xacro:laser name="..." parent="..."><origin .../></xacro:laser>' in (
        found.only.hint or ""
    )


def test_a_misspelt_argument_is_noticed(tmp_path: Path) -> None:
    found = one(
        tmp_path,
        '<xacro:arg name="height" default="1"/><link name="a_$(arg height)"/>',
        ", args: {heigth: 2}",
    )
    assert found.codes == ["extra-argument-unused"]
    assert found.only.hint == "did you mean `height`?"
    assert found.only.span is not None
    assert found.only.span.file == "robot.yaml"


def test_placement_of_a_file_that_places_itself_is_noticed(tmp_path: Path) -> None:
    found = one(tmp_path, joint(ENDS), ", xyz: [0, 0, 1]")
    assert found.codes == ["extra-placement-unused"]


def test_an_unknown_parent(tmp_path: Path) -> None:
    found = one(tmp_path, '<link name="a"/>', ", parent: frame_boddy")
    assert found.codes == ["extra-parent"]
    assert found.only.hint == "did you mean `frame_body`?"


def test_a_missing_xacro_file_and_package_folder(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        "[{xacro: none.xacro}, {xacro: a.xacro, packages: {p: none}}]",
        a_xacro=HEAD + "<link name='a'/></robot>",
    )
    assert found.codes == ["extra-missing", "extra-package"]


def test_a_file_that_is_no_robot(tmp_path: Path) -> None:
    found = load(tmp_path, "- xacro: a.xacro", a_xacro="<sdf version='1.6'/>")
    assert found.codes == ["extra-xml"]
    assert "<sdf>" in found.only.message
    found = load(tmp_path, "- xacro: a.xacro", a_xacro=b"\x00\xff nothing")
    assert found.codes == ["extra-xml"]


def test_all_faults_of_all_files_in_one_run(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.xacro}, {xacro: c.xacro}]",
        a_xacro=HEAD + "<link name='${x}'/></robot>",
        b_xacro=HEAD
        + link_with(inertia("-1"))
        + joint(ENDS, "ball").replace("`a`", "`b`")
        + "</robot>",
        c_xacro=HEAD + "<link name='c'/></robot>",
    )
    assert found.codes[0] == "extra-expansion"
    assert {"extra-inertia", "extra-joint-type"} <= set(found.codes)
    assert [link.name for link in found.parts.links][-1] == "c"


# -- limits -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("<link name='${[0] * 10**10}'/>", "memory"),
        ("<link name='${list(range(10**12))}'/>", "memory"),
        (
            '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
            "calls itself",
        ),
        ('<xacro:include filename="a.xacro"/>', "calls itself"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="memory limits are Linux's")
def test_a_file_that_wants_too_much_is_given_up(tmp_path: Path, body: str, words: str) -> None:
    found = one(tmp_path, body)
    assert found.codes[0] in ("extra-limit", "extra-expansion")
    assert words in found.only.message


def test_a_file_that_hangs_is_stopped_and_the_next_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xacro_expand, "WALL_SECONDS", 1.0)
    start = time.monotonic()
    found = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.xacro}]",
        a_xacro=HEAD + "<link name='${len([0 for i in range(10**11)])}'/></robot>",
        b_xacro=HEAD + "<link name='b'/></robot>",
    )
    assert time.monotonic() - start < 10.0
    assert found.codes == ["extra-limit"]
    assert "longer than 1 s" in found.only.message
    assert [link.name for link in found.parts.links] == ["b"]


# xacro's guard on names with underscores does not look into a lambda.
OS = (
    "(lambda: [c for c in ().__class__.__base__.__subclasses__() "
    "if c.__name__ == '_wrap_close'][0].__init__.__globals__)()"
)


@pytest.mark.skipif(sys.platform != "linux", reason="write limits are Linux's")
def test_a_file_that_escapes_finds_no_environment_and_cannot_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "squeamish")
    out = tmp_path / "out.txt"
    found = one(tmp_path, f"<link name=\"${{{OS}['environ'].get('SECRET_TOKEN', 'none')}}\"/>")
    assert [link.name for link in found.parts.links] == ["none"]
    opened = f"{OS}['open']('{out}', 65)"  # O_WRONLY | O_CREAT
    found = one(tmp_path, f"<link name=\"${{{OS}['write']({opened}, str(1).encode())}}\"/>")
    assert found.codes == ["extra-expansion"]
    assert "too large" in found.only.message
    assert out.read_bytes() == b""


def test_what_a_file_prints_does_not_disturb(tmp_path: Path) -> None:
    body = "<link name='a${xacro.message(1)}'/>"
    body += "\n<xacro:property name='x' value='${xacro.warning(2)}'/>"
    found = one(tmp_path, body + "<link name='b${x}'/>")
    assert [link.name for link in found.parts.links] == ["a", "b"]
    assert found.codes == ["extra-warning"]


def test_the_result_does_not_depend_on_the_folder(tmp_path: Path) -> None:
    found = []
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        found.append(
            load(
                tmp_path / name,
                "- {xacro: a.xacro, packages: {p: .}}",
                a_xacro=HEAD + mesh("$(find p)/m.stl") + "<gazebo>$(find p)/x</gazebo></robot>",
                m_stl=STL,
            ).parts
        )
    assert list(found[0].files) == list(found[1].files) == ["a.xacro"]
    assert repr(replace(found[0], files={})) == repr(replace(found[1], files={}))
    assert str(os.getcwd()) not in repr(found)
    assert struct.unpack_from("<I", found[0].meshes[0].data, 80) == (4,)


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes under /proc")
def test_an_interrupt_ends_the_worker(tmp_path: Path) -> None:
    (tmp_path / "a.xacro").write_text(
        HEAD + "<link name='${len([0 for i in range(10**11)])}'/></robot>", encoding="utf-8"
    )
    program = (
        "from pathlib import Path\n"
        "from thorvaldc.compiler.extras.xacro_expand import Request, Shown, expand\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "expand([Request(folder / 'a.xacro', {}, {})], Shown(folder, '', {}))\n"
    )
    ours = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL)
    children = Path(f"/proc/{ours.pid}/task/{ours.pid}/children")
    deadline = time.monotonic() + 30.0
    worker = ""
    while not worker and time.monotonic() < deadline:
        time.sleep(0.02)
        worker = children.read_text().strip()
    time.sleep(0.3)  # it is expanding now, or about to
    ours.send_signal(signal.SIGINT)
    assert ours.wait(timeout=10.0) != 0
    while Path(f"/proc/{worker}").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not Path(f"/proc/{worker}").exists()
