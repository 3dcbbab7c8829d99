"""Writes the data sheet of a robot: one HTML page with all facts, drawings and labels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.backends import Backend
from thorvaldc.backends.templates import Templates
from thorvaldc.model import Box, Collision, Cylinder, MeshShape, Robot, Shape, Sphere, Vec3, Visual
from thorvaldc.model.facts.fact_page import code, page, table_html
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts
from thorvaldc.model.facts.size import Size
from thorvaldc.model.facts.stability import DIRECTIONS, Stability
from thorvaldc.model.model_json import model_hash
from thorvaldc.model.spatial import Quat, cross, dot, rotate
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.tip_over import Point, convex_hull
from thorvaldc.model.stl import mesh_pieces
from thorvaldc.model.sums import float_sum

_MARGIN = 0.17
"""Space around a view for dimension lines, as a share of the largest extent of the robot."""
_SIDES = 24
"""Corners of the polygons for circles."""
_GRID = 1e-4
"""Points of an outline are rounded to this length in m, because the outline of a mesh with many
vertices has thousands of them."""

_TEMPLATES = Templates("datasheet", {"code": code}, escapes_html=True)


class Datasheet(Backend):
    name = "datasheet"
    summary = "HTML page to print: facts, drawings, wiring, labels, modules"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        facts = robot_facts(robot)
        projector = OutlineProjector(robot)
        addresses = [address for bus in facts.buses for address in bus.addresses]
        content = _TEMPLATES.render(
            "content.html",
            facts=facts,
            tables=fact_tables(facts),
            table_html=table_html,
            dimensions=dimension_drawing(robot, facts, projector),
            sides=side_pictures(facts, projector),
            tip_over=tip_over_drawing(facts.stability),
            labels=[address for address in addresses if address.id_space],
            model=model_hash(robot)[:12],
        )
        about = facts.description or "Data sheet"
        style = _TEMPLATES.texts["style.css"]
        text = page(f"{facts.name}: data sheet", facts.name, about, content, style)
        return {"datasheet/datasheet.html": text.encode()}


# -- drawings: values for the template, in mm to the right and down ------------------------


@dataclass(frozen=True, slots=True)
class Polygon:
    """A polygon. ``points`` is a list of x,y pairs as in SVG; ``kind`` is its style."""

    points: str
    kind: str
    fill: str = ""
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class Line:
    x1: float
    y1: float
    x2: float
    y2: float
    kind: str


@dataclass(frozen=True, slots=True)
class Text:
    """A text at a point. ``turned`` is true for a text that is read from the right."""

    x: float
    y: float
    text: str
    anchor: str = "middle"
    turned: bool = False


@dataclass(frozen=True, slots=True)
class Circle:
    x: float
    y: float
    radius: float
    kind: str


@dataclass(slots=True)
class Drawing:
    """A drawing of ``width`` and ``height`` mm with a title and a description in words."""

    key: str
    title: str
    description: str
    width: float
    height: float
    text_size: float
    polygons: list[Polygon] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    circles: list[Circle] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)


class _Sheet:
    """Places a view of the robot on a drawing.

    ``origin`` is the point of the drawing in mm where the origin of ``base_link`` is.
    """

    def __init__(self, drawing: Drawing, view: View, origin: Point) -> None:
        self.drawing = drawing
        self.view = view
        self.origin = origin

    def point(self, right: float, up: float) -> Point:
        """Return the coordinates in the drawing of a point of the view in m."""
        return round(self.origin[0] + 1000.0 * right, 1), round(self.origin[1] - 1000.0 * up, 1)

    def project(self, point: Vec3) -> Point:
        return self.point(dot(self.view.right, point), dot(self.view.up, point))

    def add_outlines(self, outlines: Iterable[Outline], *, colored: bool) -> None:
        for outline in outlines:
            points = " ".join(f"{x:g},{y:g}" for x, y in (self.point(*p) for p in outline.points))
            red, green, blue, opacity = outline.color
            fill = f"#{_byte(red)}{_byte(green)}{_byte(blue)}" if colored else ""
            self.drawing.polygons.append(
                Polygon(points, "part" if colored else "outline", fill, opacity if colored else 1.0)
            )

    def add_line(self, start: Point, end: Point, kind: str) -> None:
        (x1, y1), (x2, y2) = self.point(*start), self.point(*end)
        self.drawing.lines.append(Line(x1, y1, x2, y2, kind))

    def add_horizontal(self, left: float, right: float, at: float, line: float) -> None:
        """Add a dimension from ``left`` to ``right`` of points at the height ``at``.

        The dimension line is at the height ``line``. All values are in m.
        """
        for x in (left, right):
            self.add_line((x, at), (x, line), "extension")
            self._add_tick(x, line)
        self.add_line((left, line), (right, line), "dimension")
        x, y = self.point((left + right) / 2, line)
        gap = 0.35 * self.drawing.text_size
        self.drawing.texts.append(Text(x, round(y - gap, 1), f"{1000 * (right - left):.0f}"))

    def add_vertical(self, low: float, high: float, at: float, line: float) -> None:
        """Add a dimension from ``low`` to ``high`` of points at ``at`` to the right."""
        for y in (low, high):
            self.add_line((at, y), (line, y), "extension")
            self._add_tick(line, y)
        self.add_line((line, low), (line, high), "dimension")
        text = f"{1000 * (high - low):.0f}"
        x, y = self.point(line, (low + high) / 2)
        gap = 0.35 * self.drawing.text_size
        if 0.7 * self.drawing.text_size * len(text) < 1000.0 * (high - low):
            self.drawing.texts.append(Text(round(x - gap, 1), y, text, turned=True))
        else:  # the text is longer than the dimension: it stands upright, above the upper tick
            x, y = self.point(line, high)
            self.drawing.texts.append(Text(x, round(y - 1.3 * gap, 1), text))

    def _add_tick(self, x: float, y: float) -> None:
        half = 0.3 * self.drawing.text_size / 1000.0
        self.add_line((x - half, y - half), (x + half, y + half), "tick")

    def add_center(self, center_of_mass: Vec3) -> None:
        x, y = self.project(center_of_mass)
        radius = round(0.35 * self.drawing.text_size, 1)
        self.drawing.circles.append(Circle(x, y, radius, "center"))
        self.drawing.lines += [
            Line(round(x - 1.6 * radius, 1), y, round(x + 1.6 * radius, 1), y, "center"),
            Line(x, round(y - 1.6 * radius, 1), x, round(y + 1.6 * radius, 1), "center"),
        ]


def _byte(value: float) -> str:
    return f"{round(255 * min(max(value, 0.0), 1.0)):02x}"


def dimension_drawing(robot: Robot, facts: RobotFacts, projector: OutlineProjector) -> Drawing:
    """Return the top, side and front view of a robot with dimension lines.

    The side view is below the top view, and the front view to the right of the side view.
    """
    size = facts.size
    lower = (size.lower[0], size.lower[1], min(size.lower[2], 0.0))
    extent = max(size.length, size.width, size.height, 1e-3)
    margin = _MARGIN * extent
    length, width, height = size.length, size.width, size.upper[2] - lower[2]
    drawing = Drawing(
        "dimensions",
        f"Dimensions of {facts.name} in mm",
        _described(size),
        round(1000 * (length + width + 4 * margin), 1),
        round(1000 * (height + width + 4.7 * margin), 1),
        round(1000 * 0.023 * (length + width + 4 * margin), 1),
    )
    left, top = 1000 * (2 * margin - lower[0]), 1000 * (margin + size.upper[1])
    bottom = 1000 * (margin + width + 2.1 * margin + size.upper[2])
    middle = 1000 * (2 * margin + length + 1.7 * margin - lower[1])
    drawing.width = round(drawing.width + 1000 * 0.7 * margin, 1)
    sheets = (
        _Sheet(drawing, TOP, (left, top)),
        _Sheet(drawing, RIGHT, (left, bottom)),
        _Sheet(drawing, FRONT, (middle, bottom)),
    )
    for sheet in sheets:
        sheet.add_outlines(projector.outlines(sheet.view), colored=False)
    above, side, front = sheets
    _add_support(above, facts)
    for sheet in (side, front):
        across = (lower[0], size.upper[0]) if sheet is side else (lower[1], size.upper[1])
        sheet.add_line((across[0] - 0.3 * margin, 0.0), (across[1] + 0.3 * margin, 0.0), "ground")
    for sheet in sheets:
        sheet.add_center(facts.center_of_mass)
    xs, ys = [wheel.x for wheel in robot.wheels], [wheel.y for wheel in robot.wheels]
    above.add_vertical(lower[1], size.upper[1], lower[0], lower[0] - 1.25 * margin)
    if size.track is not None:
        above.add_vertical(min(ys), max(ys), lower[0], lower[0] - 0.55 * margin)
    side.add_vertical(lower[2], size.upper[2], lower[0], lower[0] - 1.25 * margin)
    if size.ground_clearance is not None and size.ground_clearance > 0.0:
        side.add_vertical(0.0, size.ground_clearance, lower[0], lower[0] - 0.55 * margin)
    if size.wheelbase is not None:
        side.add_horizontal(min(xs), max(xs), lower[2], lower[2] - 0.5 * margin)
    side.add_horizontal(lower[0], size.upper[0], lower[2], lower[2] - 1.0 * margin)
    if size.track is not None:
        front.add_horizontal(min(ys), max(ys), lower[2], lower[2] - 0.5 * margin)
    front.add_horizontal(lower[1], size.upper[1], lower[2], lower[2] - 1.0 * margin)
    for sheet, low, high, name in (
        (above, lower[0], size.upper[1], "top"),
        (side, lower[0], size.upper[2], "right side"),
        (front, lower[1], size.upper[2], "front"),
    ):
        x, y = sheet.point(low, high + 0.3 * margin)
        drawing.texts.append(Text(x, y, name, "start"))
    _add_scale(above, size, extent, margin)
    return drawing


def _add_scale(above: _Sheet, size: Size, extent: float, margin: float) -> None:
    """Add a bar of a round length, right of the top view."""
    length = next((bar for bar in (5.0, 1.0, 0.5, 0.1) if bar < 0.5 * extent), 0.05)
    left, at = size.upper[0] + 1.2 * margin, size.lower[1]
    for x in (left, left + length):
        above.add_line((x, at), (x, at + 0.15 * margin), "dimension")
    above.add_line((left, at), (left + length, at), "dimension")
    x, y = above.point(left + length / 2, at)
    gap = 0.35 * above.drawing.text_size
    above.drawing.texts.append(Text(x, round(y - 2.0 * gap, 1), f"scale: {1000 * length:.0f} mm"))


def _described(size: Size) -> str:
    parts = [
        f"length {1000 * size.length:.0f}",
        f"width {1000 * size.width:.0f}",
        f"height {1000 * size.height:.0f}",
    ]
    for name, value in (
        ("wheelbase", size.wheelbase),
        ("track", size.track),
        ("ground clearance", size.ground_clearance),
    ):
        if value is not None:
            parts.append(f"{name} {1000 * value:.0f}")
    return (
        f"Top, right side and front view with dimensions in mm: {', '.join(parts)}. A crossed"
        " circle is the centre of mass, the dashed line connects the contact points of the wheels."
    )


def _add_support(sheet: _Sheet, facts: RobotFacts) -> None:
    hull = convex_hull([(wheel.x, wheel.y) for wheel in facts.wheels])
    for start, end in zip(hull, [*hull[1:], *hull[:1]], strict=True):
        sheet.add_line(start, end, "support")


def side_pictures(facts: RobotFacts, projector: OutlineProjector) -> list[Drawing]:
    """Return coloured pictures of the four sides of a robot, at one scale."""
    size = facts.size
    pictures = []
    edge = 0.04 * max(size.length, size.width, size.height, 1e-3)
    low = min(size.lower[2], 0.0)
    for view in (FRONT, RIGHT, REAR, LEFT):
        ends = [dot(view.right, size.lower), dot(view.right, size.upper)]
        width, height = max(ends) - min(ends), size.upper[2] - low
        picture = Drawing(
            view.name.replace(" ", "-"),
            view.name.capitalize(),
            f"Picture of {facts.name}: {view.name}",
            round(1000 * (width + 2 * edge), 1),
            round(1000 * (height + 2 * edge), 1),
            round(50 * edge, 1),
        )
        origin = 1000 * (edge - min(ends)), 1000 * (edge + size.upper[2])
        sheet = _Sheet(picture, view, origin)
        sheet.add_outlines(projector.outlines(view), colored=True)
        sheet.add_line((min(ends) - edge, 0.0), (max(ends) + edge, 0.0), "ground")
        pictures.append(picture)
    return pictures


def tip_over_drawing(stability: Stability) -> Drawing | None:
    """Return the tip-over angle by direction as a polar diagram, or ``None`` if the robot falls.

    The front of the robot is up, the radius is the angle.
    """
    if not stability.polar:
        return None
    radius, center = 100.0, 130.0
    largest = max(math.degrees(tip.angle) for tip in stability.polar)
    ring_count = math.ceil(largest / 15.0)
    scale = radius / (15.0 * ring_count)

    def place(direction: float, degrees: float) -> Point:
        reach = scale * degrees
        return (
            round(center - reach * math.sin(direction), 1),
            round(center - reach * math.cos(direction), 1),
        )

    named = ", ".join(f"{name} {math.degrees(a):.1f} degrees" for name, a in stability.angles)
    drawing = Drawing(
        "tip-over",
        "Tip-over angle by direction",
        f"Polar diagram of the tip-over angle, with the front up: {named}.",
        2 * center,
        2 * center,
        9.0,
    )
    for ring in range(1, ring_count + 1):
        drawing.circles.append(Circle(center, center, round(15.0 * ring * scale, 1), "ring"))
        x, y = place(math.radians(-45.0), 15.0 * ring)
        drawing.texts.append(Text(x, y, f"{15 * ring}°"))
    points = [place(tip.direction, math.degrees(tip.angle)) for tip in stability.polar]
    drawing.polygons.append(Polygon(" ".join(f"{x:g},{y:g}" for x, y in points), "polar"))
    for name, direction in DIRECTIONS.items():
        x, y = place(direction, 15.0 * ring_count + 12.0 / scale)
        drawing.texts.append(Text(x, round(y + 3.0, 1), name))
    return drawing


# -- outlines of shapes in parallel projection ---------------------------------------------


class View(NamedTuple):
    """A direction of view. ``right`` and ``up`` are the axes of the picture in ``base_link``."""

    name: str
    right: Vec3
    up: Vec3

    @property
    def towards(self) -> Vec3:
        """The unit vector from the robot to the viewer."""
        return cross(self.right, self.up)


TOP = View("top", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
FRONT = View("front", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
REAR = View("rear", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
RIGHT = View("right side", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
LEFT = View("left side", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


class Outline(NamedTuple):
    """The outline of a shape in a view.

    - ``points``: corners of a convex polygon in m, to the right and up.
    - ``depth``: distance of its middle towards the viewer in m.
    - ``nearest``: the same of its nearest point.
    - ``color``: red, green, blue and opacity of the shape.
    """

    points: tuple[Point, ...]
    depth: float
    nearest: float
    color: tuple[float, float, float, float]


class OutlineProjector:
    """Projects the visible shapes of one robot with all joints at position 0.

    The outline of a mesh is that of the convex hull of each of its connected pieces: one hull would
    fill the space between a handle and the sockets beside it. A link without visible shapes is
    drawn with its collision shapes. Equal meshes with equal orientations are projected once.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._pose = tree_of(robot).pose
        self._data = {mesh.name: mesh.data for mesh in robot.meshes}
        self._meshes: dict[str, list[list[Vec3]]] = {}
        self._known: dict[tuple[Shape, Quat, View], list[tuple[list[Point], float, float]]] = {}

    def outlines(self, view: View) -> list[Outline]:
        """Return the outlines of all shapes in a view, from the back to the front.

        A link hides what is in it: the nearest points of links are compared, but within a link the
        middles, so that a rim in its tyre is shown.
        """
        towards = view.towards
        order: list[tuple[float, Outline]] = []
        for link in self._robot.links:
            outlines: list[Outline] = []
            pose = self._pose.get(link.name)
            parts: tuple[Visual | Collision, ...] = link.visuals or link.collisions
            for part in parts if pose is not None else ():
                place = self._pose[link.name] * part.pose
                w, x, y, z = (round(value, 12) for value in place.quat)
                right, up = dot(view.right, place.xyz), dot(view.up, place.xyz)
                color = part.color if isinstance(part, Visual) else (0.6, 0.6, 0.6, 1.0)
                away = dot(towards, place.xyz)
                for hull, depth, nearest in self._outlines_of(part.shape, (w, x, y, z), view):
                    points = tuple((right + u, up + v) for u, v in hull)
                    outlines.append(Outline(points, depth + away, nearest + away, color))
            front = -math.inf
            for outline in sorted(outlines, key=lambda outline: round(outline.depth, 9)):
                front = max(front, round(outline.nearest, 9))
                order.append((front, outline))
        return [outline for _, outline in sorted(order, key=lambda pair: pair[0])]

    def _outlines_of(
        self, shape: Shape, quat: Quat, view: View
    ) -> list[tuple[list[Point], float, float]]:
        """Return the outlines of a shape relative to its origin, each with the depths of its middle
        and of its nearest point."""
        key = shape, quat, view
        if key not in self._known:
            outlines = []
            for piece in self._pieces(shape):
                corners = [rotate(quat, corner) for corner in piece]
                depths = [dot(view.towards, corner) for corner in corners]
                hull = convex_hull(_projected(corners, view))
                outlines.append((hull, (min(depths) + max(depths)) / 2, max(depths)))
            shown: list[tuple[list[Point], float, float]] = []
            self._known[key] = shown
            for outline in sorted(outlines, key=lambda outline: -_area(outline[0])):
                # A smaller piece inside the outline of another one has its colour.
                if not any(all(_is_inside(p, hull) for p in outline[0]) for hull, *_ in shown):
                    shown.append(outline)
        return self._known[key]

    def _pieces(self, shape: Shape) -> Iterable[Sequence[Vec3]]:
        if not isinstance(shape, MeshShape):
            return [list(self._corners(shape))]
        if shape.mesh not in self._meshes:
            self._meshes[shape.mesh] = mesh_pieces(shape.mesh, self._data.get(shape.mesh, b""))
        a, b, c = shape.scale
        return [[(x * a, y * b, z * c) for x, y, z in piece] for piece in self._meshes[shape.mesh]]

    def _corners(self, shape: Shape) -> Iterable[Vec3]:
        match shape:
            case Box(size=(x, y, z)):
                return [
                    (a * x / 2, b * y / 2, c * z / 2)
                    for a in (-1, 1)
                    for b in (-1, 1)
                    for c in (-1, 1)
                ]
            case Cylinder(radius=radius, length=length):
                return [(x, y, c * length / 2) for x, y in _circle(radius) for c in (-1, 1)]
            case Sphere(radius=radius):
                circles = [
                    (radius * math.cos(a), radius * math.sin(a))
                    for a in (math.pi * k / 12 for k in range(-6, 7))
                ]
                return [(x, y, z) for r, z in circles for x, y in _circle(max(r, 0.0))]
            case _:  # a mesh, see `_pieces`
                return []


def _area(polygon: Sequence[Point]) -> float:
    """Return twice the area of a polygon whose corners are listed counter-clockwise."""
    pairs = zip(polygon, [*polygon[1:], *polygon[:1]], strict=True)
    return float_sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs)


def _is_inside(point: Point, hull: Sequence[Point]) -> bool:
    """Return whether a point is in a convex polygon with counter-clockwise corners."""
    x, y = point
    edges = zip(hull, [*hull[1:], *hull[:1]], strict=True)
    return all(
        (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= -_GRID * _GRID for a, b in edges
    )


def _circle(radius: float) -> Iterator[Point]:
    for k in range(_SIDES):
        angle = math.tau * (k + 0.5) / _SIDES
        yield radius * math.cos(angle), radius * math.sin(angle)


def _projected(corners: Iterable[Vec3], view: View) -> list[Point]:
    points = {
        (round(dot(view.right, corner) / _GRID), round(dot(view.up, corner) / _GRID)): None
        for corner in corners
    }
    return [(u * _GRID, v * _GRID) for u, v in points]
