"""Reads the world of a scenario (ground, zones, obstacles), and checks where robots start in it.

A robot starts in an obstacle if one of its collision shapes is inside it, so that a tall robot may
start above a row of plants.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from thorvaldc import model
from thorvaldc.compiler.scenario.height_maps import read_height_map
from thorvaldc.compiler.source.node import Node, insertion, removal
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Proposal, Report, plain
from thorvaldc.model import spatial
from thorvaldc.model.statics.convex_bodies import ConvexBody, overlap_along, overlap_of
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.occupied_space import solids_of
from thorvaldc.model.sums import float_sum

_KEYS_OF_SLOPES = ("angle", "direction")
_KEYS_OF_ROUGH_GROUND = ("amplitude", "wavelength", "seed", "size")
_KEYS_OF_MAPS = ("file", "height")
_TYPES = {
    **dict.fromkeys(_KEYS_OF_SLOPES, "slope"),
    **dict.fromkeys(_KEYS_OF_ROUGH_GROUND, "rough"),
    **dict.fromkeys(_KEYS_OF_MAPS, "map"),
}


def read_world(world: Section, folder: Path, files: dict[str, Path], report: Report) -> model.World:
    """Returns the world (ground, zones and obstacles) of a scenario document.

    The default world is level ground without obstacles.

    - ``folder``: folder to which the paths of the document are relative.
    - ``files``: the function adds each file that was read, by its name in spans.
    """
    ground = model.Ground()
    if "ground" in world:
        ground = _ground(world["ground"], folder, files, report)
    zones = tuple(read_zones(world["zones"], report))
    blocks = ObstacleReader(world, report).blocks()
    if ground.heights is None:
        return model.World(ground, blocks, zones)
    for key in ("zones", "kerbs", "rails"):
        if world[key]:
            report.add(
                "conflicting-keys",
                f"ground of the type `map` has no `{key}`",
                world.entry(key).where,
                hint=removal("leave them out, or make them a part of the map", world.node, key),
            )
    return model.World(ground, tuple(_on(ground.heights, block) for block in blocks))


def _on(heights: model.HeightMap, block: model.Block) -> model.Block:
    """Returns a block at the height of the ground."""
    x, y, _ = block.pose.xyz
    return replace(block, pose=_offset(0.0, 0.0, heights.height(x, y)) * block.pose)


def standing(placement: model.Placement, heights: model.HeightMap) -> model.Placement:
    """Returns a robot that stands on a height map, in parallel to the plane through its wheels.

    The plane has the least squared distances to the ground under the wheels.  No wheel is in the
    ground.
    """
    x, y, z = placement.pose.xyz
    points = [placement.pose.apply((w.x, w.y, 0.0)) for w in placement.robot.wheels]
    places = [(a - x, b - y, heights.height(a, b)) for a, b, _ in points]
    slope_x, slope_y, middle = _plane(places) if places else (0.0, 0.0, heights.height(x, y))
    rise = max((h - (middle + slope_x * a + slope_y * b) for a, b, h in places), default=0.0)
    length = math.hypot(slope_x, slope_y, 1.0)
    upright = (-slope_x / length, -slope_y / length, 1.0 / length)
    tilt = model.Pose((0.0, 0.0, 0.0), spatial.quat_from_z_to(upright))
    foot = _offset(x, y, z + middle + rise)
    turned = replace(placement.pose, xyz=(0.0, 0.0, 0.0))
    return replace(placement, pose=(foot * tilt * turned).clean())


def _plane(points: Sequence[model.Vec3]) -> model.Vec3:
    """Returns a, b and c of the plane z = a x + b y + c with the least squared distances along z.

    If the points are in a line on the ground, the plane is level across the line.
    """
    count = len(points)
    x, y, z = (float_sum(axis) / count for axis in zip(*points, strict=True))
    away = [(p[0] - x, p[1] - y, p[2] - z) for p in points]
    xx, xy, yy, xz, yz = (
        float_sum(p[i] * p[j] for p in away) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2))
    )
    spread, area = xx + yy, xx * yy - xy * xy
    if area > 1e-6 * spread * spread:
        a, b = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    else:
        a, b = (xz / spread, yz / spread) if spread else (0.0, 0.0)
    return a, b, z - a * x - b * y


def with_friction(robot: model.Robot, coefficient: float) -> model.Robot:
    """Returns a copy of the robot in which all wheels have the same friction coefficient."""
    wheels = (replace(wheel, friction=coefficient) for wheel in robot.wheels)
    return replace(robot, wheels=tuple(wheels))


def _ground(ground: Section, folder: Path, files: dict[str, Path], report: Report) -> model.Ground:
    """Reads the ground of the world, and reports keys that have no effect on the type of the
    ground.
    """
    node, ground_type = ground.node, ground["type"]
    keys_without_effect = {
        "plane": (*_KEYS_OF_SLOPES, *_KEYS_OF_ROUGH_GROUND, *_KEYS_OF_MAPS),
        "slope": (*_KEYS_OF_ROUGH_GROUND, *_KEYS_OF_MAPS),
        "rough": _KEYS_OF_MAPS,
        "map": ("amplitude", "wavelength", "seed"),
    }
    for key in keys_without_effect.get(ground_type, ()):
        entry = node.get(key)
        if entry is not None and "type" in ground:
            suitable_type = _TYPES[key]
            report.add(
                "conflicting-keys",
                f"`{key}` has no effect on ground of type `{ground_type}`",
                entry.where,
                hint=removal(f"leave it out, or choose `type: {suitable_type}`", node, key),
            )
    if ground_type == "slope" and node.get("angle") is None:
        hint = insertion("add `angle: 10 deg`", node, "angle", "10 deg", is_example=True)
        report.add("missing-key", "a slope has no `angle`", node.where, hint=hint)
    slope = model.Ground(ground["angle"] or 0.0, ground["direction"])
    if ground_type == "map":
        return replace(slope, heights=read_height_map(ground, folder, files, report))
    if ground_type != "rough":
        return slope
    _check_size(ground, report)
    rough = {key: ground[key] for key in _KEYS_OF_ROUGH_GROUND}
    return replace(slope, **rough)


def _check_size(ground: Section, report: Report) -> None:
    """Reports rough ground with too many cells of the height field, or without an extent."""
    size, wavelength = ground["size"], ground["wavelength"]
    cells = math.prod(edge / wavelength * CELLS_PER_WAVE for edge in size)
    if min(size) >= 1.0 and cells <= MAX_CELLS:
        return
    report.add(
        "out-of-range",
        f"rough ground of {plain(size[0])} m x {plain(size[1])} m with waves of "
        f"{plain(wavelength)} m has {cells:.3g} cells; it must be at least 1 m long and have at "
        f"most {MAX_CELLS}",
        ground.entry("size").where,
        hint="choose longer waves, or less ground",
    )


# -- zones of the ground -----------------------------------------------------------------

MAX_CELLS = 1_000_000
CELLS_PER_WAVE = 10
"""Number of height field cells per wave of rough ground.

With fewer cells per wave, the edges between cells add rolling resistance.
"""
LARGEST_CELL = 0.1  # Largest edge length of a cell of the ground's height field (m).


def read_zones(zones: Iterable[Section], report: Report) -> Iterator[model.Zone]:
    """Yields each valid zone in the list `zones` of a scenario document."""
    for zone in zones:
        node, size = zone.node, zone["size"]
        amplitude, wavelength = zone["amplitude"], zone["wavelength"]
        cell = min(LARGEST_CELL, wavelength / CELLS_PER_WAVE) if amplitude else LARGEST_CELL
        count = math.prod(edge / cell for edge in size)
        if not (min(size) > 0.0 and count <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"a zone of {plain(size[0])} m x {plain(size[1])} m has {count:.3g} cells; it must "
                f"have an extent, and at most {MAX_CELLS} cells",
                zone.entry("size").where,
            )
            continue
        _check_keys(node, report)
        yield model.Zone(
            zone.planar_pose(),
            size,
            zone["friction"],
            zone["rolling_resistance"],
            zone["height"],
            zone["slope"],
            amplitude,
            wavelength,
            zone["seed"],
        )


def _check_keys(zone_node: Node, report: Report) -> None:
    """Reports each key of a ground zone that has no effect because another key is missing.

    For example, `wavelength` has no effect in a zone without `amplitude`.
    """
    for key, base in (("wavelength", "amplitude"), ("seed", "amplitude"), ("slope", "height")):
        entry = zone_node.get(key)
        if entry is not None and zone_node.get(base) is None:
            report.add(
                "conflicting-keys",
                f"`{key}` has no effect in a zone without `{base}`",
                entry.where,
                hint=removal(f"leave it out, or add `{base}`", zone_node, key),
            )


# -- obstacles: kerbs, rails, crop rows, polytunnels, boxes, spheres and cylinders -------

MAX_BLOCKS = 5000
"""Greatest number of blocks in a world.

MuJoCo needs minutes to load a world with more geoms.
"""
_KEYS_OF_SHAPES = {"box": ("size",), "sphere": ("diameter",), "cylinder": ("diameter", "height")}


class ObstacleReader:
    """Reads the obstacles in the section ``world`` of a scenario document."""

    def __init__(self, world: Section, report: Report) -> None:
        self._report = report
        self._world = world
        self._blocks: list[model.Block] = []

    def blocks(self) -> tuple[model.Block, ...]:
        """Returns the shapes of all obstacles in the world.

        Returns an empty tuple and reports an error if the obstacles consist of too many shapes.
        """
        for key, add in (
            ("kerbs", self._add_kerb),
            ("rails", self._add_rails),
            ("crop_rows", self._add_crop),
            ("polytunnels", self._add_tunnel),
        ):
            for number, section in enumerate(self._world[key], 1):
                add(section, str(number))
        for name, obstacle in self._world["obstacles"].items():
            self._add_obstacle(obstacle, name)
        if len(self._blocks) > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the world has {len(self._blocks)} blocks; it must have at most {MAX_BLOCKS}",
                self._world.node.where,
                hint="make the rows of plants or the tunnels shorter",
            )
            return ()
        return tuple(self._blocks)

    def _add(self, kind: str, name: str, shape: model.Shape, pose: model.Pose) -> None:
        """Adds one geometric shape to the world."""
        self._blocks.append(model.Block(kind, name, shape, pose.clean()))

    def _line(self, section: Section) -> tuple[model.Pose, float]:
        """Returns the pose and the length (m) of the line between the points `from` and `to`.

        The pose of the line has the origin in the middle of the line and the x axis along the line.
        """
        (x0, y0), (x1, y1) = section["from"], section["to"]
        length = math.hypot(x1 - x0, y1 - y0)
        if length == 0.0:
            self._report.add(
                "out-of-range",
                "`from` and `to` are equal; the line must have a length",
                section.entry("to").span,
            )
            length = 1.0
        yaw = math.atan2(y1 - y0, x1 - x0)
        return model.Pose.from_xyz_rpy(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), (0.0, 0.0, yaw)), length

    def _add_kerb(self, kerb: Section, name: str) -> None:
        """Adds a kerb, which is a long box on the ground."""
        center, length = self._line(kerb)
        height = kerb["height"]
        box = model.Box((length, kerb["width"], height))
        self._add("kerb", name, box, center * _offset(0.0, 0.0, height / 2))

    def _add_rails(self, rails: Section, name: str) -> None:
        """Adds two pipe rails, on which a greenhouse robot drives.

        If the value of `ramp` is positive, each pipe rail has a ramp at each end.
        """
        center, length = self._line(rails)
        gauge, diameter, ramp = rails["gauge"], rails["diameter"], rails["ramp"]
        height = rails["height"] or diameter
        for side, sign in (("left", 1), ("right", -1)):
            rail_pose = model.Pose.from_xyz_rpy(
                (0.0, sign * gauge / 2, height - diameter / 2), (0.0, math.pi / 2, 0.0)
            )
            self._add(
                "rail", f"{name}_{side}", model.Cylinder(diameter / 2, length), center * rail_pose
            )
            if ramp <= 0.0:
                continue
            # The lower end of a rail's ramp is half buried in the ground.  The axis of the ramp
            # meets the axis of the pipe rail at the upper end.
            rise = height - diameter / 2
            pipe = model.Cylinder(diameter / 2, math.hypot(ramp, rise))
            for end, direction in (("begin", -1), ("end", 1)):
                xyz = (direction * (length + ramp) / 2, sign * gauge / 2, rise / 2)
                rpy = (0.0, math.pi / 2 + direction * math.atan2(rise, ramp), 0.0)
                pose = center * model.Pose.from_xyz_rpy(xyz, rpy)
                self._add("rail", f"{name}_{side}_{end}", pipe, pose)

    def _add_obstacle(self, obstacle: Section, name: str) -> None:
        """Adds a box, a sphere or a cylinder that stands on the ground."""
        shape_type, node = obstacle["shape"], obstacle.node
        needed_keys = _KEYS_OF_SHAPES[shape_type]
        for key in needed_keys:
            if node.get(key) is None:
                self._report.add("missing-key", f"a {shape_type} has no `{key}`", node.where)
        for key in ("size", "diameter", "height"):
            entry = node.get(key)
            if entry is not None and "shape" in obstacle and key not in needed_keys:
                self._report.add("conflicting-keys", f"a {shape_type} has no `{key}`", entry.where)
        if not all(key in obstacle for key in needed_keys):
            return
        shape: model.Shape
        if shape_type == "box":
            shape, height = model.Box(obstacle["size"]), obstacle["size"][2]
        elif shape_type == "sphere":
            shape, height = model.Sphere(obstacle["diameter"] / 2), obstacle["diameter"]
        else:
            height = obstacle["height"]
            shape = model.Cylinder(obstacle["diameter"] / 2, height)
        pose = obstacle.planar_pose() * _offset(0.0, 0.0, height / 2)
        self._add("obstacle", name, shape, pose)

    def _add_crop(self, crop: Section, name: str) -> None:
        """Adds rows of crop plants to the world.

        The document contains the pose of the first plant.  The rows of plants are parallel to the x
        axis of the first plant's pose.
        """
        first, height = crop.planar_pose(), crop["height"]
        rows, plants = crop["rows"], crop["plants"]
        row_spacing, plant_spacing = crop["row_spacing"], crop["plant_spacing"]
        plant = model.Cylinder(crop["diameter"] / 2, height)
        if rows * plants > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the rows have {rows * plants} plants; they must have at most {MAX_BLOCKS}",
                crop.node.where,
            )
            return
        for row in range(rows):
            for i in range(plants):
                pose = first * _offset(i * plant_spacing, row * row_spacing, height / 2)
                self._add("crop", f"{name}_{row + 1}_{i + 1}", plant, pose)

    def _add_tunnel(self, tunnel: Section, name: str) -> None:
        """Adds the two rows of posts of a polytunnel to the world.

        The document contains the pose of the polytunnel, with the origin in the middle of the
        entrance.  The rows of posts are parallel to the x axis of the polytunnel's pose.
        """
        entrance, width = tunnel.planar_pose(), tunnel["width"]
        spacing, height = tunnel["post_spacing"], tunnel["post_height"]
        post = model.Cylinder(tunnel["post_diameter"] / 2, height)
        posts = math.floor(tunnel["length"] / spacing + 1e-9) + 1
        if 2 * posts > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the tunnel has {2 * posts} posts; it must have at most {MAX_BLOCKS}",
                tunnel.node.where,
            )
            return
        for side, sign in (("left", 1), ("right", -1)):
            for i in range(posts):
                pose = entrance * _offset(i * spacing, sign * width / 2, height / 2)
                self._add("post", f"{name}_{side}_{i + 1}", post, pose)


def _offset(x: float, y: float, z: float) -> model.Pose:
    return model.Pose((x, y, z))


# -- where robots start ------------------------------------------------------------------

_TOLERANCE = 0.01  # Overlap (m) that is not reported.
_WAYS = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))
_CARRYING = ("kerb", "rail")  # kinds of blocks on which wheels may stand
_SECTIONS = {"crop": "crop_rows", "post": "polytunnels"}


def check_starts(fleet: model.Fleet, world: Section, report: Report) -> None:
    """Checks that no robot starts inside raised ground."""
    zone_sections = world["zones"]
    zones = fleet.world.zones if fleet.world is not None else ()
    if len(zone_sections) != len(zones):
        return  # A zone of the document is invalid.
    for section, zone in zip(zone_sections, zones, strict=True):
        if zone.level:
            continue
        for placement in fleet.placements:
            points = (placement.pose.apply((w.x, w.y, 0.0)) for w in placement.robot.wheels)
            if placement.pose.xyz[2] <= zone.pose.xyz[2] and any(
                zone.holds(x, y) for x, y, _ in points
            ):
                report.add(
                    "zone-under-robot",
                    f"{placement.name} starts inside raised ground",
                    section.node.where,
                    hint="start it beside the zone, or at the height of the ground there",
                )


def check_obstacles(fleet: model.Fleet, world: Section, report: Report) -> None:
    """Reports each robot that starts inside an obstacle, a plant or a post."""
    blocks = [
        (block, ConvexBody(block.shape, block.pose))
        for block in (fleet.world.blocks if fleet.world is not None else ())
        if block.kind not in _CARRYING
    ]
    for placement in fleet.placements if blocks else ():
        parts = list(_parts(placement))
        reported: set[int] = set()
        for block, body in blocks:
            node = _node(block, world.node)
            if node is None or id(node) in reported:
                continue
            depths = [
                overlap_of(part, body, _TOLERANCE).depth
                for part in parts
                if math.dist(part.center, body.center) < part.reach + body.reach
            ]
            depth = max(depths, default=0.0)
            if depth > _TOLERANCE:
                reported.add(id(node))
                distances = (
                    (max(overlap_along(part, body, way) for part in parts), way) for way in _WAYS
                )
                _report(placement, block, node, depth, min(distances), report)


def _report(
    placement: model.Placement,
    block: model.Block,
    node: Node,
    depth: float,
    way: tuple[float, model.Vec3],
    report: Report,
) -> None:
    """Reports a block that is inside a robot by ``depth`` (m), and that is beside the robot after
    the ``way``, a distance (m) in a direction."""
    what = {"crop": "a plant", "post": "a post"}.get(block.kind, f"the obstacle `{block.name}`")
    hint = "start the robot beside it"
    position = node.get("xyz")
    if block.kind == "obstacle" and position is not None:
        distance, direction = way
        x, y, _ = spatial.add(block.pose.xyz, spatial.scale(distance + 0.5, direction))
        moved = ", ".join(f"{plain(round(value, 2))} m" for value in (x, y, 0.0))
        hint = Proposal(
            f"move one of them, for example the obstacle to `[{moved}]`",
            f"[{moved}]",
            span=position.span,
            is_example=True,
        )
    report.add(
        "start-in-obstacle",
        f"`{placement.name}` starts {depth:.2f} m inside {what}",
        node.where,
        hint=hint,
    )


def _node(block: model.Block, world: Node) -> Node | None:
    """Returns the YAML node of a block."""
    if block.kind == "obstacle":
        return entries(world.get("obstacles")).get(block.name)
    nodes = items(world.get(_SECTIONS.get(block.kind, block.kind)))
    number = int(block.name.partition("_")[0])
    return nodes[number - 1] if number <= len(nodes) else None


def _parts(placement: model.Placement) -> Iterator[ConvexBody]:
    """Yields the collision shapes of a placed robot in the world, with all joints at zero."""
    poses = tree_of(placement.robot).pose
    for name, solids in solids_of(placement.robot, with_visuals=False).items():
        for shape, pose, data in solids:
            yield ConvexBody(shape, placement.pose * poses[name] * pose, data)
