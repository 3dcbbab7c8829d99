"""The files with which controllers of ros2_control or of Gazebo move the joints.

A robot with a controller that computes its joints from a twist has the node twist_mux in front of
this controller, with the sources and locks of the base driver. The joints of other robots are moved
by topics of single joints.
"""

from __future__ import annotations

from thorvaldc.backends.gazebo_topics import gz_bridge
from thorvaldc.backends.ros2_control import hardware_problem
from thorvaldc.backends.ros2_controllers import (
    CONTROLLER_FILE,
    Controller,
    controller_parameters,
    controllers,
)
from thorvaldc.backends.ros2_parameter_file import parameter_file
from thorvaldc.backends.ros2_parameters import twist_mux
from thorvaldc.backends.ros2_parts import node_space
from thorvaldc.backends.sdf import model_text, world_files
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Robot


def twist_controller(robot: Robot) -> Controller | None:
    """Return the released controller that computes the joints of the robot from a twist."""
    for controller in controllers(robot):
        if controller.is_released and controller.odometry_topic:
            return controller
    return None


def control_packages(robot: Robot) -> set[str]:
    """Return the ROS packages with the plug-ins of the controllers and the hardware."""
    packages = {c.package for c in controllers(robot) if c.is_released}
    packages |= {"controller_manager", "mujoco_ros2_control"}
    return packages | ({"gz_ros2_control"} if twist_controller(robot) is not None else set())


def left_out_of_control(robot: Robot) -> list[tuple[str, str]]:
    """Return what ros2_control cannot do with the robot, and the reasons."""
    reasons = []
    if twist_controller(robot) is None:
        reasons.append(
            (
                "twists in ros2_control.launch.py and gazebo.launch.py",
                "no released controller computes the joints of this robot from a twist; topics of "
                "the joints move them",
            )
        )
    problem = hardware_problem(robot, "can")
    reasons.append(
        (
            "ros2_control on the CAN bus",
            problem
            or "the tool dcfgen of ros2_canopen makes the files of the master from can/bus.yml",
        )
    )
    return reasons


def control_files(robot: Robot) -> dict[str, bytes]:
    """Return the parameters, descriptions and models of ros2_control and Gazebo, by path."""
    package = robot.ros.package
    meshes, share = f"package://{package}/meshes", f"$(find {package})"
    is_driven = twist_controller(robot) is not None
    kinds = ["mock", "mujoco", *(["gazebo"] if is_driven else [])]
    files = {f"urdf/robot_{kind}.urdf": urdf_text(robot, meshes, kind, share) for kind in kinds}
    files["sdf/model.sdf"] = model_text(
        robot, f"model://{package}/meshes", share if is_driven else None
    )
    files["config/gz_bridge.yaml"] = gz_bridge(robot, ros2_control=is_driven)
    files[CONTROLLER_FILE] = parameter_file(controller_parameters(robot)[CONTROLLER_FILE])
    if is_driven:
        mux = {f"{node_space(robot)}twist_mux": twist_mux(robot)}
        files["config/twist_mux.yaml"] = parameter_file(mux)
    return {
        **{path: text.encode() for path, text in files.items()},
        **world_files(robot.name, [robot]),
    }
