"""Builds the model of a robot from the tree of module instances.

The model contains the links, joints, wheels, motors and CAN buses of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from thorvaldc.compiler.bus import stopping_distance
from thorvaldc.compiler.bus.assemble_buses import Wiring, connect_actuators
from thorvaldc.compiler.bus.node_ids import Lock
from thorvaldc.compiler.hardware import wheel_geometry
from thorvaldc.compiler.hardware.hardware_reader import Hardware, hardware_of
from thorvaldc.compiler.hardware.robot_parts import RobotParts, couple_joints, modules_of
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, used_by
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.robot_settings import driver_settings, robot_sections
from thorvaldc.compiler.robot_settings.computer_section import check_sensor_ports, read_computer
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import read_section
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Inertial, Purchase, Robot
from thorvaldc.model.settings import OwnLaunch
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.ground_contacts import ground_contacts
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.standing import spring_loads
from thorvaldc.model.stopping import driven_wheels

if TYPE_CHECKING:
    from thorvaldc.compiler.robot_settings.wheel_calibration import Calibration


def elaborate(
    document: Node,
    instance: Instance,
    resolver: Resolver,
    base_dir: Path,
    report: Report,
    files: dict[str, Path],
    *,
    modules_are_valid: bool = True,
    lock: Lock | None = None,
    trust: bool = False,
) -> Robot | None:
    """Builds the model of a robot from a robot document.

    Returns the model of the robot.  Returns no model (``None``) if the links, joints or modules of
    the robot have errors.  Errors of the CAN buses do not prevent the creation of the model.

    Parameters
    ----------
    instance : tree of module instances that ``resolver`` made of the document.
    base_dir : folder of the robot file.
    files : the function adds each additional input file, by the name of the file in spans.
    modules_are_valid : false if any value in the section ``modules`` is invalid.
    lock : node ids of the last build.
    trust : whether xacro files are expanded without restrictions.
    """
    scope = Scope(None, {}, resolver.library, report, None)
    calibration = None
    if document.get("calibration") is not None:
        from thorvaldc.compiler.robot_settings.wheel_calibration import load_calibration

        calibration = load_calibration(document, base_dir, report, files)
    launches: tuple[OwnLaunch, ...] = ()
    if document.get("ros") is not None:
        from thorvaldc.compiler.robot_settings.own_launch_files import read_launch_files

        launches = read_launch_files(document, base_dir, report, files)
    hardware = _read_hardware(instance, resolver.library, report)
    elaborator = _Elaborator(
        document, instance, resolver, scope, hardware, calibration, launches, lock or {}, report
    )
    # The source span of a diagnostic about the whole robot is the robot's name.
    span = (document.get("name") or document).span
    leaves = list(instance.leaves())
    if report.has_errors or not modules_are_valid:
        # The geometry of a robot with an invalid or missing module is not checked, because the
        # missing module would cause false errors.  The CAN buses are always checked.
        elaborator.check_buses(
            RobotParts.joined(
                [RobotParts.moving(x, hardware[x.path]) for x in leaves if x.path in hardware]
            )
        )
        return None
    mechanical = [leaf for leaf in leaves if leaf.is_mechanical]
    parts = RobotParts.of_modules(mechanical, hardware, span)
    parts.check_names(report)
    if items(document.get("extras")):
        from thorvaldc.compiler.extras.load_extras import add_extras  # loads xacro

        parts = add_extras(document, instance, hardware, parts, base_dir, files, report, trust)
    parts = couple_joints(document, instance, parts, resolver.references, report)
    if report.has_errors:
        elaborator.check_buses(parts)
        return None
    parts, body = elaborator.with_wheel_loads(elaborator.on_ground(parts))
    return elaborator.robot(parts, body, span)


def _read_hardware(robot: Instance, library: Library, report: Report) -> dict[str, Hardware]:
    """Returns the hardware (links, joints ...) of each valid module, by the path of the module."""
    hardware: dict[str, Hardware] = {}
    library.palette(report)
    for leaf in robot.leaves():
        if leaf.type is None:
            continue
        with used_by(report, leaf.path, leaf.span, leaf.scope):
            leaf_hardware = hardware_of(leaf.type, leaf.scope, report)
        if leaf_hardware is not None:
            hardware[leaf.path] = leaf_hardware
    return hardware


class _Elaborator(NamedTuple):
    """What the steps from the parts of a robot to its model have in common."""

    document: Node
    instance: Instance
    resolver: Resolver
    scope: Scope
    hardware: Mapping[str, Hardware]
    calibration: Calibration | None
    launches: tuple[OwnLaunch, ...]
    lock: Lock
    report: Report

    def on_ground(self, parts: RobotParts) -> RobotParts:
        """Returns the robot raised so that its wheels touch the plane z = 0 of ``base_link``.

        The wheels first get the measured radii of the calibration file.
        """
        tree = JointTree(parts.links, parts.joints)
        if self.calibration is not None:
            wheels = self.calibration.with_measured_radii(parts.wheels, self.report)
            joints = wheel_geometry.raise_axles(parts.joints, tree, parts.wheels, wheels)
            parts = replace(parts, wheels=wheels, joints=joints)
            tree = JointTree(parts.links, parts.joints)
        height = clean(wheel_geometry.ground_height(tree, parts.wheels, self.report))
        return parts.raised(height, self.hardware, self.report)

    def with_wheel_loads(self, parts: RobotParts) -> tuple[RobotParts, Inertial]:
        """Returns the robot with static wheel loads, and the inertia of the whole robot.

        The joints get the rest positions of the suspension springs.
        """
        tree = JointTree(parts.links, parts.joints)
        links = wheel_geometry.with_wheel_collisions(parts.links, parts.wheels, tree)
        driven = {actuator.joint: actuator for actuator in parts.actuators}
        wheels = wheel_geometry.make_wheels(tree, parts.wheels, driven, self.report)
        actuators = parts.actuators
        if self.calibration is not None:
            actuators = self.calibration.with_steering_offsets(actuators, wheels, self.report)
        stopped = {*driven, *(servo.joint for servo in parts.joint_servos)}
        # Other parts on the ground carry their share, of which the model keeps none.
        contacts = ground_contacts(JointTree(links, parts.joints), wheels, parts.meshes, stopped)
        joints, loads = spring_loads(tree, list(parts.joints), [*wheels, *contacts], stopped)
        parts = replace(
            parts,
            links=links,
            joints=tuple(joints),
            actuators=actuators,
            wheels=tuple(replace(w, load=clean(n)) for w, n in zip(wheels, loads, strict=False)),
        )
        return parts, tree.inertial()

    def robot(self, parts: RobotParts, body: Inertial, span: Span) -> Robot | None:
        """Reads the settings of the base driver and the CAN buses, and returns the model.

        Returns no model (``None``) if the geometry of the robot has errors.
        """
        geometry_is_valid = not self.report.has_errors
        document, scope, wheels = self.document, self.scope, parts.wheels
        # A speed limit that is valid with the nominal wheel radius is also accepted with a smaller
        # measured wheel radius.
        tolerance = 1e-6 if self.calibration is None else self.calibration.tolerance
        settings = read_section(document, "robot", "driver", scope)
        settings_reader = driver_settings.DriverSettingsReader(
            settings,
            read_section(document, "robot", "parameter_sets", scope),
            wheels,
            {actuator.joint: actuator for actuator in parts.actuators},
            tolerance,
            self.report,
            self.calibration.noise if self.calibration is not None else {},
        )
        driver = settings_reader.driver()
        parameter_sets = settings_reader.parameter_sets(driver)
        driven = driven_wheels(wheels, parts.actuators)
        driver, parameter_sets = stopping_distance.with_command_timeout(
            driver, parameter_sets, settings.node.get("command_timeout"), driven
        )
        watchdog = stopping_distance.longest_watchdog(driver, parameter_sets, driven)
        twist_sources, twist_locks = driver_settings.read_twist_inputs(
            settings, driver.command_timeout, self.report
        )
        buses = self._wiring(parts, self.report).buses(self.instance, 1.0 / driver.rate, watchdog)
        name = scope.text(document.get("name"))
        ros_section = read_section(document, "robot", "ros", scope)
        ros = robot_sections.read_ros_settings(ros_section, name, self.launches, self.report)
        computer_section = read_section(document, "robot", "computer", scope)
        is_stated = document.get("computer") is not None
        computer = read_computer(computer_section, buses, self.report, is_stated=is_stated)
        check_sensor_ports(parts.sensors, computer, self.report)
        purchases: Mapping[str, Purchase] = {}
        if document.get("purchase") is not None:
            from thorvaldc.compiler.hardware.purchase_reader import read_purchases

            purchases = read_purchases(
                document, self.instance, self.resolver.library, scope, self.report
            )
        if not geometry_is_valid:
            return None
        model = Robot(
            name=name,
            namespace=scope.text(document.get("namespace")),
            description=scope.text(document.get("description")),
            links=parts.links,
            joints=parts.joints,
            wheels=wheels,
            actuators=connect_actuators(parts.actuators, buses),
            sensors=parts.sensors,
            batteries=parts.batteries,
            battery_connection=robot_sections.read_battery_connection(
                document, parts.batteries, self.report
            ),
            buses=buses,
            computer=computer,
            meshes=parts.meshes,
            calculator=robot_sections.read_calculator(document, scope),
            driver=driver,
            inertial=body.clean(),
            span=span,
            urdf_extensions=parts.urdf_extensions,
            parameter_sets=parameter_sets,
            twist_sources=twist_sources,
            twist_locks=twist_locks,
            joint_servos=parts.joint_servos,
            ros=ros,
            modules=modules_of(self.instance, self.hardware, purchases),
        )
        robot_sections.check_ros_names(model, document, self.report)
        stopping_distance.check_stopping_distance(model, settings.node, self.report)
        return model

    def check_buses(self, parts: RobotParts) -> None:
        """Reports the errors of the CAN buses if modules of the robot are missing.

        Warnings about the CAN buses are dropped, because missing modules cause most of the
        warnings.
        """
        bus_report = Report()
        rate = read_section(self.document, "robot", "driver", self.scope)["rate"]
        self._wiring(parts, bus_report).buses(self.instance, 1.0 / rate)
        for diagnostic in bus_report.errors:
            self.report.put(diagnostic)

    def _wiring(self, parts: RobotParts, report: Report) -> Wiring:
        """Returns the reader of the CAN buses of the robot."""
        actuators = {actuator.name: actuator for actuator in parts.actuators}
        joints = {joint.name: joint for joint in parts.joints}
        return Wiring(
            self.document, self.resolver, self.scope, actuators, joints, self.lock, report
        )
