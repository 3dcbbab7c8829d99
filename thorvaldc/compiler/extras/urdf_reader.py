"""Converts URDF elements to links and joints of the robot model.

The module ``urdf_elements`` lists the supported URDF elements.  A diagnostic about a URDF element
shows the line of the element in the xacro file.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from thorvaldc import model
from thorvaldc.compiler.descriptions.description import Place, Places
from thorvaldc.compiler.extras.ros2_controls import stated_servos
from thorvaldc.compiler.extras.urdf_elements import (
    ELEMENTS,
    EXTENSIONS,
    ElementReader,
    call_labels,
)
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.shapes.solids import solid_of_shapes
from thorvaldc.diagnostics import Report
from thorvaldc.model.spatial import clean, clean3, norm, scale

RGBA = tuple[float, float, float, float]

# Colour of a URDF visual without a material.
DEFAULT_COLOR: RGBA = (0.6, 0.6, 0.6, 1.0)
# Colours of material names that many URDF files use without a definition.
_COMMON_COLORS: dict[str, RGBA] = {
    "black": (0.05, 0.05, 0.05, 1.0),
    "blue": (0.0, 0.0, 0.8, 1.0),
    "brown": (0.87, 0.81, 0.76, 1.0),
    "gray": (0.5, 0.5, 0.5, 1.0),
    "green": (0.0, 0.8, 0.0, 1.0),
    "grey": (0.5, 0.5, 0.5, 1.0),
    "orange": (1.0, 0.42, 0.04, 1.0),
    "red": (0.8, 0.0, 0.0, 1.0),
    "silver": (0.75, 0.75, 0.75, 1.0),
    "white": (1.0, 1.0, 1.0, 1.0),
    "yellow": (0.9, 0.8, 0.0, 1.0),
}

MeshLoader = Callable[[str, Element, model.Vec3, bool], model.Mesh | None]
# Edge length of the box that stands for a mesh that cannot be read, in m.
_PLACEHOLDER = 0.05


@dataclass(frozen=True, slots=True)
class UrdfParts:
    """The links, joints, meshes and URDF extensions of one xacro file, in the order of the file.

    ``servos`` are the servos that the URDF extensions state, ``controls`` the ``<ros2_control>``
    elements among them.  ``places`` are those of the values of the links and joints.
    """

    links: tuple[model.Link, ...]
    joints: tuple[model.Joint, ...]
    meshes: tuple[model.Mesh, ...]
    extensions: tuple[str, ...]
    servos: tuple[model.JointServo, ...] = ()
    controls: tuple[Element, ...] = ()
    places: Places = field(default_factory=dict)


def read_urdf(
    elements: Sequence[Element],
    module: str,
    load_mesh: MeshLoader,
    report: Report,
    macros: Collection[str] = (),
    density: float | None = None,
) -> UrdfParts:
    """Converts the URDF element ``<robot>`` to links and joints of the robot model.

    - ``module``: name that identifies the extra in the model.
    - ``load_mesh``: function that loads the mesh file of an element.  The arguments of
      ``load_mesh`` are the file name, the URDF element, the scale factors and whether the mesh is
      only for the eye.  It reports an error, or for the eye a warning, and returns ``None``.
    - ``report``: report that receives the errors.
    - ``macros``: names of the xacro macros in the file, for hints about elements without prefix.
    - ``density``: density in kg/m^3 of links without ``<inertial>``, or ``None``.

    Of an element with an error, the valid part is returned.
    """
    return _Reader(module, load_mesh, report, macros, density).read(elements)


class _Reader(ElementReader):
    """Converts the URDF elements of one xacro file to links and joints."""

    def __init__(
        self,
        module: str,
        load_mesh: MeshLoader,
        report: Report,
        macros: Collection[str],
        density: float | None,
    ) -> None:
        super().__init__(report, macros)
        self.module = module
        self.load_mesh = load_mesh
        self.density = density
        self.materials: dict[str, RGBA] = {}
        self.meshes: dict[str, model.Mesh] = {}
        self.places: Places = {}

    def read(self, elements: Sequence[Element]) -> UrdfParts:
        links: list[model.Link | None] = []
        joints: list[model.Joint | None] = []
        extensions: list[Element] = []
        for element in elements:
            self.collect_materials(element)
        for element in elements:
            if element.tag == "link":
                links.append(self.link(element))
            elif element.tag == "joint":
                joints.append(self.joint(element))
            elif element.tag in EXTENSIONS:
                extensions.append(element)
            elif element.tag != "material":
                self.report_unknown(element, "robot")
        return UrdfParts(
            tuple(link for link in links if link is not None),
            tuple(joint for joint in joints if joint is not None),
            tuple(self.meshes.values()),
            tuple(element.xml for element in extensions),
            tuple(stated_servos(extensions)),
            tuple(element for element in extensions if element.tag == "ros2_control"),
            self.places,
        )

    def keep_place(self, part: str, value: str, element: Element) -> None:
        self.places[part, value] = Place(element.span, call_labels(element))

    def pose(self, owner: Element) -> model.Pose:
        origin = owner.find("origin")
        values = self.numbers(origin) if origin is not None else None
        if values is None:
            return model.Pose()
        return model.Pose.from_xyz_rpy(values["xyz"], values["rpy"]).clean()

    # -- links -------------------------------------------------------------------

    def link(self, element: Element) -> model.Link | None:
        name = self.text(element, "name") or ""
        self.check_content(element)
        visuals: list[model.Visual] = []
        collisions: list[model.Collision] = []
        unread: list[tuple[model.Pose, RGBA]] = []  # visual meshes that cannot be read
        for child in element.children:
            if child.tag in ("visual", "collision"):
                self.check_content(child)
                pose = self.pose(child)
                shape = self.geometry(child)
                number = len(visuals if child.tag == "visual" else collisions)
                self.keep_place(name, f"{child.tag} {number}", _shape_of(child))
                color = self.color(child)
                if shape is None:
                    unread += [(pose, color)] if child.tag == "visual" else []
                elif child.tag == "visual":
                    visuals.append(model.Visual(shape, pose, color))
                else:
                    collisions.append(model.Collision(shape, pose))
        inertial = self.inertial(element, name, visuals, collisions)
        if unread and collisions:
            visuals += [model.Visual(c.shape, c.pose, unread[0][1]) for c in collisions]
        elif unread:
            box = model.Box((_PLACEHOLDER, _PLACEHOLDER, _PLACEHOLDER))
            visuals += [model.Visual(box, pose, color) for pose, color in unread]
        if not name:
            return None
        return model.Link(
            name, self.module, inertial, tuple(visuals), tuple(collisions), element.span
        )

    def inertial(
        self,
        link_element: Element,
        link: str,
        visuals: Sequence[model.Visual],
        collisions: Sequence[model.Collision],
    ) -> model.Inertial | None:
        """Returns the mass and inertia of a link in its frame.

        What the URDF element does not state is computed from the shapes of the link, see
        ``computed_inertial``.
        """
        element = link_element.find("inertial")
        if element is None:
            if self.density is None:
                return None
            return self.computed_inertial(link_element, link, visuals, collisions, None)
        self.check_content(element)
        pose = self.pose(element)
        mass_element, inertia_element = element.find("mass"), element.find("inertia")
        if mass_element is None:
            self.add("extra-element", f"<inertial> of link `{link}` has no <mass>", element)
            return None
        values = self.numbers(mass_element)
        if values is None:
            return None
        mass = values["value"]
        self.keep_place(link, "mass", mass_element)
        if inertia_element is None:
            if mass <= 0.0:
                return model.Inertial(mass, pose.xyz, (0.0,) * 6)
            body = self.computed_inertial(element, link, visuals, collisions, mass)
            stated_com = body is not None and element.find("origin") is not None
            return replace(body, com=pose.xyz).clean() if body and stated_com else body
        self.keep_place(link, "inertia", inertia_element)
        entries = self.numbers(inertia_element)
        if entries is None:
            return None
        tensor = tuple(entries[name] for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        return model.Inertial(mass, (0.0, 0.0, 0.0), tensor).transformed(pose).clean()

    def computed_inertial(
        self,
        element: Element,
        link: str,
        visuals: Sequence[model.Visual],
        collisions: Sequence[model.Collision],
        mass: float | None,
    ) -> model.Inertial | None:
        """Computes the inertia of a link from its collision shapes, or from its visual shapes.

        - ``element``: URDF element that does not state the inertia.
        - ``mass``: mass in kg, or ``None`` for the density of the entry.
        """
        density = self.density if mass is None and self.density is not None else 1.0
        for noun, shapes in (("collision", collisions), ("visual", visuals)):
            body = solid_of_shapes(((s.shape, s.pose) for s in shapes), density, self.meshes)
            if body is None:
                continue
            volume = body.mass / density
            body = body.with_mass(mass) if mass is not None else body
            what = "inertia" if mass is not None else "mass and inertia"
            self.add(
                "extra-inertia-computed",
                f"the {what} of link `{link}` are those of its {noun} shapes: {volume:.3g} m^3 "
                f"with {body.mass / volume:.4g} kg/m^3 are {body.mass:.3g} kg",
                element,
            )
            return body.clean()
        if mass is not None:
            self.add(
                "extra-element",
                f"<inertial> of link `{link}` has no <inertia>",
                element,
                "it can be computed only from boxes, cylinders, spheres and closed meshes",
            )
        elif visuals or collisions:
            self.add(
                "extra-mesh-open",
                f"link `{link}` gets no mass from the density: its meshes are not closed",
                element,
                "close the meshes, or give the link an <inertial>",
            )
        return None

    def geometry(self, owner: Element) -> model.Shape | None:
        geometry = owner.find("geometry")
        if geometry is None or not geometry.children:
            self.add("extra-element", f"<{owner.tag}> has no geometry", geometry or owner)
            return None
        shape, count = geometry.children[0], len(geometry.children)
        hint = "shapes are box, cylinder, sphere and mesh"
        if count > 1:
            message = f"<geometry> contains {count} shapes; expected one"
            self.add("extra-element", message, geometry, hint)
            return None
        if shape.tag not in ELEMENTS["geometry"].children:
            self.add("extra-element", f"unknown shape <{shape.tag}>", shape, hint)
            return None
        values = self.numbers(shape)
        if shape.tag == "mesh":
            return self.mesh(shape, values, owner.tag == "visual")
        if values is None:
            return None
        if shape.tag == "box":
            return model.Box(clean3(values["size"]))
        if shape.tag == "cylinder":
            return model.Cylinder(clean(values["radius"]), clean(values["length"]))
        return model.Sphere(clean(values["radius"]))

    def mesh(
        self, element: Element, values: dict[str, Any] | None, is_visual: bool
    ) -> model.MeshShape | None:
        file_name = self.text(element, "filename")
        if file_name is None or values is None:
            return None
        mesh = self.load_mesh(file_name, element, values["scale"], is_visual)
        if mesh is None:
            return None
        self.meshes.setdefault(mesh.name, mesh)
        return model.MeshShape(mesh.name, clean3(values["scale"]))

    # -- materials ---------------------------------------------------------------

    def collect_materials(self, element: Element) -> None:
        """Collects the named materials of a URDF element and its child elements.

        A URDF visual can refer to a named material that any other element of the file defines.
        """
        if element.tag == "material":
            self.check_content(element)
            color = element.find("color")
            name = element.attributes.get("name", "").strip()
            if color is not None and name and name not in self.materials:
                values = self.numbers(color)
                if values is not None:
                    self.materials[name] = values["rgba"]
        for child in element.children:
            self.collect_materials(child)

    def color(self, visual: Element) -> RGBA:
        material = visual.find("material")
        if material is None or visual.tag != "visual":
            return DEFAULT_COLOR
        name = material.attributes.get("name", "").strip()
        if name in self.materials:
            return self.materials[name]
        color = material.find("color")
        if color is not None:
            # A URDF material without a name defines the colour of a single visual.  If a URDF
            # material has a name but is not in `materials`, an error about its colour is already
            # reported.
            values = self.numbers(color) if not name else None
            return values["rgba"] if values is not None else DEFAULT_COLOR
        if material.find("texture") is not None:
            return DEFAULT_COLOR
        common_color = _COMMON_COLORS.get(name.lower().rpartition("/")[2])
        used = "the common colour of this name" if common_color else "grey"
        self.add(
            "extra-material",
            f"material `{name}` is not defined; {used} is used",
            material,
            f'define it: <material name="{name}"><color rgba="r g b a"/></material>',
        )
        return common_color or DEFAULT_COLOR

    # -- joints ------------------------------------------------------------------

    def joint(self, element: Element) -> model.Joint | None:
        name = self.text(element, "name")
        self.check_content(element)
        kind = element.attributes.get("type", "")
        if kind not in ("fixed", "revolute", "continuous", "prismatic"):
            problem = f"the type `{kind}`, which the model does not support" if kind else "no type"
            self.add(
                "extra-joint-type",
                f"joint `{name}` has {problem}",
                element,
                "use fixed, revolute, continuous or prismatic; build a floating or planar joint "
                "from several joints",
            )
        parent, child = (self.connected_link(element, tag) for tag in ("parent", "child"))
        pose = self.pose(element)
        if name is None or parent is None or child is None:
            return None
        if kind not in ("revolute", "continuous", "prismatic"):
            return model.Joint(name, self.module, kind, parent, child, pose, element.span)
        limits = self.limits(element, kind, name)
        dynamics = element.find("dynamics")
        losses = (self.numbers(dynamics) if dynamics is not None else None) or {}
        return model.Joint(
            name,
            self.module,
            kind,
            parent,
            child,
            pose,
            element.span,
            axis=self.axis(element, name),
            lower=limits.get("lower"),
            upper=limits.get("upper"),
            effort=limits.get("effort"),
            velocity=limits.get("velocity"),
            damping=losses.get("damping", 0.0),
            friction=losses.get("friction", 0.0),
            mimic=self.mimic(element),
        )

    def connected_link(self, joint: Element, tag: str) -> str | None:
        element = joint.find(tag)
        if element is None:
            name = joint.attributes.get("name", "")
            self.add("extra-element", f"joint `{name}` has no <{tag}>", joint)
            return None
        self.check_content(element)
        return self.text(element, "link")

    def axis(self, joint: Element, name: str) -> model.Vec3:
        element = joint.find("axis")
        values = self.numbers(element) if element is not None else None
        if element is None or values is None:
            return (1.0, 0.0, 0.0)  # default axis of a joint in URDF
        length = norm(values["xyz"])
        if length < 1e-9:
            self.add("extra-number", f"joint `{name}` has an axis of length 0", element)
            return (1.0, 0.0, 0.0)
        return clean3(scale(1.0 / length, values["xyz"]))

    def limits(self, joint: Element, kind: str, name: str) -> dict[str, float]:
        """Returns the limits of a URDF joint by the names of the attributes of ``<limit>``.

        - ``kind``: type of the joint, such as ``revolute``.  A URDF joint of the type
          ``continuous`` needs no limits.
        """
        element = joint.find("limit")
        if kind == "continuous":
            if element is None:
                return {}
            return self.stated_limits(element, name, ("effort", "velocity"))
        if element is None:
            self.add(
                "extra-joint-limits",
                f"joint `{name}` is {kind} and has no <limit>",
                joint,
                'add <limit lower="" upper="" effort="" velocity=""/>, or use the type continuous',
            )
            return {}
        limits = self.stated_limits(element, name)
        lower, upper = limits.get("lower", 0.0), limits.get("upper", 0.0)
        if lower > upper:
            message = f"joint `{name}` has a lower limit above the upper limit"
            self.add("extra-joint-limits", f"{message}: {lower:g} > {upper:g}", element)
        return limits

    def stated_limits(
        self, limit: Element, joint: str, names: Sequence[str] = ()
    ) -> dict[str, float]:
        stated = [name for name in names if name in limit.attributes] if names else None
        limits = self.valid_numbers(limit, stated)
        for name in limits:
            self.keep_place(joint, name, limit)
        return limits

    def mimic(self, joint: Element) -> model.Mimic | None:
        element = joint.find("mimic")
        if element is None:
            return None
        values = self.numbers(element)
        leader = self.text(element, "joint")
        if leader is None or values is None:
            return None
        return model.Mimic(leader, values["multiplier"], values["offset"])


def _shape_of(owner: Element) -> Element:
    """Returns the element of the shape of a ``<visual>`` or ``<collision>``."""
    geometry = owner.find("geometry")
    return geometry.children[0] if geometry is not None and geometry.children else owner
