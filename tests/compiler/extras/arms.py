"""Descriptions of our own with the structure of published arms and grippers.

``ARM`` begins with a link ``world`` and a fixed joint, as those of UR, Kinova and Franka do, has a
``<ros2_control>`` element with initial positions, and a gripper with mimic joints, as Robotiq's.
"""

from __future__ import annotations

from pathlib import Path

ARM = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">
<xacro:arg name="prefix" default="arm_"/>
<xacro:property name="p" value="$(arg prefix)"/>
<xacro:macro name="body" params="name mass length">
  <link name="${p}${name}">
    <inertial>
      <origin xyz="0 0 ${length / 2}"/>
      <mass value="${mass}"/>
    </inertial>
    <collision>
      <origin xyz="0 0 ${length / 2}"/>
      <geometry><cylinder radius="0.04" length="${length}"/></geometry>
    </collision>
  </link>
</xacro:macro>
<xacro:macro name="hinge" params="name parent child z axis:='0 1 0' effort:=150 **mimic">
  <joint name="${p}${name}" type="revolute">
    <origin xyz="0 0 ${z}"/>
    <parent link="${p}${parent}"/>
    <child link="${p}${child}"/>
    <axis xyz="${axis}"/>
    <limit lower="-3" upper="3" effort="${effort}" velocity="3"/>
    <xacro:insert_block name="mimic"/>
  </joint>
</xacro:macro>
<link name="world"/>
<joint name="${p}base_joint" type="fixed">
  <parent link="world"/>
  <child link="${p}base_link"/>
</joint>
<xacro:body name="base_link" mass="4" length="0.15"/>
<xacro:body name="upper_arm" mass="8" length="0.4"/>
<xacro:body name="forearm" mass="3" length="0.4"/>
<xacro:body name="hand" mass="0.8" length="0.1"/>
<xacro:body name="left_finger" mass="0.05" length="0.05"/>
<xacro:body name="right_finger" mass="0.05" length="0.05"/>
<xacro:hinge name="shoulder" parent="base_link" child="upper_arm" z="0.15"><mimic/></xacro:hinge>
<xacro:hinge name="elbow" parent="upper_arm" child="forearm" z="0.4"><mimic/></xacro:hinge>
<xacro:hinge name="wrist" parent="forearm" child="hand" z="0.4" effort="28"><mimic/></xacro:hinge>
<xacro:hinge name="knuckle" parent="hand" child="left_finger" z="0.1" effort="5">
  <mimic/>
</xacro:hinge>
<xacro:hinge name="finger" parent="hand" child="right_finger" z="0.1" effort="5">
  <mimic><mimic joint="${p}knuckle" multiplier="-1"/></mimic>
</xacro:hinge>
<ros2_control name="${p}control" type="system">
  <hardware><plugin>mock_components/GenericSystem</plugin></hardware>
  <xacro:macro name="driven" params="name initial">
    <joint name="${p}${name}">
      <command_interface name="position"/>
      <state_interface name="position">
        <param name="initial_value">${initial}</param>
      </state_interface>
      <state_interface name="velocity"/>
    </joint>
  </xacro:macro>
  <xacro:driven name="shoulder" initial="0.3"/>
  <xacro:driven name="elbow" initial="1.2"/>
  <xacro:driven name="wrist" initial="-0.5"/>
  <xacro:driven name="knuckle" initial="-0.4"/>
  <joint name="${p}finger"><state_interface name="position"/></joint>
</ros2_control>
</robot>
"""

ROBOT = """thorvaldc: 1
name: robot
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1, width: 0.9}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 1}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 2}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, can: 3}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, can: 4}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}, can: 1}
extras:
  - {xacro: arm.xacro, parent: frame, xyz: [0, 0, 0.1]}
"""


def arm_robot(folder: Path, *, arm: str = ARM, robot: str = ROBOT) -> Path:
    """Writes a robot with an arm, and returns the path of the robot file."""
    (folder / "arm.xacro").write_text(arm, encoding="utf-8")
    path = folder / "robot.yaml"
    path.write_text(robot, encoding="utf-8")
    return path
