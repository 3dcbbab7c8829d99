"""The world of a scenario document: the ground, and everything on it as single blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.diagnostics import Report
from thorvaldc.model import (
    Block,
    Box,
    Cylinder,
    Fleet,
    Ground,
    Pose,
    Robot,
    Shape,
    Sphere,
    World,
    Zone,
)
from thorvaldc.passes.scope import Scope
from thorvaldc.source.node import Node

MAX_BLOCKS = 5000
"""More geoms than these take a simulation minutes to load."""
MAX_CELLS = 1_000_000
CELLS_PER_WAVE = 10
"""Cells of rough ground along a wave: the fewer, the more it resists rolling."""

_OF_SLOPES = ("angle", "direction")
_OF_BUMPS = ("amplitude", "wavelength", "seed", "size")


class Numbers:
    """Quantities of a document, each within its bounds."""

    def __init__(self, scope: Scope, report: Report) -> None:
        self.scope = scope
        self.report = report

    def __call__(
        self,
        node: Node,
        key: str,
        quantity: str,
        default: float = 0.0,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        above: bool = False,
    ) -> float:
        """The value of ``key`` in SI; ``above``: it must be more than ``least``."""
        found = node.get(key)
        return self.value(found, key, quantity, default, least=least, most=most, above=above)

    def value(
        self,
        found: Node | None,
        key: str,
        quantity: str,
        default: float = 0.0,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        above: bool = False,
    ) -> float:
        if found is None:
            return default
        value = self.scope.quantity(found, quantity, default)
        if least <= value <= most and not (above and value == least):
            return value
        bounds = []
        if least > -math.inf:
            bounds.append(f"{'more than' if above else 'at least'} {least:g}")
        if most < math.inf:
            bounds.append(f"at most {most:g}")
        self.report.add(
            "out-of-range",
            f"`{key}` is {value:g} in SI units; it must be {' and '.join(bounds)}",
            found.span,
        )
        return default

    def positive(self, node: Node, key: str, quantity: str, default: float) -> float:
        return self(node, key, quantity, default, least=0.0, above=True)

    def pair(self, node: Node, key: str, default: tuple[float, float]) -> tuple[float, float]:
        found = node.get(key)
        items = found.value if found is not None else None
        if not isinstance(items, tuple) or len(items) != 2:
            return default
        x, y = (self.scope.quantity(item, "length") for item in items)
        return x, y


def read_world(document: Node, numbers: Numbers, report: Report) -> World:
    node = document.get("world")
    if node is None:
        return World(Ground())
    ground = node.get("ground")
    blocks = _Blocks(numbers, report, node)
    return World(
        _ground(ground, numbers, report) if ground is not None else Ground(),
        blocks.all(),
        tuple(_zones(node.get("zones"), numbers, report)),
    )


def friction(document: Node, numbers: Numbers) -> float | None:
    """The coefficient that wheels have in this world; ``None``: their own."""
    node = document.get("world")
    if node is None or node.get("friction") is None:
        return None
    return numbers(node, "friction", "number", 1.0, least=0.0, most=5.0, above=True)


def with_friction(robot: Robot, mu: float) -> Robot:
    from dataclasses import replace

    return replace(robot, wheels=tuple(replace(wheel, friction=mu) for wheel in robot.wheels))


def _ground(node: Node, numbers: Numbers, report: Report) -> Ground:
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


def _zones(listed: Node | None, numbers: Numbers, report: Report) -> Iterator[Zone]:
    items = listed.value if listed is not None else None
    for node in items if isinstance(items, tuple) else ():
        size = numbers.pair(node, "size", (1.0, 1.0))
        amplitude = numbers(node, "amplitude", "length", least=0.0, most=1.0)
        wavelength = numbers(node, "wavelength", "length", 0.5, least=0.05, most=100.0)
        cell = min(0.1, wavelength / CELLS_PER_WAVE) if amplitude else 0.1
        count = math.prod(edge / cell for edge in size)
        if not (min(size) > 0.0 and count <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"a zone of {size[0]:g} m x {size[1]:g} m has {count:.3g} cells; it must have "
                f"an extent, and at most {MAX_CELLS} cells",
                (node.get("size") or node).where,
            )
            continue
        for key, of in (("wavelength", "amplitude"), ("seed", "amplitude"), ("slope", "height")):
            entry = node.get(key)
            if entry is not None and node.get(of) is None:
                report.add(
                    "conflicting-keys",
                    f"`{key}` says nothing of a zone without `{of}`",
                    entry.where,
                    hint=f"leave it out, or add `{of}`",
                )
        seed = node.get("seed")
        yield Zone(
            placed(node, numbers),
            size,
            _own(node, "friction", numbers, 5.0),
            _own(node, "rolling_resistance", numbers, 1.0),
            numbers(node, "height", "length", least=0.0, most=10.0),
            numbers(
                node, "slope", "angle", math.radians(10.0), least=0.01, most=math.radians(80.0)
            ),
            amplitude,
            wavelength,
            seed.value if seed is not None and isinstance(seed.value, int) else 0,
        )


def _own(node: Node, key: str, numbers: Numbers, most: float) -> float | None:
    if node.get(key) is None:
        return None
    return numbers(node, key, "number", least=0.0, most=most)


def placed(node: Node, numbers: Numbers) -> Pose:
    """The pose of ``xyz`` and ``yaw``."""
    scope = numbers.scope
    yaw = math.remainder(scope.quantity(node.get("yaw"), "angle"), 2 * math.pi)
    return Pose.from_xyz_rpy(scope.vector(node.get("xyz"), "length"), (0.0, 0.0, yaw)).clean()


def check_starts(fleet: Fleet, document: Node, report: Report) -> None:
    """That no robot starts in ground that rises, but on top of it."""
    world = document.get("world")
    listed = world.get("zones") if world is not None else None
    items = listed.value if listed is not None else None
    zones = fleet.world.zones if fleet.world is not None else ()
    if not isinstance(items, tuple) or len(items) != len(zones):
        return
    for node, zone in zip(items, zones, strict=True):
        if zone.level:
            continue
        for placement in fleet.placements:
            points = (placement.pose.apply((w.x, w.y, 0.0)) for w in placement.robot.wheels)
            if placement.pose.xyz[2] <= zone.pose.xyz[2] and any(
                zone.holds(x, y) for x, y, _ in points
            ):
                report.add(
                    "zone-under-robot",
                    f"{placement.name} starts within ground that rises",
                    node.where,
                    hint="start it beside, or as high as the ground is there",
                )


class _Blocks:
    """Expands what stands around into single things."""

    def __init__(self, numbers: Numbers, report: Report, world: Node) -> None:
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
        return placed(node, self.numbers)

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
