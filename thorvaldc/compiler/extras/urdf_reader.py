"""URDF elements as links and joints of the model, every fault at its line.

Reads what URDF defines and the model can say; the rest is reported, not dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import (
    Box,
    Collision,
    Cylinder,
    Inertial,
    Joint,
    Link,
    Mesh,
    MeshShape,
    Mimic,
    Pose,
    Shape,
    Sphere,
    Vec3,
    Visual,
)
from thorvaldc.model.spatial import clean, clean3, norm, scale

RGBA = tuple[float, float, float, float]

# For visuals that name no material, and for names that files use without defining them.
DEFAULT_COLOR: RGBA = (0.6, 0.6, 0.6, 1.0)
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

# Elements of the robot that go along in URDF alone.
EXTENSIONS = ("gazebo", "transmission", "ros2_control", "sensor")

# What each element may hold: children, attributes.  Those marked "-" are URDF but
# have no counterpart in the model.
_CONTENT: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "link": (("inertial", "visual", "collision"), ("name", "type")),
    "inertial": (("origin", "mass", "inertia"), ()),
    "visual": (("origin", "geometry", "material"), ("name",)),
    "collision": (("origin", "geometry", "-contact_coefficients"), ("name",)),
    "geometry": (("box", "cylinder", "sphere", "mesh"), ()),
    "origin": ((), ("xyz", "rpy")),
    "mass": ((), ("value",)),
    "inertia": ((), ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")),
    "box": ((), ("size",)),
    "cylinder": ((), ("radius", "length")),
    "sphere": ((), ("radius",)),
    "mesh": ((), ("filename", "scale")),
    "material": (("color", "-texture"), ("name",)),
    "color": ((), ("rgba",)),
    "joint": (
        (
            "origin",
            "parent",
            "child",
            "axis",
            "limit",
            "dynamics",
            "mimic",
            "-safety_controller",
            "-calibration",
        ),
        ("name", "type"),
    ),
    "parent": ((), ("link",)),
    "child": ((), ("link",)),
    "axis": ((), ("xyz",)),
    "limit": ((), ("lower", "upper", "effort", "velocity")),
    "dynamics": ((), ("damping", "friction")),
    "mimic": ((), ("joint", "multiplier", "offset")),
}

MeshLoader = Callable[[str, Element, Vec3], Mesh | None]


@dataclass(frozen=True, slots=True)
class UrdfParts:
    """The links and joints of one file, in its order, with its meshes and extensions."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    meshes: tuple[Mesh, ...]
    extensions: tuple[str, ...]


def labels_of(element: Element) -> tuple[Label, ...]:
    """Where the macros were called that the element came through."""
    return tuple(Label(span, "in the macro called here") for span in element.calls[:4])


def read_urdf(
    elements: Sequence[Element],
    module: str,
    load: MeshLoader,
    report: Report,
    macros: Collection[str] = (),
) -> UrdfParts:
    """Links, joints, meshes and extensions of the children of ``<robot>``.

    ``load`` finds the mesh that an element names and reports where it cannot;
    ``macros`` are the names of the file's macros, for hints.
    """
    return _Reader(module, load, report, macros).read(elements)


class _Reader:
    def __init__(
        self, module: str, load: MeshLoader, report: Report, macros: Collection[str]
    ) -> None:
        self.macros = macros
        self.module = module
        self.load = load
        self.report = report
        self.materials: dict[str, RGBA] = {}
        self.meshes: dict[str, Mesh] = {}

    def read(self, elements: Sequence[Element]) -> UrdfParts:
        links: list[Link] = []
        joints: list[Joint] = []
        extensions: list[str] = []
        for element in elements:
            self.collect_materials(element)
        for element in elements:
            if element.tag == "link":
                link = self.link(element)
                if link is not None:
                    links.append(link)
            elif element.tag == "joint":
                joint = self.joint(element)
                if joint is not None:
                    joints.append(joint)
            elif element.tag in EXTENSIONS:
                extensions.append(element.xml)
            elif element.tag != "material":
                self.unknown(element, element.tag, "robot")
        return UrdfParts(
            tuple(links), tuple(joints), tuple(self.meshes.values()), tuple(extensions)
        )

    # -- faults ------------------------------------------------------------------

    def fault(self, code: str, message: str, element: Element, hint: str | None = None) -> None:
        self.report.add(code, message, element.span, hint=hint, labels=labels_of(element))

    def unknown(self, element: Element, tag: str, inside: str) -> None:
        hint = None
        if tag in ("include", "macro", "property", "if", "unless", "arg"):
            hint = f"xacro's own elements have a prefix: <xacro:{tag} ...>"
        elif tag in self.macros:
            hint = f"a macro is called with the prefix: <xacro:{tag} ...>"
        else:
            known = [c for c in _CONTENT.get(inside, ((), ()))[0] if not c.startswith("-")]
            if inside == "robot":
                known = ["link", "joint", "material", *EXTENSIONS]
            hint = did_you_mean(tag, known)
        self.fault(
            "extra-left-out", f"<{tag}> in <{inside}> is not known and left out", element, hint
        )

    def check_content(self, element: Element) -> None:
        children, attributes = _CONTENT[element.tag]
        for child in element.children:
            if f"-{child.tag}" in children:
                self.fault(
                    "extra-left-out",
                    f"<{child.tag}> in <{element.tag}> has no counterpart in the model: left out",
                    child,
                )
            elif child.tag not in children:
                self.unknown(child, child.tag, element.tag)
        for name in element.attributes:
            if name not in attributes and not name.startswith("xmlns"):
                self.fault(
                    "extra-left-out",
                    f"attribute `{name}` of <{element.tag}> is not known and left out",
                    element,
                    did_you_mean(name, attributes),
                )

    # -- values ------------------------------------------------------------------

    def numbers(
        self, element: Element, name: str, count: int, default: str | None = None
    ) -> list[float] | None:
        """``count`` finite numbers of an attribute, or ``None`` with the fault reported."""
        text = element.attributes.get(name, default)
        if text is None:
            self.fault("extra-element", f"<{element.tag}> has no attribute `{name}`", element)
            return None
        words = text.split()
        found: list[float] = []
        for word in words:
            try:
                value = float(word)
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or "_" in word:
                self.fault(
                    "extra-number",
                    f'<{element.tag} {name}="{text}">: `{word}` is not a finite number',
                    element,
                    "numbers are separated by spaces, in m, rad and kg, without a unit",
                )
                return None
            found.append(value)
        if len(found) != count:
            self.fault(
                "extra-number",
                f'<{element.tag} {name}="{text}"> has {len(found)} numbers, not {count}',
                element,
            )
            return None
        return found

    def number(self, element: Element, name: str, default: str | None = None) -> float | None:
        found = self.numbers(element, name, 1, default)
        return found[0] if found is not None else None

    def vector(self, element: Element, name: str, default: str | None = None) -> Vec3 | None:
        found = self.numbers(element, name, 3, default)
        return (found[0], found[1], found[2]) if found is not None else None

    def positive(self, element: Element, *names: str) -> list[float] | None:
        values = [self.number(element, name) for name in names]
        good = [value for value in values if value is not None]
        for name, value in zip(names, values, strict=True):
            if value is not None and value <= 0.0:
                self.fault(
                    "extra-number",
                    f"<{element.tag}> has {name} {value:g} m; it must be over 0",
                    element,
                )
                return None
        return good if len(good) == len(names) else None

    def pose(self, owner: Element) -> Pose:
        origin = owner.find("origin")
        if origin is None:
            return Pose()
        self.check_content(origin)
        xyz = self.vector(origin, "xyz", "0 0 0")
        rpy = self.vector(origin, "rpy", "0 0 0")
        if xyz is None or rpy is None:
            return Pose()
        return Pose.from_xyz_rpy(xyz, rpy).clean()

    def name(self, element: Element) -> str | None:
        name = element.attributes.get("name", "").strip()
        if not name:
            self.fault("extra-element", f"<{element.tag}> has no name", element)
            return None
        return name

    # -- links -------------------------------------------------------------------

    def link(self, element: Element) -> Link | None:
        name = self.name(element)
        self.check_content(element)
        inertial: Inertial | None = None
        visuals: list[Visual] = []
        collisions: list[Collision] = []
        for child in element.children:
            if child.tag == "inertial":
                inertial = self.inertial(child, name or "")
            elif child.tag in ("visual", "collision"):
                self.check_content(child)
                pose = self.pose(child)
                shape = self.geometry(child)
                color = self.color(child)
                if shape is None:
                    continue
                if child.tag == "visual":
                    visuals.append(Visual(shape, pose, color))
                else:
                    collisions.append(Collision(shape, pose))
        if name is None:
            return None
        return Link(name, self.module, inertial, tuple(visuals), tuple(collisions), element.span)

    def inertial(self, element: Element, link: str) -> Inertial | None:
        self.check_content(element)
        pose = self.pose(element)
        mass_element, inertia_element = element.find("mass"), element.find("inertia")
        if mass_element is None or inertia_element is None:
            missing = "mass" if mass_element is None else "inertia"
            self.fault("extra-element", f"<inertial> of link `{link}` has no <{missing}>", element)
            return None
        self.check_content(mass_element)
        self.check_content(inertia_element)
        mass = self.number(mass_element, "value")
        entries = [
            self.number(inertia_element, name, default)
            for name, default in (
                ("ixx", None),
                ("iyy", None),
                ("izz", None),
                ("ixy", "0"),
                ("ixz", "0"),
                ("iyz", "0"),
            )
        ]
        good = [entry for entry in entries if entry is not None]
        if mass is None or len(good) != 6:
            return None
        if mass < 0.0:
            self.fault("extra-inertia", f"link `{link}` has a mass of {mass:g} kg", mass_element)
            return None
        found = Inertial(
            mass, (0.0, 0.0, 0.0), (good[0], good[1], good[2], good[3], good[4], good[5])
        )
        low, middle, high = found.principal_moments()
        slack = 1e-6 * high + 1e-12
        if mass == 0.0 and high > slack:
            self.fault("extra-inertia", f"link `{link}` has an inertia but no mass", mass_element)
            return None
        if low < -slack or high > low + middle + slack:
            moments = ", ".join(f"{m:.4g}" for m in (low, middle, high))
            what = (
                "one of them is negative"
                if low < -slack
                else "no body's largest one is over the sum of the others"
            )
            self.fault(
                "extra-inertia",
                f"link `{link}` has principal moments of inertia {moments} kg m^2: {what}",
                inertia_element,
                "compute it from the shape; a box: ixx = m (y^2 + z^2) / 12 and so on",
            )
            return None
        return found.transformed(pose).clean() if mass > 0.0 else None

    def geometry(self, owner: Element) -> Shape | None:
        geometry = owner.find("geometry")
        if geometry is None or not geometry.children:
            self.fault("extra-element", f"<{owner.tag}> has no geometry", geometry or owner)
            return None
        shape = geometry.children[0]
        if len(geometry.children) > 1 or shape.tag not in _CONTENT["geometry"][0]:
            count = len(geometry.children)
            self.fault(
                "extra-element",
                f"<geometry> holds {count} shapes; it takes one"
                if count > 1
                else f"the shape <{shape.tag}> is not known",
                geometry if count > 1 else shape,
                "shapes are box, cylinder, sphere and mesh",
            )
            return None
        self.check_content(shape)
        if shape.tag == "mesh":
            return self.mesh(shape)
        if shape.tag == "box":
            size = self.vector(shape, "size")
            if size is not None and min(size) <= 0.0:
                self.fault("extra-number", f"<box> has an edge of {min(size):g} m", shape)
                return None
            return Box(clean3(size)) if size is not None else None
        if shape.tag == "cylinder":
            sizes = self.positive(shape, "radius", "length")
            return Cylinder(clean(sizes[0]), clean(sizes[1])) if sizes is not None else None
        sizes = self.positive(shape, "radius")
        return Sphere(clean(sizes[0])) if sizes is not None else None

    def mesh(self, element: Element) -> MeshShape | None:
        factors = self.vector(element, "scale", "1 1 1")
        name = element.attributes.get("filename", "").strip()
        if not name:
            self.fault("extra-element", "<mesh> has no filename", element)
            return None
        if factors is None:
            return None
        if 0.0 in factors:
            self.fault("extra-number", "<mesh> has a scale of 0", element)
            return None
        mesh = self.load(name, element, factors)
        if mesh is None:
            return None
        self.meshes.setdefault(mesh.name, mesh)
        return MeshShape(mesh.name, clean3(factors))

    # -- materials ---------------------------------------------------------------

    def collect_materials(self, element: Element) -> None:
        """Materials are known by name in the whole file, wherever they are defined."""
        if element.tag == "material":
            self.check_content(element)
            color = element.find("color")
            name = element.attributes.get("name", "")
            if color is not None and name and name not in self.materials:
                self.check_content(color)
                rgba = self.numbers(color, "rgba", 4)
                if rgba is not None and not all(0.0 <= c <= 1.0 for c in rgba):
                    self.fault(
                        "extra-number",
                        f'<color rgba="{color.attributes["rgba"]}"> is not within 0..1',
                        color,
                        "divide by 255 where the values are bytes",
                    )
                elif rgba is not None:
                    self.materials[name] = (rgba[0], rgba[1], rgba[2], rgba[3])
        for child in element.children:
            self.collect_materials(child)

    def color(self, visual: Element) -> RGBA:
        material = visual.find("material")
        if material is None or visual.tag != "visual":
            return DEFAULT_COLOR
        name = material.attributes.get("name", "").strip()
        if name in self.materials:
            return self.materials[name]
        own = material.find("color")
        if own is not None:  # a material without a name, for this visual alone
            rgba = self.numbers(own, "rgba", 4) if not name else None
            return (rgba[0], rgba[1], rgba[2], rgba[3]) if rgba is not None else DEFAULT_COLOR
        if material.find("texture") is None:
            known = _COMMON_COLORS.get(name.lower().rpartition("/")[2])
            self.fault(
                "extra-material",
                f"material `{name}` is not defined; "
                + ("the usual colour of that name" if known else "grey")
                + " is used",
                material,
                f'define it: <material name="{name}"><color rgba="r g b a"/></material>',
            )
            return known or DEFAULT_COLOR
        return DEFAULT_COLOR

    # -- joints ------------------------------------------------------------------

    def joint(self, element: Element) -> Joint | None:
        name = self.name(element)
        self.check_content(element)
        kind = element.attributes.get("type", "")
        if kind not in ("fixed", "revolute", "continuous", "prismatic"):
            text = f"joint `{name}` has no type"
            if kind:
                text = f"joint `{name}` has the type `{kind}`, which the model does not have"
            self.fault(
                "extra-joint-type",
                text,
                element,
                "use fixed, revolute, continuous or prismatic; a floating or planar one can be "
                "put together from several",
            )
            return None
        ends = [self.end(element, tag, name or "") for tag in ("parent", "child")]
        pose = self.pose(element)
        parent, child = ends
        if name is None or parent is None or child is None:
            return None
        if kind == "fixed":
            return Joint(name, self.module, kind, parent, child, pose, element.span)
        limits = self.limits(element, kind, name)
        axis = self.axis(element, name)
        if limits is None or axis is None:
            return None
        lower, upper, effort, velocity = limits
        damping = friction = 0.0
        dynamics = element.find("dynamics")
        if dynamics is not None:
            self.check_content(dynamics)
            damping = self.not_negative(dynamics, "damping")
            friction = self.not_negative(dynamics, "friction")
        return Joint(
            name,
            self.module,
            kind,
            parent,
            child,
            pose,
            element.span,
            axis=axis,
            lower=lower,
            upper=upper,
            effort=effort,
            velocity=velocity,
            damping=damping,
            friction=friction,
            mimic=self.mimic(element),
        )

    def end(self, joint: Element, tag: str, name: str) -> str | None:
        element = joint.find(tag)
        link = element.attributes.get("link", "").strip() if element is not None else ""
        if element is not None:
            self.check_content(element)
        if not link:
            self.fault("extra-element", f"joint `{name}` names no {tag} link", element or joint)
            return None
        return link

    def axis(self, joint: Element, name: str) -> Vec3 | None:
        element = joint.find("axis")
        if element is None:
            return (1.0, 0.0, 0.0)  # URDF's default
        self.check_content(element)
        axis = self.vector(element, "xyz", "1 0 0")
        if axis is None:
            return None
        length = norm(axis)
        if length < 1e-9:
            self.fault("extra-number", f"joint `{name}` has an axis of length 0", element)
            return None
        return clean3(scale(1.0 / length, axis))

    def limits(
        self, joint: Element, kind: str, name: str
    ) -> tuple[float | None, float | None, float | None, float | None] | None:
        element = joint.find("limit")
        if element is None:
            if kind == "continuous":
                return (None, None, None, None)
            self.fault(
                "extra-joint-limits",
                f"joint `{name}` is {kind} and has no <limit>",
                joint,
                '<limit lower="" upper="" effort="" velocity=""/>, or the type continuous',
            )
            return None
        self.check_content(element)
        values: list[float | None] = []
        for attribute in ("effort", "velocity"):
            if kind == "continuous" and attribute not in element.attributes:
                values.append(None)
                continue
            value = self.number(element, attribute)
            if value is None:
                return None
            if value < 0.0:
                self.fault(
                    "extra-joint-limits",
                    f"joint `{name}` has a limit {attribute}={value:g}; it must not be negative",
                    element,
                )
                return None
            values.append(value)
        if kind == "continuous":
            return (None, None, values[0], values[1])
        lower, upper = self.number(element, "lower", "0"), self.number(element, "upper", "0")
        if lower is None or upper is None:
            return None
        if lower > upper:
            self.fault(
                "extra-joint-limits",
                f"joint `{name}` has the lower limit {lower:g} over the upper one {upper:g}",
                element,
            )
            return None
        return (lower, upper, values[0], values[1])

    def not_negative(self, element: Element, name: str) -> float:
        value = self.number(element, name, "0")
        if value is not None and value < 0.0:
            self.fault("extra-number", f"<{element.tag}> has {name}={value:g}, under 0", element)
            return 0.0
        return value or 0.0

    def mimic(self, joint: Element) -> Mimic | None:
        element = joint.find("mimic")
        if element is None:
            return None
        self.check_content(element)
        other = element.attributes.get("joint", "").strip()
        multiplier = self.number(element, "multiplier", "1")
        offset = self.number(element, "offset", "0")
        if not other:
            self.fault("extra-element", "<mimic> names no joint", element)
        if not other or multiplier is None or offset is None:
            return None
        return Mimic(other, multiplier, offset)
