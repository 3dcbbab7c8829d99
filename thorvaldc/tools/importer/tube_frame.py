"""Converts the pipes, corners and beams of the robot's frame in an original file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from thorvaldc.diagnostics.plain_numbers import millimetres, plain
from thorvaldc.tools.importer.drives import Drive, Segment, mount_on_root
from thorvaldc.tools.importer.original_mapping import OriginalMapping
from thorvaldc.tools.importer.robot_text import Module, Names, angle

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
    # The names are chosen before errors are found, so that the names do not depend on errors.
    pipe_names = [names.make(mapping.name, f"pipe_{i}") for i, mapping in enumerate(pipes)]
    corner_names = [names.make(mapping.name, f"corner_{i}") for i, mapping in enumerate(corners)]
    pipe_values = [
        _read_pipe(mapping, name) for mapping, name in zip(pipes, pipe_names, strict=True)
    ]
    corner_values = [
        _read_corner(mapping, name) for mapping, name in zip(corners, corner_names, strict=True)
    ]
    heights = [pipe[4] for pipe in pipe_values if pipe is not None]
    heights = heights or [corner[2] for corner in corner_values if corner is not None]
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
    for mapping, name, pipe in zip(pipes, pipe_names, pipe_values, strict=True):
        if pipe is None:
            continue
        x1, y1, x2, y2, z = pipe
        frame.tubes.append((x1, y1, x2, y2))
        frame.modules.append(
            _bar("frame/tube", name, (x1, y1), (x2, y2), z - height, [mapping.location])
        )
    for mapping, name, corner in zip(corners, corner_names, corner_values, strict=True):
        if corner is None:
            continue
        x, y, z, quarter_turns = corner
        mount = mount_on_root(x, y, z - height)
        if quarter_turns:
            mount["rpy"] = [0.0, 0.0, angle(quarter_turns * math.pi / 2)]
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
    mount = mount_on_root((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, z)
    if dy or dx < 0.0:
        mount["rpy"] = [0.0, 0.0, angle(math.atan2(dy, dx))]
    return Module(name, module_type, mount, {"length": math.hypot(dx, dy)}, comments=comments)


def _read_pipe(
    mapping: OriginalMapping, name: str
) -> tuple[float, float, float, float, float] | None:
    """Returns the end points x1, y1, x2, y2 (m) of a pipe, and the height (m) above the ground.

    Returns ``None`` if the pipe is not valid.
    """
    target = f"modules.{name}"
    mapping.leave_out("space", _SPACE)
    values = [mapping.number(key, f"{target}.mount") for key in ("x1", "y1", "x2", "y2")]
    height = mapping.number(
        "height", f"{target}.mount", default=_DEFAULT_HEIGHT, low=0.05, high=20.0
    )
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


def _read_corner(mapping: OriginalMapping, name: str) -> tuple[float, float, float, int] | None:
    """Returns the position x, y, z (m) of a corner, and the yaw angle in quarter turns.

    Returns ``None`` if the corner is not valid.
    """
    target = f"modules.{name}"
    mapping.leave_out("space", _SPACE)
    mapping.leave_out(
        "corner_mesh", "it is the number of a mesh; the library has its own corner mesh"
    )
    x, y = mapping.number("x", f"{target}.mount"), mapping.number("y", f"{target}.mount")
    z = mapping.number("z", f"{target}.mount", default=_DEFAULT_HEIGHT)
    corner_type = mapping.number("type", f"{target}.mount.rpy", default=0.0)
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
            text = mapping.text(key, f"modules.{name}.mount")
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
