"""The joints of a generated ROS 2 package behind controllers, like ros2_control.

``ros2_control_engine.py PACKAGE [--mujoco scene.xml]``: mock hardware, or a scene in MuJoCo.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tests.ros.engines.joint_engine import JointEngine, Motions, common_arguments, fail
from tests.ros.engines.mujoco_joints import MujocoJoints
from tests.ros.engines.ros2_control_files import (
    BROADCASTER,
    FORWARD,
    MOCK,
    MUJOCO,
    Controller,
    Hardware,
    read_controllers,
    read_hardware,
)

CLOCK_RATE = 100.0  # Hz, of the engine with MuJoCo


class MockJoints:
    """mock_components/GenericSystem with ``calculate_dynamics``: wall time, ideal joints.

    A commanded speed integrates to a position by backward Euler; a commanded position is there at
    once, and its velocity is a difference.
    """

    has_clock = False

    def __init__(self, hardware: Hardware) -> None:
        if hardware.parameters.get("calculate_dynamics") != "true":
            fail("mock hardware without calculate_dynamics does not integrate speeds")
        self._start = {
            name: (joint.states.get("position", 0.0), joint.states.get("velocity", 0.0))
            for name, joint in hardware.joints.items()
        }
        self.commands: dict[tuple[str, str], float] = {}
        self.factor = 1.0
        self.time_ns = time.time_ns()
        self._values = dict(self._start)

    def advance(self, time_ns: int) -> None:
        now = time.time_ns()
        period = max(1e-9, (now - self.time_ns) * 1e-9) * self.factor
        self.time_ns = now
        for (joint, interface), command in self.commands.items():
            position, _ = self._values[joint]
            if interface == "velocity":
                self._values[joint] = (position + command * period, command)
            else:
                self._values[joint] = (command, (command - position) / period)

    def reset(self) -> None:
        self._values = dict.fromkeys(self._start, (0.0, 0.0))

    def command(self, joint: str, interface: str, value: float) -> None:
        self.commands[joint, interface] = value

    def motions(self) -> Motions:
        return dict(self._values)

    def truth(self, message: Odometry) -> bool:
        return False


class ForwardCommand:
    """forward_command_controller/ForwardCommandController.

    A message with a wrong length fails the next update, so that the controller manager deactivates
    the controller; the hardware keeps its last commands.  An empty message is no command.
    """

    def __init__(self, controller: Controller, hardware: Hardware) -> None:
        self.name = controller.name
        self.joints = controller.parameters.get("joints") or fail(f"{self.name}: no joints")
        self.interface = controller.parameters.get("interface_name") or fail(
            f"{self.name}: no interface_name"
        )
        for joint in self.joints:
            commands = hardware.joints[joint].commands if joint in hardware.joints else {}
            if self.interface not in commands:
                fail(f"{self.name}: the hardware has no interface {joint}/{self.interface}")
        self.values: list[float] = []
        self.is_active = True

    def take(self, message: Float64MultiArray) -> list[str]:
        if not all(map(math.isfinite, message.data)):
            report(f"{self.name}: non-finite value received, message dropped")
            return []
        self.values = list(message.data)
        return [self.name]

    def update(self) -> dict[str, float]:
        """Returns the commands of this cycle."""
        if not self.is_active or not self.values:
            return {}
        if len(self.values) != len(self.joints):
            self.is_active = False
            report(
                f"{self.name}: command size ({len(self.values)}) does not match number of "
                f"interfaces ({len(self.joints)}); the controller is deactivated"
            )
            return {}
        return dict(zip(self.joints, self.values, strict=True))


class ControlEngine(JointEngine):
    """The controller manager: each cycle it reads, updates the controllers, and writes."""

    def __init__(self, options: argparse.Namespace) -> None:
        manager, controllers = read_controllers(options.package, options.namespace)
        hardware = read_hardware(options.package / "urdf" / urdf_name(options.mujoco))
        rate = float(manager.get("update_rate", 100))
        self.hardware, self.enforces = hardware, options.enforce_limits
        if manager.get("enforce_command_limits") is not None:
            self.enforces = bool(manager["enforce_command_limits"])
        world = self._world(options, hardware, rate)
        self.forwards = [ForwardCommand(c, hardware) for c in controllers if c.type == FORWARD]
        self._claim_once()
        broadcasters = [c for c in controllers if c.type == BROADCASTER]
        super().__init__("controller_manager", world, options, rate, CLOCK_RATE)
        for controller in broadcasters[:1]:
            self._broadcast(controller)
        for forward in self.forwards:
            topic = f"{forward.name}/commands"
            self.hear(Float64MultiArray, topic, [forward.name], forward.take)

    def _world(self, options: argparse.Namespace, hardware: Hardware, rate: float) -> Any:
        if (hardware.plugin == MUJOCO) is not (options.mujoco is not None):
            fail(f"the hardware is {hardware.plugin}")
        if hardware.plugin == MOCK:
            return MockJoints(hardware)
        keyframe = hardware.parameters.get("initial_keyframe")
        scene = MujocoJoints(options.mujoco, rate, keyframe)
        for joint in hardware.joints.values():
            if joint.name not in scene.names:
                fail(f"the scene has no joint {joint.name!r}")
            for interface in joint.commands:
                if (joint.name, interface) not in scene.inputs:
                    fail(f"the scene has no actuator for {joint.name}/{interface}")
        return scene

    def _claim_once(self) -> None:
        claims = [(joint, f.interface) for f in self.forwards for joint in f.joints]
        for claim in claims:
            if claims.count(claim) > 1:
                fail(f"more than one claim of the interface {'/'.join(claim)}")

    def _broadcast(self, controller: Controller) -> None:
        """Prepares the joint states.

        Joints of the parameter ``joints`` have its order, others the order of their names; a joint
        without an interface has NaN for it.
        """
        values, known = controller.parameters, self.hardware.joints
        chosen, interfaces = values.get("joints") or [], values.get("interfaces") or []
        is_chosen = bool(chosen and interfaces)
        fields = {}
        for name in ("position", "velocity", "effort"):
            source = values.get(f"map_interface_to_joint_state.{name}", name)
            fields[name] = name if name in interfaces else source
        for joint in chosen if is_chosen else []:
            for interface in interfaces:
                if joint not in known or interface not in known[joint].states:
                    fail(f"{controller.name}: there is no interface {joint}/{interface}")
        self._joints = chosen if is_chosen else [n for n in self.hardware.urdf_joints if n in known]
        self._interfaces = {
            joint: {
                name: source
                for name, source in fields.items()
                if source in known[joint].states and (not is_chosen or source in interfaces)
            }
            for joint in self._joints
        }
        self._joints = [joint for joint in self._joints if self._interfaces[joint]]
        if not self._joints:
            fail(f"{controller.name}: no state interfaces found to publish")
        self._extra = [j for j in values.get("extra_joints") or [] if j not in self._joints]
        self._frame = values.get("frame_id", "base_link")
        prefix = f"{controller.name}/" if values.get("use_local_topics") else ""
        self.publish_states_on(f"{prefix}joint_states")

    def state_message(self, now: Any, motions: Motions) -> JointState:
        message = JointState()
        message.header.stamp, message.header.frame_id = now, self._frame
        for joint in self._joints:
            if joint not in motions:
                continue
            values = {"position": motions[joint][0], "velocity": motions[joint][1]}
            sources = self._interfaces[joint]
            message.name.append(joint)
            for name in ("position", "velocity", "effort"):
                getattr(message, name).append(values.get(sources.get(name, ""), math.nan))
        for joint in self._extra:
            message.name.append(joint)
            for name in ("position", "velocity", "effort"):
                getattr(message, name).append(0.0)
        return message

    def update(self) -> None:
        if isinstance(self.world, MockJoints):
            self.world.factor = self.factor
        for forward in self.forwards:
            for joint, value in forward.update().items():
                low, high = self.hardware.joints[joint].commands[forward.interface]
                bounded = min(max(value, low), high) if self.enforces else value
                self.world.command(joint, forward.interface, bounded)


def urdf_name(scene: Path | None) -> str:
    return "robot_mock.urdf" if scene is None else "robot_mujoco.urdf"


def report(message: str) -> None:
    print(f"error: {message}", file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("package", type=Path, help="folder of the generated ROS 2 package")
    parser.add_argument("--mujoco", type=Path, metavar="scene.xml", help="MJCF file")
    parser.add_argument(
        "--enforce-limits",
        action=argparse.BooleanOptionalAction,
        default=os.environ.get("ROS_DISTRO") not in (None, "jazzy"),
        help="clamp commands to min and max; the default of Kilted, not of Jazzy",
    )
    common_arguments(parser)
    return ControlEngine(parser.parse_args()).run()


if __name__ == "__main__":
    raise SystemExit(main())
