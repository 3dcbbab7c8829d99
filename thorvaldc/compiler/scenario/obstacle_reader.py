"""Reads the obstacles of a world and converts each obstacle to simple geometric shapes.

The obstacles are kerbs, rails, crop rows, polytunnels, boxes, spheres and cylinders.
"""

from __future__ import annotations

import math

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.value_reader import entries, items
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Block, Box, Cylinder, Pose, Shape, Sphere

MAX_BLOCKS = 5000
"""Greatest number of blocks in a world.

MuJoCo needs minutes to load a world with more geoms.
"""
_KEYS_OF_SHAPES = {"box": ("size",), "sphere": ("diameter",), "cylinder": ("diameter", "height")}


class ObstacleReader:
    """Reads the obstacles in the section ``world`` of a scenario document."""

    def __init__(self, quantities: BoundedQuantities, report: Report, world: Node) -> None:
        self._quantities = quantities
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
            for number, node in enumerate(items(self._world.get(key)), 1):
                add(node, str(number))
        for name, node in entries(self._world.get("obstacles")).items():
            self._add_obstacle(node, name)
        if len(self._blocks) > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the world has {len(self._blocks)} blocks; it must have at most {MAX_BLOCKS}",
                self._world.where,
                hint="make the rows of plants or the tunnels shorter",
            )
            return ()
        return tuple(self._blocks)

    def _add(self, kind: str, name: str, shape: Shape, pose: Pose) -> None:
        """Adds one geometric shape to the world."""
        self._blocks.append(Block(kind, name, shape, pose.clean()))

    def _line(self, node: Node) -> tuple[Pose, float]:
        """Returns the pose and the length (m) of the line between the points `from` and `to`.

        The pose of the line has the origin in the middle of the line and the x axis along the line.
        """
        x0, y0 = self._quantities.pair(node, "from", (0.0, 0.0))
        x1, y1 = self._quantities.pair(node, "to", (1.0, 0.0))
        length = math.hypot(x1 - x0, y1 - y0)
        if length == 0.0:
            self._report.add(
                "out-of-range",
                "`from` and `to` are equal; the line must have a length",
                (node.get("to") or node).span,
            )
            length = 1.0
        yaw = math.atan2(y1 - y0, x1 - x0)
        return Pose.from_xyz_rpy(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), (0.0, 0.0, yaw)), length

    def _add_kerb(self, node: Node, name: str) -> None:
        """Adds a kerb, which is a long box on the ground."""
        center, length = self._line(node)
        width = self._quantities.positive(node, "width", "length", 0.15)
        height = self._quantities.positive(node, "height", "length", 0.05)
        self._add(
            "kerb", name, Box((length, width, height)), center * _offset(0.0, 0.0, height / 2)
        )

    def _add_rails(self, node: Node, name: str) -> None:
        """Adds two pipe rails, on which a greenhouse robot drives.

        If the value of `ramp` is positive, each pipe rail has a ramp at each end.
        """
        center, length = self._line(node)
        gauge = self._quantities.positive(node, "gauge", "length", 0.6)
        diameter = self._quantities.positive(node, "diameter", "length", 0.051)
        height = self._quantities(node, "height", "length", diameter, least=0.0, above=True)
        ramp = self._quantities(node, "ramp", "length", least=0.0)
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

    def _add_obstacle(self, node: Node, name: str) -> None:
        """Adds a box, a sphere or a cylinder that stands on the ground."""
        pose, quantities = self._quantities.planar_pose(node), self._quantities
        shape_node = node.get("shape")
        shape_type = shape_node.value if shape_node is not None else None
        needed_keys = _KEYS_OF_SHAPES.get(str(shape_type), ())
        for key in needed_keys:
            if node.get(key) is None:
                self._report.add("missing-key", f"a {shape_type} has no `{key}`", node.where)
                return
        for key in ("size", "diameter", "height"):
            entry = node.get(key)
            if entry is not None and needed_keys and key not in needed_keys:
                self._report.add("conflicting-keys", f"a {shape_type} has no `{key}`", entry.where)
        shape: Shape
        if shape_type == "box":
            size = quantities.scope.vector(node.get("size"), "length")
            if min(size) <= 0.0:
                span = (node.get("size") or node).span
                self._report.add("out-of-range", "a box has three lengths of more than 0", span)
                return
            shape, height = Box(size), size[2]
        else:
            diameter = quantities.positive(node, "diameter", "length", 1.0)
            height = quantities.positive(node, "height", "length", 1.0)
            shape = Cylinder(diameter / 2, height)
            if shape_type == "sphere":
                shape, height = Sphere(diameter / 2), diameter
        self._add("obstacle", name, shape, pose * _offset(0.0, 0.0, height / 2))

    def _add_crop(self, node: Node, name: str) -> None:
        """Adds rows of crop plants to the world.

        The document contains the pose of the first plant.  The rows of plants are parallel to the x
        axis of the first plant's pose.
        """
        first, quantities = self._quantities.planar_pose(node), self._quantities
        rows, plants = _count(node, "rows"), _count(node, "plants")
        row_spacing = quantities.positive(node, "row_spacing", "length", 1.0)
        plant_spacing = quantities.positive(node, "plant_spacing", "length", 0.3)
        height = quantities.positive(node, "height", "length", 0.4)
        plant = Cylinder(quantities.positive(node, "diameter", "length", 0.06) / 2, height)
        if rows * plants > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the rows have {rows * plants} plants; they must have at most {MAX_BLOCKS}",
                node.where,
            )
            return
        for row in range(rows):
            for i in range(plants):
                pose = first * _offset(i * plant_spacing, row * row_spacing, height / 2)
                self._add("crop", f"{name}_{row + 1}_{i + 1}", plant, pose)

    def _add_tunnel(self, node: Node, name: str) -> None:
        """Adds the two rows of posts of a polytunnel to the world.

        The document contains the pose of the polytunnel, with the origin in the middle of the
        entrance.  The rows of posts are parallel to the x axis of the polytunnel's pose.
        """
        entrance, quantities = self._quantities.planar_pose(node), self._quantities
        length = quantities.positive(node, "length", "length", 10.0)
        width = quantities.positive(node, "width", "length", 6.5)
        spacing = quantities.positive(node, "post_spacing", "length", 2.2)
        height = quantities.positive(node, "post_height", "length", 2.0)
        post = Cylinder(quantities.positive(node, "post_diameter", "length", 0.06) / 2, height)
        posts = math.floor(length / spacing + 1e-9) + 1
        if 2 * posts > MAX_BLOCKS:
            self._report.add(
                "out-of-range",
                f"the tunnel has {2 * posts} posts; it must have at most {MAX_BLOCKS}",
                node.where,
            )
            return
        for side, sign in (("left", 1), ("right", -1)):
            for i in range(posts):
                pose = entrance * _offset(i * spacing, sign * width / 2, height / 2)
                self._add("post", f"{name}_{side}_{i + 1}", post, pose)


def _offset(x: float, y: float, z: float) -> Pose:
    return Pose((x, y, z))


def _count(node: Node, key: str) -> int:
    entry = node.get(key)
    return entry.value if entry is not None and isinstance(entry.value, int) else 1
