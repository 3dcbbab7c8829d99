"""Compiles scenario files.

A scenario contains robots, a world, a script of commands, injected faults and expectations.
"""

from __future__ import annotations

import functools
import math
import os
import posixpath
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.recordings.twist_log_reader import read_twists
from thorvaldc.compiler.result import Compilation, Compile, SourceFile
from thorvaldc.compiler.scenario import fleet_compilation, world_reader
from thorvaldc.compiler.source.input_file import LOGS, report_missing
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report, did_you_mean
from thorvaldc.model import Fleet, Placement, Pose, Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.scenario import (
    GROUPS,
    Command,
    Expectation,
    Noise,
    Scenario,
    SensorSettings,
    WheelFault,
)
from thorvaldc.model.sensor_numbers import SENSOR_NUMBERS, not_simulated
from thorvaldc.schema import inlined


def compile_scenario(
    source: SourceFile,
    compile_part: Compile,
    robot: Path | str | None,
) -> Compilation:
    """Compiles a scenario file.

    Parameters
    ----------
    source : the scenario file.
    compile_part : function that compiles the robot and fleet files that the scenario names.
    robot : path of a robot or fleet file.  The robots of the file replace the robots of the
        scenario.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    document = source.document
    if document is not None:
        checked = source.check_shape(document)
        section = read_document(checked, "scenario", ValueReader(report))
        fleet = _read_robots(section, source, compile_part, report, parts, robot)
        if fleet is not None:
            folder, files = source.path.parent, compilation.files
            scenario = read_scenario(section, fleet, folder, files, report)
            scenario = _with_log(checked, scenario, source, compilation.files, report)
            compilation.scenario, compilation.model = scenario, scenario.fleet
    return compilation.complete(source, report, parts)


def _read_robots(
    document: Section,
    source: SourceFile,
    compile_part: Compile,
    report: Report,
    parts: dict[str, Compilation],
    robot: Path | str | None,
) -> Fleet | None:
    """Returns the fleet of a scenario, or ``None`` if a robot is missing or has errors."""
    node = document.node
    fleet_node = node.get("fleet")
    entries = [entry for _, entry in document["robots"].items()]
    if robot is None and fleet_node is None and node.get("robots") is not None:
        fleet = fleet_compilation.read_fleet(document, source, compile_part, report, parts)
        # If robots of the fleet are missing, the checks of the scenario would report false errors.
        return (
            fleet
            if len(fleet.placements) == sum(map(fleet_compilation.robots_of, entries))
            else None
        )
    if robot is not None:
        folder, span = source.path.parent, node.span
        part: SourceFile | None = SourceFile(Path(robot), os.path.relpath(robot, folder), folder)
    elif fleet_node is not None:
        part, span = fleet_compilation.open_named_file(source, fleet_node, report), fleet_node.span
    else:
        report.add(
            "scenario-robots-missing",
            "the scenario has neither `robots` nor a `fleet`",
            node.span,
            hint="add one of them, or name a robot: thorvaldc scenario FILE --robot robot.yaml",
        )
        return None
    if part is None:
        return None
    if part.kind == "scenario":
        report.add(
            "fleet-in-fleet", f"`{part.name}` is a scenario; a robot or a fleet is needed", span
        )
        return None
    parts[part.name] = compile_part(part)
    model = parts[part.name].model
    if isinstance(model, Robot):
        return Fleet(model.name, "", _place_single_robot(model, document["robots"], report))
    return model


def _place_single_robot(robot: Robot, robots: Section, report: Report) -> tuple[Placement, ...]:
    """Places the robot that replaces all robots of a scenario.

    If the section ``robots`` of the scenario has exactly one entry, the new robot gets the name and
    pose of the entry.  If the section ``robots`` does not have exactly one entry, the new robot
    keeps the name in the robot file and is placed at the origin.
    """
    entries = list(robots.items())
    if len(entries) != 1:
        return (Placement(robot.name, Pose(), robot),)
    placements = fleet_compilation.Placements(report)
    for name, entry in entries:
        placements.add(name, entry, robot)
    return tuple(placements.placed)


def _with_log(
    document: Node, scenario: Scenario, source: SourceFile, files: dict[str, Path], report: Report
) -> Scenario:
    """Returns the scenario with the commands from the log file that the script names.

    A scenario without a log file is returned unchanged.
    """
    script = document.get("script")
    log = script.get("log") if script is not None else None
    if script is None or log is None:
        return scenario
    robot, topic = script.get("robot"), script.get("topic")
    driven_robots = [
        (placement.name, placement.robot)
        for placement in scenario.fleet.placements
        if robot is None or placement.name == robot.value
    ]
    log_files: dict[str, Path] = {}
    path = source.path.parent / str(log.value)
    if not os.path.exists(path):
        report_missing("script-log", source.path.parent, log, LOGS, report)
        return scenario
    commands_by_robot = read_twists(
        path,
        posixpath.normpath(posixpath.join(posixpath.dirname(log.span.file), str(log.value))),
        log.span,
        driven_robots,
        str(topic.value) if topic is not None else "",
        log_files,
        report,
    )
    files.update(log_files)
    commands = (
        (name, commands_by_robot.get(name, scripted)) for name, scripted in scenario.commands
    )
    return replace(scenario, commands=tuple(commands))


# -- the document, after the robots of the scenario have been compiled -------------------

# Parameter of each type of injected fault.
_FAULT_VALUES = {"steering_offset": "angle", "radius_error": "error", "ice": "friction"}
_FAULTS_OF_MOTORS = ("encoder_frozen", "motor_lost")


@functools.cache
def metric_units() -> Mapping[str, str]:
    """Returns the names of the metrics of a run and their SI units, in the order of all outputs.

    A scenario can expect each of them, so its schema states their quantities.
    """
    metrics = inlined("scenario")["properties"]["expect"]["properties"]
    kinds = {name: each["properties"]["min"].get("x-quantity") for name, each in metrics.items()}
    units = {name: si.unit_of(kind) if kind else "" for name, kind in kinds.items()}
    return {**units, "energy_per_metre": "J/m"}  # N, which nobody would call it


def read_scenario(
    document: Section, fleet: Fleet, folder: Path, files: dict[str, Path], report: Report
) -> Scenario:
    """Returns the scenario that a scenario document describes.

    The fleet of the scenario contains the robots of ``fleet`` and the world of the document.

    - ``folder``, ``files``: as for ``world_reader.read_world``.
    """
    world = document["world"]
    friction = world["friction"]
    if friction is not None:
        placements = (
            replace(p, robot=world_reader.with_friction(p.robot, friction))
            for p in fleet.placements
        )
        fleet = replace(fleet, placements=tuple(placements))
    name, description = document["scenario"], document["description"]
    surroundings = world_reader.read_world(world, folder, files, report)
    heights = surroundings.ground.heights
    if heights is not None:
        placements = (world_reader.standing(p, heights) for p in fleet.placements)
        fleet = replace(fleet, placements=tuple(placements))
    fleet = replace(fleet, name=name, description=description, world=surroundings)
    world_reader.check_starts(fleet, world, report)
    world_reader.check_obstacles(fleet, world, report)
    # A missing or wrong duration is an error; then no step is after the end.
    duration = document.get("duration", math.inf)
    sections = _SectionReader(fleet, duration, report)
    record = document["record"]
    return Scenario(
        name=name,
        description=description,
        fleet=fleet,
        duration=duration,
        commands=sections.commands(document["script"]),
        faults=tuple(sections.wheel_faults(document["faults"])),
        noise=sections.noise(document["noise"]),
        expectations=tuple(sections.expectations(document["expect"])),
        span=document.node.span,
        record=tuple(group for group in GROUPS if group in (record["what"] or GROUPS)),
        every=record["every"],
        open_loop=document["open_loop"],
        sensors=sections.sensors(document["sensors"]) if "sensors" in document else None,
    )


class _SectionReader:
    """Reads the sections of a scenario document that refer to the robots of the scenario."""

    def __init__(self, fleet: Fleet, duration: float, report: Report) -> None:
        self.robots = {placement.name: placement.robot for placement in fleet.placements}
        self.duration = duration
        self.report = report

    def commands(
        self, script: Section | tuple[Section, ...] | None
    ) -> tuple[tuple[str, tuple[Command, ...]], ...]:
        """Returns the scripted commands of each robot, sorted by time.

        If the script names a log file instead of commands, the method returns no commands, and the
        module ``scenario_compilation`` reads the log file.
        """
        commands: dict[str, list[Command]] = {name: [] for name in self.robots}
        if isinstance(script, Section):
            # If the script names a log file, only the robot name of the script is checked.
            self._robot_names(script)
            script = ()
        last_time = 0.0
        for step in script or ():
            at = step.node.get("at")
            if at is not None and step["at"] < last_time:
                self.report.add(
                    "out-of-range",
                    f"the step at {step['at']:g} s stands after that at {last_time:g} s",
                    at.span,
                    hint="steps stand in the order of their times: move it, or correct its time",
                )
            elif at is not None:
                last_time = step["at"]
            self._check_time(step, last_time, "step")
            vx, vy, wz = step["vx"], step["vy"], step["wz"]
            command = Command(last_time, vx, vy, wz, step["parameters"])
            for name in self._robot_names(step):
                commands[name].append(command)
                self._check_parameter_set(name, step.node.get("parameters"))
        steps = [(step, key) for step in script or () for key in ("vx", "vy", "wz", "parameters")]
        # An invalid value, which is reported elsewhere, may be meant to move the robot.
        if script and not any(step.get(key, step.node.get(key)) for step, key in steps):
            self.report.add(
                "scenario-without-motion",
                "the script moves no robot: no step has a speed",
                script[0].node.where,
                hint="give a step `vx`, `vy` or `wz`, as in `{at: 1 s, vx: 0.5 m/s}`, or remove the"
                " script",
            )
        return tuple((name, tuple(listed)) for name, listed in commands.items())

    def _check_time(self, section: Section, time: float, what: str) -> None:
        """Warns about a part of the scenario that begins at ``time`` (s), after the end."""
        at = section.node.get("at")
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

    def wheel_faults(self, faults: tuple[Section, ...]) -> Iterator[WheelFault]:
        """Yields each valid fault that the scenario injects at a wheel."""
        for section in faults:
            if "type" not in section or "wheel" not in section:
                continue
            names = self._robot_names(section)
            if len(names) > 1:
                self.report.add(
                    "missing-key",
                    "a fault has no `robot`, and there are several",
                    section.node.where,
                    hint=f"add `robot: {names[0]}`",
                )
            if len(names) != 1:
                continue
            fault = self._wheel_fault(section, names[0])
            if fault is not None:
                yield fault

    def _wheel_fault(self, section: Section, robot: str) -> WheelFault | None:
        """Reads an injected fault at a wheel.

        Returns ``None`` and reports an error if the injected fault is not valid.
        """
        node, fault_type = section.node, section["type"]
        motor = "steering" if fault_type == "steering_offset" else section["motor"] or "drive"
        wheel = section.entry("wheel")
        if not self._has_wheel(self.robots[robot], wheel, motor if fault_type != "ice" else ""):
            return None
        value = 0.0
        keys = {"motor"} if fault_type in _FAULTS_OF_MOTORS else set()
        if fault_type in _FAULT_VALUES:
            key = _FAULT_VALUES[fault_type]
            keys.add(key)
            if node.get(key) is None:
                self.report.add(
                    "missing-key", f"the fault `{fault_type}` has no `{key}`", node.where
                )
                return None
            value = section[key] or 0.0
        for key in ("angle", "error", "friction", "motor"):
            entry = node.get(key)
            if entry is not None and key not in keys:
                self.report.add(
                    "conflicting-keys", f"the fault `{fault_type}` has no `{key}`", entry.where
                )
        start, end = section["at"], section.get("until", math.inf)
        self._check_time(section, start, "fault")
        if "until" in section:
            section.is_within("until", {"x-exclusive-minimum": start})
        return WheelFault(fault_type, robot, section["wheel"], motor, value, start, end, node.span)

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

    def _robot_names(self, section: Section) -> Sequence[str]:
        """Returns the name of the robot that a section names, or all names if it names none.

        Returns an empty list and reports an error if the scenario has no robot of the name.
        """
        node, names = section.node.get("robot"), list(self.robots)
        if node is None:
            return names
        if node.value in self.robots:
            return [str(node.value)]
        self.report.add(
            "scenario-robot-unknown",
            f"the scenario has no robot `{node.value}`",
            node.span,
            hint=did_you_mean(str(node.value), names, f"its robots: {', '.join(names)}"),
        )
        return []

    def noise(self, noise: Section) -> Noise:
        """Returns the noise of the simulated sensors."""
        gyro = noise.node.get("gyro") or noise.node.get("gyro_bias")
        if gyro is not None and not any(map(_has_imu, self.robots.values())):
            self.report.add(
                "scenario-imu-missing",
                "no robot of the scenario has an IMU that measures its yaw rate",
                gyro.where,
                hint="mount a `sensor/imu` on one of them",
            )
        return Noise(
            noise["seed"],
            noise["wheel_speed"],
            noise["wheel_position"],
            noise["steering_angle"],
            (noise["gyro"] or 0.0) if gyro is not None else None,
            noise["gyro_bias"],
            noise["encoder_counts"],
        )

    def sensors(self, settings: Section) -> SensorSettings:
        """Returns the settings of the sensors of the modules."""
        left_out = not_simulated(self.robots.values())
        if left_out or not any(robot.sensors for robot in self.robots.values()):
            self.report.add(
                "scenario-sensor-missing",
                f"no simulated sensor has the type of {', '.join(left_out)}"
                if left_out
                else "no robot of the scenario has a sensor",
                settings.node.where,
                hint=f"simulated are the types {', '.join(SENSOR_NUMBERS)}",
            )
        return SensorSettings(settings["errors"], settings["images"])

    def expectations(self, expected: Section) -> Iterator[Expectation]:
        """Yields the expected range of each metric in the section `expect` of a scenario."""
        for metric, bounds in expected.items():
            least, most = bounds["min"], bounds["max"]
            if least is not None and most is not None and least > most:
                self.report.add(
                    "out-of-range",
                    f"`{metric}` is expected to be at least {least:g} and at most {most:g}",
                    bounds.node.where,
                )
            yield Expectation(metric, least, most, bounds.node.where)


def _has_imu(robot: Robot) -> bool:
    """Returns whether a robot has an inertial measurement unit."""
    return any(sensor.type == "imu" for sensor in robot.sensors)
