"""Reads a scenario document after the robots of the scenario have been compiled."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.value_reader import ValueReader, entries, items
from thorvaldc.compiler.scenario.start_checks import check_obstacles
from thorvaldc.compiler.scenario.variations import (
    read_variations,
    with_changes,
    without_variations,
)
from thorvaldc.compiler.scenario.world_reader import read_world, wheel_friction, with_friction
from thorvaldc.compiler.scenario.zone_reader import check_starts
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS, Command, Expectation, Noise, Scenario, WheelFault

MAX_DURATION = 86400.0  # s: one day

# Parameter of each type of injected fault: the key, the kind of quantity, and the least and
# greatest value in SI units.
_FAULT_VALUES = {
    "steering_offset": ("angle", "angle", -1.0, 1.0),
    "radius_error": ("error", "number", -0.5, 1.0),
    "ice": ("friction", "number", 0.0, 5.0),
}
_FAULTS_OF_MOTORS = ("encoder_frozen", "motor_lost")

METRICS = {
    "end_error": "length",
    "yaw_error": "angle",
    "path": "length",
    "length_ratio": "number",
    "tilt": "angle",
    "slip": "velocity",
    "largest_slip": "velocity",
    "steering_limit_hits": "number",
    "collisions": "number",
    "energy": "energy",
    "energy_per_metre": "force",
}


def read_scenario(document: Node, fleet: Fleet, report: Report) -> Scenario:
    """Returns the scenario that a scenario document describes.

    The fleet of the scenario contains the robots of ``fleet`` and the world of the document.  The
    function also checks each value in the section ``variations`` of the scenario document.
    """
    scenario = _read(document, fleet, report)
    if document.get("variations") is not None:
        _check_variations(document, fleet, report)
    return scenario


def _check_variations(document: Node, fleet: Fleet, report: Report) -> None:
    """Applies each value of a variation to the scenario document, and reports the errors."""
    variations = read_variations(document, (), None, None, report)
    if report.has_errors:
        return
    for change in variations.single_changes():
        if change.path.partition(".")[0] in ("robots", "fleet"):
            # Values that replace a robot file are not checked, because the check would compile
            # another robot.
            continue
        shape, content = Report(), Report()
        varied = without_variations(with_changes(document, [change], content))
        check(varied, "scenario", shape)
        _read(without_invalid_values(varied, shape), fleet, content)
        for diagnostic in (*shape.errors, *content.errors):
            report.put(diagnostic)


def _read(document: Node, fleet: Fleet, report: Report) -> Scenario:
    reader = ValueReader(report)
    quantities = BoundedQuantities(reader, report)
    friction = wheel_friction(document, quantities)
    if friction is not None:
        placements = (replace(p, robot=with_friction(p.robot, friction)) for p in fleet.placements)
        fleet = replace(fleet, placements=tuple(placements))
    name = reader.text(document.get("scenario"))
    description = reader.text(document.get("description"))
    world = read_world(document, quantities, report)
    fleet = replace(fleet, name=name, description=description, world=world)
    check_starts(fleet, document, report)
    check_obstacles(fleet, document, report)
    # A missing or wrong duration is an error; then no step is after the end.
    duration = quantities(
        document, "duration", "time", math.inf, least=0.0, most=MAX_DURATION, above=True
    )
    sections = _SectionReader(fleet, duration, quantities, report)
    record = document.get("record")
    open_loop = document.get("open_loop")
    return Scenario(
        name=name,
        description=description,
        fleet=fleet,
        duration=min(duration, MAX_DURATION),
        commands=sections.commands(document.get("script")),
        faults=tuple(sections.wheel_faults(document.get("faults"))),
        noise=sections.noise(document.get("noise")),
        expectations=tuple(sections.expectations(document.get("expect"))),
        span=document.span,
        record=_record_groups(record),
        every=quantities(record, "every", "time", least=0.0) if record is not None else 0.0,
        open_loop=open_loop is not None and open_loop.value is True,
    )


def _record_groups(record: Node | None) -> tuple[str, ...]:
    """Returns the names of the column groups that are written to the record of a run.

    By default, all column groups are written to the record of a run.
    """
    named = {str(node.value) for node in items(record.get("what") if record else None)}
    return tuple(group for group in GROUPS if not named or group in named)


class _SectionReader:
    """Reads the sections of a scenario document that refer to the robots of the scenario."""

    def __init__(
        self, fleet: Fleet, duration: float, quantities: BoundedQuantities, report: Report
    ) -> None:
        self.robots = {placement.name: placement.robot for placement in fleet.placements}
        self.duration = duration
        self.quantities = quantities
        self.report = report

    def commands(self, script: Node | None) -> tuple[tuple[str, tuple[Command, ...]], ...]:
        """Returns the scripted commands of each robot, sorted by time.

        If the script names a log file instead of commands, the method returns no commands, and the
        module ``scenario_compilation`` reads the log file.
        """
        commands: dict[str, list[Command]] = {name: [] for name in self.robots}
        if script is not None and (robot_node := script.get("robot")) is not None:
            # If the script names a log file, only the robot name of the script is checked.
            self._robot_names(robot_node)
        last_time = 0.0
        for node in items(script):
            time = self.quantities(
                node, "at", "time", last_time, least=last_time, most=MAX_DURATION
            )
            last_time = time
            self._check_time(node, time, "step")
            parameters = node.get("parameters")
            command = Command(
                time,
                self.quantities(node, "vx", "velocity"),
                self.quantities(node, "vy", "velocity"),
                self.quantities(node, "wz", "angular_velocity"),
                "" if parameters is None else str(parameters.plain()),
            )
            robot_node = node.get("robot")
            for name in commands if robot_node is None else self._robot_names(robot_node):
                commands[name].append(command)
                self._check_parameter_set(name, parameters)
        return tuple((name, tuple(listed)) for name, listed in commands.items())

    def _check_time(self, node: Node, time: float, what: str) -> None:
        """Warns about a part of the scenario that begins at ``time`` (s), after the end."""
        at = node.get("at")
        if at is not None and time > self.duration:
            self.report.add(
                "scenario-step-late",
                f"the {what} at {time:g} s never happens: the scenario ends at {self.duration:g} s",
                at.span,
                hint=f"give it a longer `duration`, or remove the {what}",
            )

    def _check_parameter_set(self, robot: str, node: Node | None) -> None:
        """Checks that a robot has the parameter set that a command names."""
        known = [parameter_set.name for parameter_set in self.robots[robot].parameter_sets]
        if node is not None and node.value not in known:
            known_hint = f"it has {', '.join(known)}" if known else "its file names none"
            self.report.add(
                "parameter-set-unknown",
                f"{robot} has no parameter set `{node.value}`",
                node.span,
                hint=did_you_mean(str(node.value), known, known_hint),
            )

    def wheel_faults(self, section: Node | None) -> Iterator[WheelFault]:
        """Yields each valid fault that the scenario injects at a wheel."""
        for node in items(section):
            type_node, wheel = node.get("type"), node.get("wheel")
            if type_node is None or wheel is None or not isinstance(type_node.value, str):
                continue
            robot_node = node.get("robot")
            names = list(self.robots) if robot_node is None else self._robot_names(robot_node)
            if len(names) > 1:
                self.report.add(
                    "missing-key",
                    "a fault has no `robot`, and there are several",
                    node.where,
                    hint=f"add `robot: {names[0]}`",
                )
            if len(names) != 1:
                continue
            fault = self._wheel_fault(node, type_node.value, names[0], wheel)
            if fault is not None:
                yield fault

    def _wheel_fault(
        self, node: Node, fault_type: str, robot: str, wheel: Node
    ) -> WheelFault | None:
        """Reads an injected fault at a wheel.

        Returns ``None`` and reports an error if the injected fault is not valid.
        """
        motor_node = node.get("motor")
        motor = str(motor_node.value) if motor_node is not None else "drive"
        if fault_type == "steering_offset":
            motor = "steering"
        needed_motor = motor if fault_type != "ice" else ""
        if not self._has_wheel(self.robots[robot], wheel, needed_motor):
            return None
        value = 0.0
        keys = {"motor"} if fault_type in _FAULTS_OF_MOTORS else set()
        if fault_type in _FAULT_VALUES:
            key, quantity, least, most = _FAULT_VALUES[fault_type]
            keys.add(key)
            if node.get(key) is None:
                self.report.add(
                    "missing-key", f"the fault `{fault_type}` has no `{key}`", node.where
                )
                return None
            value = self.quantities(node, key, quantity, least=least, most=most)
        for key in ("angle", "error", "friction", "motor"):
            entry = node.get(key)
            if entry is not None and key not in keys:
                self.report.add(
                    "conflicting-keys", f"the fault `{fault_type}` has no `{key}`", entry.where
                )
        start = self.quantities(node, "at", "time", least=0.0)
        self._check_time(node, start, "fault")
        end = self.quantities(node, "until", "time", math.inf, least=start, above=True)
        return WheelFault(fault_type, robot, str(wheel.value), motor, value, start, end, node.span)

    def _has_wheel(self, robot: Robot, node: Node, motor: str) -> bool:
        """Checks that the robot has the wheel of an injected fault, and that the wheel has the
        required motor.

        ``motor``: ``drive`` or ``steering``, or empty if the wheel needs no motor.
        """
        for wheel in robot.wheels:
            if wheel.name != node.value:
                continue
            is_missing = {"drive": not wheel.driven, "steering": not wheel.steered}
            if is_missing.get(motor, False):
                self.report.add(
                    "scenario-wheel-unknown",
                    f"`{wheel.name}` has no {motor} motor",
                    node.span,
                )
                return False
            return True
        names = [wheel.name for wheel in robot.wheels]
        self.report.add(
            "scenario-wheel-unknown",
            f"{robot.name} has no wheel `{node.value}`",
            node.span,
            hint=did_you_mean(str(node.value), names, f"its wheels: {', '.join(names)}"),
        )
        return False

    def _robot_names(self, node: Node) -> Sequence[str]:
        """Returns a list with the robot name that a YAML node contains.

        Returns an empty list and reports an error if the scenario has no robot of the name in the
        YAML node.
        """
        if node.value in self.robots:
            return [str(node.value)]
        names = list(self.robots)
        self.report.add(
            "scenario-robot-unknown",
            f"the scenario has no robot `{node.value}`",
            node.span,
            hint=did_you_mean(str(node.value), names, f"its robots: {', '.join(names)}"),
        )
        return []

    def noise(self, node: Node | None) -> Noise:
        """Returns the noise of the simulated sensors."""
        if node is None:
            return Noise()
        seed, counts = node.get("seed"), node.get("encoder_counts")
        gyro = node.get("gyro") or node.get("gyro_bias")
        if gyro is not None and not any(map(_has_imu, self.robots.values())):
            self.report.add(
                "scenario-imu-missing",
                "no robot of the scenario has an IMU that measures its yaw rate",
                gyro.where,
                hint="mount a `sensor/imu` on one of them",
            )
        quantities = self.quantities
        return Noise(
            seed.value if seed is not None and isinstance(seed.value, int) else 0,
            quantities(node, "wheel_speed", "angular_velocity", least=0.0),
            quantities(node, "wheel_position", "angle", least=0.0),
            quantities(node, "steering_angle", "angle", least=0.0),
            quantities(node, "gyro", "angular_velocity", least=0.0) if gyro is not None else None,
            quantities(node, "gyro_bias", "angular_velocity"),
            counts is not None and counts.value is True,
        )

    def expectations(self, node: Node | None) -> Iterator[Expectation]:
        """Yields the expected range of each metric in the section `expect` of a scenario."""
        for metric, bounds in entries(node).items():
            quantity = METRICS.get(metric)
            if quantity is None:
                continue  # The schema check has already reported the unknown metric.
            least, most = (
                self.quantities(bounds, key, quantity) if bounds.get(key) is not None else None
                for key in ("min", "max")
            )
            if least is not None and most is not None and least > most:
                self.report.add(
                    "out-of-range",
                    f"`{metric}` is expected to be at least {least:g} and at most {most:g}",
                    bounds.where,
                )
            yield Expectation(metric, least, most, bounds.where)


def _has_imu(robot: Robot) -> bool:
    """Returns whether a robot has an inertial measurement unit."""
    return any(sensor.type == "imu" for sensor in robot.sensors)
