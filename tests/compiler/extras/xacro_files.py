"""Helpers of the tests of extras: write xacro files and load them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.extras.join_extras import Attachment
from thorvaldc.compiler.extras.load_extras import load_extras
from thorvaldc.compiler.hardware.robot_parts import RobotParts
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Diagnostic, Report, Span
from thorvaldc.model import Joint, Link, Pose
from thorvaldc.model.stl import binary_stl

LINKS = {"base_link": Span("robot.yaml"), "frame_body": Span("robot.yaml", 3)}
JOINTS = {"frame_mount": Span("robot.yaml", 3)}
HEAD = '<?xml version="1.0"?>\n<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="extra">\n'


@dataclass
class Loaded:
    parts: RobotParts
    files: dict[str, Path]
    report: Report

    @property
    def codes(self) -> list[str]:
        return [d.code.name for d in self.report]

    @property
    def only(self) -> Diagnostic:
        (diagnostic,) = self.report
        return diagnostic

    def link(self, name: str) -> Link:
        return next(link for link in self.parts.links if link.name == name)

    def joint(self, name: str) -> Joint:
        return next(joint for joint in self.parts.joints if joint.name == name)


def attach(text: str | None) -> Attachment | None:
    return {
        None: ("frame_body", Pose()),
        "frame": ("frame_body", Pose()),
        "frame.side": (
            "frame_body",
            Pose.from_xyz_rpy((0.0, 1.0, 0.0), (0.0, 0.0, math.pi / 2)),
        ),
        "frame.top": ("frame_body", Pose((0.0, 0.0, 0.5))),
    }.get(text)


def load(folder: Path, entries: str, **files: str | bytes) -> Loaded:
    """Loads ``entries`` of a robot file in ``folder``; ``mast_xacro="..."`` writes mast.xacro."""
    for name, data in files.items():
        stem, _, suffix = name.rpartition("_")
        path = folder.joinpath(*f"{stem}.{suffix}".split("__"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    report, read_files = Report(), dict[str, Path]()
    node = read_text(entries.encode(), "robot.yaml", report)
    assert node is not None, list(report)
    assert isinstance(node.value, tuple)
    parts = load_extras(
        node.value,
        folder,
        links=LINKS,
        joints=JOINTS,
        attach=attach,
        files=read_files,
        report=report,
    )
    return Loaded(parts, read_files, report)


def load_one(folder: Path, body: str, entry: str = "") -> Loaded:
    """Loads one file ``a.xacro``; its body starts on line 3."""
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
      <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <gazebo reference="${name}"><sensor type="ray" name="${name}"><!-- c --></sensor></gazebo>
</xacro:macro>
<material name="dark"><color rgba="0.1 0.2 0.3 1"/></material>
</robot>
"""
)


def mesh(name: str, more: str = "") -> str:
    shape = f'<geometry><mesh filename="{name}"{more}/></geometry>'
    return f'<link name="m"><visual>{shape}</visual></link>'


def link_with(inertial: str) -> str:
    return f'<link name="a"><inertial>\n{inertial}\n</inertial></link>'


def inertia(mass: str, ixx: str = "1", iyy: str = "1", izz: str = "1", ixy: str = "0") -> str:
    entries = f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="0" iyz="0"'
    return f'<mass value="{mass}"/>\n<inertia {entries}/>'


def joint(inner: str, kind: str = "fixed", name: str = "j") -> str:
    return f'<link name="a">{INERTIAL}</link>\n<joint name="{name}" type="{kind}">\n{inner}</joint>'


ENDS = '<parent link="frame_body"/><child link="a"/>'
