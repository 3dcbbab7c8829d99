"""Reads the obstacles of a world and converts each obstacle to simple geometric shapes.

The obstacles are kerbs, rails, crop rows, polytunnels, boxes, spheres and cylinders.
"""

from __future__ import annotations

import math

from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Report
from thorvaldc.model import Block, Box, Cylinder, Pose, Shape, Sphere

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
        self._blocks: list[Block] = []

    def blocks(self) -> tuple[Block, ...]:
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

    def _add(self, kind: str, name: str, shape: Shape, pose: Pose) -> None:
        """Adds one geometric shape to the world."""
        self._blocks.append(Block(kind, name, shape, pose.clean()))

    def _line(self, section: Section) -> tuple[Pose, float]:
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
        return Pose.from_xyz_rpy(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), (0.0, 0.0, yaw)), length

    def _add_kerb(self, kerb: Section, name: str) -> None:
        """Adds a kerb, which is a long box on the ground."""
        center, length = self._line(kerb)
        height = kerb["height"]
        box = Box((length, kerb["width"], height))
        self._add("kerb", name, box, center * _offset(0.0, 0.0, height / 2))

    def _add_rails(self, rails: Section, name: str) -> None:
        """Adds two pipe rails, on which a greenhouse robot drives.

        If the value of `ramp` is positive, each pipe rail has a ramp at each end.
        """
        center, length = self._line(rails)
        gauge, diameter, ramp = rails["gauge"], rails["diameter"], rails["ramp"]
        height = rails["height"] or diameter
        for side, sign in (("left", 1), ("right", -1)):
            rail_pose = Pose.from_xyz_rpy(
                (0.0, sign * gauge / 2, height - diameter / 2), (0.0, math.pi / 2, 0.0)
            )
            self._add("rail", f"{name}_{side}", Cylinder(diameter / 2, length), center * rail_pose)
            if ramp <= 0.0:
                continue
            # The lower end of a rail's ramp is half buried in the ground.  The axis of the ramp
            # meets the axis of the pipe rail at the upper end.
            rise = height - diameter / 2
            pipe = Cylinder(diameter / 2, math.hypot(ramp, rise))
            for end, direction in (("begin", -1), ("end", 1)):
                xyz = (direction * (length + ramp) / 2, sign * gauge / 2, rise / 2)
                rpy = (0.0, math.pi / 2 + direction * math.atan2(rise, ramp), 0.0)
                pose = center * Pose.from_xyz_rpy(xyz, rpy)
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
        shape: Shape
        if shape_type == "box":
            shape, height = Box(obstacle["size"]), obstacle["size"][2]
        elif shape_type == "sphere":
            shape, height = Sphere(obstacle["diameter"] / 2), obstacle["diameter"]
        else:
            height = obstacle["height"]
            shape = Cylinder(obstacle["diameter"] / 2, height)
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
        plant = Cylinder(crop["diameter"] / 2, height)
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
        post = Cylinder(tunnel["post_diameter"] / 2, height)
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


def _offset(x: float, y: float, z: float) -> Pose:
    return Pose((x, y, z))
