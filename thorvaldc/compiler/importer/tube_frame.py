"""The frame of the original: pipes, corners and beams, each where the file puts it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from thorvaldc.compiler.importer.drives import FRAME, Drive, Segment
from thorvaldc.compiler.importer.original_file import Entry
from thorvaldc.compiler.importer.robot_text import Module, Names, Value, angle

DEFAULT_HEIGHT = 0.65
_SHORTEST = 0.01
_SPACE = "what it means is not published; tubes and corners lie at their coordinates"


@dataclass
class Frame:
    """``height`` over the ground; ``tubes`` the pipes seen from above, for the clamps."""

    height: float
    tubes: list[Segment] = field(default_factory=list)
    modules: list[Module] = field(default_factory=list)

    @property
    def center_x(self) -> float:
        """The middle of the tubes."""
        xs = [x for tube in self.tubes for x in (tube[0], tube[2])]
        return (max(xs) + min(xs)) / 2 if xs else 0.0


def read_frame(
    pipes: Sequence[Entry], corners: Sequence[Entry], names: Names, root: Entry
) -> Frame:
    """Pipes and corners; the height that most of them have is the frame's."""
    named_pipes = [(entry, names.make(entry.name, f"pipe_{i}")) for i, entry in enumerate(pipes)]
    named = [(entry, names.make(entry.name, f"corner_{i}")) for i, entry in enumerate(corners)]
    found = [(entry, name, _pipe(entry, name)) for entry, name in named_pipes]
    placed = [(entry, name, _corner(entry, name)) for entry, name in named]
    heights = [pipe[4] for _, _, pipe in found if pipe is not None]
    heights = heights or [corner[2] for _, _, corner in placed if corner is not None]
    if heights:
        height = max(heights, key=lambda h: (heights.count(h), -h))
    else:
        height = DEFAULT_HEIGHT
        root.report.add(
            "import-assumed",
            f"the file has no pipes and no corners: the drives hang {height:g} m over the ground "
            "on a root without parts",
            root.span("motor_drives"),
            hint="choose a frame module, as frame/tube_rectangular, in the robot.yaml",
        )
    frame = Frame(height)
    for entry, name, pipe in found:
        if pipe is None:
            continue
        x1, y1, x2, y2, z = pipe
        frame.tubes.append((x1, y1, x2, y2))
        frame.modules.append(
            _bar("frame/tube", name, (x1, y1), (x2, y2), z - height, [_where(entry)])
        )
    for entry, name, corner in placed:
        if corner is None:
            continue
        x, y, z, kind = corner
        mount: dict[str, Value] = {"parent": FRAME, "xyz": [x, y, z - height]}
        if kind:
            mount["rpy"] = [0.0, 0.0, angle(kind * math.pi / 2)]
        frame.modules.append(Module(name, "frame/corner", mount, comments=[_where(entry)]))
    return frame


def _where(entry: Entry) -> str:
    return f"{entry.path}, line {entry.node.where.line}"


def _bar(
    kind: str,
    name: str,
    start: tuple[float, float],
    end: tuple[float, float],
    z: float,
    comments: list[str],
) -> Module:
    """A tube or beam from start to end: its module lies along x, its origin in the middle."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    mount: dict[str, Value] = {
        "parent": FRAME,
        "xyz": [(start[0] + end[0]) / 2, (start[1] + end[1]) / 2, z],
    }
    if dy or dx < 0.0:
        mount["rpy"] = [0.0, 0.0, angle(math.atan2(dy, dx))]
    return Module(name, kind, mount, {"length": math.hypot(dx, dy)}, comments=comments)


def _pipe(entry: Entry, name: str) -> tuple[float, float, float, float, float] | None:
    to = f"modules.{name}"
    entry.leave_out("space", _SPACE)
    values = [entry.number(key, f"{to}.mount") for key in ("x1", "y1", "x2", "y2")]
    height = entry.number("height", f"{to}.mount", default=DEFAULT_HEIGHT, low=0.05, high=20.0)
    missing = [key for key in ("x1", "y1", "x2", "y2") if not entry.has(key)]
    if missing:
        entry.fault("import-missing", f"`{entry.path}` has no `{'`, `'.join(missing)}`")
    x1, y1, x2, y2 = values
    if x1 is None or y1 is None or x2 is None or y2 is None or height is None:
        return None
    if math.hypot(x2 - x1, y2 - y1) < _SHORTEST:
        entry.fault("import-value", f"`{entry.path}` is shorter than {_SHORTEST * 1000:g} mm")
        return None
    return x1, y1, x2, y2, height


def _corner(entry: Entry, name: str) -> tuple[float, float, float, int] | None:
    to = f"modules.{name}"
    entry.leave_out("space", _SPACE)
    entry.leave_out(
        "corner_mesh", "it is the number of a picture; the library draws its own corners"
    )
    x, y = entry.number("x", f"{to}.mount"), entry.number("y", f"{to}.mount")
    z = entry.number("z", f"{to}.mount", default=DEFAULT_HEIGHT)
    kind = entry.number("type", f"{to}.mount.rpy", default=0.0)
    if kind not in (None, 0, 1, 2, 3):
        entry.leave_out("type", "only corners of type 0 to 3 are known; it is not turned")
        kind = 0.0
    missing = [key for key in ("x", "y") if not entry.has(key)]
    if missing:
        entry.fault("import-missing", f"`{entry.path}` has no `{'`, `'.join(missing)}`")
    if x is None or y is None or z is None or kind is None:
        return None
    return x, y, z, int(kind)


def read_beams(entries: Sequence[Entry], drives: Sequence[Drive], names: Names) -> list[Module]:
    """Beams from one drive to another, at the height of the frame."""
    by_name = {drive.entry.name: drive for drive in drives}
    modules: list[Module] = []
    for i, entry in enumerate(entries):
        name = names.make(entry.name, f"beam_{i}")
        ends: list[Drive] = []
        for key in ("start", "end"):
            text = entry.text(key, f"modules.{name}.mount")
            if text is None:
                entry.fault("import-missing", f"`{entry.path}` has no `{key}`")
            elif text not in by_name:
                known = ", ".join(f"`{n}`" for n in by_name) or "none"
                entry.fault(
                    "import-reference",
                    f"`{key}` of `{entry.path}` names the drive `{text}`, which does not exist",
                    key,
                    f"the drives are {known}",
                )
            else:
                ends.append(by_name[text])
        if len(ends) < 2:
            continue
        start, end = ends
        if math.hypot(end.x - start.x, end.y - start.y) < _SHORTEST:
            entry.fault("import-value", f"`{entry.path}` begins and ends in one place")
            continue
        modules.append(
            _bar("frame/beam", name, (start.x, start.y), (end.x, end.y), 0.0, [_where(entry)])
        )
    return modules
