"""The RViz configuration of a ROS 2 package."""

from __future__ import annotations

from thorvaldc.backends.ros2_parameter_file import quoted
from thorvaldc.backends.ros2_parts import Parts, full_topic, odom_frame, sensor_topic
from thorvaldc.model import Robot

_DISPLAYS = {"lidar_2d": "LaserScan", "lidar_3d": "PointCloud2"}


def rviz_text(robot: Robot, parts: Parts) -> str:
    """Return the text of the RViz configuration: the robot, its odometry, its lidars and the map.

    Everything is shown in the frame ``odom``, which exists without localization too.
    """
    displays = [
        _display("Grid", "Grid"),
        _topic_display(
            "Robot",
            "RobotModel",
            full_topic(robot, "robot_description"),
            field="Description Topic",
            latched=True,
        ),
        _display("Frames", "TF", enabled=False),
        _topic_display("Odometry", "Odometry", full_topic(robot, "odometry/base_raw")),
    ]
    displays += [
        _topic_display(
            sensor.name, _DISPLAYS[sensor.type], sensor_topic(robot, sensor), best_effort=True
        )
        for sensor in parts.lidars
    ]
    if parts.navigation:
        costmap = full_topic(robot, "local_costmap/costmap")
        displays += [
            _topic_display("Local costmap", "Map", costmap, latched=True),
            _topic_display("Path", "Path", full_topic(robot, "plan")),
        ]
    if parts.slam is not None:
        displays.append(_topic_display("Map", "Map", full_topic(robot, "map"), latched=True))
    goal = full_topic(robot, "goal_pose")
    return (
        "Visualization Manager:\n"
        '  Class: ""\n'
        "  Displays:\n" + "".join(displays) + "  Global Options:\n"
        f"    Fixed Frame: {quoted(odom_frame(robot))}\n"
        "  Tools:\n"
        "    - Class: rviz_default_plugins/MoveCamera\n"
        "    - Class: rviz_default_plugins/Measure\n"
        "    - Class: rviz_default_plugins/SetGoal\n"
        "      Topic:\n"
        f"        Value: {quoted(goal)}\n"
        "  Views:\n"
        "    Current:\n"
        "      Class: rviz_default_plugins/Orbit\n"
        "      Distance: 6\n"
    )


def _display(name: str, kind: str, *, enabled: bool = True) -> str:
    return (
        f"    - Class: rviz_default_plugins/{kind}\n"
        f"      Name: {quoted(name)}\n"
        f"      Enabled: {'true' if enabled else 'false'}\n"
    )


def _topic_display(
    name: str,
    kind: str,
    topic: str,
    *,
    field: str = "Topic",
    latched: bool = False,
    best_effort: bool = False,
) -> str:
    return _display(name, kind) + (
        f"      {field}:\n"
        f"        Value: {quoted(topic)}\n"
        f"        Durability Policy: {'Transient Local' if latched else 'Volatile'}\n"
        f"        Reliability Policy: {'Best Effort' if best_effort else 'Reliable'}\n"
    )
