"""The files of a ROS 2 package that ros2_control reads: controllers, hardware, launch file.

What the real programs would refuse, and parameters that nothing reads, end the program.
"""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tests.ros.engines.joint_engine import fail

FORWARD = "forward_command_controller/ForwardCommandController"
BROADCASTER = "joint_state_broadcaster/JointStateBroadcaster"
OF_ALL: dict[str, type] = {"update_rate": int, "is_async": bool, "use_sim_time": bool}
PARAMETERS: dict[str, dict[str, type]] = {
    FORWARD: {"joints": list, "interface_name": str},
    BROADCASTER: {
        "use_local_topics": bool,
        "joints": list,
        "interfaces": list,
        "extra_joints": list,
        "map_interface_to_joint_state.position": str,
        "map_interface_to_joint_state.velocity": str,
        "map_interface_to_joint_state.effort": str,
        "use_urdf_to_filter": bool,
        "publish_dynamic_joint_states": bool,
        "frame_id": str,
    },
}
MOCK = "mock_components/GenericSystem"
MUJOCO = "mujoco_ros2_control/MujocoSystemInterface"
HARDWARE = {MOCK: {"calculate_dynamics"}, MUJOCO: {"mujoco_model", "initial_keyframe"}}
MOVING = ("continuous", "revolute", "prismatic")


@dataclass(frozen=True)
class Controller:
    """A controller that the spawner starts, with its flat parameters."""

    name: str
    type: str
    parameters: dict[str, Any]


@dataclass(frozen=True)
class Joint:
    """A joint of the hardware: limits and initial values of its interfaces (rad, rad/s, m)."""

    name: str
    commands: dict[str, tuple[float, float]] = field(default_factory=dict)
    states: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Hardware:
    plugin: str
    parameters: dict[str, str]
    joints: dict[str, Joint]
    urdf_joints: tuple[str, ...]
    """Joints of the URDF that move, sorted, as the map of urdf::Model sorts them."""


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _nodes(content: dict[str, Any], prefix: str = "") -> list[tuple[str, dict[str, Any]]]:
    """Returns the node names of a parameter file, which may be nested, and the parameters."""
    found = []
    for name, value in content.items():
        path = f"{prefix}/{name.strip('/')}"
        if "ros__parameters" in value:
            found.append((path, value["ros__parameters"]))
        else:
            found += _nodes(value, path)
    return found


def _parameters_of(content: dict[str, Any], namespace: str, node: str) -> dict[str, Any]:
    """Returns the parameters of a node; a name without a namespace is in the root namespace."""
    full = "/".join(["", *filter(None, [namespace.strip("/")]), node])
    values: dict[str, Any] = {}
    for path, parameters in _nodes(content):
        pattern = re.escape(path).replace(r"/\*\*", "(/.+)?").replace(r"\*", "[^/]+")
        if re.fullmatch(pattern, full) or path == "/**":
            values |= _flat(parameters)
    return values


def started_controllers(launch_file: Path) -> list[str]:
    """Returns the list ``CONTROLLERS`` of a launch file, which the spawner starts."""
    for line in ast.parse(launch_file.read_text(encoding="utf-8")).body:
        names = [getattr(t, "id", "") for t in line.targets] if isinstance(line, ast.Assign) else []
        if names == ["CONTROLLERS"]:
            return list(ast.literal_eval(line.value))
    return fail(f"{launch_file.name} starts no CONTROLLERS")


def read_controllers(package: Path, namespace: str) -> tuple[dict[str, Any], list[Controller]]:
    """Returns the manager's parameters, and the controllers that the launch file starts."""
    path = package / "config" / "controllers.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    manager = _parameters_of(content, namespace, "controller_manager")
    if type(manager.get("update_rate", 100)) is not int or manager.get("update_rate", 100) <= 0:
        fail("update_rate of controller_manager is not a whole number above 0")
    controllers = []
    for name in started_controllers(package / "launch" / "ros2_control.launch.py"):
        kind = manager.get(f"{name}.type")
        if kind is None:
            fail(f"the 'type' param was not defined for {name!r}")
        if kind not in PARAMETERS:
            fail(f"controller {name!r}: unknown type {kind!r}")
        parameters = _parameters_of(content, namespace, name)
        _check(name, parameters, OF_ALL | PARAMETERS[kind])
        controllers.append(Controller(name, kind, parameters))
    for key in manager:
        known = key in ("update_rate", "enforce_command_limits", "use_sim_time")
        if not known and not key.endswith(".type"):
            fail(f"controller_manager: unknown parameter {key!r}")
    return manager, controllers


def _check(name: str, parameters: dict[str, Any], known: dict[str, type]) -> None:
    for key, value in parameters.items():
        if key not in known:
            fail(f"{name}: unknown parameter {key!r}")
        if type(value) is not known[key]:
            fail(f"{name}: parameter {key!r} is not a {known[key].__name__}")
        if isinstance(value, list) and not all(isinstance(item, str) for item in value):
            fail(f"{name}: parameter {key!r} is not a list of strings")


def read_hardware(urdf: Path) -> Hardware:
    """Reads the only ``<ros2_control>`` element of a URDF."""
    root = ElementTree.parse(urdf).getroot()
    elements = root.findall("ros2_control")
    if len(elements) != 1 or elements[0].get("type") != "system":
        fail(f"{urdf.name} has not one <ros2_control> of the type system")
    element = elements[0]
    plugin = (element.findtext("hardware/plugin") or "").strip()
    if plugin not in HARDWARE:
        fail(f"unknown hardware {plugin!r}")
    parameters = {
        str(p.get("name")): (p.text or "").strip() for p in element.findall("hardware/param")
    }
    if unknown := sorted(parameters.keys() - HARDWARE[plugin]):
        fail(f"unknown parameter of the hardware: {unknown[0]!r}")
    moving = sorted(str(j.get("name")) for j in root.findall("joint") if j.get("type") in MOVING)
    joints = {}
    for each in element.findall("joint"):
        joint = _joint(each)
        if joint.name not in moving:
            fail(f"joint {joint.name!r} of <ros2_control> is no moving joint of the URDF")
        joints[joint.name] = joint
    return Hardware(plugin, parameters, joints, tuple(moving))


def _joint(element: ElementTree.Element) -> Joint:
    joint = Joint(str(element.get("name")))
    for command in element.findall("command_interface"):
        values = {p.get("name"): p.text for p in command.findall("param")}
        limits = float(values.get("min") or "-inf"), float(values.get("max") or "inf")
        joint.commands[str(command.get("name"))] = limits
    for state in element.findall("state_interface"):
        values = {p.get("name"): p.text for p in state.findall("param")}
        joint.states[str(state.get("name"))] = float(values.get("initial_value") or 0.0)
    return joint
