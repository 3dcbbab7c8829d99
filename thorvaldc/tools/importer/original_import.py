"""Converts configuration files of the original system to robot.yaml.

The page ``docs/import.md`` describes the conversion of original configuration files.  Modules of
this package::

    original_file              file -> tree of texts, as ROS reads YAML; typed values, and their log
    frame_and_drives, devices  values -> modules of the robot
    robot_text                 modules -> text of robot.yaml
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, plain
from thorvaldc.model.sums import float_sum
from thorvaldc.tools.importer import devices, frame_and_drives, original_file, robot_text

_DRIVES = "motor_drives"
_MAX_NESTING = 8
# Diagnostic codes about the generated robot.yaml.  Without a robot.yaml, such diagnostics are
# dropped.
_RESULT_CODES = ("import-assumed", "import-left-out")
# Keys of mappings that contain `motor_drives`.  A key such as `ros_parameters` is not the name of a
# robot.
_GENERIC_KEYS = (
    "",
    "ros_parameters",
    "base_driver",
    "thorvald_base_driver",
    "parameters",
    "params",
)


@dataclass(frozen=True, slots=True)
class ImportResult:
    """Result of the conversion of an original configuration file.

    ``text`` is the text of the robot.yaml, or ``None`` if the file has errors.  ``conversions``
    contains the conversion of each value of the file, by the path of the value.
    """

    text: str | None
    report: Report
    conversions: dict[original_file.Key, original_file.Conversion]


def import_original(path: Path) -> ImportResult:
    """Converts an original configuration file to a robot.yaml.

    If the file has errors, no robot.yaml is created, and diagnostics about the robot.yaml are
    dropped.
    """
    result = _import(path, Report())
    if result.text is not None:
        return result
    report = Report()
    for diagnostic in result.report:
        if diagnostic.code.name not in _RESULT_CODES:
            report.put(diagnostic)
    return replace(result, report=report)


def _import(path: Path, report: Report) -> ImportResult:
    document = original_file.read_original(path, str(path), report)
    if document is None:
        return ImportResult(None, report, {})
    log = original_file.ConversionLog(document, report)
    root_path_and_node = _find_root(document, ())
    if root_path_and_node is None:
        report.add(
            "import-not-original",
            f"`{path}` has no `{_DRIVES}`: it is not a configuration file of the original system",
            document.span,
            hint="give the file with `motor_drives`, `batteries`, `pipes` and `corners`",
        )
        return ImportResult(None, report, {})
    root = original_file.OriginalMapping(*root_path_and_node, log)
    robot = _convert(root, _robot_name(root, path))
    log.finish()
    if robot is None or report.has_errors:
        return ImportResult(None, report, log.conversions)
    robot.comments = [
        f"Converted from {path.name}, a configuration file of the original system.",
        "Numbers that are not in this file come from the library.",
    ]
    return ImportResult(robot_text.render(robot), report, log.conversions)


def _find_root(node: Node, key: original_file.Key) -> tuple[original_file.Key, Node] | None:
    """Returns the path and the node of the mapping that contains the key ``motor_drives``."""
    if not isinstance(node.value, dict) or len(key) > _MAX_NESTING:
        return None
    if _DRIVES in node.value:
        return key, node
    for name, child in node.value.items():
        root = _find_root(child, (*key, name))
        if root is not None:
            return root
    return None


def _robot_name(root: original_file.OriginalMapping, path: Path) -> str:
    """Returns the name of the robot in an original configuration file.

    The name of the robot is the value of the key `robot_name`.  If the file has no key
    `robot_name`, the name of the robot is the key of the innermost mapping that contains
    `motor_drives`.  If no mapping key is a robot name, the name of the robot is the file name.
    """
    outer_keys = [key for key in root.key if robot_text.as_id(key) not in _GENERIC_KEYS]
    return (
        robot_text.as_id(root.text("robot_name") or "")
        or next((robot_text.as_id(key) for key in reversed(outer_keys)), "")
        or robot_text.as_id(path.name.split(".")[0])
        or "robot"
    )


def _convert(root: original_file.OriginalMapping, name: str) -> robot_text.Robot | None:
    robot = robot_text.Robot(name)
    _convert_settings(root, robot)
    calculator = root.text("base_calculator")
    names = robot_text.Names((robot_text.ROOT_MODULE,))
    drives = frame_and_drives.read_drives(root.children(_DRIVES), names)
    if not drives and not root.report.has_errors:
        root.report_error("import-missing", f"`{_DRIVES}` is empty: a robot has at least one drive")
    frame = frame_and_drives.read_frame(
        root.children("pipes"), root.children("corners"), names, root
    )
    beams = frame_and_drives.read_beams(root.children("beams"), drives, names)
    batteries = devices.read_batteries(root.children("batteries"), frame.height, names)
    boards = devices.read_boards(root.children("io"), {d.node_id: d.source for d in drives}, names)
    sensors = _read_sensors(root, devices.ParentFrames(frame, drives), names)
    if root.report.has_errors:
        return None
    wheel_modules = frame_and_drives.drive_modules(drives, frame.height, frame.tubes, names)
    if root.report.has_errors:
        return None
    robot.base_calculator = _base_calculator(root, calculator, wheel_modules)
    robot.defaults = frame_and_drives.share_params(wheel_modules)
    robot.modules = [
        robot_text.Module(
            robot_text.ROOT_MODULE,
            "frame/open",
            comments=[f"height over the ground: {plain(frame.height)} m"],
        ),
        *frame.modules,
        *beams,
        *wheel_modules,
        *add_casters(wheel_modules, drives[0].source, frame.height, frame.center_x, names),
        *batteries,
        *boards,
        *sensors,
    ]
    return robot


def _convert_settings(root: original_file.OriginalMapping, robot: robot_text.Robot) -> None:
    """Converts the parameters of the original base driver that robot.yaml can express."""
    rate = root.number("rate", low=1.0, high=1000.0)
    if rate is not None:
        robot.driver["rate"] = f"{rate:g} Hz"
    prefix = root.text("tf_prefix")
    if prefix:
        robot.namespace = robot_text.as_id(prefix)
    for key, reason in (
        ("can_interface_type", "the bus is chosen when the driver starts"),
        ("can_interface_name", "the bus is chosen when the driver starts"),
        ("simple_sim", "simulation is chosen when the driver starts"),
        ("odom_frame_id", "the generated ROS files name the link frames"),
        ("enable_odom_tf", "the generated ROS files define the transforms"),
        ("robot_model", "the model is generated from the robot.yaml"),
        ("model_extras", "list the xacro files under `extras` in the robot.yaml"),
    ):
        root.leave_out(key, reason)
    root.leave_out("twist_covariance", "the base calculator computes the covariance itself")


def _base_calculator(
    root: original_file.OriginalMapping, text: str | None, wheel_modules: list[robot_text.Module]
) -> str:
    """Returns the name of the base calculator that replaces the original base calculator.

    The default is the general base calculator.

    ``text`` is the name of the original ROS plug-in, such as ``pltf_clc_2wdiff::PltfClc2WDiff``.
    """
    if not text:
        return "general"
    plugin = re.sub(r"[^a-z0-9]", "", text.lower().rpartition(":")[2])
    drive_types = [module.type for module in wheel_modules if module.mount is not None]
    if "diff" in plugin:
        axles = {module.mount.xyz[0] for module in wheel_modules if module.mount is not None}
        if "assembly/steered_drive" in drive_types:
            reason = "has steered drives"
        elif len(axles) > 1:
            reason = "has wheels on several axles"
        elif len(drive_types) < 2:
            reason = "has one driven wheel"
        else:
            return "differential"
        root.report.add(
            "import-assumed",
            f"`{text}` is for two wheels on one axle, but this robot {reason}: "
            "`general` is used instead",
            root.span("base_calculator"),
        )
        return "general"
    if "1w" in plugin or "onewheel" in plugin:
        if drive_types == ["assembly/steered_drive"]:
            return "one_wheel"
    elif plugin == "pltfclcstd":
        return "general"
    root.report.add(
        "import-assumed",
        f"the base calculator `{text}` is unknown for this arrangement of wheels: "
        "`general` is used instead",
        root.span("base_calculator"),
        hint="`general` drives any arrangement of wheels",
    )
    return "general"


def _read_sensors(
    root: original_file.OriginalMapping, parents: devices.ParentFrames, names: robot_text.Names
) -> list[robot_text.Module]:
    """Returns the modules of all sensors in the original file.

    The value of a sensor key is one sensor, a list of sensors or a mapping of sensors.
    """
    sensors: list[tuple[original_file.OriginalMapping, str]] = []
    for key, node in (root.node.value if isinstance(root.node.value, dict) else {}).items():
        module_type = devices.sensor_module_type(key)
        if module_type is None:
            continue
        has_several = isinstance(node.value, dict) and all(
            isinstance(child.value, dict) for child in node.value.values()
        )
        if has_several or isinstance(node.value, tuple) or node.value is None:
            sensors += [(child, module_type) for child in root.children(key)]
        elif isinstance(node.value, dict):
            mapping = original_file.OriginalMapping((*root.key, key), node, root.log)
            sensors.append((mapping, module_type))
    modules = [
        devices.read_sensor(mapping, module_type, parents, names)
        for mapping, module_type in sensors
    ]
    return [module for module in modules if module is not None]


# -- casters for a robot that would fall over -------------------------------------------

_SHORTEST_CASTER = 0.4  # m, from the ground to the mount
_LEAST_WHEELBASE = 0.8  # m, least distance of the casters from the drives, along x
_ON_LINE = 0.05  # m, largest distance of a wheel from the straight line through the other wheels

Point = tuple[float, float]  # x, y in base_link, m


def add_casters(
    wheel_modules: Sequence[robot_text.Module],
    source: original_file.OriginalMapping,
    frame_height: float,
    frame_center_x: float,
    names: robot_text.Names,
) -> list[robot_text.Module]:
    """Returns two casters if all driven wheels are on one straight line.

    If the driven wheels are not on one straight line, no casters are needed and the list is empty.
    Added casters are reported as an assumption.

    ``frame_height`` (m) is the height of the robot's frame above the ground.  ``frame_center_x``
    (m) is the x coordinate of the middle of the frame in ``base_link``.
    """
    points = [module.mount.xyz[:2] for module in wheel_modules if module.mount is not None]
    if not _are_on_a_line(points):
        return []
    module_type = "caster/fixed" if len(set(points)) == 1 else "caster/swivel"
    positions = _caster_positions(points, frame_center_x)
    height = max(frame_height, _SHORTEST_CASTER)
    source.report.add(
        "import-assumed",
        f"all drives are on one line and the file contains no passive wheels: {len(positions)} "
        f"`{module_type}` are added at " + " and ".join(f"({x:g}, {y:g}) m" for x, y in positions),
        source.node.where,
        hint="correct type and position of the passive wheels in the robot.yaml",
    )
    return [
        robot_text.Module(
            names.make(f"support_{i}", "support"),
            module_type,
            robot_text.Mount((x, y, height - frame_height)),
            {"height": height},
            comments=["assumed: original files do not contain passive wheels"],
        )
        for i, (x, y) in enumerate(positions)
    ]


def _caster_positions(points: Sequence[Point], frame_center_x: float) -> list[Point]:
    """Returns the positions of two casters (x, y in m) in ``base_link``.

    The driven wheels are on one straight line, which usually is an axle across the robot.  If the
    wheels are in line along the x axis, as on a bicycle, one caster is placed on each side of the
    robot.
    """
    x = float_sum(point[0] for point in points) / len(points)
    y = float_sum(point[1] for point in points) / len(points)
    half_length = max(abs(point[0] - x) for point in points)
    half_width = max(abs(point[1] - y) for point in points)
    half_track = max(0.3, half_width)
    if half_length > half_width:  # the wheels are in line as on a bicycle: one caster on each side
        return [(x, y + 0.4), (x, y - 0.4)]
    if abs(frame_center_x - x) > 0.15:  # axle at one end of the frame: casters at the other end
        distance = max(2.0 * abs(frame_center_x - x), _LEAST_WHEELBASE)
        caster_x = x + math.copysign(distance, frame_center_x - x)
        return [(caster_x, y + half_track), (caster_x, y - half_track)]
    if len(set(points)) == 1:  # a single wheel
        return [(x - 0.8, y + 0.4), (x - 0.8, y - 0.4)]
    return [(x + 0.6, y), (x - 0.6, y)]  # axle in the middle: one caster in front, one behind


def _are_on_a_line(points: Sequence[Point]) -> bool:
    x0, y0 = points[0]
    farthest = max(points, key=lambda point: math.hypot(point[0] - x0, point[1] - y0))
    dx, dy = farthest[0] - x0, farthest[1] - y0
    length = math.hypot(dx, dy)
    if length < 1e-6:
        return True
    # The distance of a point from a straight line is the cross product divided by the length.
    return all(abs((x - x0) * dy - (y - y0) * dx) / length < _ON_LINE for x, y in points)
