"""ROS 2 parameters of Nav2: planner, controller, costmaps, velocity smoother, collision monitor.

A twist of Nav2 passes the velocity smoother and the collision monitor before it reaches the source
``auto_nav`` of the base driver::

    controller_server, behavior_server -> cmd_vel_nav -> velocity_smoother -> cmd_vel_smoothed
        -> collision_monitor -> auto_nav/cmd_vel

Parameters that are left out have the defaults of Nav2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.backends import ros2_parts
from thorvaldc.backends.ros2_parameters import Parameters, is_holonomic
from thorvaldc.model import Robot, Sensor, stopping
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.model.settings import RAMP_PERIOD, DriverSettings
from thorvaldc.model.statics.occupied_space import footprint

CONTROLLER_FREQUENCY = 1.0 / RAMP_PERIOD  # Hz; MPPI needs a step of this period
STEPS = 56  # steps of MPPI; 2.8 s ahead
REVERSE_SHARE = 0.5  # speed in reverse, as a fraction of the robot's limit
RESOLUTION = 0.05  # m, edge of a cell of the costmaps
MARGIN = 0.3  # m, distance to obstacles that the planner prefers
FARTHEST_MARK = (
    0.95  # of the range of a lidar: Nav2 takes an infinite ray as one of almost its range
)
LOWEST_OBSTACLE = 0.1  # m above the ground, of points of 3d lidars


class Motion:
    """How the robot can move.

    - ``kind``: ``omni``, ``diff`` (it turns on the spot) or ``ackermann``.
    - ``turning_radius``: smallest radius in m of the path of ``base_link``, 0 if it can turn on the
      spot.
    """

    def __init__(self, robot: Robot) -> None:
        self.turning_radius = _turning_radius(robot)
        self.kind = "omni" if is_holonomic(robot) else "diff"
        if self.kind == "diff" and self.turning_radius > 0.0:
            self.kind = "ackermann"


def _turning_radius(robot: Robot) -> float:
    """Return the smallest turning radius in m.

    The centre of rotation lies on the axle line of the fixed wheels, at the distance R from the
    middle. A steered wheel at the distance L from the line and d from the middle has to turn by
    atan(L / (R - d)) on the inner side, so that its limit q gives R = L / tan(q) + d.
    """
    fixed = [w for w in robot.wheels if not w.steered and w.swivel_joint is None]
    if not fixed:
        return 0.0
    axle = math.fsum(w.x for w in fixed) / len(fixed)
    radius = 0.0
    for wheel in robot.wheels:
        joint = robot.joint(wheel.steering_joint) if wheel.steering_joint is not None else None
        if joint is None or joint.lower is None or joint.upper is None:
            continue
        limit = min(abs(joint.lower), abs(joint.upper))
        if limit < math.radians(89.0):
            radius = max(radius, abs(wheel.x - axle) / math.tan(limit) + abs(wheel.y))
    return radius


def global_frame(robot: Robot, parts: ros2_parts.Parts) -> str:
    return ros2_parts.map_frame(robot) if parts.map_sources else ros2_parts.odom_frame(robot)


def nav2(robot: Robot, parts: ros2_parts.Parts) -> dict[str, Parameters]:
    """Return the parameters of the nodes of Nav2, except for the global costmap, by the name of
    the node relative to the name space."""
    motion, corners = Motion(robot), footprint(robot)
    stamped: Parameters = {"enable_stamped_cmd_vel": robot.ros.stamped}
    frames: Parameters = {
        "global_frame": global_frame(robot, parts),
        "robot_base_frame": ros2_parts.base_frame(robot),
    }
    driver = robot.driver
    odometry = ros2_parts.full_topic(robot, odometry_topic(parts))

    def axes(linear: float, angular: float) -> list[float]:
        return [linear, linear if motion.kind == "omni" else 0.0, angular]

    speeds = axes(*driver.top_speeds)
    spins = motion.kind != "ackermann"
    behaviors = [
        *(["spin"] if spins else []),
        *("backup", "drive_on_heading", "assisted_teleop", "wait"),
    ]
    plugins = {
        "spin": "nav2_behaviors::Spin",
        "backup": "nav2_behaviors::BackUp",
        "drive_on_heading": "nav2_behaviors::DriveOnHeading",
        "assisted_teleop": "nav2_behaviors::AssistedTeleop",
        "wait": "nav2_behaviors::Wait",
    }
    straight: dict[str, Parameters] = {}
    if robot.ros.distro != "jazzy":  # there the velocity smoother alone limits them
        limits: Parameters = {
            "acceleration_limit": driver.max_linear_acceleration,
            "deceleration_limit": -driver.max_linear_deceleration,
        }
        straight = {"backup": limits, "drive_on_heading": limits}
    navigators = {"navigate_to_pose": "nav2_bt_navigator::NavigateToPoseNavigator"}
    if spins:  # the other behaviour tree has recoveries that turn on the spot
        navigators["navigate_through_poses"] = "nav2_bt_navigator::NavigateThroughPosesNavigator"
    return {
        "bt_navigator": {
            **frames,
            "odom_topic": odometry,
            "navigators": list(navigators),
            **{name: {"plugin": plugin} for name, plugin in navigators.items()},
        },
        "controller_server": {
            **stamped,
            "controller_frequency": CONTROLLER_FREQUENCY,
            "odom_topic": odometry,
            "min_x_velocity_threshold": 0.001,
            "min_y_velocity_threshold": 0.001,
            "min_theta_velocity_threshold": 0.001,
            "controller_plugins": ["FollowPath"],
            "FollowPath": _mppi(robot, motion),
        },
        "local_costmap/local_costmap": _local_costmap(robot, parts, corners),
        "planner_server": {
            "planner_plugins": ["GridBased"],
            "GridBased": _planner(motion),
        },
        "smoother_server": {
            "smoother_plugins": ["simple_smoother"],
            "simple_smoother": {"plugin": "nav2_smoother::SimpleSmoother"},
        },
        "behavior_server": {
            **stamped,
            **frames,
            "local_frame": ros2_parts.odom_frame(robot),
            "behavior_plugins": behaviors,
            **{name: {"plugin": plugins[name], **straight.get(name, {})} for name in behaviors},
            "max_rotational_vel": driver.max_angular_velocity * REVERSE_SHARE,
            "min_rotational_vel": min(0.1, driver.max_angular_velocity * REVERSE_SHARE),
            "rotational_acc_lim": _angular_ramp(driver),
        },
        "waypoint_follower": {
            "waypoint_task_executor_plugin": "wait_at_waypoint",
            "wait_at_waypoint": {"plugin": "nav2_waypoint_follower::WaitAtWaypoint"},
        },
        "velocity_smoother": {
            **stamped,
            "smoothing_frequency": CONTROLLER_FREQUENCY,
            "feedback": "OPEN_LOOP",
            "odom_topic": odometry,
            "max_velocity": speeds,
            "min_velocity": [-speed for speed in speeds],
            "max_accel": axes(driver.max_linear_acceleration, driver.max_angular_acceleration),
            "max_decel": [-deceleration for deceleration in axes(*driver.decelerations)],
            "velocity_timeout": _velocity_timeout(driver),
        },
        "collision_monitor": {**stamped, **_collision_monitor(robot, parts)},
    }


def _velocity_timeout(driver: DriverSettings) -> float:
    """Return the time in s after which the smoother stops without new commands.

    It repeats their last stamp until one message later, before the driver finds it too old.
    """
    timeout = driver.command_timeout
    return max(0.5 * timeout, round(timeout - 2.0 * RAMP_PERIOD, 9))


def odometry_topic(parts: ros2_parts.Parts) -> str:
    """Return the topic of the odometry whose frame is the owner's of ``odom`` to ``base_link``."""
    return "odometry/filtered" if parts.local_ekf else "odometry/base_raw"


def _mppi(robot: Robot, motion: Motion) -> Parameters:
    driver = robot.driver
    speed, acceleration = driver.max_linear_velocity, driver.max_linear_acceleration
    deceleration = driver.max_linear_deceleration
    values: Parameters = {
        "plugin": "nav2_mppi_controller::MPPIController",
        "time_steps": STEPS,
        "model_dt": 1.0 / CONTROLLER_FREQUENCY,
        "vx_max": speed,
        "vx_min": -REVERSE_SHARE * speed,
        "vy_max": speed if motion.kind == "omni" else 0.0,
        "wz_max": driver.max_angular_velocity,
        "ax_max": acceleration,
        "ax_min": -deceleration,
        "ay_max": acceleration,
        "ay_min": -deceleration,
        "az_max": _angular_ramp(driver),
        # The spread of the samples follows the limits, as in the defaults of Nav2.
        "vx_std": 0.4 * speed,
        "vy_std": 0.4 * speed,
        "wz_std": 0.2 * driver.max_angular_velocity,
    }
    values |= _motion_model(robot.ros.distro, motion)
    critics = ["ConstraintCritic", "CostCritic", "GoalCritic", "GoalAngleCritic"]
    critics += ["PathAlignCritic", "PathFollowCritic", "PathAngleCritic", "PreferForwardCritic"]
    if motion.kind == "omni":
        critics.append("TwirlingCritic")
    values["critics"] = critics
    values["CostCritic"] = {"consider_footprint": True}
    return values


def _motion_model(distro: str, motion: Motion) -> Parameters:
    """Return the parameters of the motion model: a name, or from Lyrical on a plug-in."""
    name = {"omni": "Omni", "diff": "DiffDrive", "ackermann": "Ackermann"}[motion.kind]
    radius: Parameters = {"min_turning_r": motion.turning_radius}
    if distro in ("jazzy", "kilted"):
        ackermann = {"AckermannConstraints": radius} if motion.kind == "ackermann" else {}
        return {"motion_model": name, **ackermann}
    key = {"omni": "omni", "diff": "diff_drive", "ackermann": "ackermann"}[motion.kind]
    plugin: Parameters = {"plugin": f"mppi::{name}MotionModel"}
    return {
        "motion_model": key,
        key: {**plugin, **radius} if motion.kind == "ackermann" else plugin,
    }


def _planner(motion: Motion) -> Parameters:
    if motion.kind != "ackermann":
        return {"plugin": "nav2_navfn_planner::NavfnPlanner", "allow_unknown": True}
    return {
        "plugin": "nav2_smac_planner::SmacPlannerHybrid",
        "allow_unknown": True,
        "minimum_turning_radius": motion.turning_radius,
        "motion_model_for_search": "REEDS_SHEPP",
    }


def plugin_packages(robot: Robot, parts: ros2_parts.Parts) -> list[str]:
    """Return the ROS packages with the plug-ins that the parameters name."""
    if not parts.navigation:
        return []
    planner = "smac" if Motion(robot).kind == "ackermann" else "navfn"
    return ["nav2_costmap_2d", "nav2_mppi_controller", f"nav2_{planner}_planner"]


# -- costmaps ---------------------------------------------------------------------------


def _text(corners: Sequence[tuple[float, float]]) -> str:
    return "[" + ", ".join(f"[{x!r}, {y!r}]" for x, y in corners) + "]"


def _reach(corners: Sequence[tuple[float, float]]) -> float:
    return max(math.hypot(x, y) for x, y in corners)


def _costmap(robot: Robot, corners: Sequence[tuple[float, float]], frame: str) -> Parameters:
    return {
        "global_frame": frame,
        "robot_base_frame": ros2_parts.base_frame(robot),
        "resolution": RESOLUTION,
        "footprint": _text(corners),
        "footprint_padding": 0.01,
        "inflation_layer": {
            "plugin": "nav2_costmap_2d::InflationLayer",
            "inflation_radius": _up(_reach(corners) + MARGIN),
        },
    }


def _up(value: float) -> float:
    return math.ceil(value * 10.0) / 10.0


def _local_costmap(
    robot: Robot, parts: ros2_parts.Parts, corners: Sequence[tuple[float, float]]
) -> Parameters:
    # MPPI looks ahead this far in all directions.
    ahead = robot.driver.max_linear_velocity * STEPS / CONTROLLER_FREQUENCY
    size = math.ceil(2.0 * (ahead + _reach(corners)))
    return {
        **_costmap(robot, corners, ros2_parts.odom_frame(robot)),
        "rolling_window": True,
        "width": size,
        "height": size,
        "update_frequency": 5.0,
        "publish_frequency": 2.0,
        "plugins": ["obstacle_layer", "inflation_layer"],
        "obstacle_layer": _obstacles(robot, parts),
    }


def global_costmap(robot: Robot, parts: ros2_parts.Parts, source: str) -> Parameters:
    """Return the parameters of the global costmap.

    ``source`` is that of the localization: with ``slam`` and ``amcl``, the costmap has the map;
    otherwise it is an area around the robot.
    """
    values = _costmap(robot, footprint(robot), global_frame(robot, parts))
    layers = ["obstacle_layer", "inflation_layer"]
    has_map = source in ("slam", "amcl")
    if has_map:
        layers.insert(0, "static_layer")
        values["static_layer"] = {
            "plugin": "nav2_costmap_2d::StaticLayer",
            "map_topic": ros2_parts.full_topic(robot, "map"),
            "map_subscribe_transient_local": True,
        }
    else:
        values |= {"rolling_window": True, "width": 50, "height": 50}
    return {
        **values,
        "update_frequency": 1.0,
        "publish_frequency": 1.0,
        "track_unknown_space": has_map,
        "plugins": layers,
        "obstacle_layer": _obstacles(robot, parts),
    }


def _obstacles(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    names = [_source_name(sensor) for sensor in parts.lidars]
    values: Parameters = {
        "plugin": "nav2_costmap_2d::ObstacleLayer",
        "observation_sources": " ".join(names),
    }
    for name, sensor in zip(names, parts.lidars, strict=True):
        is_scan = sensor.type == "lidar_2d"
        reach = sensor_numbers(sensor)["range"]
        values[name] = {
            "topic": ros2_parts.sensor_topic(robot, sensor),
            "data_type": "LaserScan" if is_scan else "PointCloud2",
            "marking": True,
            "clearing": True,
            "min_obstacle_height": 0.0 if is_scan else LOWEST_OBSTACLE,
            "max_obstacle_height": 2.5,
            "obstacle_max_range": min(FARTHEST_MARK * reach, 20.0),
            "raytrace_max_range": min(reach, 22.0),
            # A ray without an echo is infinite: it clears the way up to the range of the lidar.
            **({"inf_is_valid": True} if is_scan else {}),
        }
    return values


def amcl(robot: Robot, lidar: Sensor) -> dict[str, Parameters]:
    """Return the parameters of the nodes that localize the robot in a saved map with a 2d lidar."""
    frame = ros2_parts.map_frame(robot)
    model = "Omni" if is_holonomic(robot) else "Differential"
    return {
        "map_server": {"topic_name": "map", "frame_id": frame},
        "amcl": {
            "global_frame_id": frame,
            "odom_frame_id": ros2_parts.odom_frame(robot),
            "base_frame_id": ros2_parts.base_frame(robot),
            "scan_topic": ros2_parts.sensor_topic(robot, lidar),
            "map_topic": ros2_parts.full_topic(robot, "map"),
            "laser_max_range": sensor_numbers(lidar)["range"],
            "robot_model_type": f"nav2_amcl::{model}MotionModel",
        },
    }


def _source_name(sensor: Sensor) -> str:
    return sensor.name.replace(".", "_")


def _collision_monitor(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    names = [_source_name(sensor) for sensor in parts.lidars]
    values: Parameters = {
        "base_frame_id": ros2_parts.base_frame(robot),
        "odom_frame_id": ros2_parts.odom_frame(robot),
        "cmd_vel_in_topic": ros2_parts.full_topic(robot, "cmd_vel_smoothed"),
        "cmd_vel_out_topic": ros2_parts.full_topic(
            robot, ros2_parts.source_topic(robot, "auto_nav")
        ),
        "transform_tolerance": 0.2,
        "source_timeout": 1.0,
        # As long as Nav2 commands: after a silence, the driver awaits a zero on a free way too.
        "stop_pub_timeout": 3600.0,
        "polygons": ["FootprintApproach"],
        "FootprintApproach": {
            "type": "polygon",
            "action_type": "approach",
            "footprint_topic": ros2_parts.full_topic(robot, "local_costmap/published_footprint"),
            "time_before_collision": _stopping_time(robot),
            "simulation_time_step": 0.1,
            "min_points": 6,
            "visualize": False,
            "enabled": True,
        },
        "observation_sources": names,
    }
    for name, sensor in zip(names, parts.lidars, strict=True):
        values[name] = {
            "type": "scan",
            "topic": ros2_parts.sensor_topic(robot, sensor),
            "enabled": True,
        }
        if sensor.type == "lidar_3d":
            values[name] = {
                "type": "pointcloud",
                "topic": ros2_parts.sensor_topic(robot, sensor),
                "min_height": LOWEST_OBSTACLE,
                "max_height": 2.5,
                "enabled": True,
            }
    return values


def _stopping_time(robot: Robot) -> float:
    """Return the time in s in which the robot stops from its limits, with half a second more.

    The action ``approach`` allows the speed d/T at the distance d, with this time T. The robot
    follows it if it can decelerate by v/T, where v is its largest speed.
    """
    driven = stopping.driven_wheels(robot.wheels, robot.actuators)
    return _up(stopping.driver_ramp(driven, robot.driver).time + 0.5)


def _angular_ramp(driver: DriverSettings) -> float:
    """Return the one limit in rad/s^2 that Nav2 has for acceleration and deceleration."""
    return min(driver.max_angular_acceleration, driver.max_angular_deceleration)
