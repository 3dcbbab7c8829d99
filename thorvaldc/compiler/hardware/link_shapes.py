"""Reads the shapes, colours and masses of the links in a module document."""

from __future__ import annotations

import re
from pathlib import Path

from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.compiler.shapes.solids import uniform_solid
from thorvaldc.compiler.source.dimensions import EXPECTED
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import (
    Box,
    Collision,
    Cylinder,
    Inertial,
    Mesh,
    MeshShape,
    Shape,
    Sphere,
    Vec3,
    Visual,
)

RGBA = tuple[float, float, float, float]
DEFAULT_COLOR = "#9a9a9a"
_COLOR = re.compile(r"#[0-9a-fA-F]{6}([0-9a-fA-F]{2})?")


class LinkShapeReader:
    """Reads the shapes, colours and masses of the links of one module.

    Attributes
    ----------
    folder : folder of the module.  Paths of mesh files are relative to the folder.
    is_builtin : whether the module is one of the built-in library.
    palette : colours by name.
    report : collects the diagnostics.
    meshes : meshes of all parts that were read, by file name.
    """

    def __init__(
        self, folder: Path, is_builtin: bool, palette: dict[str, str], report: Report
    ) -> None:
        self.folder = folder
        self.is_builtin = is_builtin
        self.palette = palette
        self.report = report
        self.meshes: dict[str, Mesh] = {}

    def read(
        self,
        part: Node,
        scope: Scope,
        visuals: list[Visual],
        collisions: list[Collision],
    ) -> Inertial | None:
        """Reads a part of a link, and adds the shape of the part to the link.

        Returns the inertia of the part in the frame of the link, or ``None`` for a part without
        mass.
        """
        shape_node = part.get("shape")
        pose = scope.pose(part).clean()
        collides = scope.boolean(part.get("collide"), False)
        shape = self._shape(shape_node, scope, collides) if shape_node is not None else None
        if shape is not None:
            if scope.boolean(part.get("show"), True):
                visuals.append(Visual(shape, pose, self._color(part.get("color"), scope)))
            if collides:
                collisions.append(Collision(shape, pose))
        inertial = self._inertial(part, shape, scope)
        return inertial.transformed(pose) if inertial is not None else None

    def _inertial(self, part: Node, shape: Shape | None, scope: Scope) -> Inertial | None:
        """Returns the mass and the inertia of a link part in the coordinate frame of the part.

        If the module document does not state the inertia, the inertia of a uniform solid is
        computed.  The shape of the uniform solid is the value of `inertia_shape`, or the visual
        shape of the link part.
        """
        mass_node = part.get("mass")
        if mass_node is None:
            return None
        mass = scope.quantity(mass_node, "mass")
        if mass < 0:
            self.report.add(
                "mass-negative", f"the mass is {mass:g} kg; it must not be negative", mass_node.span
            )
            return None
        stated_inertia = part.get("inertia")
        if stated_inertia is not None:
            values = [scope.quantity(item, "inertia") for item in items(stated_inertia)]
            xx, yy, zz, xy, xz, yz = [*values, *[0.0] * 6][:6]
            com = scope.vector(part.get("com"), "length")
            return Inertial(mass, com, (xx, yy, zz, xy, xz, yz))
        inertia_shape = part.get("inertia_shape")
        if inertia_shape is not None:
            shape = self._shape(inertia_shape, scope, False)
        if shape is None or isinstance(shape, MeshShape):
            if shape is not None or part.get("shape") is None:
                self.report.add(
                    "inertia-unknown",
                    "the mass has no solid shape from which to compute the inertia",
                    mass_node.where,
                    hint="add `inertia_shape: {box: [...]}` or `com` and `inertia`",
                )
            return None
        wall = part.get("wall")
        thickness = scope.quantity(wall, "length") if wall is not None else None
        if wall is not None and thickness is not None:
            self._check_positive((thickness,), wall)
        return uniform_solid(shape, mass, thickness)

    def _shape(self, node: Node, scope: Scope, collides: bool) -> Shape | None:
        """Reads a box, cylinder, sphere or mesh of a module document.

        The sizes of the shape are in m.
        """
        box, cylinder = node.get("box"), node.get("cylinder")
        sphere, mesh = node.get("sphere"), node.get("mesh")
        if box is not None:
            size = scope.vector(box, "length")
            self._check_positive(size, box)
            return Box(size)
        if cylinder is not None:
            radius = scope.quantity(cylinder.get("radius"), "length")
            length = scope.quantity(cylinder.get("length"), "length")
            self._check_positive((radius, length), cylinder)
            return Cylinder(radius, length)
        if sphere is not None:
            radius = scope.quantity(sphere.get("radius"), "length")
            self._check_positive((radius,), sphere)
            return Sphere(radius)
        if mesh is not None:
            return self._mesh(mesh, scope, collides)
        return None

    def _check_positive(self, sizes: tuple[float, ...], node: Node) -> None:
        """Checks that all sizes of a box, cylinder or sphere are greater than 0."""
        if min(sizes) <= 0.0 and not self.report.has_errors:
            shown = ", ".join(plain(size) for size in sizes)
            self.report.add(
                "size-not-positive", f"sizes must be positive, not {shown} m", node.span
            )

    def _mesh(self, node: Node, scope: Scope, collides: bool) -> MeshShape | None:
        """Reads a mesh file and adds the mesh to ``meshes``."""
        file = node.get("file")
        if file is None:
            return None
        name = scope.text(file)
        factors = self._mesh_scale(node.get("scale"), scope)
        mesh = load_mesh(
            self.folder / name,
            file.span,
            self.report,
            display=name,
            scale=factors,
            collides=collides,
            is_builtin=self.is_builtin,
            named_in=(self.folder, file),
        )
        if mesh is None:
            return None
        self.meshes[mesh.name] = mesh
        return MeshShape(mesh.name, factors)

    def _mesh_scale(self, scale: Node | None, scope: Scope) -> Vec3:
        """Returns the scale factors of a mesh.  One number is the factor of all axes.

        A scale may be a length, that of one unit of the mesh.
        """
        length = EXPECTED["length"]
        if scale is not None and not isinstance(scale.value, tuple):
            value = scope.evaluate(scale)
            if isinstance(value, int | float | str):
                factor = scope.quantity(scale, "ratio", 1.0, length)
                return (factor, factor, factor)
        return scope.vector(scale, "ratio", (1.0, 1.0, 1.0), length)

    def _color(self, node: Node | None, scope: Scope) -> RGBA:
        """Returns a colour as red, green, blue and alpha, each from 0 to 1.

        A document contains a colour as "#rrggbb", as "#rrggbbaa" or as the name of a palette
        colour.
        """
        text = scope.text(node, DEFAULT_COLOR) or DEFAULT_COLOR
        digits = self.palette.get(text, text)
        if _COLOR.fullmatch(digits):
            values = [int(digits[i : i + 2], 16) / 255 for i in range(1, len(digits), 2)]
            r, g, b, a = (round(v, 4) for v in [*values, 1.0][:4])
            return (r, g, b, a)
        known = hint_of_known(text, list(self.palette))
        self.report.add(
            "color-unknown",
            f"`{text}` is not a colour",
            node.span if node is not None else None,
            hint=known
            if isinstance(known, Proposal)
            else f'write "#rrggbb" or a name of the palette; {known}',
        )
        return (0.5, 0.5, 0.5, 1.0)
