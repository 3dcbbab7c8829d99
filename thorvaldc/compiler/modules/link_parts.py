"""The parts that a module's links are made of: shapes, colours, masses."""

from __future__ import annotations

import re
from pathlib import Path

from thorvaldc.compiler.geometry.meshes import load_mesh
from thorvaldc.compiler.modules.scope import Scope, hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model.robot import Box, Collision, Cylinder, Mesh, MeshShape, Shape, Sphere, Visual
from thorvaldc.model.spatial import Inertial

RGBA = tuple[float, float, float, float]
DEFAULT_COLOR = "#9a9a9a"
_COLOR = re.compile(r"#[0-9a-fA-F]{6}([0-9a-fA-F]{2})?")


class PartReader:
    """Reads the parts of one module's links; ``meshes`` gathers what they use.

    ``folder`` is the module's, for its mesh files.
    """

    def __init__(self, folder: Path, palette: dict[str, str], report: Report) -> None:
        self.folder = folder
        self.palette = palette
        self.report = report
        self.meshes: dict[str, Mesh] = {}

    def read(
        self,
        part: Node,
        scope: Scope,
        visuals: list[Visual],
        collisions: list[Collision],
        masses: list[Inertial],
    ) -> None:
        shape_node, mass_node = part.get("shape"), part.get("mass")
        pose = scope.pose(part).clean()
        shape = self._shape(shape_node, scope) if shape_node is not None else None
        if shape is not None:
            if scope.boolean(part.get("show"), True):
                visuals.append(Visual(shape, pose, self._color(part.get("color"), scope)))
            if scope.boolean(part.get("collide"), False):
                collisions.append(Collision(shape, pose))
        if mass_node is None:
            return
        mass = scope.quantity(mass_node, "mass")
        if mass < 0:
            self.report.add(
                "mass-negative", f"the mass is {mass:g} kg; it must not be negative", mass_node.span
            )
            return
        explicit = part.get("inertia")
        if explicit is not None:
            masses.append(self._explicit(part, explicit, mass, scope).transformed(pose))
            return
        stand_in = part.get("inertia_shape")
        if stand_in is not None:
            shape = self._shape(stand_in, scope)
        if shape is None or isinstance(shape, MeshShape):
            if shape is not None or shape_node is None:
                self.report.add(
                    "inertia-unknown",
                    "a mass needs a solid shape to have an inertia from",
                    mass_node.where,
                    hint="add `inertia_shape: {box: [...]}` or `com` and `inertia`",
                )
            return
        wall = part.get("wall")
        thickness = scope.quantity(wall, "length") if wall is not None else None
        if wall is not None and thickness is not None:
            self._positive((thickness,), wall)
        masses.append(uniform_solid(shape, mass, thickness).transformed(pose))

    def _explicit(self, part: Node, node: Node, mass: float, scope: Scope) -> Inertial:
        items = node.value if isinstance(node.value, tuple) else ()
        values = [scope.quantity(item, "inertia") for item in items]
        values += [0.0] * (6 - len(values))
        com = scope.vector(part.get("com"), "length")
        return Inertial(
            mass, com, (values[0], values[1], values[2], values[3], values[4], values[5])
        )

    def _shape(self, node: Node, scope: Scope) -> Shape | None:
        box, cylinder = node.get("box"), node.get("cylinder")
        sphere, mesh = node.get("sphere"), node.get("mesh")
        if box is not None:
            size = scope.vector(box, "length")
            self._positive(size, box)
            return Box(size)
        if cylinder is not None:
            radius = scope.quantity(cylinder.get("radius"), "length")
            length = scope.quantity(cylinder.get("length"), "length")
            self._positive((radius, length), cylinder)
            return Cylinder(radius, length)
        if sphere is not None:
            radius = scope.quantity(sphere.get("radius"), "length")
            self._positive((radius,), sphere)
            return Sphere(radius)
        if mesh is not None:
            return self._mesh(mesh, scope)
        return None

    def _positive(self, sizes: tuple[float, ...], node: Node) -> None:
        if min(sizes) <= 0.0 and not self.report.has_errors:
            shown = ", ".join(f"{s:g}" for s in sizes)
            self.report.add(
                "size-not-positive", f"sizes must be positive, not {shown} m", node.span
            )

    def _mesh(self, node: Node, scope: Scope) -> MeshShape | None:
        file = node.get("file")
        if file is None:
            return None
        name = scope.text(file)
        path = self.folder / name
        mesh = load_mesh(path, file.span, self.report, display=name)
        if mesh is None:
            return None
        self.meshes[mesh.name] = mesh
        factor = node.get("scale")
        if factor is not None and not isinstance(factor.value, tuple):
            value = scope.evaluate(factor)
            if isinstance(value, int | float | str):
                one = scope.quantity(factor, "ratio", 1.0)
                return MeshShape(mesh.name, (one, one, one))
        return MeshShape(mesh.name, scope.vector(factor, "ratio", (1.0, 1.0, 1.0)))

    def _color(self, node: Node | None, scope: Scope) -> RGBA:
        text = scope.text(node, DEFAULT_COLOR) or DEFAULT_COLOR
        digits = self.palette.get(text, text)
        if _COLOR.fullmatch(digits):
            values = [int(digits[i : i + 2], 16) / 255 for i in range(1, len(digits), 2)]
            r, g, b, a = (round(v, 4) for v in [*values, 1.0][:4])
            return (r, g, b, a)
        self.report.add(
            "color-unknown",
            f"`{text}` is no colour",
            node.span if node is not None else None,
            hint='write "#rrggbb" or a name of the palette; '
            + hint_of_known(text, list(self.palette)),
        )
        return (0.5, 0.5, 0.5, 1.0)


def uniform_solid(shape: Shape, mass: float, wall: float | None = None) -> Inertial:
    """Inertia of a body of uniform density about its centre; cylinders may be tubes.

    Source: the textbook formulas of solid boxes, cylinders, tubes and spheres.
    """
    if isinstance(shape, Box):
        x, y, z = shape.size
        d = (y * y + z * z, x * x + z * z, x * x + y * y)
        ixx, iyy, izz = (mass / 12 * v for v in d)
    elif isinstance(shape, Cylinder):
        inner = max(shape.radius - wall, 0.0) if wall is not None else 0.0
        square = shape.radius**2 + inner**2
        ixx = iyy = mass * (3 * square + shape.length**2) / 12
        izz = mass * square / 2
    elif isinstance(shape, Sphere):
        ixx = iyy = izz = 0.4 * mass * shape.radius**2
    else:
        ixx = iyy = izz = 0.0
    return Inertial(mass, (0.0, 0.0, 0.0), (ixx, iyy, izz, 0.0, 0.0, 0.0))
