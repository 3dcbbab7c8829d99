"""Converts the drives and the frame of an original file.

A drive is steered (type 0) or unsteered (type 1).  The frame has pipes, corners and beams.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from thorvaldc.diagnostics import Label, millimetres, plain
from thorvaldc.tools.importer.original_file import OriginalMapping
from thorvaldc.tools.importer.robot_text import Module, Mount, Names, Value

NODE_IDS = (1, 127)  # least and greatest CANopen node id (CiA 301)
_WHEEL_RADIUS, _WHEEL_WIDTH = 0.2, 0.16  # m, radius and width of the module type wheel/agri_200
# Least height (m) of the robot's frame above the top of a wheel.  The arm of a drive needs the
# space above the wheel.
_CLEARANCE_FIXED = 0.12
_CLEARANCE_STEERED = 0.22  # for a drive with a steering module
_CLAMP_REACH = 0.4  # m, largest horizontal distance of a drive from the tube that the clamp holds
_SAME_POSITION = 0.05  # m; two wheels at a smaller distance are the same wheel

_ParamRow = tuple[str, str, str, float, float]
# Optional values of a drive: key, parameter of the drive module, unit, least and greatest value.
_PARAMS: tuple[_ParamRow, ...] = (
    ("prp_gr_rt", "gear_ratio", "", 1.0, 1e4),
    ("prp_enc_ppr", "encoder_ppr", "", 1, 1_000_000),
    ("prp_max_rpm", "motor_max_speed", "rpm", 1.0, 1e5),
    ("prp_sim_a", "wheel_acceleration", "m/s^2", 0.05, 100.0),
)
_STEERING_PARAMS: tuple[_ParamRow, ...] = (
    ("str_gr_rt", "steering_gear_ratio", "", 1.0, 1e4),
    ("str_enc_ppr", "steering_encoder_ppr", "", 1, 1_000_000),
    ("str_lim", "steering_limit", "rad", 0.01, 100.0),
    ("str_sim_v", "steering_velocity", "rad/s", 0.01, 100.0),
)

Segment = tuple[float, float, float, float]  # x1, y1, x2, y2 in base_link, m


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive of an original configuration file.

    ``x`` and ``y`` are the coordinates (m) of the wheel's contact point in ``base_link``.
    ``radius`` (m) is the radius of the wheel.
    """

    source: OriginalMapping
    name: str
    steered: bool
    node_id: int
    x: float
    y: float
    radius: float
    params: dict[str, Value]
    comments: tuple[str, ...] = ()


def read_drives(mappings: Sequence[OriginalMapping], names: Names) -> list[Drive]:
    """Returns the valid drives of an original file, and reports the errors of invalid drives."""
    drives: list[Drive] = []
    for mapping in mappings:
        name = names.make(mapping.name, f"drive_{len(drives)}")
        drive = _read_drive(mapping, name)
        if drive is not None:
            drives.append(drive)
    return drives


def _read_drive(mapping: OriginalMapping, name: str) -> Drive | None:
    earlier_errors = len(mapping.report.errors)
    for key in ("node", "x", "y"):
        if not mapping.has(key):
            mapping.report_error(
                "import-missing", f"`{mapping.path}` has no `{key}`", hint=f"add it: `{key}: ...`"
            )
    node_id = mapping.integer("node", low=NODE_IDS[0], high=NODE_IDS[1])
    x = mapping.number("x")
    y = mapping.number("y")
    drive_type = mapping.integer("type", low=0, high=1)
    if mapping.has("type") and drive_type is None:
        return None
    steered = drive_type != 1
    params: dict[str, Value] = {}
    radius = _read_wheel(mapping, params)
    _read_params(mapping, _PARAMS, params)
    if steered:
        _read_params(mapping, _STEERING_PARAMS, params)
    else:
        for key, *_ in _STEERING_PARAMS:
            mapping.leave_out(key, "a drive of type 1 has no steering")
    mapping.leave_out("leg_mesh", "it is the number of a mesh; the library has its own leg meshes")
    if len(mapping.report.errors) > earlier_errors:
        return None
    if node_id is None or x is None or y is None or radius is None:
        return None
    return Drive(mapping, name, steered, node_id, x, y, radius, params)


def _read_wheel(mapping: OriginalMapping, params: dict[str, Value]) -> float | None:
    """Returns the radius (m) of the wheel, or ``None`` if the radius is not valid.

    A radius or width that differs from the default wheel is added to ``params``.
    """
    wheel_params: dict[str, Value] = {}
    sizes: list[float | None] = []
    for key, param, usual, low in (
        ("r_wheel", "radius", _WHEEL_RADIUS, 0.05),
        ("w_wheel", "width", _WHEEL_WIDTH, 0.02),
    ):
        size = mapping.number(key, default=usual, low=low, high=5.0)
        if size is not None and size != usual:
            wheel_params[param] = size
        sizes.append(size)
    if wheel_params:
        params["wheel"] = {"type": "wheel/agri_200", "params": wheel_params}
    return sizes[0]


def _read_params(
    mapping: OriginalMapping, rows: Sequence[_ParamRow], params: dict[str, Value]
) -> None:
    """Converts optional values of an original drive to parameters of the drive module."""
    for key, param, unit, low, high in rows:
        value: float | None
        if isinstance(low, int):
            value = mapping.integer(key, low=low, high=int(high))
        else:
            value = mapping.number(key, low=low, high=high)
        if value is not None:
            number = repr(value) if value != int(value) else str(int(value))
            params[param] = f"{number} {unit}" if unit else value


def drive_modules(
    drives: Sequence[Drive], frame_height: float, tubes: Sequence[Segment], names: Names
) -> list[Module]:
    """Returns the drive modules, and the motor controllers of the drives of type 1.

    ``frame_height`` is the height (m) of the robot's frame above the ground.  ``tubes`` contains
    the end points (m) of each frame tube in the top view.
    """
    by_node_id: dict[int, list[Drive]] = {}
    for drive in drives:
        by_node_id.setdefault(drive.node_id, []).append(drive)
    modules: list[Module] = []
    for node_id, node_drives in by_node_id.items():
        if node_drives[0].steered and len(node_drives) == 1:
            modules.append(_steered_module(node_drives[0], frame_height, tubes))
        elif all(not drive.steered for drive in node_drives) and len(node_drives) <= 2:
            modules += _unsteered_modules(node_id, node_drives, drives, frame_height, names)
        else:
            source = node_drives[-1].source
            source.report.add(
                "import-node-duplicate",
                f"{len(node_drives)} drives have node id {node_id}",
                source.span("node"),
                hint="every controller has its own node id; "
                "only two drives of type 1 share a controller",
                labels=[
                    Label(drive.source.span("node"), "also here") for drive in node_drives[:-1]
                ],
            )
    return modules


def _drive_module(drive: Drive, module_type: str, clearance: float, frame_height: float) -> Module:
    """Returns the module of one drive.

    A drive with a large wheel is mounted above the robot's frame.
    """
    height = max(frame_height, 2.0 * drive.radius + clearance)
    params = dict(drive.params)
    params["height"] = height
    params["leg_side"] = "right" if drive.y >= 0.0 else "left"
    return Module(
        drive.name,
        module_type,
        Mount((drive.x, drive.y, height - frame_height)),
        params,
        comments=[drive.source.location, *drive.comments],
    )


def _steered_module(drive: Drive, frame_height: float, tubes: Sequence[Segment]) -> Module:
    module = _drive_module(drive, "assembly/steered_drive", _CLEARANCE_STEERED, frame_height)
    clamp = _nearest_point(drive.x, drive.y, tubes)
    if clamp is not None:
        module.params["clamp_x"] = clamp[0] - drive.x
        module.params["clamp_y"] = clamp[1] - drive.y
    module.can = drive.node_id
    return module


def _unsteered_modules(
    node_id: int,
    node_drives: Sequence[Drive],
    all_drives: Sequence[Drive],
    frame_height: float,
    names: Names,
) -> list[Module]:
    """Returns the modules of one or two unsteered drives and of the common motor controller.

    The motor controller of a drive of type 1 has two motors, but the original file contains the
    position of only one wheel.  No publication states the position of the second wheel.

    Two drives of type 1 with the same node id use both channels of one motor controller.  For a
    single drive of type 1, the wheel of the second motor is assumed at the mirrored y coordinate.
    If another drive is at the mirrored position, the second channel of the motor controller is not
    used.
    """
    first = node_drives[0]
    source = first.source
    one_position = (
        f"`{source.path}` is of type 1, two propulsion motors on one controller, and "
        "contains one position"
    )
    drive_at_mirror_image = any(
        math.hypot(drive.x - first.x, drive.y + first.y) < _SAME_POSITION for drive in all_drives
    )
    if len(node_drives) == 1 and not drive_at_mirror_image:
        mirror_name = names.make(f"{first.name}_mirrored", "drive_mirrored")
        source.report.add(
            "import-assumed",
            f"{one_position}: the second wheel is put at y = {plain(-first.y)} m",
            source.span("type"),
            hint=f"correct `{mirror_name}` in the robot.yaml if it is elsewhere",
        )
        mirror_image = Drive(
            source,
            mirror_name,
            False,
            node_id,
            first.x,
            -first.y,
            first.radius,
            first.params,
            ("assumed: the wheel of the second motor is the mirror image of the first",),
        )
        node_drives = [first, mirror_image]
    channels: dict[str, Value]
    if len(node_drives) == 2:
        left, right = sorted(node_drives, key=lambda drive: -drive.y)
        channels = {"left": f"{left.name}.propulsion", "right": f"{right.name}.propulsion"}
    else:
        channels = {"left" if first.y >= 0.0 else "right": f"{first.name}.propulsion"}
        source.report.add(
            "import-assumed",
            f"{one_position}: the second motor has no position and is left out",
            source.span("type"),
            hint="connect it in the robot.yaml: `channels` of the controller",
        )
    controller = Module(
        names.make(f"{first.name}_controller", "controller"),
        "controller/propulsion_propulsion",
        can=node_id,
        channels=channels,
        comments=["controller of type 1: two propulsion motors on one node"],
    )
    wheels = [
        _drive_module(drive, "assembly/fixed_drive", _CLEARANCE_FIXED, frame_height)
        for drive in node_drives
    ]
    return [*wheels, controller]


def _nearest_point(x: float, y: float, tubes: Sequence[Segment]) -> tuple[float, float] | None:
    """Returns the nearest point (x, y in m) of a frame tube, where the clamp of a drive is
    attached.

    Returns ``None`` if no frame tube is in reach of the clamp, or if a frame tube is straight above
    the drive at (x, y).
    """
    nearest: tuple[float, float, float] | None = None
    for x1, y1, x2, y2 in tubes:
        dx, dy = x2 - x1, y2 - y1
        # The projection of the point (x, y) on the tube is at t = 0 at the start of the tube, and
        # at t = 1 at the end of the tube.
        t = ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy)
        t = min(1.0, max(0.0, t))
        px, py = x1 + t * dx, y1 + t * dy
        distance = math.hypot(px - x, py - y)
        # If two tubes are equally near, the first tube is used.  The tolerance of 1e-9 m removes
        # the effect of rounding errors.
        if nearest is None or distance < nearest[0] - 1e-9:
            nearest = (distance, px, py)
    if nearest is None or not 1e-3 < nearest[0] < _CLAMP_REACH:
        return None
    return nearest[1], nearest[2]


def share_params(modules: Sequence[Module]) -> dict[str, Value]:
    """Returns the parameter values that are the same for all drive modules.

    The function removes the common parameter values from the drive modules.  The section `defaults`
    of robot.yaml contains the common values.
    """
    drives = [module for module in modules if module.type.startswith("assembly/")]
    if len(drives) < 2 or len({drive.type for drive in drives}) > 1:
        return {}
    shared = {
        key: value
        for key, value in drives[0].params.items()
        if all(key in drive.params and drive.params[key] == value for drive in drives)
    }
    for drive in drives:
        drive.params = {k: v for k, v in drive.params.items() if k not in shared}
    return shared


# -- pipes, corners and beams -----------------------------------------------------------

_DEFAULT_HEIGHT = 0.65  # m, default height of the robot's frame above the ground
_SHORTEST = 0.01  # m, least length of a pipe or beam
_SPACE = "its meaning is not published; tubes and corners are at their coordinates"


@dataclass
class Frame:
    """The tubular frame of a robot.

    ``height`` is the height (m) of the frame above the ground.  ``tubes`` contains the end points
    (m) of each tube in the top view.
    ``corners`` contains the module of each corner, by the key of the corner in the file.
    """

    height: float
    tubes: list[Segment] = field(default_factory=list)
    modules: list[Module] = field(default_factory=list)
    corners: dict[str, Module] = field(default_factory=dict)

    @property
    def center_x(self) -> float:
        """The x coordinate (m) of the middle of the frame in ``base_link``."""
        xs = [x for tube in self.tubes for x in (tube[0], tube[2])]
        return (max(xs) + min(xs)) / 2 if xs else 0.0


def read_frame(
    pipes: Sequence[OriginalMapping],
    corners: Sequence[OriginalMapping],
    names: Names,
    root: OriginalMapping,
) -> Frame:
    """Returns the tubular frame of the robot.

    The height of the frame is the most frequent height of the pipes.  In a file without pipes, the
    height of the frame is the most frequent height of the corners.  In a file without pipes and
    corners, the height of the frame is 0.65 m.
    """
    # Invalid pipes and corners have names, too, so that the names do not depend on errors.
    pipe_values = [
        (mapping, names.make(mapping.name, f"pipe_{i}"), _read_pipe(mapping))
        for i, mapping in enumerate(pipes)
    ]
    corner_values = [
        (mapping, names.make(mapping.name, f"corner_{i}"), _read_corner(mapping))
        for i, mapping in enumerate(corners)
    ]
    heights = [pipe[4] for *_, pipe in pipe_values if pipe is not None]
    heights = heights or [corner[2] for *_, corner in corner_values if corner is not None]
    if heights:
        # If two heights are equally frequent, the lower height is used.
        height = max(heights, key=lambda h: (heights.count(h), -h))
    else:
        height = _DEFAULT_HEIGHT
        root.report.add(
            "import-assumed",
            f"the file has no pipes and no corners: the drives are mounted {plain(height)} m over "
            "the ground on a root module without parts",
            root.span("motor_drives"),
            hint="use a frame module such as `frame/tube_rectangular` in the robot.yaml",
        )
    frame = Frame(height)
    for mapping, name, pipe in pipe_values:
        if pipe is None:
            continue
        x1, y1, x2, y2, z = pipe
        frame.tubes.append((x1, y1, x2, y2))
        frame.modules.append(
            _bar("frame/tube", name, (x1, y1), (x2, y2), z - height, [mapping.location])
        )
    for mapping, name, corner in corner_values:
        if corner is None:
            continue
        x, y, z, quarter_turns = corner
        mount = Mount((x, y, z - height), (0.0, 0.0, quarter_turns * math.pi / 2))
        module = Module(name, "frame/corner", mount, comments=[mapping.location])
        frame.modules.append(module)
        frame.corners[mapping.name] = module
    return frame


def _bar(
    module_type: str,
    name: str,
    start: tuple[float, float],
    end: tuple[float, float],
    z: float,
    comments: list[str],
) -> Module:
    """Returns the module of a tube or beam between two points (x, y in m).

    The link frame of a tube or beam has the origin in the middle and the x axis along the tube or
    beam.
    """
    dx, dy = end[0] - start[0], end[1] - start[1]
    middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2, z
    mount = Mount(middle, (0.0, 0.0, math.atan2(dy, dx)))
    return Module(name, module_type, mount, {"length": math.hypot(dx, dy)}, comments=comments)


def _read_pipe(mapping: OriginalMapping) -> tuple[float, float, float, float, float] | None:
    """Returns the end points x1, y1, x2, y2 (m) of a pipe, and the height (m) above the ground.

    Returns ``None`` if the pipe is not valid.
    """
    mapping.leave_out("space", _SPACE)
    values = [mapping.number(key) for key in ("x1", "y1", "x2", "y2")]
    height = mapping.number("height", default=_DEFAULT_HEIGHT, low=0.05, high=20.0)
    missing = [key for key in ("x1", "y1", "x2", "y2") if not mapping.has(key)]
    if missing:
        mapping.report_error("import-missing", f"`{mapping.path}` has no `{'`, `'.join(missing)}`")
    x1, y1, x2, y2 = values
    if x1 is None or y1 is None or x2 is None or y2 is None or height is None:
        return None
    if math.hypot(x2 - x1, y2 - y1) < _SHORTEST:
        mapping.report_error(
            "import-value", f"`{mapping.path}` is shorter than {millimetres(_SHORTEST, 6)}"
        )
        return None
    return x1, y1, x2, y2, height


def _read_corner(mapping: OriginalMapping) -> tuple[float, float, float, int] | None:
    """Returns the position x, y, z (m) of a corner, and the yaw angle in quarter turns.

    Returns ``None`` if the corner is not valid.
    """
    mapping.leave_out("space", _SPACE)
    mapping.leave_out(
        "corner_mesh", "it is the number of a mesh; the library has its own corner mesh"
    )
    x, y = mapping.number("x"), mapping.number("y")
    z = mapping.number("z", default=_DEFAULT_HEIGHT)
    corner_type = mapping.number("type", default=0.0)
    if corner_type not in (None, 0, 1, 2, 3):
        mapping.leave_out(
            "type", "only the corner types 0 to 3 are known; the corner is not rotated"
        )
        corner_type = 0.0
    missing = [key for key in ("x", "y") if not mapping.has(key)]
    if missing:
        mapping.report_error("import-missing", f"`{mapping.path}` has no `{'`, `'.join(missing)}`")
    if x is None or y is None or z is None or corner_type is None:
        return None
    return x, y, z, int(corner_type)


def read_beams(
    mappings: Sequence[OriginalMapping], drives: Sequence[Drive], names: Names
) -> list[Module]:
    """Returns the modules of the beams.

    A beam connects two drives at the height of the robot's frame.
    """
    by_name = {drive.source.name: drive for drive in drives}
    modules: list[Module] = []
    for i, mapping in enumerate(mappings):
        name = names.make(mapping.name, f"beam_{i}")
        end_drives: list[Drive] = []
        for key in ("start", "end"):
            text = mapping.text(key)
            if text is None:
                mapping.report_error("import-missing", f"`{mapping.path}` has no `{key}`")
            elif text not in by_name:
                drive_names = ", ".join(f"`{n}`" for n in by_name) or "none"
                mapping.report_error(
                    "import-reference",
                    f"`{key}` of `{mapping.path}` names the drive `{text}`, which does not exist",
                    key,
                    f"the drives are {drive_names}",
                )
            else:
                end_drives.append(by_name[text])
        if len(end_drives) < 2:
            continue
        start, end = end_drives
        if math.hypot(end.x - start.x, end.y - start.y) < _SHORTEST:
            mapping.report_error(
                "import-value", f"`{mapping.path}` starts and ends at the same position"
            )
            continue
        modules.append(
            _bar("frame/beam", name, (start.x, start.y), (end.x, end.y), 0.0, [mapping.location])
        )
    return modules
