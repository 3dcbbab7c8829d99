"""Makes statements of the sections of ROS parameter files, and of parameters in launch files."""

from __future__ import annotations

from typing import Any

from thorvaldc.compiler.descriptions.facts import Fact, ParameterSection
from thorvaldc.compiler.descriptions.parameter_files import LEFT, TRACTION, is_plain
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.tools.audit.audit_facts import Evidence

# -- statements about frames, transforms, stamps and speeds -----------------------------

# Frames of the robot itself, which a description must have.
BASE_FRAMES = (
    *("base_frame_id", "base_frame", "robot_base_frame", "base_link_frame", "base_link_frame_id"),
    "base_link",
)
# Frames above the robot: nodes make them, and no description has them.
WORLD_FRAMES = (
    *("odom_frame_id", "odom_frame", "map_frame", "map_frame_id", "world_frame", "global_frame"),
    *("global_frame_id", "odometry_frame", "fixed_frame"),
)
STAMPED = (
    *("use_stamped_vel", "use_stamped", "publish_stamped_twist", "enable_stamped_cmd_vel"),
    "stamped",
)


def node_facts(section: ParameterSection) -> list[Fact]:
    """Returns the statements of the parameters of a node."""
    subject = f"`{section.short_name}`"
    facts: list[Fact] = []
    # The driver of thorvaldc takes the sources itself: no twist_mux stands before it.
    has_multiplexer = section.short_name == "base_driver"
    for name, node in section.values.items():
        if not (has_multiplexer and isinstance(node.value, bool)):
            facts += _parameter_facts(subject, name, node.value, node.span)
    transform = _odometry_transform(section)
    if transform is not None:
        facts.append(transform)
    return facts + _speeds(section, subject)


def _parameter_facts(subject: str, name: str, value: Any, span: Span) -> list[Fact]:
    """Returns what one parameter states about frames and stamps.

    Stamps on which an argument of a launch file decides are ``None``.
    """
    last = name.rsplit(".", 1)[-1]
    if last in STAMPED:
        stamped = value if isinstance(value, bool) else None
        return [Fact("stamped", f"{subject} ({last})", stamped, span)]
    if not isinstance(value, str) or not is_plain(value):
        return []
    frame = value.strip("/")
    is_frame = bool(frame) and " " not in frame
    if last in BASE_FRAMES and is_frame:
        return [Fact("base frame", subject, frame, span)]
    if last == "frame_id" and is_frame:
        return [Fact("sensor frame", subject, frame, span)]
    return [Fact("world frame", subject, frame, span)] if last in WORLD_FRAMES else []


def is_drive_controller(section: ParameterSection) -> bool:
    """Whether a node is a drive controller of ros2_controllers."""
    return any(name in section.values for name in (*LEFT, *TRACTION))


def is_estimator(section: ParameterSection) -> bool:
    """Whether a node is an EKF or UKF of robot_localization."""
    inputs = ("odom0", "imu0", "twist0", "pose0")
    return "base_link_frame" in section.values and any(i in section.values for i in inputs)


def _odometry_transform(section: ParameterSection) -> Fact | None:
    """Returns whether a node publishes the transform from the odometry frame to the robot."""
    subject = f"`{section.short_name}`"
    if is_estimator(section):
        parameter, kind = "publish_tf", "estimator"
        odom = section.text("odom_frame") or "odom"
        if (section.text("world_frame") or odom) != odom:
            return None  # it publishes map -> odom
    elif is_drive_controller(section) or "enable_odom_tf" in section.values:
        parameter, kind = "enable_odom_tf", "controller"
        odom = section.text("odom_frame_id") or "odom"
    else:
        return None
    node = section.values.get(parameter)
    span = node.span if node is not None else section.span
    shown = f"{subject} ({parameter}{'' if node is not None else ' is true by default'})"
    # Drive controllers and estimators publish the transform unless it is switched off.
    enabled = section.flag(parameter) is not False
    return Fact(f"{kind} transform", shown, enabled, span, "", (odom.strip("/"),))


_LIMITS = {
    "linear.x.max_velocity": ("linear", "linear.x.has_velocity_limits"),
    "angular.z.max_velocity": ("angular", "angular.z.has_velocity_limits"),
}
# Speeds that planners of Nav2 demand, by the last part of the name.
_PLANNED = {
    "max_vel_x": "linear",
    "vx_max": "linear",
    "desired_linear_vel": "linear",
    "max_vel_theta": "angular",
    "wz_max": "angular",
    "max_rotational_vel": "angular",
    "rotate_to_heading_angular_vel": "angular",
}


def _speeds(section: ParameterSection, subject: str) -> list[Fact]:
    facts: list[Fact] = []

    def add(kind: str, name: str, node: Node, value: float) -> None:
        unit = "m/s" if kind.startswith("linear") else "rad/s"
        if value > 0.0:
            facts.append(Fact(kind, f"{subject} ({name})", value, node.span, unit))

    if is_drive_controller(section):
        for name, (kind, switch) in _LIMITS.items():
            value = section.number(name)
            if value is not None and section.flag(switch) is not False:
                add(f"{kind} limit", name, section.values[name], value)
        return facts
    speeds = section.items("max_velocity")
    if section.short_name == "velocity_smoother" and len(speeds) == 3:
        for kind, item in (("linear", speeds[0]), ("angular", speeds[2])):
            if isinstance(item.value, int | float):
                add(f"{kind} limit", "max_velocity", item, float(item.value))
                add(f"{kind} plan", "max_velocity", item, float(item.value))
    for name, node in section.values.items():
        planned = _PLANNED.get(name.rsplit(".", 1)[-1])
        value = section.number(name)
        if planned is not None and value is not None:
            add(f"{planned} plan", name, node, value)
    return facts


def launched_facts(evidence: Evidence) -> list[Fact]:
    """Returns the statements of the parameters and names in launch files."""
    facts: list[Fact] = []
    for launch in evidence.launches:
        for node in launch.nodes:
            subject = f"`{node.name or node.executable or 'node'}`"
            for name, fact in node.parameters.items():
                facts += _parameter_facts(subject, name, fact.value, fact.span)
    return facts


def published_frames(evidence: Evidence) -> set[str]:
    """Returns the frames that nodes of the launch files and parameter files publish."""
    frames = {"map", "odom", "world", "earth", "utm", "base_footprint_ekf"}
    frames |= {fact.value for fact in evidence.stated("world frame")}
    for launch in evidence.launches:
        for node in launch.nodes:
            if node.executable == "static_transform_publisher":
                words = [word.strip("/") for word in node.arguments]
                frames.update(word for word in words if word and not word.startswith("-"))
                for name in ("frame_id", "child_frame_id"):
                    if name in node.parameters and node.parameters[name].value is not None:
                        frames.add(str(node.parameters[name].value).strip("/"))
    return frames
