"""Computes the hardware of a module (links, joints, motors and devices) from the module document.

The hardware of a module does not depend on the position of the module in the robot.  If a robot has
nine equal drives, the hardware of the drive is computed once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.hardware.hardware_parts import Hardware
from thorvaldc.compiler.hardware.joint_reader import read_joints, read_motors, with_common_limits
from thorvaldc.compiler.hardware.link_shapes import LinkShapeReader
from thorvaldc.compiler.hardware.module_values import ModuleValues
from thorvaldc.compiler.hardware.purchase_reader import read_purchase
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.dimensions import element_of
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import INVALID, entries, items
from thorvaldc.diagnostics import Report
from thorvaldc.model import (
    Battery,
    Collision,
    Inertial,
    Link,
    Pose,
    Sensor,
    SourcedMass,
    Tread,
    Visual,
    Wheel,
)
from thorvaldc.model.spatial import clean, combine

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
        self.values = ModuleValues(module, scope, report)
        self.masses: list[SourcedMass] = []
        self.shapes = LinkShapeReader(
            module.folder,
            module.display.startswith(BUILTIN_LIBRARY),
            scope.library.palette(),
            report,
        )

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
        joints = read_joints(values)
        joints, motors = with_common_limits(joints, read_motors(values, joints))
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
            self.values.section(mount, "mount").pose() if mount is not None else Pose(),
            tuple(self.shapes.meshes.values()),
            self.scope.quantity(height, "length") if is_stated else None,
            read_purchase(document.get("purchase"), self.scope, self.report),
        )

    def _check_mass(self, links: tuple[Link, ...]) -> None:
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

    def _link(self, name: str, node: Node) -> Link:
        """Reads a link of a module document with the visual shapes and collision shapes of all
        parts of the link, and notes the masses of the parts.
        """
        visuals: list[Visual] = []
        collisions: list[Collision] = []
        inertials: list[Inertial] = []
        for part in items(node.get("parts")):
            for scope in self._repetitions(part):
                if scope.boolean(part.get("when"), True):
                    mass = self.shapes.read(part, scope, visuals, collisions)
                    if mass is not None:
                        inertials.append(mass)
                        source = scope.text(part.get("source"))
                        self.masses.append(SourcedMass(clean(mass.mass), source))
        inertial = combine(inertials).clean() if inertials else None
        return Link(name, "", inertial, tuple(visuals), tuple(collisions), node.where)

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
            values = [self.values.scalar(v) if isinstance(v, Node) else v for v in values]
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

    # -- wheel, sensor, battery -------------------------------------------------------------

    def _wheel(self, node: Node) -> Wheel:
        """Reads the section `wheel` of a module document."""
        wheel = self.values.section(node, "wheel")
        return Wheel(
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

    def _treads(self, wheel: Section) -> Iterator[Tread]:
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
            yield Tread(name, tread["xyz"], tread["width"], tread["flange"])

    def _sensor(self, node: Node) -> Sensor:
        """Reads the section `sensor` of a module document."""
        kind, link = self.scope.text(node.get("type")), self.values.link_name(node.get("link"))
        properties = self.values.properties(node.get("properties"))
        return Sensor("", "", kind, link, properties, node.where)

    def _battery(self, node: Node) -> Battery:
        """Reads the section `battery` of a module document."""
        present = self.scope.boolean(node.get("present"), True)
        link = self.values.link_name(node.get("link"))
        properties = self.values.properties(node.get("properties"))
        return Battery("", "", link, "" if present else None, properties, node.where)
