"""Reads ROS parameter files to sections, one for each node, and makes statements of them.

Parameters in launch files make the same statements.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.node import Node, plain_scalar
from thorvaldc.compiler.source.reader import MAX_DEPTH, MAX_VALUES, compose
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, ParameterSection, UnreadableFileError

_KEY = "ros__parameters"


def read_yaml(data: bytes, display: str, report: Report) -> Node | None:
    """Returns the document of a YAML file as ROS reads it, or ``None`` if it is empty.

    ROS merges mappings with the same key, and of two values it takes the last one, which is
    reported if they differ.  Raises ``UnreadableFileError``.
    """
    strict = Report()
    root = compose(data, display, strict)
    if root is None:
        if any(d.code.name == "yaml-empty" for d in strict):
            return None
        error = strict.sorted()[0]
        raise UnreadableFileError(error.message, error.span)
    converter = _Converter(display, report)
    try:
        return converter.node(root, None, 0)
    except OverflowError:
        text = f"the document has more than {MAX_VALUES} values, aliases expanded"
        raise UnreadableFileError(text) from None


class _Converter:
    """Converts the nodes of PyYAML; repeated keys, merge keys and aliases are allowed."""

    def __init__(self, file: str, report: Report) -> None:
        self.file = file
        self.report = report
        self.count = 0
        self.ignored = Report()  # words such as `yes`: readers of ROS know them

    def node(self, raw: Any, key_span: Span | None, depth: int) -> Node:
        self.count += 1
        if self.count > MAX_VALUES or depth > MAX_DEPTH:  # also an alias that contains itself
            raise OverflowError
        line, column = raw.start_mark.line + 1, raw.start_mark.column + 1
        span = Span(self.file, line, column, line, column + 1)
        if raw.id == "scalar":
            end = raw.end_mark
            span = Span(self.file, line, column, end.line + 1, end.column + 1)
            value = raw.value if raw.style else plain_scalar(raw.value, span, self.ignored)
            return Node(value, span, key_span, bool(raw.style))
        if raw.id == "sequence":
            return Node(tuple(self.node(v, None, depth + 1) for v in raw.value), span, key_span)
        values: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            key = self.node(raw_key, None, depth + 1)
            value = self.node(raw_value, key.span, depth + 1)
            if raw_key.value == "<<" and isinstance(value.value, dict):
                values = {**value.value, **values}
            else:
                self.add(values, str(raw_key.value), value)
        return Node(values, span, key_span)

    def add(self, values: dict[str, Node], key: str, last: Node) -> None:
        """Adds the value of a key that can occur twice in one mapping."""
        first = values.get(key, last)
        if first is not last and isinstance(first.value, dict) and isinstance(last.value, dict):
            merged = dict(first.value)
            for name, value in last.value.items():
                self.add(merged, name, value)
            last = Node(merged, first.span, first.key_span)
        elif first.plain() != last.plain() and first.key_span != last.key_span:
            self.report.add(
                "audit-key-twice",
                f"the key `{key}` occurs twice with different values; ROS uses the last one",
                last.where,
                hint="keep one of them",
                labels=[Label(first.where, FIRST_USE)],
            )
        values[key] = last


def sections(document: Node, display: str, path: Path) -> list[ParameterSection]:
    """Returns the sections of a document in the order of the file; other keys are ignored."""
    result: list[ParameterSection] = []

    def collect(node: Node, name: str) -> None:
        if not isinstance(node.value, dict):
            return
        for key, child in node.value.items():
            if key == _KEY:
                values = flattened(child)
                result.append(ParameterSection(name, display, path, child.where, values))
            else:
                collect(child, f"{name}/{key.strip('/')}" if name else key.strip("/"))

    collect(document, "")
    return result


def flattened(node: Node, prefix: str = "") -> dict[str, Node]:
    """Returns the parameters of a node by their dotted names; lists stay lists."""
    if not isinstance(node.value, dict):
        return {prefix: node}
    values: dict[str, Node] = {}
    for key, child in node.value.items():
        values |= flattened(child, f"{prefix}.{key}" if prefix else key)
    return values


# -- statements about wheels and joints -------------------------------------------------

LEFT = (
    *("left_wheel_names", "left_wheel_name", "left_wheel"),
    *("front_left_wheel_name", "rear_left_wheel_name"),
    *("front_left_wheel_command_joint_name", "rear_left_wheel_command_joint_name"),
)
RIGHT = tuple(name.replace("left", "right") for name in LEFT)
TRACTION = (
    *("rear_wheels_names", "front_wheels_names", "traction_joints_names"),
    *("traction_joint_name", "wheel_names"),
)
_STEERING = ("steering_joints_names", "steering_joint_name", "front_steering")
_JOINT_LISTS = (*LEFT, *RIGHT, *TRACTION, *_STEERING, "joints", "joint")
_RADIUS = ("wheel_radius", "wheels_radius", "kinematics.wheels_radius", "traction_wheels_radius",
           "front_wheels_radius", "rear_wheels_radius")  # fmt: skip
_SEPARATION = ("wheel_separation", "wheel_separation_y", "traction_track_width")


def controller_facts(section: ParameterSection, known: Collection[str]) -> list[Fact]:
    """Returns what the parameters of a node state about joints and wheels.

    - ``known``: names of the joints of all descriptions.
    """
    facts: list[Fact] = []
    subject = f"`{section.short_name}`"
    for name in _JOINT_LISTS:
        facts += [
            Fact("joint", subject, joint_of(item.value, known), item.span)
            for item in section.items(name)
            if isinstance(item.value, str) and is_plain(item.value)
        ]
    left = plain_names(section, LEFT, known)
    right = plain_names(section, RIGHT, known)
    wheels = (*left, *right) or plain_names(section, TRACTION, known)
    sides = (*left, "", *right) if left and right else ()
    for kind, parameters, joints in (
        ("wheel radius", _RADIUS, wheels),
        ("wheel separation", _SEPARATION, sides),
    ):
        for name in parameters:
            value = section.number(name)
            if value is not None and joints:
                span = section.values[name].span
                facts.append(Fact(kind, subject, value, span, "m", joints))
    return facts


def is_plain(name: str) -> bool:
    """Whether a name is written in full, without substitutions such as ``$(var prefix)``."""
    return bool(name) and "$" not in name and "{" not in name and "<" not in name


def joint_of(name: str, known: Collection[str]) -> str:
    """Returns the joint of an interface: that of a chained controller is `controller/joint`."""
    return name if name in known else name.rsplit("/", 1)[-1]


def plain_names(
    section: ParameterSection, parameters: Sequence[str], known: Collection[str]
) -> tuple[str, ...]:
    """Returns the joints in parameters, or no joints if a name contains a substitution."""
    names = [
        joint_of(item.value, known)
        for parameter in parameters
        for item in section.items(parameter)
        if isinstance(item.value, str)
    ]
    return tuple(names) if all(is_plain(name) for name in names) else ()


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
    """Returns what one parameter states about frames and stamps."""
    last = name.rsplit(".", 1)[-1]
    if isinstance(value, bool) and last in STAMPED:
        return [Fact("stamped", f"{subject} ({last})", value, span)]
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
            for _, target in node.remappings:
                if target.endswith("cmd_vel_unstamped"):
                    text = f"{subject} (remapping to {target})"
                    facts.append(Fact("stamped", text, False, node.span))
    return facts


def stamped_arguments(evidence: Evidence) -> set[str]:
    """Returns the parameters about stamps that an argument of a launch file decides."""
    return {
        name
        for launch in evidence.launches
        for node in launch.nodes
        for name, fact in node.parameters.items()
        if name in STAMPED and not isinstance(fact.value, bool)
    }


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
