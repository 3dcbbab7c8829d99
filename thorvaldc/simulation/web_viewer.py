"""The 3D viewer in a web browser: the page of ``thorvaldc view`` and the data that it draws.

The JavaScript is built from the folder ``viewer/``, and ``templates/view`` contains the page.  The
surfaces of shapes come from ``pictures``.  The module also runs without numpy.  Begin with
``view_page``, or with ``page_data`` for the JSON object that the preview sends after each change of
a file.
"""

from __future__ import annotations

import base64
import functools
import json
import math
import sys
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, Literal

from thorvaldc.backends.description_parts import BLOCK_COLORS, Color
from thorvaldc.backends.mjcf import zone_color
from thorvaldc.backends.mjcf_terrain import relief, relief_of
from thorvaldc.compiler.modules.mounting import MountingPort
from thorvaldc.model import Box, Fleet, Ground, Joint, MeshShape, Pose, Robot, Shape, World, Zone
from thorvaldc.model.plugins import data_folder
from thorvaldc.model.spatial import quat_from_axis_angle
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.simulation.pictures.triangles import is_closed, shape_triangles, zone_text

PLACEHOLDER = "/*DATA*/"
"""Placeholder in the template that the data of the model replaces."""
VIEWER = "/*VIEWER*/"
"""Placeholder in the templates that ``viewer_script()`` replaces."""
PANEL = "<!--PANEL-->"
"""Placeholder in the template for more sections beside the picture."""


def view_page(model: Robot | Fleet, before: Robot | Fleet | None = None, panel: str = "") -> str:
    """Returns an HTML document that shows the model of a robot or a fleet in 3D.

    The document also shows the model ``before``, as a translucent shape at the same place.
    ``panel`` is HTML beside the picture.  The model must contain the data of the meshes.
    """
    data = page_data(model)
    if before is not None:
        data["ghost"] = page_data(before)
    # The text `</script` inside the JSON data would end the script element.
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    template = (data_folder("templates") / "view" / "page.html").read_text(encoding="utf-8")
    page = template.replace(PANEL, panel, 1).replace(PLACEHOLDER, text)
    return page.replace(VIEWER, viewer_script(), 1)


def viewer_script() -> str:
    """Returns the JavaScript of the 3D scene and of the tables beside it, for the pages."""
    folder = data_folder("templates") / "view"
    scripts = (folder / name for name in ("viewer.js", "panel.js"))
    return "\n".join(script.read_text(encoding="utf-8") for script in scripts)


# -- data ------------------------------------------------------------------------------------------

PortsOf = Callable[[Robot], Sequence[MountingPort]]


def page_data(
    model: Robot | Fleet, cache: MeshCache | None = None, ports: PortsOf | None = None
) -> dict[str, Any]:
    """Returns the data of a robot or a fleet that the viewer draws, as a JSON object.

    Lengths are in m, angles in rad, masses in kg, and quaternions in the order wxyz.  The model
    must contain the data of the meshes.  Robots with an equal design share one copy of the design
    data.

    The function takes meshes from ``cache`` and adds new ones to it.  ``ports`` returns the
    mounting ports of a robot.
    """
    shapes = Shapes({} if cache is None else cache)
    designs: list[dict[str, Any]] = []
    robots: list[dict[str, Any]] = []
    placements = (
        [(p.name, p.pose, p.robot) for p in model.placements]
        if isinstance(model, Fleet)
        else [(model.name, Pose(), model)]
    )
    for name, pose, robot in placements:
        design = robot_data(robot, shapes, ports(robot) if ports is not None else ())
        if design not in designs:
            designs.append(design)
        robots.append({"name": name, "pose": pose_values(pose), "design": designs.index(design)})
    data: dict[str, Any] = {
        "name": model.name,
        "description": model.description,
        "robots": robots,
        "designs": designs,
        "shapes": shapes.meshes,
    }
    if isinstance(model, Fleet) and model.world is not None:
        first = model.placements[0].robot  # fixed bodies have no meshes: any robot will do
        starts = tuple(p.pose for p in model.placements)
        data["world"] = world_data(model.world, starts, lambda shape: shapes.index(first, shape))
    return data


# -- robots ----------------------------------------------------------------------------------------

MeshData = dict[str, Any]
"""Points and triangles of a mesh in base64, and whether it is the surface of a closed body."""
MeshCache = dict[tuple[Shape, str], MeshData]
"""Meshes by shape and hash of the mesh file."""


class Shapes:
    """The triangle meshes of all visual shapes.  Equal shapes share one mesh."""

    def __init__(self, cache: MeshCache) -> None:
        self.meshes: list[MeshData] = []
        self._cache = cache
        self._indices: dict[tuple[Shape, str], int] = {}

    def index(self, robot: Robot, shape: Shape) -> int:
        content = ""
        if isinstance(shape, MeshShape):
            content = next(mesh.sha256 for mesh in robot.meshes if mesh.name == shape.mesh)
        key = (shape, content)
        if key not in self._indices:
            if key not in self._cache:
                points, triangles = shape_triangles(robot, shape)
                self._cache[key] = {
                    "points": base64_of("f", chain.from_iterable(points)),
                    "faces": base64_of("I", chain.from_iterable(triangles)),
                    "closed": is_closed(points, triangles),
                }
            self._indices[key] = len(self.meshes)
            self.meshes.append(self._cache[key])
        return self._indices[key]


def base64_of(kind: Literal["f", "I"], numbers: Iterable[float]) -> str:
    """Returns numbers as float32 (``f``) or uint32 (``I``), little-endian, in base64."""
    values = array(kind, numbers)
    if sys.byteorder == "big":
        values.byteswap()
    return base64.b64encode(values).decode("ascii")


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 9) for value in values]


def pose_values(pose: Pose) -> list[float]:
    """Returns a pose as [x, y, z, qw, qx, qy, qz], rounded."""
    return _rounded((*pose.xyz, *pose.quat))


def robot_data(robot: Robot, shapes: Shapes, ports: Sequence[MountingPort]) -> dict[str, Any]:
    """Returns the data of a robot that do not depend on the pose of the robot."""
    driven = sum(1 for wheel in robot.wheels if wheel.driven)
    steered = sum(1 for wheel in robot.wheels if wheel.steered)
    tree = tree_of(robot)
    starts = {servo.joint: servo.initial for servo in robot.joint_servos}
    links = tree.links_below(robot.links[0].name)  # parents first: the page computes poses so
    return {
        "facts": f"{robot.inertial.mass:.1f} kg, {len(robot.wheels)} wheels"
        f" ({driven} driven, {steered} steered)",
        "links": [
            {
                "name": link.name,
                "module": link.module,
                "mass": 0.0 if link.inertial is None else round(link.inertial.mass, 6),
                "visuals": [
                    {
                        "shape": shapes.index(robot, visual.shape),
                        "pose": pose_values(visual.pose),
                        "color": _rounded(visual.color),
                    }
                    for visual in link.visuals
                ],
            }
            for link in robot.links
        ],
        "joints": [_joint(tree.parent_joint[link], starts) for link in links[1:]],
        "frames": [
            *({"name": s.name, "kind": "sensor", "link": s.link} for s in robot.sensors),
            *({"name": link.name, "kind": "link", "link": link.name} for link in robot.links),
            *(
                {
                    "name": p.name,
                    "kind": "port",
                    "link": p.link,
                    "pose": pose_values(p.pose),
                    "note": "taken" if p.carries else "free",
                }
                for p in ports
            ),
        ],
        "ports": [{"name": p.name, "kind": p.kind, "carries": list(p.carries)} for p in ports],
        "nodes": [
            {
                "bus": bus.name,
                "name": node.name,
                "module": node.module,
                "id": node.id,
                "id_space": node.id_space,
                "serial": node.serial,
            }
            for bus in robot.buses
            for node in bus.nodes
        ],
    }


def _joint(joint: Joint, starts: Mapping[str, float]) -> dict[str, Any]:
    lower, upper = joint.lower, joint.upper
    if joint.type == "continuous" or lower is None or upper is None:
        lower, upper = -math.pi, math.pi
    value: dict[str, Any] = {
        "name": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "pose": pose_values(joint.pose),
        "axis": _rounded(joint.axis),
        "lower": lower,
        "upper": upper,
    }
    if starts.get(joint.name):
        value["start"] = starts[joint.name]
    if joint.mimic is not None:
        value["mimic"] = {
            "joint": joint.mimic.joint,
            "multiplier": joint.mimic.multiplier,
            "offset": joint.mimic.offset,
        }
    return value


# -- world -----------------------------------------------------------------------------------------

GROUND_COLOR = (0.68, 0.64, 0.55, 1.0)
MAX_CELLS = 40_000
"""Largest number of cells of a height grid in the page."""
_PLATE = 0.004
"""Thickness in m of the plate of the first level zone.  Plates of later zones are thicker, so that
the last one is visible where zones overlap."""


def world_data(
    world: World, starts: Sequence[Pose], index: Callable[[Shape], int]
) -> dict[str, Any]:
    """Returns the data of a world that the viewer draws, as a JSON object.

    The poses are relative to the ground plane, which the viewer turns by ``tilt`` (quaternion
    wxyz).  Heights of reliefs are in m, row by row along y.

    Parameters
    ----------
    starts : start poses of the robots, around which rough ground is level.
    index : function that returns the index of the mesh of a shape.
    """
    bodies = [
        _body(block.kind, block.name, index(block.shape), block.pose, BLOCK_COLORS[block.kind])
        for block in world.blocks
    ]
    reliefs = []
    for number, zone in enumerate(world.zones, 1):
        if zone.level:
            plate = Box((*zone.size, _PLATE * (1.0 + number / len(world.zones))))
            text = zone_text(zone, ", ")
            bodies.append(_body("zone", text, index(plate), zone.pose, zone_color(zone)))
        else:
            reliefs.append(
                {
                    "kind": "zone",
                    "pose": pose_values(zone.pose),
                    "color": zone_color(zone),
                    **_zone_relief(zone),
                }
            )
    ground = world.ground
    if not ground.even:
        reliefs.append(_ground_relief(ground, tuple(starts)))
    axis = (math.sin(ground.direction), -math.cos(ground.direction), 0.0)
    return {
        "text": _text(world),
        "tilt": list(quat_from_axis_angle(axis, ground.angle)),
        "bodies": bodies,
        "reliefs": reliefs,
    }


def _body(kind: str, name: str, shape: int, pose: Pose, color: Color) -> dict[str, Any]:
    values = pose_values(pose)
    return {"kind": kind, "name": name, "shape": shape, "pose": values, "color": color}


# The same ground is drawn after each change of a file; random heights take some 0.1 s.
@functools.lru_cache(maxsize=8)
def _ground_relief(ground: Ground, starts: tuple[Pose, ...]) -> dict[str, Any]:
    ground_relief = relief_of(ground, starts)
    low = Pose((*ground_relief.center, ground_relief.low))
    grid = _relief(ground_relief.size, ground_relief.rows, ground_relief.height)
    return {"kind": "ground", "pose": pose_values(low), "color": GROUND_COLOR, **grid}


@functools.lru_cache(maxsize=32)
def _zone_relief(zone: Zone) -> dict[str, Any]:
    rows, top = relief(zone)
    return _relief(zone.size, rows, top)


def _relief(size: tuple[float, float], rows: list[list[float]], top: float) -> dict[str, Any]:
    """Returns a height grid, of which every n-th row and column is left in a large one."""
    counts = (len(rows), len(rows[0]))
    step = math.ceil(math.sqrt(counts[0] * counts[1] / MAX_CELLS))
    ys, xs = (_samples(count, step) for count in counts)
    return {
        "size": list(size),
        "rows": len(ys),
        "columns": len(xs),
        "heights": base64_of("f", (top * rows[y][x] for y in ys for x in xs)),
    }


def _samples(count: int, step: int) -> list[int]:
    """Returns about every ``step``-th index of ``count`` ones, with equal gaps and both ends."""
    gaps = max(2, math.ceil(count / step)) - 1
    gap = (count - 1) / gaps
    return [*(round(i * gap) for i in range(gaps)), count - 1]


def _text(world: World) -> str:
    ground, parts = world.ground, []
    if ground.angle:
        uphill = math.degrees(ground.direction)
        parts.append(f"slope {math.degrees(ground.angle):.3g} deg (uphill at {uphill:.3g} deg)")
    if ground.heights is not None:
        x, y = ground.heights.size
        parts.append(f"height map of {x:.3g} m x {y:.3g} m")
    if ground.amplitude:
        parts.append(f"bumps of {1e3 * ground.amplitude:.3g} mm")
    counts = Counter(block.kind for block in world.blocks)
    counts["zone"] = len(world.zones)
    parts += [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
    return ", ".join(parts)
