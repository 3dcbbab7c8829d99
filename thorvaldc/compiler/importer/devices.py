"""Batteries, IO boards and sensors of the original."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.compiler.importer.drives import FRAME, NODES
from thorvaldc.compiler.importer.original_file import Entry
from thorvaldc.compiler.importer.robot_text import Module, Names, Value, angle
from thorvaldc.diagnostics import Label
from thorvaldc.model.spatial import Pose

_BATTERY_HEIGHT = 0.07  # of the enclosure's bottom over the tube
_OLD_BATTERY_IDS = 344
_IO_ID = 20
# From the foot of the library's sensor to the frame in which it measures.
_LIDAR_LASER = 0.085
_ANTENNA_CENTER = 0.035
_IMU_CENTER = 0.012


def _where(entry: Entry) -> str:
    return f"{entry.path}, line {entry.node.where.line}"


# -- batteries ------------------------------------------------------------------------


def read_batteries(entries: Sequence[Entry], height: float, names: Names) -> list[Module]:
    """Enclosures with or without a battery, the battery's id by either of the file's rules."""
    modules: list[Module] = []
    for i, entry in enumerate(entries):
        name = names.make(entry.name, f"battery_{i}")
        to = f"modules.{name}"
        comments = [_where(entry)]
        identity = _battery_id(entry, to, comments)
        x = entry.number("x", f"{to}.mount.xyz", default=0.0)
        y = entry.number("y", f"{to}.mount.xyz", default=0.0)
        z = entry.number("z", f"{to}.mount.xyz", default=height + _BATTERY_HEIGHT)
        yaw = entry.number("yaw", f"{to}.mount.rpy", default=0.0)
        entry.leave_out("bat_mesh", "it is the number of a picture; the library draws its own box")
        present = _battery_present(entry, to, identity)
        if x is None or y is None or z is None or yaw is None:
            continue
        mount: dict[str, Value] = {"parent": FRAME, "xyz": [x, y, z - height]}
        if yaw:
            mount["rpy"] = [0.0, 0.0, angle(yaw)]
        params: dict[str, Value] = {} if present else {"with_battery": False}
        modules.append(
            Module(
                name,
                "battery/enclosure",
                mount,
                params,
                can=identity if present else None,
                comments=comments,
            )
        )
    return modules


def _battery_id(entry: Entry, to: str, comments: list[str]) -> int | None:
    """The id on the bus, 0..15; ``None`` where the file says that there is no battery."""
    key = "id" if entry.has("id") else "node"
    if key == "id":
        entry.leave_out("node", "`id` says which battery it is")
    value = entry.number(key, f"{to}.can")
    if value is None or value < 0.0:
        return None
    given = value
    if key == "node" and value > _OLD_BATTERY_IDS - 1:
        value -= _OLD_BATTERY_IDS
        comments.append(f"node {given:g} is battery {value:g}: the old form is the id + 344")
    if value != round(value) or not 0 <= value <= 15:
        entry.fault(
            "import-value",
            f"`{key}` of `{entry.path}` is {given:g}: battery {value:g} has no frames of its own",
            key,
            "the ids of batteries go from 0 to 15, as 344 to 359 in the old form",
        )
        return None
    return int(value)


def _battery_present(entry: Entry, to: str, identity: int | None) -> bool:
    stated = entry.boolean("with_battery", f"{to}.params.with_battery")
    kind = entry.number("type", f"{to}.params.with_battery")
    present = identity is not None
    if kind not in (None, 0, 1):
        entry.report.add(
            "import-assumed",
            f"`type` of `{entry.path}` is {kind:g}; only 0, none, and 1, the battery by KC, are "
            "known: taken as the latter",
            entry.span("type"),
        )
        kind = 1.0
    for key, says in (("with_battery", stated), ("type", None if kind is None else kind == 1)):
        if says is not None and says != present:
            entry.report.add(
                "import-assumed",
                f"`{key}` of `{entry.path}` says that there is {'a' if says else 'no'} battery, "
                f"its address says {'one' if present else 'none'}: taken as "
                f"{'there' if present else 'an empty enclosure'}",
                entry.span(key),
                hint="correct `with_battery` and `can` in the robot.yaml if it is wrong",
            )
    return present


# -- IO boards ------------------------------------------------------------------------


def read_boards(entries: Sequence[Entry], nodes: dict[int, Entry], names: Names) -> list[Module]:
    """IO boards; ``nodes`` are the ids on the bus that drives have taken."""
    taken = dict(nodes)
    modules: list[Module] = []
    for i, entry in enumerate(entries):
        name = names.make(entry.name, f"io_{i}")
        to = f"modules.{name}"
        node: int | None = _IO_ID
        comments = [_where(entry)]
        if entry.has("id"):
            node = entry.integer("id", f"{to}.can", low=NODES[0], high=NODES[1])
        else:
            comments.append(f"no id in the file: the original's default, {_IO_ID}")
        entry.leave_out("type", "the library has one IO board for all of the original's types")
        params: dict[str, Value] = {}
        for relay in (0, 1):
            state = entry.boolean(f"rl{relay}_init_state", f"{to}.params.relay_{relay}_at_start")
            if state is not None:
                params[f"relay_{relay}_at_start"] = state
        if node is None:
            continue
        if node in taken:
            entry.report.add(
                "import-node-duplicate",
                f"node {node} is given to `{taken[node].path}` and to `{entry.path}`",
                entry.span("id"),
                hint="every node on the bus has an id of its own",
                labels=[Label(taken[node].node.where, "also here")],
            )
            continue
        taken[node] = entry
        modules.append(Module(name, "io/board", None, params, can=node, comments=comments))
    return modules


# -- sensors --------------------------------------------------------------------------


def sensor_kind(key: str) -> str | None:
    """The library's type for a key of the file such as ``lidar_front``; ``None`` for others."""
    for word, kind in (
        ("lidar", "sensor/lidar_2d"),
        ("laser", "sensor/lidar_2d"),
        ("gnss", "sensor/gnss_antenna"),
        ("gps", "sensor/gnss_antenna"),
        ("imu", "sensor/imu"),
        ("camera", "sensor/camera"),
    ):
        if key.lower().startswith(word):
            return kind
    return None


def read_sensor(entry: Entry, kind: str, height: float, names: Names) -> Module | None:
    """The sensor so that the frame in which it measures has the file's pose in base_link."""
    name = names.make(entry.name, kind.rpartition("/")[2])
    to = f"modules.{name}.mount"
    if not any(entry.has(key) for key in ("x", "y", "z")):
        entry.report.add(
            "import-assumed",
            f"`{entry.path}` has no x, y, z: it is put at the origin of base_link",
            entry.node.where,
            hint=f"give `{name}` its place in the robot.yaml",
        )
    x, y, z = (entry.number(key, f"{to}.xyz", default=0.0) for key in ("x", "y", "z"))
    roll, pitch, yaw = (
        entry.number(key, f"{to}.rpy", default=0.0) for key in ("roll", "pitch", "yaw")
    )
    comments = [_where(entry)]
    told = [
        f"{key} {text}"
        for key in ("make", "model", "type")
        if (text := entry.text(key, f"a comment of modules.{name}"))
    ]
    if told:
        comments.append(", ".join(told))
    parent = entry.text("parent_link", to)
    if parent and parent.strip("/").rpartition("/")[2] != "base_link":
        entry.report.add(
            "import-assumed",
            f"`{entry.path}` is given relative to the link `{parent}`, which the robot.yaml does "
            "not have: its pose is taken in base_link",
            entry.span("parent_link"),
            hint=f"correct the mount of `{name}` in the robot.yaml",
        )
    for key in ("topic_prefix", "suffix"):
        entry.leave_out(key, "topics are named by the generated ROS files")
    entry.leave_out("output_sim", "every sensor is in the simulation")
    if x is None or y is None or z is None or roll is None or pitch is None or yaw is None:
        return None
    pose = Pose.from_xyz_rpy((x, y, z - height), (roll, pitch, yaw))
    params: dict[str, Value] = {}
    offset = {"sensor/lidar_2d": _LIDAR_LASER, "sensor/imu": _IMU_CENTER}.get(kind, 0.0)
    if kind == "sensor/gnss_antenna":
        # Its foot stands on the frame where that is below, else the antenna has no mast.
        upright = roll == 0.0 and pitch == 0.0
        mast = max(0.0, z - height - _ANTENNA_CENTER) if upright else 0.0
        params["mast"] = mast
        offset = mast + _ANTENNA_CENTER
    mounted = (pose * Pose((0.0, 0.0, -offset))).clean()
    mount: dict[str, Value] = {"parent": FRAME, "xyz": [*mounted.xyz]}
    if roll or pitch or yaw:
        mount["rpy"] = [angle(roll), angle(pitch), angle(yaw)]
    return Module(name, kind, mount, params, comments=comments)
