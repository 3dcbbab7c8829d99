"""The world of a scenario document: the ground, and everything on it as single blocks."""

from __future__ import annotations

import math

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.scenario.ground_zones import CELLS_PER_WAVE, MAX_CELLS, read_zones
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Block, Box, Cylinder, Ground, Pose, Robot, Shape, Sphere, World

MAX_BLOCKS = 5000
"""More geoms than these take a simulation minutes to load."""

_OF_SLOPES = ("angle", "direction")
_OF_BUMPS = ("amplitude", "wavelength", "seed", "size")


def read_world(document: Node, numbers: BoundedQuantities, report: Report) -> World:
    node = document.get("world")
    if node is None:
        return World(Ground())
    ground = node.get("ground")
    blocks = _Blocks(numbers, report, node)
    return World(
        _ground(ground, numbers, report) if ground is not None else Ground(),
        blocks.all(),
        tuple(read_zones(node.get("zones"), numbers, report)),
    )


def friction(document: Node, numbers: BoundedQuantities) -> float | None:
    """The coefficient that wheels have in this world; ``None``: their own."""
    node = document.get("world")
    if node is None or node.get("friction") is None:
        return None
    return numbers(node, "friction", "number", 1.0, least=0.0, most=5.0, above=True)


def with_friction(robot: Robot, mu: float) -> Robot:
    from dataclasses import replace

    return replace(robot, wheels=tuple(replace(wheel, friction=mu) for wheel in robot.wheels))


def _ground(node: Node, numbers: BoundedQuantities, report: Report) -> Ground:
    type_ = node.get("type")
    kind = type_.value if type_ is not None else None
    wrong = {"plane": (*_OF_SLOPES, *_OF_BUMPS), "slope": _OF_BUMPS}.get(str(kind), ())
    for key in wrong:
        entry = node.get(key)
        if entry is not None:
            wanted = "rough" if key in _OF_BUMPS else "slope"
            report.add(
                "conflicting-keys",
                f"`{key}` says nothing of ground of type `{kind}`",
                entry.where,
                hint=f"leave it out, or choose `type: {wanted}`",
            )
    if kind == "slope" and node.get("angle") is None:
        report.add("missing-key", "a slope has no `angle`", node.where, hint="add `angle: 10 deg`")
    amplitude, wavelength, seed, size = 0.0, 1.0, 0, (30.0, 30.0)
    if kind == "rough":
        amplitude = numbers(node, "amplitude", "length", 0.02, least=0.0, most=1.0)
        wavelength = numbers(node, "wavelength", "length", 1.0, least=0.05, most=100.0)
        found = node.get("seed")
        seed = found.value if found is not None and isinstance(found.value, int) else 0
        size = numbers.pair(node, "size", size)
        cells = math.prod(edge / wavelength * CELLS_PER_WAVE for edge in size)
        if not (min(size) >= 1.0 and cells <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"rough ground of {size[0]:g} m x {size[1]:g} m with waves of {wavelength:g} m has "
                f"{cells:.3g} cells; it must be at least 1 m long and have at most {MAX_CELLS}",
                (node.get("size") or node).where,
                hint="take longer waves, or less ground",
            )
            size = (30.0, 30.0)
    return Ground(
        numbers(node, "angle", "angle", least=0.0, most=math.radians(60.0)),
        numbers(node, "direction", "angle"),
        amplitude,
        wavelength,
        seed,
        size,
    )


class _Blocks:
    """Expands what stands around into single things."""

    def __init__(self, numbers: BoundedQuantities, report: Report, world: Node) -> None:
        self.numbers = numbers
        self.report = report
        self.world = world
        self.found: list[Block] = []

    def all(self) -> tuple[Block, ...]:
        for key, make in (
            ("kerbs", self._kerb),
            ("rails", self._rails),
            ("crop_rows", self._crop),
            ("polytunnels", self._tunnel),
        ):
            listed = self.world.get(key)
            items = listed.value if listed is not None else None
            for number, node in enumerate(items if isinstance(items, tuple) else (), 1):
                make(node, str(number))
        named = self.world.get("obstacles")
        entries = named.value if named is not None else None
        for name, node in (entries if isinstance(entries, dict) else {}).items():
            self._obstacle(node, name)
        if len(self.found) > MAX_BLOCKS:
            self.report.add(
                "out-of-range",
                f"the world has {len(self.found)} things in it; it must have at most {MAX_BLOCKS}",
                self.world.where,
                hint="make the rows of plants or the tunnels shorter",
            )
            return ()
        return tuple(self.found)

    def _add(self, kind: str, name: str, shape: Shape, pose: Pose) -> None:
        self.found.append(Block(kind, name, shape, pose.clean()))

    def _line(self, node: Node) -> tuple[Pose, float]:
        """The middle of the stretch from ``from`` to ``to``, with x along it; its length."""
        x0, y0 = self.numbers.pair(node, "from", (0.0, 0.0))
        x1, y1 = self.numbers.pair(node, "to", (1.0, 0.0))
        length = math.hypot(x1 - x0, y1 - y0)
        if length == 0.0:
            end = node.get("to")
            self.report.add(
                "out-of-range",
                "`to` is where `from` is; there must be a length",
                (end or node).span,
            )
            length = 1.0
        yaw = math.atan2(y1 - y0, x1 - x0)
        return Pose.from_xyz_rpy(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), (0.0, 0.0, yaw)), length

    def _frame(self, node: Node) -> Pose:
        return self.numbers.planar_pose(node)

    def _kerb(self, node: Node, name: str) -> None:
        middle, length = self._line(node)
        width = self.numbers.positive(node, "width", "length", 0.15)
        height = self.numbers.positive(node, "height", "length", 0.05)
        self._add("kerb", name, Box((length, width, height)), middle * _at(0.0, 0.0, height / 2))

    def _rails(self, node: Node, name: str) -> None:
        middle, length = self._line(node)
        gauge = self.numbers.positive(node, "gauge", "length", 0.6)
        diameter = self.numbers.positive(node, "diameter", "length", 0.051)
        height = self.numbers(node, "height", "length", diameter, least=0.0, above=True)
        ramp = self.numbers(node, "ramp", "length", least=0.0)
        for side, sign in (("left", 1), ("right", -1)):
            lying = Pose.from_xyz_rpy(
                (0.0, sign * gauge / 2, height - diameter / 2), (0.0, math.pi / 2, 0.0)
            )
            self._add("rail", f"{name}_{side}", Cylinder(diameter / 2, length), middle * lying)
            if ramp <= 0.0:
                continue
            # From half in the ground up to the rail, where the axes meet.
            rise = height - diameter / 2
            slant = Cylinder(diameter / 2, math.hypot(ramp, rise))
            for end, out in (("begin", -1), ("end", 1)):
                where = (out * (length + ramp) / 2, sign * gauge / 2, rise / 2)
                tilt = (0.0, math.pi / 2 + out * math.atan2(rise, ramp), 0.0)
                pose = middle * Pose.from_xyz_rpy(where, tilt)
                self._add("rail", f"{name}_{side}_{end}", slant, pose)

    def _obstacle(self, node: Node, name: str) -> None:
        pose, numbers = self._frame(node), self.numbers
        shape = node.get("shape")
        kind = shape.value if shape is not None else None
        needed = {"box": ("size",), "sphere": ("diameter",), "cylinder": ("diameter", "height")}
        wanted = needed.get(str(kind), ())
        for key in wanted:
            if node.get(key) is None:
                self.report.add("missing-key", f"a {kind} has no `{key}`", node.where)
                return
        for key in ("size", "diameter", "height"):
            entry = node.get(key)
            if entry is not None and wanted and key not in wanted:
                self.report.add("conflicting-keys", f"a {kind} has no `{key}`", entry.where)
        made: Shape
        if kind == "box":
            size = numbers.scope.vector(node.get("size"), "length")
            if min(size) <= 0.0:
                where = (node.get("size") or node).span
                self.report.add("out-of-range", "a box has three lengths of more than 0", where)
                return
            made, height = Box(size), size[2]
        else:
            diameter = numbers.positive(node, "diameter", "length", 1.0)
            height = numbers.positive(node, "height", "length", 1.0)
            made = Cylinder(diameter / 2, height)
            if kind == "sphere":
                made, height = Sphere(diameter / 2), diameter
        self._add("obstacle", name, made, pose * _at(0.0, 0.0, height / 2))

    def _crop(self, node: Node, name: str) -> None:
        frame, numbers = self._frame(node), self.numbers
        rows, plants = _whole(node, "rows"), _whole(node, "plants")
        across = numbers.positive(node, "row_spacing", "length", 1.0)
        along = numbers.positive(node, "plant_spacing", "length", 0.3)
        height = numbers.positive(node, "height", "length", 0.4)
        plant = Cylinder(numbers.positive(node, "diameter", "length", 0.06) / 2, height)
        if rows * plants > MAX_BLOCKS:
            self.report.add(
                "out-of-range",
                f"the rows have {rows * plants} plants; they must have at most {MAX_BLOCKS}",
                node.where,
            )
            return
        for row in range(rows):
            for i in range(plants):
                pose = frame * _at(i * along, row * across, height / 2)
                self._add("crop", f"{name}_{row + 1}_{i + 1}", plant, pose)

    def _tunnel(self, node: Node, name: str) -> None:
        frame, numbers = self._frame(node), self.numbers
        length = numbers.positive(node, "length", "length", 10.0)
        width = numbers.positive(node, "width", "length", 6.5)
        spacing = numbers.positive(node, "post_spacing", "length", 2.2)
        height = numbers.positive(node, "post_height", "length", 2.0)
        post = Cylinder(numbers.positive(node, "post_diameter", "length", 0.06) / 2, height)
        posts = math.floor(length / spacing + 1e-9) + 1
        if 2 * posts > MAX_BLOCKS:
            self.report.add(
                "out-of-range",
                f"the tunnel has {2 * posts} posts; it must have at most {MAX_BLOCKS}",
                node.where,
            )
            return
        for side, sign in (("left", 1), ("right", -1)):
            for i in range(posts):
                pose = frame * _at(i * spacing, sign * width / 2, height / 2)
                self._add("post", f"{name}_{side}_{i + 1}", post, pose)


def _at(x: float, y: float, z: float) -> Pose:
    return Pose((x, y, z))


def _whole(node: Node, key: str) -> int:
    found = node.get(key)
    return found.value if found is not None and isinstance(found.value, int) else 1
