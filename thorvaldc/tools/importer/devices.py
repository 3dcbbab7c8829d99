"""Converts the batteries, IO boards and sensors of an original configuration file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.diagnostics import Label
from thorvaldc.model import Pose
from thorvaldc.tools.importer.frame_and_drives import NODE_IDS, Drive, Frame
from thorvaldc.tools.importer.original_file import OriginalMapping
from thorvaldc.tools.importer.robot_text import ROOT_MODULE, Module, Mount, Names, Value

# m, height of the bottom of a battery enclosure above the axis of a frame tube
_BATTERY_HEIGHT = 0.07
_OLD_BATTERY_IDS = 344  # in older files, the value of `node` is 344 plus the battery id
_IO_NODE_ID = 20  # default node id of the IO board in the original system
# Height (m) of the measurement frame of each library sensor above the foot of the sensor.
_OFFSETS = {"sensor/lidar_2d": 0.085, "sensor/lidar_3d": 0.038, "sensor/imu": 0.012}
_ANTENNA_CENTER = 0.035


# -- batteries ------------------------------------------------------------------------


def read_batteries(
    mappings: Sequence[OriginalMapping], height: float, names: Names
) -> list[Module]:
    """Returns the modules of the battery enclosures, with or without a battery.

    ``height`` is the height (m) of the robot's frame above the ground.
    """
    modules: list[Module] = []
    for i, mapping in enumerate(mappings):
        name = names.make(mapping.name, f"battery_{i}")
        comments = [mapping.location]
        battery_id = _battery_id(mapping, comments)
        x = mapping.number("x", default=0.0)
        y = mapping.number("y", default=0.0)
        z = mapping.number("z", default=height + _BATTERY_HEIGHT)
        yaw = mapping.number("yaw", default=0.0)
        mapping.leave_out(
            "bat_mesh", "it is the number of a mesh; the library has its own enclosure mesh"
        )
        present = _battery_present(mapping, battery_id)
        if x is None or y is None or z is None or yaw is None:
            continue
        mount = Mount((x, y, z - height), (0.0, 0.0, yaw))
        params: dict[str, Value] = {} if present else {"with_battery": False}
        modules.append(
            Module(
                name,
                "battery/enclosure",
                mount,
                params,
                can=battery_id if present else None,
                comments=comments,
            )
        )
    return modules


def _battery_id(mapping: OriginalMapping, comments: list[str]) -> int | None:
    """Returns the battery id on the CAN bus, from 0 to 15.

    Returns ``None`` if the enclosure is empty or the battery id is not valid.

    Newer original files contain the battery id in the key `id`, and older files in the key `node`.
    A negative battery id means an enclosure without a battery.
    """
    key = "id" if mapping.has("id") else "node"
    if key == "id":
        mapping.leave_out("node", "`id` already identifies the battery")
    value = mapping.number(key)
    if value is None or value < 0.0:
        return None
    number = value
    if key == "node" and value > _OLD_BATTERY_IDS - 1:
        value -= _OLD_BATTERY_IDS
        comments.append(f"node {number:g} is battery {value:g}: older files add 344 to the id")
    if value != round(value) or not 0 <= value <= 15:
        mapping.report_error(
            "import-value",
            f"`{key}` of `{mapping.path}`: expected a battery from 0 to 15 (344 to 359 in older "
            f"files), got {number:g} (battery {value:g})",
            key,
            "only these batteries have CAN ids",
        )
        return None
    return int(value)


def _battery_present(mapping: OriginalMapping, battery_id: int | None) -> bool:
    """Returns whether the enclosure contains a battery.

    The enclosure contains a battery if the file contains a battery id.  A contradiction with the
    keys `with_battery` and `type` is reported.
    """
    with_battery = mapping.boolean("with_battery")
    battery_type = mapping.number("type")
    present = battery_id is not None
    if battery_type not in (None, 0, 1):
        mapping.report.add(
            "import-assumed",
            f"`type` of `{mapping.path}`: expected 0 (no battery) or 1 (KC battery), "
            f"got {battery_type:g}; 1 is assumed",
            mapping.span("type"),
        )
        battery_type = 1.0
    for key, value in (
        ("with_battery", with_battery),
        ("type", None if battery_type is None else battery_type == 1),
    ):
        if value is not None and value != present:
            mapping.report.add(
                "import-assumed",
                f"`{key}` of `{mapping.path}` means {'a' if value else 'no'} battery, its id means "
                f"{'one' if present else 'none'}: "
                f"{'a battery' if present else 'an empty enclosure'} is assumed",
                mapping.span(key),
                hint="correct `with_battery` and `can` in the robot.yaml if it is wrong",
            )
    return present


# -- IO boards ------------------------------------------------------------------------


def read_boards(
    mappings: Sequence[OriginalMapping], drive_nodes: dict[int, OriginalMapping], names: Names
) -> list[Module]:
    """Returns the modules of the IO boards.

    ``drive_nodes`` contains the drives of the original file, by the node id of the motor
    controller.  An IO board with the node id of a drive is reported.
    """
    users = dict(drive_nodes)
    modules: list[Module] = []
    for i, mapping in enumerate(mappings):
        name = names.make(mapping.name, f"io_{i}")
        node_id: int | None = _IO_NODE_ID
        comments = [mapping.location]
        if mapping.has("id"):
            node_id = mapping.integer("id", low=NODE_IDS[0], high=NODE_IDS[1])
        else:
            comments.append(f"the file has no id: {_IO_NODE_ID} is the default of the original")
        mapping.leave_out("type", "the library has one IO board for all types of the original")
        params: dict[str, Value] = {}
        for relay in (0, 1):
            state = mapping.boolean(f"rl{relay}_init_state")
            if state is not None:
                params[f"relay_{relay}_at_start"] = state
        if node_id is None:
            continue
        if node_id in users:
            mapping.report.add(
                "import-node-duplicate",
                f"`{users[node_id].path}` and `{mapping.path}` have node id {node_id}",
                mapping.span("id"),
                hint="every node on a bus has its own id",
                labels=[Label(users[node_id].node.where, "also here")],
            )
            continue
        users[node_id] = mapping
        modules.append(Module(name, "io/board", None, params, can=node_id, comments=comments))
    return modules


# -- sensors --------------------------------------------------------------------------


def sensor_module_type(key: str) -> str | None:
    """Returns the module type of the sensor that a key such as ``lidar_front`` names.

    Returns ``None`` if the key does not name a sensor.
    """
    for word, module_type in (
        ("lidar", "sensor/lidar_2d"),
        ("laser", "sensor/lidar_2d"),
        ("gnss", "sensor/gnss_antenna"),
        ("gps", "sensor/gnss_antenna"),
        ("imu", "sensor/imu"),
        ("camera", "sensor/camera"),
    ):
        if key.lower().startswith(word):
            return module_type
    return None


class ParentFrame(NamedTuple):
    """The link frame of the original system to which the pose of a sensor is relative.

    - ``module``: name of the imported module that carries the sensor.
    - ``carrier``: pose of this module in the frame of the root module.
    - ``pose``: pose of the link frame in the frame of this module.
    - ``what``: the assumed place of the link frame, or an empty text if nothing is assumed.
    """

    module: str
    carrier: Pose
    pose: Pose
    what: str = ""


class ParentFrames:
    """Finds the link frame that `parent_link` of a sensor names.

    The original system publishes `cornerN_1` and `cornerN_2` as child frames of `cornerN`, and
    `topN` at the leg of `driveN` as a child frame of `base_link`.  Its files do not contain the
    poses of these frames.
    """

    def __init__(self, frame: Frame, drives: Sequence[Drive]) -> None:
        self.base = ParentFrame(ROOT_MODULE, Pose(), Pose((0.0, 0.0, -frame.height)))
        self.corners = frame.corners
        self.drives = {drive.source.name: drive for drive in drives}

    def find(self, name: str) -> ParentFrame | None:
        """Returns the link frame with the name, or ``None`` if the file does not define it."""
        if name == "base_link":
            return self.base
        corner = self.corners.get(name) or self.corners.get(re.sub(r"_[12]$", "", name))
        if corner is not None and corner.mount is not None:
            carrier = Pose.from_xyz_rpy(corner.mount.xyz, corner.mount.rpy)
            what = f"the origin of the corner `{corner.name}`"
            return ParentFrame(corner.name, carrier, Pose(), what)
        drive = self.drives.get(re.sub(r"^top(?=\d+$)", "drive", name))
        if drive is not None:
            what = f"a point above the wheel of `{drive.name}`, at the height of the frame"
            return ParentFrame(ROOT_MODULE, Pose(), Pose((drive.x, drive.y, 0.0)), what)
        return None


def read_sensor(
    mapping: OriginalMapping, module_type: str, parents: ParentFrames, names: Names
) -> Module | None:
    """Returns the module of a sensor, or ``None`` if the pose of the sensor is not valid.

    The pose in the original file is the pose of the measurement frame in the frame of
    `parent_link`.
    """
    module_type = _with_lidar_type(mapping, module_type)
    name = names.make(mapping.name, module_type.rpartition("/")[2])
    if not any(mapping.has(key) for key in ("x", "y", "z")):
        mapping.report.add(
            "import-assumed",
            f"`{mapping.path}` has no x, y, z: the origin of its parent link is assumed",
            mapping.node.where,
            hint=f"set the mount of `{name}` in the robot.yaml",
        )
    x, y, z = (mapping.number(key, default=0.0) for key in ("x", "y", "z"))
    roll, pitch, yaw = (mapping.number(key, default=0.0) for key in ("roll", "pitch", "yaw"))
    comments = [mapping.location]
    product = [f"{key} {text}" for key in ("make", "model", "type") if (text := mapping.text(key))]
    if product:
        comments.append(", ".join(product))
    link = mapping.text("parent_link")
    parent = parents.find(link.strip("/").rpartition("/")[2]) if link else parents.base
    if parent is None or parent.what:
        place = parent.what if parent is not None else "base_link"
        mapping.report.add(
            "import-assumed",
            f"the pose of `{mapping.path}` is relative to the link `{link}`, whose pose the file "
            f"does not contain: {place} is assumed",
            mapping.span("parent_link"),
            hint=f"correct the mount of `{name}` in the robot.yaml",
        )
    parent = parent or parents.base
    for key in ("topic_prefix", "suffix"):
        mapping.leave_out(key, "the generated ROS files name the topics")
    mapping.leave_out("output_sim", "the simulation contains every sensor")
    if x is None or y is None or z is None or roll is None or pitch is None or yaw is None:
        return None
    pose = parent.pose * Pose.from_xyz_rpy((x, y, z), (roll, pitch, yaw))
    params: dict[str, Value] = {}
    offset = _OFFSETS.get(module_type, 0.0)
    if module_type == "sensor/gnss_antenna":
        # An upright GNSS antenna above the robot's frame stands on a mast.  A tilted antenna has no
        # mast.
        upright = roll == 0.0 and pitch == 0.0
        above = (parent.carrier * pose).xyz[2]
        mast = max(0.0, above - _ANTENNA_CENTER) if upright else 0.0
        params["mast"] = mast
        offset = mast + _ANTENNA_CENTER
    mounted = (pose * Pose((0.0, 0.0, -offset))).clean()
    mount = Mount(mounted.xyz, (roll, pitch, yaw), parent.module)
    return Module(name, module_type, mount, params, comments=comments)


def _with_lidar_type(mapping: OriginalMapping, module_type: str) -> str:
    """Returns the module type of a lidar by its `type`, which is `2d` or `3d`."""
    if module_type != "sensor/lidar_2d":
        return module_type
    text = mapping.text("type") or ""
    if text.lower() in ("3d", "3"):
        return "sensor/lidar_3d"
    if text.lower() not in ("", "2d", "2"):
        mapping.report.add(
            "import-assumed",
            f"`type` of `{mapping.path}`: expected 2d or 3d, got `{text}`; 2d is assumed",
            mapping.span("type"),
            hint="use `sensor/lidar_3d` in the robot.yaml for a scanner with several layers",
        )
    return module_type
