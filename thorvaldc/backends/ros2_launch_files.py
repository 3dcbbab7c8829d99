"""The launch files of a ROS 2 package, as Python programs for the launch system of ROS 2.

``base.launch.py`` starts the robot's description and its base driver; the launch files of
simulations and of the real robot include it with other arguments. The texts contain the names of
the package, of its name space and of topics; the parameter files have all other values.
"""

from __future__ import annotations

import json

from thorvaldc.backends.placeholders import fill
from thorvaldc.backends.ros2_control_launch_files import GAZEBO, ROS2_CONTROL, control_values
from thorvaldc.backends.ros2_navigation import Motion
from thorvaldc.backends.ros2_parts import Parts, sensor_topic, source_topic
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.ros import EKF

_HEAD = '''\
"""@SUMMARY@"""

@IMPORTS@
PACKAGE = "@PACKAGE@"
NAMESPACE = "@NAMESPACE@"
@CONSTANTS@

def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
'''
# Module of each name that the launch files use.
_MODULES = {
    "get_package_share_directory": "ament_index_python.packages",
    "LaunchDescription": "launch",
    "AppendEnvironmentVariable": "launch.actions",
    "DeclareLaunchArgument": "launch.actions",
    "GroupAction": "launch.actions",
    "IncludeLaunchDescription": "launch.actions",
    "OpaqueFunction": "launch.actions",
    "IfCondition": "launch.conditions",
    "UnlessCondition": "launch.conditions",
    "PythonLaunchDescriptionSource": "launch.launch_description_sources",
    "EqualsSubstitution": "launch.substitutions",
    "LaunchConfiguration": "launch.substitutions",
    "NotEqualsSubstitution": "launch.substitutions",
    "Node": "launch_ros.actions",
    "SetParameter": "launch_ros.actions",
    "ParameterValue": "launch_ros.parameter_descriptions",
}

BASE = """\
    config = os.path.join(share, "config")
    with open(os.path.join(share, "urdf", "robot.urdf"), encoding="utf-8") as file:
        description = file.read()

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="bus",
                choices=["ideal", "mujoco", "virtual", "bus"],
                description="ideal joints, MuJoCo, a simulated bus, or the robot's bus",
            ),
            DeclareLaunchArgument(
                "bus",
                default_value="@BUS@",
                description="CAN interface of the robot's bus, as in thorvaldc run --bus",
            ),
            DeclareLaunchArgument(
                "real_time_factor",
                default_value="1.0",
                description="speed of a simulation; 0.0: as fast as possible",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="take the time from /clock"
            ),
            DeclareLaunchArgument(
                "publish_clock", default_value="false", description="publish /clock"
            ),
            DeclareLaunchArgument(
                "enable_odom_tf",
                default_value="@ODOM_TF@",
                description="the base driver publishes the transform from odom to base_link",
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                name="robot_state_publisher",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "robot_state_publisher.yaml"),
                    {"robot_description": ParameterValue(description, value_type=str)},
                    use_sim_time,
                ],
            ),
            Node(
                package=PACKAGE,
                executable="base_driver",
                name="base_driver",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "base_driver.yaml"),
                    {
                        "model_file": os.path.join(config, "model.json"),
                        "base": argument("base", str),
                        "bus": argument("bus", str),
                        "real_time_factor": argument("real_time_factor", float),
                        "publish_clock": argument("publish_clock", bool),
                        "enable_odom_tf": argument("enable_odom_tf", bool),
                    },
                    use_sim_time,
                ],
            ),
@EKF@            Node(
                condition=IfCondition(LaunchConfiguration("rviz")),
                package="rviz2",
                executable="rviz2",
                name="rviz2",
                namespace=NAMESPACE,
                arguments=["-d", os.path.join(share, "rviz", "robot.rviz")],
                parameters=[use_sim_time],
            ),
        ]
    )
"""

EKF_NODE = """\
            Node(
                condition=UnlessCondition(LaunchConfiguration("enable_odom_tf")),
                package="robot_localization",
                executable="ekf_node",
                name="ekf_odom",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "ekf_odom.yaml"), use_sim_time],
            ),
"""

_INCLUDE_BASE = """\
    base = os.path.join(share, "launch", "base.launch.py")
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(base),
                launch_arguments={
@ARGUMENTS@                }.items(),
            )
        ]
    )
"""

TELEOP = """\
    config = os.path.join(share, "config")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "teleop_controller",
                default_value="",
                description="name of the pad as SDL reports it; default: the first pad",
            ),
            DeclareLaunchArgument(
                "stamped",
                default_value="@STAMPED@",
                description="TwistStamped in place of Twist; ros2_control needs true",
            ),
            Node(
                package="joy",
                executable="game_controller_node",
                name="game_controller_node",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "teleop_twist_joy.yaml"),
                    {
                        "device_name": ParameterValue(
                            LaunchConfiguration("teleop_controller"), value_type=str
                        )
                    },
                ],
            ),
            Node(
                package="teleop_twist_joy",
                executable="teleop_node",
                name="teleop_twist_joy_node",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "teleop_twist_joy.yaml"),
                    {
                        "publish_stamped_twist": ParameterValue(
                            LaunchConfiguration("stamped"), value_type=bool
                        )
                    },
                ],
                remappings=[("cmd_vel", "@TELEOP_TOPIC@")],
            ),
        ]
    )
"""


_TIME = """\
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="take the time from /clock"
            ),
"""

GNSS = """\
    config = os.path.join(share, "config")
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    return LaunchDescription(
        [
@TIME@            Node(
                package="robot_localization",
                executable="ekf_node",
                name="ekf_map",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "gnss.yaml"), use_sim_time],
                remappings=[("odometry/filtered", "odometry/filtered_map")],
            ),
            Node(
                package="robot_localization",
                executable="navsat_transform_node",
                name="navsat_transform",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "gnss.yaml"), use_sim_time],
                remappings=[
                    ("odometry/filtered", "odometry/filtered_map"),
                    ("gps/fix", "@GNSS_TOPIC@"),
@IMU@                ],
            ),
        ]
    )
"""

SLAM = """\
    config = os.path.join(share, "config")
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    return LaunchDescription(
        [
@TIME@            Node(
                package="slam_toolbox",
                executable="async_slam_toolbox_node",
                name="slam_toolbox",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "slam_toolbox.yaml"), use_sim_time],
            ),
            # slam_toolbox is a lifecycle node without the bond of Nav2's nodes.
            Node(
                package="nav2_lifecycle_manager",
                executable="lifecycle_manager",
                name="lifecycle_manager_slam",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    {"autostart": True, "node_names": ["slam_toolbox"], "bond_timeout": 0.0},
                    use_sim_time,
                ],
            ),
        ]
    )
"""

NAVIGATION = """\
    nav2 = os.path.join(share, "config", "nav2.yaml")
    localization = LaunchConfiguration("localization")
    stamped = {
        "enable_stamped_cmd_vel": ParameterValue(LaunchConfiguration("stamped"), value_type=bool)
    }

    def node(package, name, *parameters, remappings=()):
        return Node(
            package=package,
            executable=name,
            name=name,
            namespace=NAMESPACE,
            output="screen",
            parameters=[nav2, *parameters, stamped],
            remappings=remappings,
        )

    # velocity_smoother and collision_monitor pass the twists on to the base driver.
    out = [("cmd_vel", "cmd_vel_nav")]
    costmap = [os.path.join(share, "config", "global_costmap_"), localization, ".yaml"]
    return LaunchDescription(
        [
@TIME@            DeclareLaunchArgument(
                "localization",
                default_value="@DEFAULT_SOURCE@",
                choices=@SOURCES@,
                description="node that publishes the transform from map to odom",
            ),
            DeclareLaunchArgument(
                "stamped",
                default_value="@STAMPED@",
                description="TwistStamped in place of Twist; ros2_control needs true",
            ),
            GroupAction(
                [
                    SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
@LOCALIZATIONS@                    node("nav2_controller", "controller_server", remappings=out),
                    node("nav2_smoother", "smoother_server"),
                    node("nav2_planner", "planner_server", costmap),
                    node("nav2_behaviors", "behavior_server", remappings=out),
                    node("nav2_bt_navigator", "bt_navigator"@TREE@),
                    node("nav2_waypoint_follower", "waypoint_follower"),
                    node("nav2_velocity_smoother", "velocity_smoother", remappings=out),
                    node("nav2_collision_monitor", "collision_monitor"),
                    Node(
                        package="nav2_lifecycle_manager",
                        executable="lifecycle_manager",
                        name="lifecycle_manager_navigation",
                        namespace=NAMESPACE,
                        output="screen",
                        parameters=[{"autostart": True, "node_names": NODES}],
                    ),
                ]
            ),
        ]
    )


NODES = [
    "controller_server",
    "smoother_server",
    "planner_server",
    "behavior_server",
    "bt_navigator",
    "waypoint_follower",
    "velocity_smoother",
    "collision_monitor",
]
"""

_LOCALIZATION = """\
                    IncludeLaunchDescription(
                        PythonLaunchDescriptionSource(
                            os.path.join(share, "launch", "@SOURCE@.launch.py")
                        ),
                        condition=IfCondition(EqualsSubstitution(localization, "@SOURCE@")),
                    ),
"""

# A robot that cannot turn on the spot has no recoveries, which would turn it.
_TREE = """\
, {
                        "default_nav_to_pose_bt_xml": os.path.join(
                            get_package_share_directory("nav2_bt_navigator"),
                            "behavior_trees",
                            "navigate_w_replanning_time.xml",
                        )
                    }"""

_FLEET = '''\
"""All robots of the fleet @FLEET@, each at its place in the frame map."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Package, name space, and place in the frame map: x, y, z in m, quaternion x, y, z, w.
ROBOTS = [
@ROBOTS@]


def robot(package, namespace, pose):
    options = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
    place = [text for item in zip(options, pose) for text in (item[0], str(item[1]))]
    share = get_package_share_directory(package)
    # The group keeps the arguments of a robot from the others.
    return GroupAction(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(os.path.join(share, "launch", "base.launch.py")),
                launch_arguments={"base": LaunchConfiguration("base")}.items(),
            ),
            Node(
                condition=IfCondition(LaunchConfiguration("poses")),
                package="tf2_ros",
                executable="static_transform_publisher",
                name="map_to_odom",
                namespace=namespace,
                arguments=place + ["--frame-id", "map", "--child-frame-id", f"{namespace}/odom"],
            ),
        ]
    )


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="ideal",
                choices=["ideal", "virtual"],
                description="ideal joints, or simulated buses",
            ),
            DeclareLaunchArgument(
                "poses",
                default_value="true",
                description="publish the transforms from map to the odom frame of each robot",
            ),
            *[robot(*values) for values in ROBOTS],
        ]
    )
'''


def fleet_launch_file(fleet: Fleet) -> str:
    """Return the text of the launch file that starts all robots of a fleet at their places.

    MuJoCo is not among the bases: each base driver would have its own world and its own clock.
    """
    robots = ""
    for placement in fleet.placements:
        robot, pose = placement.robot, placement.pose
        w, *xyz = pose.quat
        values = (robot.ros.package, robot.namespace, [*pose.xyz, *xyz, w])
        robots += f"    ({', '.join(json.dumps(value) for value in values)}),\n"
    return fill(_FLEET, {"FLEET": fleet.name, "ROBOTS": robots})


def launch_files(robot: Robot, parts: Parts) -> dict[str, str]:
    """Return the launch files of a robot by their path in the package."""
    turns = Motion(robot).kind != "ackermann"
    values = {
        "PACKAGE": robot.ros.package,
        "NAMESPACE": robot.namespace,
        "BUS": ",".join(f"{bus.name}=socketcan:can{i}" for i, bus in enumerate(robot.buses))
        if len(robot.buses) > 1
        else "socketcan:can0",
        "ODOM_TF": "false" if robot.ros.odom_tf == EKF else "true",
        "STAMPED": str(robot.ros.stamped).lower(),
        "TELEOP_TOPIC": source_topic(robot, "teleop_joy"),
        "EKF": EKF_NODE if parts.local_ekf else "",
        "TIME": _TIME,
        "GNSS_TOPIC": sensor_topic(robot, parts.gnss) if parts.gnss is not None else "",
        "IMU": f'                    ("imu", "{sensor_topic(robot, parts.imu)}"),\n'
        if parts.imu is not None
        else "",
        "SOURCES": json.dumps(parts.map_sources or ("none",)),
        "DEFAULT_SOURCE": (parts.map_sources or ("none",))[0],
        "LOCALIZATIONS": "".join(
            fill(_LOCALIZATION, {"SOURCE": source}) for source in parts.map_sources
        ),
        "TREE": "" if turns else _TREE,
    }
    files = {
        "base": (
            "The robot's description and its base driver; other launch files include it.",
            BASE,
        ),
        "ideal": (
            "Simulation with ideal joints, without physics.",
            _include_base(base="ideal"),
        ),
        "mujoco": (
            "Simulation in MuJoCo, which gives the time of all nodes by /clock.",
            _include_base(base="mujoco", use_sim_time="true", publish_clock="true"),
        ),
        "teleop": ("A pad moves the robot, while its upper left or right button is held.", TELEOP),
    }
    if robot.buses:
        files["virtual"] = (
            "The real driver on a simulated bus with simulated drives.",
            _include_base(base="virtual"),
        )
        files["robot"] = ("The real robot on its CAN bus.", _include_base(base="bus"))
    if parts.gnss is not None:
        files["gnss"] = ("GNSS, odometry and IMU give the pose in the frame map.", GNSS)
    if parts.slam is not None:
        files["slam"] = ("slam_toolbox makes a map and gives the pose in it.", SLAM)
    if parts.navigation:
        files["navigation"] = ("Nav2 and its localization; the robot must run already.", NAVIGATION)
    if robot.actuators:
        values |= control_values(robot)
        files["gazebo"] = ("Simulation in Gazebo, which gives the time of all nodes.", GAZEBO)
        files["ros2_control"] = (
            "Controllers of ros2_control move the robot, without the base driver.",
            ROS2_CONTROL,
        )
    return {
        f"launch/{name}.launch.py": _program(summary, body, values)
        for name, (summary, body) in files.items()
    }


def _include_base(**arguments: str) -> str:
    indent = " " * 20
    items = "".join(f'{indent}"{name}": "{value}",\n' for name, value in arguments.items())
    return fill(_INCLUDE_BASE, {"ARGUMENTS": items})


def _import(module: str, names: list[str]) -> str:
    line = f"from {module} import {', '.join(names)}\n"
    if len(line) <= 101:
        return line
    return f"from {module} import (\n" + "".join(f"    {name},\n" for name in names) + ")\n"


def _program(summary: str, body: str, values: dict[str, str]) -> str:
    """Return the text of a launch file with its imports and the values of the robot."""
    head = _HEAD
    if body is ROS2_CONTROL:  # the function `start` finds the shared folder
        head = head.replace("    share = get_package_share_directory(PACKAGE)\n", "")
    body = fill(body, values)
    used: dict[str, list[str]] = {}
    for name, module in _MODULES.items():
        if any(f"{before}{name}(" in head + body for before in " =("):
            used.setdefault(module, []).append(name)
    imports = "".join(_import(module, names) for module, names in used.items())
    if "os." in body:
        imports = f"import os\n\n{imports}"
    uses_controllers = "CONTROLLERS" in body
    constants = f"CONTROLLERS = {values['CONTROLLERS']}\n" if uses_controllers else ""
    texts = {"SUMMARY": summary, "IMPORTS": imports, "CONSTANTS": constants}
    return fill(head, {**values, **texts}) + body
