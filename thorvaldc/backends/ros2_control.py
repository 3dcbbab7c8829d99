"""The ``<ros2_control>`` elements of a URDF: interfaces of the joints, and the hardware behind.

Each element lists joints with their command and state interfaces, and the plug-in that reads and
writes them:

- ``mock``: ideal joints without physics, part of ros2_control.
- ``gazebo``: joints of the SDF model in Gazebo. The model loads the plug-in, see ``sdf_robot``.
- ``mujoco``: joints of an MJCF scene, see ``mjcf.ros2_control_files``.
- ``can``: CiA 402 drives, with the file ``bus.yml`` of the target `can`.

The range of a command interface (``min``, ``max``) is that of the actuator or joint.
"""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.backends.xml_writer import Element, number, parse
from thorvaldc.model import Actuator, Bus, Joint, JointServo, Robot

PLUGINS = {
    "mock": "mock_components/GenericSystem",
    "gazebo": "gz_ros2_control/GazeboSimSystem",
    "mujoco": "mujoco_ros2_control/MujocoSystemInterface",
    "can": "canopen_ros2_control/Cia402System",
}
"""Hardware plug-in of each kind of hardware."""
PACKAGES = {
    "mock": "hardware_interface",
    "gazebo": "gz_ros2_control",
    "mujoco": "mujoco_ros2_control",
    "can": "canopen_ros2_control",
}
"""ROS package of each plug-in."""
MUJOCO_SCENE = "mjcf/scene.xml"
"""Path of the MJCF scene relative to the shared folder of the package."""
SIMULATED = ("mock", "gazebo", "mujoco")


def ros2_control_elements(robot: Robot, hardware: str, share: str) -> list[Element]:
    """Return the ``<ros2_control>`` elements of a robot, one for each CAN bus with ``can``.

    ``hardware`` is a key of ``PLUGINS``. ``share`` is the shared folder of the ROS package, as a
    path or as the xacro expression ``$(find package)``; it begins the paths of files.

    Raises ``ValueError`` if the robot cannot have this hardware, with the reason of
    ``hardware_problem``.
    """
    problem = hardware_problem(robot, hardware)
    if problem is not None:
        raise ValueError(problem)
    if hardware == "can":
        return [_can_system(robot, bus, share) for bus in robot.buses if _motors_on(robot, bus)]
    root, system = _system(f"{robot.name}_{hardware}", hardware)
    if hardware == "mock":
        _add_param(system, "calculate_dynamics", "true")
    elif hardware == "mujoco":
        _add_param(system, "mujoco_model", f"{share}/{MUJOCO_SCENE}")
        _add_param(system, "initial_keyframe", "home")
    for joint in robot.joints:
        if joint.type != "fixed":
            _add_joint(root, robot, joint)
    return [root]


def kept_extensions(robot: Robot, hardware: str | None) -> Iterator[str]:
    """Yield the XML of the extras that a URDF with this hardware contains.

    A simulator drives all joints of the robot, so that the ``<ros2_control>`` elements of extras,
    which name the real hardware of an arm, are left out.
    """
    for text in robot.urdf_extensions:
        if hardware not in SIMULATED or parse(text).tag != "ros2_control":
            yield text


def hardware_problem(robot: Robot, hardware: str) -> str | None:
    """Return why the robot cannot have a kind of hardware, or ``None`` if it can."""
    if hardware != "can":
        return None
    if not robot.buses:
        return "the robot has no CAN bus"
    drives = {(b.name, n.name): n for b in robot.buses for n in b.nodes if n.is_cia402}
    names = {name for _, name in drives}
    others = [a.name for a in robot.actuators if a.node not in names]
    if others:
        return f"no CiA 402 drive moves {', '.join(others)}"
    for bus in robot.buses:
        strange = [node.name for node in bus.described_nodes if not node.is_cia402]
        if strange and _motors_on(robot, bus):
            # Cia402System takes each node of bus.yml as a CiA 402 drive.
            return f"bus {bus.name} has nodes that are no CiA 402 drives: {', '.join(strange)}"
    return None


def initial_position(robot: Robot, joint: Joint) -> float:
    """Return the position of a joint in rad or m at the start: that of its servo, or 0, or the
    limit that is nearest to 0."""
    for servo in robot.joint_servos:
        if servo.joint == joint.name:
            return servo.initial
    low = 0.0 if joint.lower is None else joint.lower
    high = 0.0 if joint.upper is None else joint.upper
    return max(low, 0.0) or min(high, 0.0)


def _system(name: str, hardware: str) -> tuple[Element, Element]:
    root = Element("ros2_control", name=name, type="system")
    system = root.add("hardware")
    system.add("plugin").text = PLUGINS[hardware]
    return root, system


def _can_system(robot: Robot, bus: Bus, share: str) -> Element:
    """Return the element of the drives on one bus.

    Passive joints have no drive, and the drives of extras have their own elements.
    """
    alone = len(robot.buses) == 1
    root, system = _system(f"{robot.name}_{bus.name}", "can")
    name = "bus.yml" if alone else f"{bus.name}.bus.yml"
    number_of_bus = [b.name for b in robot.buses].index(bus.name)
    folder = f"{share}/can" if alone else f"{share}/can/{bus.name}"
    _add_param(system, "bus_config", f"{share}/can/{name}")
    _add_param(system, "master_config", f"{folder}/master.dcf")
    _add_param(system, "master_bin", f"{folder}/master.bin")
    _add_param(system, "can_interface_name", f"can{number_of_bus}")
    for actuator in _motors_on(robot, bus):
        node = next(n for n in bus.nodes if n.name == actuator.node)
        element = _add_joint(root, robot, robot.joint(actuator.joint))
        _add_param(element, "node_id", str(node.id))
        if len(node.channels) > 1:
            channels = [channel.name for channel in node.channels]
            _add_param(element, "channel", str(channels.index(actuator.channel or "")))
    return root


def _motors_on(robot: Robot, bus: Bus) -> list[Actuator]:
    names = {node.name for node in bus.nodes}
    return [actuator for actuator in robot.actuators if actuator.node in names]


def _add_joint(root: Element, robot: Robot, joint: Joint) -> Element:
    element = root.add("joint", name=robot.prefix + joint.name)
    for motor in _motors(robot, joint):
        interface, low, high = command_range(joint, motor)
        command = element.add("command_interface", name=interface)
        if low is not None and high is not None:
            _add_param(command, "min", number(low))
            _add_param(command, "max", number(high))
    position = element.add("state_interface", name="position")
    initial = initial_position(robot, joint)
    if initial:
        _add_param(position, "initial_value", number(initial))
    element.add("state_interface", name="velocity")
    return element


def _motors(robot: Robot, joint: Joint) -> Iterator[Actuator | JointServo]:
    yield from (actuator for actuator in robot.actuators if actuator.joint == joint.name)
    yield from (servo for servo in robot.joint_servos if servo.joint == joint.name)


def command_range(
    joint: Joint, motor: Actuator | JointServo
) -> tuple[str, float | None, float | None]:
    """Return the command interface of a driven joint and its range, in rad, m, rad/s or m/s."""
    if isinstance(motor, Actuator):
        if motor.role == "propulsion":
            return "velocity", -motor.max_velocity, motor.max_velocity
        return "position", joint.lower, joint.upper
    if motor.interface == "velocity":
        return "velocity", -joint.velocity if joint.velocity else None, joint.velocity or None
    return "position", joint.lower, joint.upper


def _add_param(parent: Element, name: str, text: str) -> None:
    parent.add("param", name=name).text = text
