"""Drives of the original: steered ones (type 0) and pairs without steering (type 1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from thorvaldc.compiler.importer.original_file import Entry
from thorvaldc.compiler.importer.robot_text import Module, Names, Value
from thorvaldc.diagnostics import Label

FRAME = "frame"
# What a drive needs over its wheel for its arm, and for its steering module too, m.
_OVER_FIXED_WHEEL = 0.12
_OVER_STEERED_WHEEL = 0.22
_WHEEL_RADIUS, _WHEEL_WIDTH = 0.2, 0.16
NODES = (1, 127)
# A tube nearer than this is what the drive's clamp holds.
_CLAMP_REACH = 0.4

_SHORTEST_CASTER = 0.4
_NEAREST_CASTER = 0.8
# Wheels of two drives that are nearer than this are one wheel.
_SAME_PLACE = 0.05

Segment = tuple[float, float, float, float]


class Outline(Protocol):
    """What is asked of a frame: its height and the middle of its length."""

    height: float

    @property
    def center_x(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive as read: ``x``, ``y`` is the contact point in base_link."""

    entry: Entry
    name: str
    steered: bool
    node: int
    x: float
    y: float
    radius: float
    params: dict[str, Value]
    comments: tuple[str, ...] = ()


def read_drives(entries: Sequence[Entry], names: Names) -> list[Drive]:
    """All drives without a fault; the faults are reported."""
    drives: list[Drive] = []
    for entry in entries:
        name = names.make(entry.name, f"drive_{len(drives)}")
        drive = _read(entry, name)
        if drive is not None:
            drives.append(drive)
    return drives


def _read(entry: Entry, name: str) -> Drive | None:
    to = f"modules.{name}"
    faults = len(entry.report)
    for key in ("node", "x", "y"):
        if not entry.has(key):
            entry.fault(
                "import-missing", f"`{entry.path}` has no `{key}`", hint=f"add it: `{key}: ...`"
            )
    node = entry.integer("node", f"{to}.can", low=NODES[0], high=NODES[1])
    x = entry.number("x", f"{to}.mount.xyz")
    y = entry.number("y", f"{to}.mount.xyz")
    kind = entry.integer("type", f"{to}.type", low=0, high=1)
    if entry.has("type") and kind is None:
        return None
    steered = kind != 1
    params: dict[str, Value] = {}
    radius = entry.number(
        "r_wheel", f"{to}.params.wheel", default=_WHEEL_RADIUS, low=0.05, high=5.0
    )
    width = entry.number("w_wheel", f"{to}.params.wheel", default=_WHEEL_WIDTH, low=0.02, high=5.0)
    given: dict[str, Value] = {}
    if entry.has("r_wheel") and radius is not None and radius != _WHEEL_RADIUS:
        given["radius"] = radius
    if entry.has("w_wheel") and width is not None and width != _WHEEL_WIDTH:
        given["width"] = width
    if given:
        params["wheel"] = {"type": "wheel/agri_200", "params": given}
    _quantity(entry, params, to, "prp_gr_rt", "gear_ratio", low=1.0, high=1e4)
    _count(entry, params, to, "prp_enc_ppr", "encoder_ppr")
    _quantity(entry, params, to, "prp_max_rpm", "motor_max_speed", " rpm", low=1.0, high=1e5)
    _quantity(entry, params, to, "prp_sim_a", "wheel_acceleration", " m/s^2", low=0.05, high=100.0)
    if steered:
        _quantity(entry, params, to, "str_gr_rt", "steering_gear_ratio", low=1.0, high=1e4)
        _count(entry, params, to, "str_enc_ppr", "steering_encoder_ppr")
        _quantity(entry, params, to, "str_lim", "steering_limit", " rad", low=0.01, high=100.0)
        _quantity(
            entry, params, to, "str_sim_v", "steering_velocity", " rad/s", low=0.01, high=100.0
        )
    else:
        for key in ("str_gr_rt", "str_enc_ppr", "str_lim", "str_sim_v"):
            entry.leave_out(key, "a drive of type 1 has no steering")
    entry.leave_out("leg_mesh", "it is the number of a picture; the library draws its own legs")
    if len(entry.report) > faults and any(
        d.severity.value == "error" for d in list(entry.report)[faults:]
    ):
        return None
    if node is None or x is None or y is None or radius is None or width is None:
        return None
    return Drive(entry, name, steered, node, x, y, radius, params)


def _quantity(
    entry: Entry,
    params: dict[str, Value],
    to: str,
    key: str,
    param: str,
    unit: str = "",
    *,
    low: float,
    high: float,
) -> None:
    value = entry.number(key, f"{to}.params.{param}", low=low, high=high)
    if value is not None:
        number = repr(value) if value != int(value) else str(int(value))
        params[param] = f"{number}{unit}" if unit else value


def _count(entry: Entry, params: dict[str, Value], to: str, key: str, param: str) -> None:
    value = entry.integer(key, f"{to}.params.{param}", low=1, high=1_000_000)
    if value is not None:
        params[param] = value


def place_drives(
    drives: Sequence[Drive], height: float, tubes: Sequence[Segment], names: Names
) -> list[Module]:
    """Modules of all drives, their contact points at x, y, and the controllers of type 1.

    ``height`` is that of the frame over the ground, ``tubes`` its pipes seen from above.
    """
    by_node: dict[int, list[Drive]] = {}
    for drive in drives:
        by_node.setdefault(drive.node, []).append(drive)
    modules: list[Module] = []
    for node, sharing in by_node.items():
        first = sharing[0]
        if first.steered and len(sharing) == 1:
            modules.append(_steered(first, height, tubes))
        elif all(not d.steered for d in sharing) and len(sharing) <= 2:
            modules += _pair(node, sharing, drives, height, names)
        else:
            entry = sharing[-1].entry
            entry.report.add(
                "import-node-duplicate",
                f"node {node} is given to {len(sharing)} drives",
                entry.span("node"),
                hint="every controller has a node of its own; only two drives of type 1 share one",
                labels=[Label(d.entry.span("node"), "also here") for d in sharing[:-1]],
            )
    return modules


def _comment(drive: Drive) -> str:
    return f"{drive.entry.path}, line {drive.entry.node.where.line}"


def _mount(x: float, y: float, z: float) -> dict[str, Value]:
    return {"parent": FRAME, "xyz": [x, y, z]}


def _steered(drive: Drive, height: float, tubes: Sequence[Segment]) -> Module:
    own = max(height, 2.0 * drive.radius + _OVER_STEERED_WHEEL)
    params: dict[str, Value] = dict(drive.params)
    params["height"] = own
    params["leg_side"] = "right" if drive.y >= 0.0 else "left"
    clamp = _nearest(drive.x, drive.y, tubes)
    if clamp is not None:
        params["clamp_x"], params["clamp_y"] = clamp[0] - drive.x, clamp[1] - drive.y
    return Module(
        drive.name,
        "assembly/steered_drive",
        _mount(drive.x, drive.y, own - height),
        params,
        can=drive.node,
        comments=[_comment(drive)],
    )


def _fixed(drive: Drive, height: float) -> Module:
    own = max(height, 2.0 * drive.radius + _OVER_FIXED_WHEEL)
    params: dict[str, Value] = dict(drive.params)
    params["height"] = own
    params["leg_side"] = "right" if drive.y >= 0.0 else "left"
    mount = _mount(drive.x, drive.y, own - height)
    return Module(
        drive.name,
        "assembly/fixed_drive",
        mount,
        params,
        comments=[_comment(drive), *drive.comments],
    )


def _pair(
    node: int, sharing: Sequence[Drive], drives: Sequence[Drive], height: float, names: Names
) -> list[Module]:
    """Two wheels on the two channels of one controller.

    An entry of type 1 names one place, and nothing published says where the second
    motor's wheel is.  Two entries with one node are the two wheels.  A single entry is
    taken for a wheel and its mirror image, unless a wheel is there already: then the
    second channel stays free.
    """
    first = sharing[0]
    mirror_taken = any(
        math.hypot(other.x - first.x, other.y + first.y) < _SAME_PLACE for other in drives
    )
    if len(sharing) == 1 and not mirror_taken:
        mirrored = names.make(f"{first.name}_mirrored", "drive_mirrored")
        first.entry.report.add(
            "import-assumed",
            f"`{first.entry.path}` is of type 1, two propulsion motors on one controller, and "
            f"names one place: the second wheel is put at y = {-first.y:g} m",
            first.entry.span("type"),
            hint=f"correct `{mirrored}` in the robot.yaml if it is elsewhere",
        )
        twin = Drive(
            first.entry,
            mirrored,
            False,
            node,
            first.x,
            -first.y,
            first.radius,
            first.params,
            ("assumed: the second motor's wheel, mirrored",),
        )
        sharing = [first, twin]
    channels: dict[str, Value]
    if len(sharing) == 2:
        left, right = sorted(sharing, key=lambda d: -d.y)
        channels = {"left": f"{left.name}.propulsion", "right": f"{right.name}.propulsion"}
    else:
        channels = {"left" if first.y >= 0.0 else "right": f"{first.name}.propulsion"}
        first.entry.report.add(
            "import-assumed",
            f"`{first.entry.path}` is of type 1, two propulsion motors on one controller, and "
            "names one place: the second motor has none and is left out",
            first.entry.span("type"),
            hint="wire it in the robot.yaml: channels of the controller",
        )
    controller = Module(
        names.make(f"{first.name}_controller", "controller"),
        "controller/propulsion_propulsion",
        can=node,
        channels=channels,
        comments=["the controller of type 1, two propulsion motors on one node"],
    )
    return [*(_fixed(drive, height) for drive in sharing), controller]


def _nearest(x: float, y: float, tubes: Sequence[Segment]) -> tuple[float, float] | None:
    """The nearest point of a tube, where one is in reach and not straight above."""
    best: tuple[float, float, float] | None = None
    for x1, y1, x2, y2 in tubes:
        dx, dy = x2 - x1, y2 - y1
        t = ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy)
        t = min(1.0, max(0.0, t))
        px, py = x1 + t * dx, y1 + t * dy
        distance = math.hypot(px - x, py - y)
        if best is None or distance < best[0] - 1e-9:
            best = (distance, px, py)
    if best is None or not 1e-3 < best[0] < _CLAMP_REACH:
        return None
    return best[1], best[2]


def share_params(modules: Sequence[Module]) -> dict[str, Value]:
    """Take the params that all drives have alike out of them, for `defaults`."""
    drives = [m for m in modules if m.type.startswith("assembly/")]
    if len(drives) < 2 or len({m.type for m in drives}) > 1:
        return {}
    shared = {
        key: value
        for key, value in drives[0].params.items()
        if all(key in m.params and m.params[key] == value for m in drives)
    }
    for module in drives:
        module.params = {k: v for k, v in module.params.items() if k not in shared}
    return shared


def supports(placed: Sequence[Module], entry: Entry, frame: Outline, names: Names) -> list[Module]:
    """Casters for wheels that all stand on one line, which the original's files leave out."""
    spots = [spot(m) for m in placed if m.mount is not None]
    if not _on_a_line(spots):
        return []
    x = sum(s[0] for s in spots) / len(spots)
    y = sum(s[1] for s in spots) / len(spots)
    half = max(0.3, max(abs(s[1] - y) for s in spots))
    one_wheel = len(set(spots)) == 1
    kind = "caster/fixed" if one_wheel else "caster/swivel"
    lengthwise = max(abs(s[0] - x) for s in spots) > max(abs(s[1] - y) for s in spots)
    if lengthwise:
        places = [(x, y + 0.4), (x, y - 0.4)]
    elif abs(frame.center_x - x) > 0.15:
        away = max(2.0 * abs(frame.center_x - x), _NEAREST_CASTER)
        behind = x + math.copysign(away, frame.center_x - x)
        places = [(behind, y + half), (behind, y - half)]
    elif one_wheel:
        places = [(x - 0.8, y + 0.4), (x - 0.8, y - 0.4)]
    else:
        places = [(x + 0.6, y), (x - 0.6, y)]
    post = max(frame.height, _SHORTEST_CASTER)
    entry.report.add(
        "import-assumed",
        f"the drives stand on one line and the file names no passive wheels: {len(places)} "
        f"of `{kind}` are added, at " + " and ".join(f"({px:g}, {py:g}) m" for px, py in places),
        entry.node.where,
        hint="put the real ones in their place in the robot.yaml",
    )
    return [
        Module(
            names.make(f"support_{i}", "support"),
            kind,
            _mount(px, py, post - frame.height),
            {"height": post},
            comments=["assumed: the original's files name no passive wheels"],
        )
        for i, (px, py) in enumerate(places)
    ]


def spot(module: Module) -> tuple[float, float]:
    """x and y of a module's mount."""
    xyz = module.mount["xyz"] if module.mount is not None else None
    if not isinstance(xyz, list) or not isinstance(xyz[0], float) or not isinstance(xyz[1], float):
        raise TypeError(f"{module.name} has no place")
    return xyz[0], xyz[1]


def _on_a_line(spots: Sequence[tuple[float, float]]) -> bool:
    x0, y0 = spots[0]
    far = max(spots, key=lambda s: math.hypot(s[0] - x0, s[1] - y0))
    dx, dy = far[0] - x0, far[1] - y0
    length = math.hypot(dx, dy)
    if length < 1e-6:
        return True
    return all(abs((x - x0) * dy - (y - y0) * dx) / length < 0.05 for x, y in spots)
