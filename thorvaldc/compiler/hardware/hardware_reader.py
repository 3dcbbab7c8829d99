"""Computes the hardware of a module (links, joints, motors and devices) from the module document.

The hardware of a module does not depend on the position of the module in the robot.  If a robot has
nine equal drives, the hardware of the drive is computed once.

Links, joints and motors are elements of the model in the frame of the module.  They have the names
of the module document, no module and the spans of that document.  ``RobotParts`` places them in a
robot: with the name of the module as a prefix, the path of the module, and its span in the robot
file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from thorvaldc import model
from thorvaldc.compiler.hardware import joint_reader
from thorvaldc.compiler.hardware.ros2_driver_reader import read_ros2_driver
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.compiler.shapes.solids import uniform_solid
from thorvaldc.compiler.source.dimensions import EXPECTED, element_of
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.readable_folders import is_below, real_folders
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import INVALID, entries, items
from thorvaldc.diagnostics import Proposal, Report, did_you_mean, nearest
from thorvaldc.model.robot import NOT_STATED
from thorvaldc.model.sensor_numbers import SENSOR_NUMBERS
from thorvaldc.model.spatial import clean, combine
from thorvaldc.schema import inlined


class Hardware(NamedTuple):
    """Links, joints, motors and devices of a module for given parameter values.

    - ``masses``: masses of the parts of all links, in the order of the module document.
    - ``joints``, ``motors``: effort and velocity of a joint with a motor are the lower of the two
      limits.
    - ``wheel``: wheel with its size; ``make_wheels`` computes its place in the robot.
    - ``battery``: its ``node`` is ``None`` if the enclosure is empty.
    - ``mount_pose``: pose in the first link's frame where the module is mounted.
    """

    links: tuple[model.Link, ...] = ()
    masses: tuple[model.SourcedMass, ...] = ()
    joints: tuple[model.Joint, ...] = ()
    motors: tuple[model.Actuator, ...] = ()
    wheel: model.Wheel | None = None
    sensor: model.Sensor | None = None
    battery: model.Battery | None = None
    mount_pose: model.Pose = model.Pose()
    meshes: tuple[model.Mesh, ...] = ()
    height_above_ground: float | None = None
    purchase: model.Purchase = NOT_STATED


RGBA = tuple[float, float, float, float]
DEFAULT_COLOR = "#9a9a9a"
_COLOR = re.compile(r"#[0-9a-fA-F]{6}([0-9a-fA-F]{2})?")
MAX_CACHED = 256
"""Largest number of parameter values of a module type whose hardware is cached: a study compiles
designs without end."""
UNPLACED: dict[str, Any] = {
    "spin_joint": "",
    "steering_joint": None,
    "swivel_joint": None,
    "suspension_joint": None,
    "driven": False,
    "steering_sign": 1.0,
    **dict.fromkeys(
        ["x", "y", "heading", "trail", "lateral_offset", "load", "contact_height"], 0.0
    ),
}
"""Fields of a wheel that depend on its place in the robot: ``make_wheels`` computes them."""
MAX_REPETITIONS = 1000  # Largest number of copies of a link part with the key `for`.


def hardware_of(module: ModuleType, scope: Scope, report: Report) -> Hardware | None:
    """Returns the hardware of a module that is not an assembly.

    The hardware of a module type is cached for each set of parameter values.  Returns no hardware
    (``None``) if the value of a parameter is invalid.  The error of an invalid parameter value has
    already been reported.
    """
    key = tuple(tuple(v) if isinstance(v, list) else v for v in scope.parameter_values())
    if any(value is INVALID for value in key):
        return None
    key = (*scope.library.palette().items(), *key)
    if key not in module.elaborated:
        if len(module.elaborated) >= MAX_CACHED:
            module.elaborated.clear()
        # The diagnostics of a module type are cached, because each use of the module type must
        # report the diagnostics.
        module_report = Report()
        outer_report, scope.report = scope.report, module_report
        try:
            built = _HardwareReader(module, scope, module_report).read()
        finally:
            scope.report = outer_report
        module.elaborated[key] = (built, module_report)
    hardware: Hardware
    hardware, module_report = module.elaborated[key]
    report.extend(module_report)
    return hardware


class _HardwareReader:
    """Reads the hardware of one module type for given parameter values."""

    def __init__(self, module: ModuleType, scope: Scope, report: Report) -> None:
        self.module = module
        self.scope = scope
        self.report = report
        self.values = joint_reader.ModuleValues(module, scope, report)
        self.masses: list[model.SourcedMass] = []
        self.meshes: dict[str, model.Mesh] = {}  # of all parts, by file name

    def read(self) -> Hardware:
        """Returns the hardware of the module and reports all errors in the module document."""
        section, document, values = self.module.section, self.module.document, self.values
        if not values.link_names and (section("links") or section("joints")):
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` has no links with these parameters",
                next(iter({**section("joints"), **section("links")}.values())).where,
                hint="leave the whole module out instead: `type: none`",
            )
            return Hardware()
        links = tuple(self._link(name, section("links")[name]) for name in values.link_names)
        joints = joint_reader.read_joints(values)
        joints, motors = joint_reader.with_common_limits(
            joints, joint_reader.read_motors(values, joints)
        )
        for port in section("ports").values():
            values.link_name(port.get("link"))
        mount = document.get("mount")
        self._check_mount_link(mount)
        free_mount = document.get("free_mount")
        if free_mount is not None:
            values.link_name(free_mount.get("link"))
        height = document.get("height_above_ground")
        is_stated = height is not None and self.scope.evaluate(height) is not None
        wheel, sensor, battery = (
            node if node is not None and values.is_present(node) else None
            for node in map(document.get, ("wheel", "sensor", "battery"))
        )
        if sensor or battery or any(link.visuals or link.collisions for link in links):
            self._check_mass(links)
        return Hardware(
            links,
            tuple(self.masses),
            joints,
            motors,
            self._wheel(wheel) if wheel is not None else None,
            self._sensor(sensor) if sensor is not None else None,
            self._battery(battery) if battery is not None else None,
            self.values.section(mount, "mount").pose() if mount is not None else model.Pose(),
            tuple(self.meshes.values()),
            self.scope.quantity(height, "length") if is_stated else None,
            self._purchase(document.get("purchase")),
        )

    def _check_mass(self, links: tuple[model.Link, ...]) -> None:
        """Checks that a module that is a body, and not only a frame, has a mass."""
        if self.report.has_errors:
            return  # a mass with an error is not missing
        if links and not any(mass.mass for mass in self.masses):
            self.report.add(
                "module-massless",
                f"`{self.module.name}` has no mass: the weight, the wheel loads and the tip-over "
                "angles of the robot leave it out",
                links[0].span,
                hint="weigh it and give one of its parts a `mass` with its `source`",
            )

    def _check_mount_link(self, mount: Node | None) -> None:
        """Checks that the key `mount` of a module document names the first link of the module."""
        node = mount.get("link") if mount is not None else None
        link_names = self.values.link_names
        if node is not None and self.values.link_name(node) in link_names[1:]:
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` is mounted by `{self.scope.text(node)}`, which is not its "
                f"first link, `{link_names[0]}`",
                node.span,
                hint="the first link carries the mount; write that link first",
            )

    # -- links ------------------------------------------------------------------------

    def _link(self, name: str, node: Node) -> model.Link:
        """Reads a link of a module document with the visual shapes and collision shapes of all
        parts of the link, and notes the masses of the parts.
        """
        visuals: list[model.Visual] = []
        collisions: list[model.Collision] = []
        inertials: list[model.Inertial] = []
        for part in items(node.get("parts")):
            for scope in self._repetitions(part):
                if scope.boolean(part.get("when"), True):
                    mass = self._part(part, scope, visuals, collisions)
                    if mass is not None:
                        inertials.append(mass)
                        source = scope.text(part.get("source"))
                        self.masses.append(model.SourcedMass(clean(mass.mass), source))
        inertial = combine(inertials).clean() if inertials else None
        return model.Link(name, "", inertial, tuple(visuals), tuple(collisions), node.where)

    def _repetitions(self, part: Node) -> list[Scope]:
        """Returns the names for expressions for each copy of a part with the key `for`."""
        loop = part.get("for")
        if loop is None or not isinstance(loop.value, dict):
            return [self.scope]
        scopes = [self.scope]
        for name, node in loop.value.items():
            values = self.scope.evaluate(node) if isinstance(node.value, str) else node.value
            if not isinstance(values, tuple | list):
                self.report.add("wrong-type", "expected a list", node.span)
                values = ()
            dimensions = self.scope.dimension_of(node) if values else []
            values = [self.scope.scalar(v, 0.0) if isinstance(v, Node) else v for v in values]
            count = len(scopes) * len(values)
            if count > MAX_REPETITIONS:
                self.report.add(
                    "too-many-parts",
                    f"a part is repeated {count} times; at most {MAX_REPETITIONS} are read",
                    loop.where,
                )
                return []
            scopes = [
                scope.with_names({name: value}, {name: element_of(dimensions, index)})
                for scope in scopes
                for index, value in enumerate(values)
            ]
        return scopes

    # -- wheel, sensor, battery, purchase --------------------------------------------------------

    def _wheel(self, node: Node) -> model.Wheel:
        """Reads the section `wheel` of a module document."""
        wheel = self.values.section(node, "wheel")
        return model.Wheel(
            name="",
            module="",
            link=self.values.link_name(node.get("link")),
            radius=wheel["radius"],
            width=wheel["width"],
            radii=tuple(wheel["radii"].items()),
            friction=wheel["friction"],
            rolling_resistance=wheel["rolling_resistance"],
            treads=tuple(self._treads(wheel)),
            span=node.where,
            **UNPLACED,
        )

    def _treads(self, wheel: Section) -> Iterator[model.Tread]:
        """Yields the treads of a wheel, which are the rolling surfaces of the wheel.

        Each tread of a wheel needs a radius of the same name in the section `radii`.
        """
        radius_names = entries(wheel.node.get("radii"))
        for name, tread in wheel["treads"].items():
            if name not in radius_names:
                self.report.add(
                    "missing-key",
                    f"the ring `{name}` has no radius",
                    tread.node.where,
                    hint=f"add `radii: {{{name}: 90 mm}}`",
                )
                continue
            yield model.Tread(name, tread["xyz"], tread["width"], tread["flange"])

    def _sensor(self, node: Node) -> model.Sensor:
        """Reads the section `sensor` of a module document."""
        kind, link = self.scope.text(node.get("type")), self.values.link_name(node.get("link"))
        properties = node.get("properties")
        if kind in SENSOR_NUMBERS:
            self._check_numbers(kind, properties or Node({}, node.span))
        driver = read_ros2_driver(node.get("ros2_driver"), kind, self.values)
        numbers = self.values.properties(properties)
        return model.Sensor("", "", kind, link, numbers, node.where, driver)

    def _check_numbers(self, kind: str, properties: Node) -> None:
        """Checks the numbers of a simulated sensor; other properties are for other programs."""
        schemas = SENSOR_NUMBERS[kind]
        numbers = Section(properties, {"properties": schemas}, self.scope).read()
        if "minimum_range" in schemas:
            largest = numbers.get("range", schemas["range"]["default"])
            numbers.is_within("minimum_range", {"x-maximum": largest})
        stated = entries(properties)
        others = [name for name in schemas if name not in stated]
        for name, node in stated.items():
            # Only a misspelt name: `range_max` may be a property for another program.
            meant = nearest(name, others, cutoff=0.8) if name not in schemas else None
            if meant is not None:
                message = f"`{name}` is not a number of a {kind}"
                hint = did_you_mean(name, [meant])
                self.report.add("unknown-key", message, node.where, hint=hint)

    def _battery(self, node: Node) -> model.Battery:
        """Reads the section `battery` of a module document."""
        present = self.scope.boolean(node.get("present"), True)
        link = self.values.link_name(node.get("link"))
        properties = self.values.properties(node.get("properties"))
        return model.Battery("", "", link, "" if present else None, properties, node.where)

    def _purchase(self, node: Node | None) -> model.Purchase:
        """Reads the section `purchase` of a module document, which few modules have."""
        if node is None:
            return NOT_STATED
        from thorvaldc.compiler.hardware.purchase_reader import read_purchase

        return read_purchase(node, self.scope, self.report)

    # -- shapes, colours and masses of links -------------------------------------------------

    def _part(
        self,
        part: Node,
        scope: Scope,
        visuals: list[model.Visual],
        collisions: list[model.Collision],
    ) -> model.Inertial | None:
        """Reads a part of a link, and adds the shape of the part to the link.

        The solid from which a mass is computed is also a collision shape, because heavy parts must
        not be missing where a robot keeps its distance.

        Returns the inertia of the part in the frame of the link, or ``None`` for a part without
        mass.
        """
        links = inlined("module")["properties"]["links"]["additionalProperties"]
        values = Section(part, links["properties"]["parts"]["items"], scope)
        pose = values.pose().clean()
        collides = values["collide"]
        shape = self._shape(values["shape"], scope, bool(collides))
        if shape is not None and values["show"]:
            visuals.append(model.Visual(shape, pose, self._color(part.get("color"), scope)))
        solid = shape
        if "inertia_shape" in values:
            solid = self._shape(values["inertia_shape"], scope, False)
        collision = shape if collides else None
        if collides is None and "mass" in values and not isinstance(solid, model.MeshShape):
            collision = solid
        if collision is not None:
            collisions.append(model.Collision(collision, pose))
        inertial = self._inertial(values, solid, scope)
        return inertial.transformed(pose) if inertial is not None else None

    def _inertial(
        self, part: Section, shape: model.Shape | None, scope: Scope
    ) -> model.Inertial | None:
        """Returns the mass and the inertia of a link part in the coordinate frame of the part.

        If the module document does not state the inertia, the inertia of a uniform solid is
        computed.  ``shape``: value of `inertia_shape`, or the shape of the link part.
        """
        mass = part["mass"]
        if mass is None:
            return None
        if "inertia" in part:
            return model.Inertial(mass, part.get("com", (0.0, 0.0, 0.0)), part["inertia"])
        if shape is None or isinstance(shape, model.MeshShape):
            stated = map(part.node.get, ("shape", "inertia", "inertia_shape"))
            if shape is not None or not any(stated):  # else it has an error
                self.report.add(
                    "inertia-unknown",
                    "the mass has no solid shape from which to compute the inertia",
                    part.entry("mass").where,
                    hint="add `inertia_shape: {box: [...]}` or `com` and `inertia`",
                )
            return None
        return uniform_solid(shape, mass, part["wall"])

    def _shape(self, shape: Section, scope: Scope, collides: bool) -> model.Shape | None:
        """Reads a box, cylinder, sphere or mesh of a module document.

        The sizes of the shape are in m.
        """
        if "box" in shape:
            return model.Box(shape["box"])
        if "cylinder" in shape:
            return model.Cylinder(shape["cylinder"]["radius"], shape["cylinder"]["length"])
        if "sphere" in shape:
            return model.Sphere(shape["sphere"]["radius"])
        if "mesh" in shape:
            return self._mesh(shape["mesh"].node, scope, collides)
        return None

    def _mesh(self, node: Node, scope: Scope, collides: bool) -> model.MeshShape | None:
        """Reads a mesh file and adds the mesh to ``meshes``."""
        file = node.get("file")
        if file is None:
            return None
        name = scope.text(file)
        factors = self._mesh_scale(node.get("scale"), scope)
        is_builtin = self.module.display.startswith(BUILTIN_LIBRARY)
        if not is_builtin and not is_below(
            self.module.folder / name, real_folders([self.module.library_folder])
        ):
            self.report.add(
                "mesh-missing",
                f"mesh file `{name}` cannot be read: it is outside of the library folder",
                file.span,
                hint="copy it beside the module file",
            )
            return None
        mesh = load_mesh(
            self.module.folder / name,
            file.span,
            self.report,
            display=name,
            scale=factors,
            collides=collides,
            is_builtin=is_builtin,
            named_in=(self.module.folder, file),
        )
        if mesh is None:
            return None
        self.meshes[mesh.name] = mesh
        return model.MeshShape(mesh.name, factors)

    def _mesh_scale(self, scale: Node | None, scope: Scope) -> model.Vec3:
        """Returns the scale factors of a mesh.  One number is the factor of all axes.

        A scale may be a length, that of one unit of the mesh.
        """
        length = EXPECTED["length"]
        if scale is None:
            return (1.0, 1.0, 1.0)
        if not isinstance(scale.value, tuple):
            value = scope.evaluate(scale)
            if isinstance(value, int | float | str):
                factor = scope.quantity(scale, "ratio", 1.0, length)
                return (factor, factor, factor)
            factors = scope.numbers(scale, "ratio", 3, length)
            return factors if factors is not INVALID else (1.0, 1.0, 1.0)
        x, y, z = (scope.quantity(factor, "ratio", 1.0, length) for factor in items(scale))
        return (x, y, z)

    def _color(self, node: Node | None, scope: Scope) -> RGBA:
        """Returns a colour as red, green, blue and alpha, each from 0 to 1.

        A document contains a colour as "#rrggbb", as "#rrggbbaa" or as the name of a palette
        colour.
        """
        text = scope.text(node, DEFAULT_COLOR) or DEFAULT_COLOR
        palette = self.scope.library.palette()
        digits = palette.get(text, text)
        if _COLOR.fullmatch(digits):
            values = [int(digits[i : i + 2], 16) / 255 for i in range(1, len(digits), 2)]
            r, g, b, a = (round(v, 4) for v in [*values, 1.0][:4])
            return (r, g, b, a)
        known = hint_of_known(text, list(palette))
        self.report.add(
            "color-unknown",
            f"`{text}` is not a colour",
            node.span if node is not None else None,
            hint=known
            if isinstance(known, Proposal)
            else f'write "#rrggbb" or a name of the palette; {known}',
        )
        return (0.5, 0.5, 0.5, 1.0)
