"""Configuration files of the original system as robot.yaml."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.importer.devices import (
    read_batteries,
    read_boards,
    read_sensor,
    sensor_kind,
)
from thorvaldc.compiler.importer.drives import (
    FRAME,
    place_drives,
    read_drives,
    share_params,
    spot,
    supports,
)
from thorvaldc.compiler.importer.original_file import Account, Entry, Fate, Key, read_original
from thorvaldc.compiler.importer.robot_text import Module, Names, Robot, as_id, render
from thorvaldc.compiler.importer.tube_frame import read_beams, read_frame
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report

__all__ = ["Fate", "ImportResult", "import_file", "import_original"]

_DRIVES = "motor_drives"
_MAX_NESTING = 8
_OF_THE_RESULT = ("import-assumed", "import-left-out")
_NOT_ROBOTS = ("", "ros_parameters", "base_driver", "thorvald_base_driver", "parameters", "params")


@dataclass(frozen=True, slots=True)
class ImportResult:
    """``text`` is the robot.yaml, ``None`` after errors.

    ``notes`` tells of every value of the file what became of it, by its path.
    """

    text: str | None
    notes: dict[Key, Fate]


def import_original(path: Path) -> tuple[str | None, Report]:
    """The text of a robot.yaml for a file of the original, and what there is to say of it."""
    report = Report()
    return import_file(path, report).text, report


def import_file(path: Path, report: Report) -> ImportResult:
    """Convert a configuration file of the original; its faults go to ``report``.

    Where it has errors, nothing is said of what was assumed or left out: there is no result.
    """
    found = Report()
    result = _import(path, found)
    for diagnostic in found:
        if result.text is not None or diagnostic.code.name not in _OF_THE_RESULT:
            report.put(diagnostic)
    return result


def _import(path: Path, report: Report) -> ImportResult:
    document = read_original(path, str(path), report)
    if document is None:
        return ImportResult(None, {})
    account = Account(document, report)
    found = _find_drives(document, ())
    if found is None:
        report.add(
            "import-not-original",
            f"`{path}` has no `{_DRIVES}`: it is no configuration file of the original system",
            document.span,
            hint="that is the file with motor_drives, batteries, pipes and corners",
        )
        return ImportResult(None, {})
    key, node = found
    root = Entry(key, node, account)
    robot = _convert(root, _name(root, key, path))
    account.finish()
    if robot is None or report.has_errors:
        return ImportResult(None, account.fates)
    robot.comments = [
        f"Made from {path.name}, a configuration file of the original system.",
        "Numbers that are not here are the library's.",
    ]
    return ImportResult(render(robot), account.fates)


def _find_drives(node: Node, key: Key) -> tuple[Key, Node] | None:
    """The mapping that has ``motor_drives``, at whatever depth."""
    if not isinstance(node.value, dict) or len(key) > _MAX_NESTING:
        return None
    if _DRIVES in node.value:
        return key, node
    for name, child in node.value.items():
        found = _find_drives(child, (*key, name))
        if found is not None:
            return found
    return None


def _name(root: Entry, key: Key, path: Path) -> str:
    """The robot's name: the file's word for it, the key it is nested under, the file's name."""
    stated = root.text("robot_name", "name")
    nested = [k for k in key if as_id(k) not in _NOT_ROBOTS]
    return (
        as_id(stated or "")
        or next((as_id(k) for k in reversed(nested)), "")
        or as_id(path.name.split(".")[0])
        or "robot"
    )


def _convert(root: Entry, name: str) -> Robot | None:
    robot = Robot(name)
    _settings(root, robot)
    calculator = root.text("base_calculator", "base_calculator")
    names = Names((FRAME,))
    drives = read_drives(root.entries(_DRIVES), names)
    if not drives and not root.report.has_errors:
        root.fault("import-missing", f"`{_DRIVES}` is empty: a robot has at least one drive")
    frame = read_frame(root.entries("pipes"), root.entries("corners"), names, root)
    beams = read_beams(root.entries("beams"), drives, names)
    batteries = read_batteries(root.entries("batteries"), frame.height, names)
    boards = read_boards(root.entries("io"), {d.node: d.entry for d in drives}, names)
    sensors = _sensors(root, frame.height, names)
    if root.report.has_errors:
        return None
    placed = place_drives(drives, frame.height, frame.tubes, names)
    if root.report.has_errors:
        return None
    robot.base_calculator = _calculator(root, calculator, placed)
    robot.defaults = share_params(placed)
    robot.modules = [
        Module(FRAME, "frame/open", comments=[f"its height is {frame.height:g} m"]),
        *frame.modules,
        *beams,
        *placed,
        *supports(placed, drives[0].entry, frame, names),
        *batteries,
        *boards,
        *sensors,
    ]
    return robot


def _settings(root: Entry, robot: Robot) -> None:
    """What the driver's parameters in such a file say of the robot itself."""
    rate = root.number("rate", "driver.rate", low=1.0, high=1000.0)
    if rate is not None:
        robot.driver["rate"] = f"{rate:g} Hz"
    prefix = root.text("tf_prefix", "namespace")
    if prefix:
        robot.namespace = as_id(prefix)
    for key, why in (
        ("can_interface_type", "the bus is chosen when the driver starts"),
        ("can_interface_name", "the bus is chosen when the driver starts"),
        ("simple_sim", "simulation is chosen when the driver starts"),
        ("odom_frame_id", "frames are named by the generated ROS files"),
        ("enable_odom_tf", "transforms are chosen in the generated ROS files"),
        ("robot_model", "the model is generated from the robot.yaml"),
        ("model_extras", "name the xacro files under `extras` in the robot.yaml"),
    ):
        root.leave_out(key, why)
    covariance = root.node.get("twist_covariance")
    if covariance is not None:
        why = "the base calculator computes the covariance itself"
        root.account.leave_out((*root.key, "twist_covariance"), covariance, why)


def _calculator(root: Entry, text: str | None, placed: list[Module]) -> str:
    """The plugin of ours for the original's; the original's default is the general one."""
    if not text:
        return "general"
    plugin = re.sub(r"[^a-z0-9]", "", text.lower().rpartition(":")[2])
    kinds = [module.type for module in placed if module.mount is not None]
    if "diff" in plugin:
        axles = {spot(module)[0] for module in placed if module.mount is not None}
        if "assembly/steered_drive" in kinds:
            reason = "steers"
        elif len(axles) > 1:
            reason = "has wheels on several axles"
        elif len(kinds) < 2:
            reason = "has one driven wheel"
        else:
            return "differential"
        root.report.add(
            "import-assumed",
            f"`{text}` is for two wheels on one axle; this robot {reason}: "
            "`general` is taken in its place",
            root.span("base_calculator"),
        )
        return "general"
    if "1w" in plugin or "onewheel" in plugin:
        if kinds == ["assembly/steered_drive"]:
            return "one_wheel"
    elif plugin == "pltfclcstd":
        return "general"
    root.report.add(
        "import-assumed",
        f"the base calculator `{text}` is not known for such a robot: "
        "`general` is taken in its place",
        root.span("base_calculator"),
        hint="`general` drives any arrangement of wheels",
    )
    return "general"


def _sensors(root: Entry, height: float, names: Names) -> list[Module]:
    found: list[tuple[Entry, str]] = []
    for key, node in (root.node.value if isinstance(root.node.value, dict) else {}).items():
        kind = sensor_kind(key)
        if kind is None:
            continue
        group = isinstance(node.value, dict) and all(
            isinstance(child.value, dict) for child in node.value.values()
        )
        if group or isinstance(node.value, tuple):
            found += [(child, kind) for child in root.entries(key)]
        elif isinstance(node.value, dict) or node.value is None:
            child = root.child(key)
            if child is not None:
                found.append((child, kind))
    modules = [read_sensor(entry, kind, height, names) for entry, kind in found]
    return [module for module in modules if module is not None]
