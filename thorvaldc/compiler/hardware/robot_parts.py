"""Collects the links, joints and devices of all modules of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

from thorvaldc.compiler.hardware.hardware_parts import Hardware
from thorvaldc.compiler.hardware.purchase_reader import purchase_of
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.plain_numbers import millimetres
from thorvaldc.model import (
    Actuator,
    Battery,
    Joint,
    JointServo,
    Link,
    Mesh,
    Module,
    Pose,
    Sensor,
    SourcedMass,
    Wheel,
)
from thorvaldc.model.module import Purchase
from thorvaldc.model.spatial import clean

Placed = TypeVar("Placed", Link, Joint, Actuator, Wheel, Sensor, Battery)

# Allowed difference (m) between the computed height of the root module and the height in the module
# document.
HEIGHT_TOLERANCE = 1e-3


@dataclass
class RobotParts:
    """Container of the links, joints, actuators, wheels, sensors, batteries and meshes of a robot.

    ``joint_servos`` are the servos of extras.

    The name of a link or joint is ``<module>_<name>``.  The part ``<module>`` is the path of the
    module instance with underscores instead of dots.  The part ``<name>`` is the name of the link
    or joint in the module document.
    """

    links: list[Link]
    joints: list[Joint] = field(default_factory=list)
    actuators: list[Actuator] = field(default_factory=list)
    wheels: list[Wheel] = field(default_factory=list)
    sensors: list[Sensor] = field(default_factory=list)
    batteries: list[Battery] = field(default_factory=list)
    meshes: dict[str, Mesh] = field(default_factory=dict)
    joint_servos: list[JointServo] = field(default_factory=list)

    def add(self, leaf: Instance, hardware: Mapping[str, Hardware]) -> None:
        """Adds the links, joints, motors and devices of a module.

        ``hardware`` contains the links, joints and devices of each module, by the path of the
        module.
        """
        part = hardware[leaf.path]
        prefix = name_prefix(leaf.path)
        for mesh in part.meshes:
            self.meshes[mesh.name] = mesh
        self.links += (_placed(link, leaf) for link in part.links)
        self.joints.append(_mount_joint(leaf, hardware))
        if part.wheel is not None:
            link_name = f"{prefix}_{part.wheel.link}"
            self.wheels.append(_placed(part.wheel, leaf, name=prefix, link=link_name))
        if part.sensor is not None:
            link_name = f"{prefix}_{part.sensor.link}"
            self.sensors.append(_placed(part.sensor, leaf, name=prefix, link=link_name))
        if part.battery is not None:
            link_name = f"{prefix}_{part.battery.link}"
            node = prefix if part.battery.node is not None else None
            self.batteries.append(
                _placed(part.battery, leaf, name=prefix, link=link_name, node=node)
            )
        self.add_joints(leaf, part)

    def add_joints(self, leaf: Instance, hardware: Hardware) -> None:
        """Adds the joints and motors of a module."""
        prefix = name_prefix(leaf.path)
        for joint in hardware.joints:
            ends = {"parent": f"{prefix}_{joint.parent}", "child": f"{prefix}_{joint.child}"}
            self.joints.append(_placed(joint, leaf, **ends))
        for motor in hardware.motors:
            self.actuators.append(_placed(motor, leaf, joint=f"{prefix}_{motor.joint}"))

    def check_names(self, report: Report) -> None:
        """Reports two links or two joints with the same name.

        For example, the links of the modules `a_b.c` and `a.b_c` have the same prefix `a_b_c`.
        """
        for word, elements in (("link", self.links), ("joint", self.joints)):
            first_by_name: dict[str, Link | Joint] = {}
            for element in elements:
                first = first_by_name.setdefault(element.name, element)
                if first is not element:
                    report.add(
                        "name-twice",
                        f"two {word}s have the name `{element.name}`: "
                        f"one of `{first.module or 'the base'}` and one of `{element.module}`",
                        element.span,
                        labels=[Label(first.span, "the first one")],
                        hint="rename one of the modules",
                    )

    def raise_root(self, height: float, hardware: Mapping[str, Hardware], report: Report) -> None:
        """Raises the root module by ``height`` (m), so that the wheels stand on the ground.

        The module document may state the height of the root module above the ground.  A difference
        between ``height`` and the height in the module document is reported.  The root module of a
        robot without wheels is placed at the height in the module document.
        """
        for i, joint in enumerate(self.joints):
            if joint.parent != "base_link" or joint.type != "fixed" or not joint.module:
                continue
            root = hardware.get(joint.module)
            if root is None:
                continue
            x, y, z = joint.pose.xyz
            z += height
            self.joints[i] = replace(joint, pose=Pose((x, y, z), joint.pose.quat).clean())
            stated = root.height_above_ground
            if not self.wheels and stated is not None:
                self.joints[i] = replace(joint, pose=Pose((x, y, stated), joint.pose.quat))
            elif stated is not None and abs(stated - z) > HEIGHT_TOLERANCE:
                report.add(
                    "frame-height",
                    f"`{joint.module}` states a height of {millimetres(stated, 6)}; "
                    f"on these wheels it is {millimetres(z, 6)}",
                    joint.span,
                    hint=f"set `height: {millimetres(z, 6)}`, leave it out, "
                    "or choose legs of another length",
                )


def modules_of(
    robot: Instance,
    hardware: Mapping[str, Hardware],
    purchases: Mapping[str, Purchase] = MappingProxyType({}),
) -> tuple[Module, ...]:
    """Returns the modules of the robot that are not assemblies, in the order of the file.

    ``purchases``: purchase data in the robot document, by module type or path of a module.
    """
    modules = []
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        mounted = leaf.is_mechanical
        modules.append(
            Module(
                leaf.path,
                leaf.type.name,
                leaf.mount.leaf.path if mounted and leaf.mount is not None else "",
                mounted,
                mass_by_source(hardware[leaf.path]) if mounted else (),
                leaf.span,
                purchase_of(leaf, hardware, purchases),
            )
        )
    return tuple(modules)


def mass_by_source(hardware: Hardware) -> tuple[SourcedMass, ...]:
    """Returns the mass of a module by source, in the order of the module document."""
    masses: dict[str, float] = {}
    for part in hardware.masses:
        masses[part.source] = masses.get(part.source, 0.0) + part.mass
    return tuple(SourcedMass(clean(mass), source) for source, mass in masses.items())


def _placed(element: Placed, leaf: Instance, **changes: str | None) -> Placed:
    """Returns an element of a module's hardware as an element of the robot.

    ``changes``: names of other elements in the robot.  Without a new ``name``, the element gets
    the name of the module as a prefix.
    """
    changes.setdefault("name", f"{name_prefix(leaf.path)}_{element.name}")
    return replace(element, module=leaf.path, span=leaf.span, **changes)  # type: ignore[arg-type]


def _mount_joint(leaf: Instance, hardware: Mapping[str, Hardware]) -> Joint:
    """Returns the fixed joint between the carrying link and the first link of a leaf module."""
    part = hardware[leaf.path]
    prefix = name_prefix(leaf.path)
    child = f"{prefix}_{part.links[0].name}"
    if leaf.mount is None:
        parent, pose = "base_link", Pose()
    else:
        carrier = leaf.mount.leaf
        link = leaf.mount.link or hardware[carrier.path].links[0].name
        parent = f"{name_prefix(carrier.path)}_{link}"
        pose = leaf.mount.pose * part.mount_pose.inverse()
    return Joint(f"{prefix}_mount", leaf.path, "fixed", parent, child, pose.clean(), leaf.span)
