"""Builds the model of a robot from the tree of module instances.

The model contains the links, joints, wheels, motors and CAN buses of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.bus.assemble_buses import Wiring, connect_actuators
from thorvaldc.compiler.bus.lock_file import Lock
from thorvaldc.compiler.bus.stopping_distance import (
    check_stopping_distance,
    longest_watchdog,
    with_command_timeout,
)
from thorvaldc.compiler.hardware.hardware_reader import Hardware, hardware_of
from thorvaldc.compiler.hardware.purchase_reader import read_purchases
from thorvaldc.compiler.hardware.robot_parts import RobotParts, couple_joints, modules_of
from thorvaldc.compiler.hardware.wheel_geometry import (
    add_wheel_collisions,
    ground_height,
    make_wheels,
)
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, used_by
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.robot_settings.driver_settings import DriverSettingsReader, TwistInputReader
from thorvaldc.compiler.robot_settings.robot_sections import (
    check_ros_names,
    read_battery_connection,
    read_calculator,
    read_ros_settings,
)
from thorvaldc.compiler.robot_settings.wheel_calibration import (
    MAX_RADIUS_CHANGE,
    Calibration,
    calibrate_steering,
    calibrate_wheels,
    load_calibration,
    raise_axles,
)
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import read_section
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Report
from thorvaldc.model import Inertial, Link, Robot, Wheel
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.standing import spring_loads
from thorvaldc.model.stopping import driven_wheels


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
    elaborator = _Elaborator(document, resolver, base_dir, report, files, lock or {}, trust)
    return elaborator.elaborate(instance, modules_are_valid)


class _Elaborator:
    """Builder of the model of one robot document."""

    def __init__(
        self,
        document: Node,
        resolver: Resolver,
        base_dir: Path,
        report: Report,
        files: dict[str, Path],
        lock: Lock,
        trust: bool,
    ) -> None:
        self.trust = trust
        self.document = document
        self.resolver = resolver
        self.base_dir = base_dir
        self.files = files
        # The source span of a diagnostic about the whole robot is the robot's name.
        self.span = (document.get("name") or document).span
        self.lock = lock
        self.report = report
        self.scope = Scope(None, {}, resolver.library, report, None)

    def elaborate(self, robot: Instance, modules_are_valid: bool) -> Robot | None:
        """Returns the model of the robot, or ``None`` if the modules have errors.

        The geometry of a robot with an invalid or missing module is not checked, because the
        missing module would cause false errors.  The CAN buses of the robot are always checked.
        """
        parts = RobotParts([Link("base_link", "", None, (), (), self.span)])
        calibration = load_calibration(self.document, self.base_dir, self.report, self.files)
        hardware = self._read_hardware(robot)
        if self.report.has_errors or not modules_are_valid:
            for leaf in robot.leaves():
                if leaf.path in hardware:
                    parts.add_joints(leaf, hardware[leaf.path])
            self._check_buses(robot, parts)
            return None
        for leaf in robot.leaves():
            if leaf.is_mechanical:
                parts.add(leaf, hardware)
        parts.check_names(self.report)
        urdf_extensions: tuple[str, ...] = ()
        if items(self.document.get("extras")):
            from thorvaldc.compiler.extras.load_extras import add_extras  # loads xacro

            urdf_extensions = add_extras(
                self.document,
                robot,
                hardware,
                parts,
                self.base_dir,
                self.files,
                self.report,
                self.trust,
            )
        couple_joints(self.document, robot, parts, self.resolver.references, self.report)
        if self.report.has_errors:
            self._check_buses(robot, parts)
            return None
        self._stand_on_ground(parts, hardware, calibration)
        wheels, body = self._load_wheels(parts, calibration)
        return self._make_robot(robot, parts, wheels, body, hardware, calibration, urdf_extensions)

    def _read_hardware(self, robot: Instance) -> dict[str, Hardware]:
        """Returns the links, joints and other hardware of each valid module, by the path of the
        module.
        """
        hardware: dict[str, Hardware] = {}
        self.resolver.library.palette(self.report)
        for leaf in robot.leaves():
            if leaf.type is None:
                continue
            with self.report.used_by(used_by(leaf.path, leaf.span)):
                leaf_hardware = hardware_of(leaf.type, leaf.scope, self.report)
            if leaf_hardware is not None:
                hardware[leaf.path] = leaf_hardware
        return hardware

    def _stand_on_ground(
        self, parts: RobotParts, hardware: dict[str, Hardware], calibration: Calibration | None
    ) -> None:
        """Raises the robot so that the wheels touch the plane z = 0 of ``base_link``.

        The method first applies the measured wheel radii of the calibration file.
        """
        tree = JointTree(parts.links, parts.joints)
        if calibration is not None:
            measured_wheels = calibrate_wheels(calibration, parts.wheels, self.report)
            raise_axles(parts.joints, tree, parts.wheels, measured_wheels)
            parts.wheels = measured_wheels
            tree = JointTree(parts.links, parts.joints)
        height = clean(ground_height(tree, parts.wheels, self.report))
        parts.raise_root(height, hardware, self.report)

    def _load_wheels(
        self, parts: RobotParts, calibration: Calibration | None
    ) -> tuple[list[Wheel], Inertial]:
        """Returns the wheels with static wheel loads, and the inertia of the whole robot.

        The method also sets the rest positions of the suspension springs.
        """
        tree = JointTree(parts.links, parts.joints)
        add_wheel_collisions(parts.links, parts.wheels, tree)
        actuators = {actuator.joint: actuator for actuator in parts.actuators}
        wheels = make_wheels(tree, parts.wheels, actuators, self.report)
        if calibration is not None:
            calibrate_steering(calibration, parts.actuators, wheels, self.report)
        body = tree.inertial()
        stopped = {*actuators, *(servo.joint for servo in parts.joint_servos)}
        parts.joints, loads = spring_loads(tree, parts.joints, wheels, stopped)
        wheels = [replace(w, load=clean(n)) for w, n in zip(wheels, loads, strict=True)]
        return wheels, body

    def _make_robot(
        self,
        robot: Instance,
        parts: RobotParts,
        wheels: list[Wheel],
        body: Inertial,
        hardware: Mapping[str, Hardware],
        calibration: Calibration | None,
        urdf_extensions: tuple[str, ...],
    ) -> Robot | None:
        """Reads the settings of the base driver and the CAN buses, and returns the model.

        Returns no model (``None``) if the geometry of the robot has errors.
        """
        geometry_is_valid = not self.report.has_errors
        # A speed limit that is valid with the nominal wheel radius is also accepted with a smaller
        # measured wheel radius.
        tolerance = 1e-6 if calibration is None else MAX_RADIUS_CHANGE
        settings = read_section(self.document, "robot", "driver", self.scope)
        settings_reader = DriverSettingsReader(
            settings,
            read_section(self.document, "robot", "parameter_sets", self.scope),
            wheels,
            {actuator.joint: actuator for actuator in parts.actuators},
            tolerance,
            self.report,
            calibration.noise if calibration is not None else None,
        )
        driver = settings_reader.driver()
        parameter_sets = settings_reader.parameter_sets(driver)
        driven = driven_wheels(wheels, parts.actuators)
        driver, parameter_sets = with_command_timeout(
            driver, parameter_sets, settings.node.get("command_timeout"), driven
        )
        watchdog = longest_watchdog(driver, parameter_sets, driven)
        twist_inputs = TwistInputReader(settings, self.report)
        twist_sources = twist_inputs.sources(driver.command_timeout)
        twist_locks = twist_inputs.locks(twist_sources)
        buses = self._wiring(parts, self.report).buses(robot, 1.0 / driver.rate, watchdog)
        ros_section = read_section(self.document, "robot", "ros", self.scope)
        ros = read_ros_settings(
            ros_section, self.scope.text(self.document.get("name")), self.report
        )
        purchases = read_purchases(
            self.document, robot, self.resolver.library, self.scope, self.report
        )
        if not geometry_is_valid:
            return None
        model = Robot(
            name=self.scope.text(self.document.get("name")),
            namespace=self.scope.text(self.document.get("namespace")),
            description=self.scope.text(self.document.get("description")),
            links=tuple(parts.links),
            joints=tuple(parts.joints),
            wheels=tuple(wheels),
            actuators=connect_actuators(parts.actuators, buses),
            sensors=tuple(parts.sensors),
            batteries=tuple(parts.batteries),
            battery_connection=read_battery_connection(self.document, parts.batteries, self.report),
            buses=buses,
            meshes=tuple(parts.meshes.values()),
            calculator=read_calculator(self.document, self.scope),
            driver=driver,
            inertial=body.clean(),
            span=self.span,
            urdf_extensions=urdf_extensions,
            parameter_sets=parameter_sets,
            twist_sources=twist_sources,
            twist_locks=twist_locks,
            joint_servos=tuple(parts.joint_servos),
            ros=ros,
            modules=modules_of(robot, hardware, purchases),
        )
        check_ros_names(model, self.document, self.report)
        check_stopping_distance(model, settings.node, self.report)
        return model

    def _wiring(self, parts: RobotParts, report: Report) -> Wiring:
        """Returns the reader of the CAN buses of the robot."""
        actuators = {actuator.name: actuator for actuator in parts.actuators}
        joints = {joint.name: joint for joint in parts.joints}
        return Wiring(
            self.document, self.resolver, self.scope, actuators, joints, self.lock, report
        )

    def _check_buses(self, robot: Instance, parts: RobotParts) -> None:
        """Reports the errors of the CAN buses if modules of the robot are missing.

        Warnings about the CAN buses are dropped, because missing modules cause most of the
        warnings.
        """
        bus_report = Report()
        rate = read_section(self.document, "robot", "driver", self.scope)["rate"]
        self._wiring(parts, bus_report).buses(robot, 1.0 / rate)
        for diagnostic in bus_report.errors:
            self.report.put(diagnostic)
