"""The README of a ROS 2 package: commands, parts, and what is left out with the reasons."""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.backends.placeholders import fill
from thorvaldc.backends.ros2_parts import Parts, full_topic, sensor_topic
from thorvaldc.model import Fleet, Robot

_TEXT = """\
# @PACKAGE@

The ROS 2 package of the robot `@ROBOT@`, for ROS 2 @DISTRO@. `thorvaldc build` wrote it from the
robot's file; changes here are lost.

## Build and start

```bash
source /opt/ros/@DISTRO_ID@/setup.bash
rosdep install --from-paths . --ignore-src -y       # in the folder of this package
colcon build --base-paths .
source install/setup.bash
ros2 launch @PACKAGE@ ideal.launch.py
```

In a second terminal, these commands arm the robot and move it:

```bash
ros2 service call @ARM@ "{data: true}"
ros2 topic pub --rate 10 @TOPIC@ @MESSAGE@
```

@LAUNCHES@
`ros2 launch @PACKAGE@ FILE --show-args` prints the arguments of a launch file.

The driver was never tried on physical hardware. Lift the wheels off the ground before the first
`robot.launch.py`, and keep the emergency stop in reach.

## The runtime of thorvaldc

The base driver is a program of the Python package `thorvaldc`, which no ROS repository contains.
Debian and Ubuntu refuse to install into the Python of the system, so make an environment that sees
ROS 2, and put it on the path of Python:

```bash
python3 -m venv --system-site-packages ~/thorvaldc
~/thorvaldc/bin/pip install thorvaldc
export PYTHONPATH=$PYTHONPATH:$(ls -d ~/thorvaldc/lib/python3*/site-packages)
```

The simulations need the package `thorvaldc`. For the computer of a robot, `thorvaldc-runtime` is
enough: the same node without compiler and simulations.

Without internet: on a computer with internet, the same Python version and the same processor,

```bash
python3 -m pip download thorvaldc -d wheelhouse
```

and on the robot, with the folder `wheelhouse`, in place of the second line above:

```bash
~/thorvaldc/bin/pip install --no-index --find-links wheelhouse thorvaldc
```

## Topics

| topic | type | content |
| --- | --- | --- |
@TOPICS@
## Names

`namespace` in the robot's file is the prefix of topics, nodes, joints and frames in all files. It
replaces the arguments `robot_name` and `tf_prefix` of the original launch files. `ros.odom_tf`
decides on the one node that publishes the transform from `odom` to `base_link`: here @OWNER@.

## Left out

@LEFT_OUT@"""

LAUNCHES = {
    "ideal": "simulation with ideal joints",
    "mujoco": "simulation in MuJoCo, with `/clock`",
    "virtual": "the driver on a simulated bus",
    "robot": "the real robot; `bus:=socketcan:can0`",
    "teleop": "a pad moves the robot",
    "gazebo": "simulation in Gazebo",
    "ros2_control": "controllers of ros2_control in place of the base driver; `hardware:=mock`",
    "gnss": "GNSS, odometry and IMU give the pose in `map`",
    "slam": "slam_toolbox makes a map",
    "navigation": "Nav2 with its localization, beside a launch file that starts the robot",
    "fleet": "all robots of the fleet",
    "base": "part of others: description and base driver",
}


def readme(robot: Robot, parts: Parts, launches: Iterable[str]) -> str:
    """Return the text of the README. ``launches`` lists the names of the launch files."""
    stamped = robot.ros.stamped
    kind = "TwistStamped" if stamped else "Twist"
    twist = "{linear: {x: 0.2}}"
    sources = [
        f"| `{full_topic(robot, s.topic)}` | geometry_msgs/msg/{kind} | twists of `{s.name}`,"
        f" priority {s.priority} |"
        for s in robot.twist_sources
    ]
    locks = [
        f"| `{full_topic(robot, lock.topic)}` | std_msgs/msg/Bool | lock `{lock.name}`,"
        f" priority {lock.priority} |"
        for lock in robot.twist_locks
    ]
    sensors = [
        f"| `{sensor_topic(robot, s)}` | {SENSOR_TYPES[s.type]} | from the driver of `{s.name}`,"
        f" frame `{robot.prefix}{s.link}` |"
        for s in robot.sensors
        if s.type in SENSOR_TYPES
    ]
    values = {
        "PACKAGE": robot.ros.package,
        "ROBOT": robot.name,
        "DISTRO": robot.ros.distro.capitalize(),
        "DISTRO_ID": robot.ros.distro,
        "ARM": f"{full_topic(robot, 'enable')} std_srvs/srv/SetBool",
        "TOPIC": full_topic(robot, "teleop_joy/cmd_vel"),
        "MESSAGE": f"geometry_msgs/msg/{kind} "
        + (f'"{{header: auto, twist: {twist}}}"' if stamped else f'"{twist}"'),
        "LAUNCHES": "| launch file | content |\n| --- | --- |\n"
        + "".join(f"| `{name}.launch.py` | {LAUNCHES[name]} |\n" for name in launches),
        "TOPICS": "".join(f"{line}\n" for line in [*sources, *locks, *sensors]),
        "OWNER": "the base driver" if robot.ros.odom_tf == "driver" else "the EKF",
        "LEFT_OUT": "".join(f"- {part}: {reason}.\n" for part, reason in parts.left_out)
        or "Nothing.\n",
    }
    return fill(_TEXT, values)


SENSOR_TYPES = {
    "lidar_2d": "sensor_msgs/msg/LaserScan",
    "lidar_3d": "sensor_msgs/msg/PointCloud2",
    "imu": "sensor_msgs/msg/Imu",
    "gnss": "sensor_msgs/msg/NavSatFix",
}


_FLEET = """\
# @PACKAGE@

Starts all robots of the fleet `@FLEET@` in ROS 2. `thorvaldc build` wrote it; changes here are
lost.
In the folder that also contains the packages of the robots:

```bash
rosdep install --from-paths . --ignore-src -y
colcon build --base-paths .
source install/setup.bash
ros2 launch @PACKAGE@ fleet.launch.py                 # ideal joints
ros2 launch @PACKAGE@ fleet.launch.py base:=virtual   # simulated buses
```

`map` is the frame of the fleet file: a static transform places the `odom` frame of each robot.
Start with `poses:=false` where a localization publishes these transforms.

| robot | package | name space |
| --- | --- | --- |
@ROBOTS@"""


def fleet_readme(fleet: Fleet, package: str) -> str:
    """Return the text of the README of the package that starts all robots of a fleet."""
    robots = "".join(
        f"| {p.robot.name} | `{p.robot.ros.package}` | `/{p.robot.namespace}` |\n"
        for p in fleet.placements
    )
    return fill(_FLEET, {"PACKAGE": package, "FLEET": fleet.name, "ROBOTS": robots})
