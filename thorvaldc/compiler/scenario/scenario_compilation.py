"""Compiles scenario files.

A scenario contains robots, a world, a script of commands, injected faults and expectations.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.recordings.twist_log_reader import read_twists
from thorvaldc.compiler.result import Compilation, Compile, SourceFile
from thorvaldc.compiler.scenario import fleet_compilation
from thorvaldc.compiler.scenario.scenario_reader import read_scenario
from thorvaldc.compiler.scenario.variations import Change, with_changes, without_variations
from thorvaldc.compiler.source.input_file import LOGS, missing_file_hint
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Placement, Pose, Robot
from thorvaldc.model.scenario import Scenario


def compile_scenario(
    source: SourceFile,
    compile_part: Compile,
    robot: Path | str | None,
    changes: Sequence[Change],
) -> Compilation:
    """Compiles a scenario file.

    Parameters
    ----------
    source : the scenario file.
    compile_part : function that compiles the robot and fleet files that the scenario names.
    robot : path of a robot or fleet file.  The robots of the file replace the robots of the
        scenario.
    changes : new values for entries of the scenario document.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    document = source.document
    if document is not None:
        if changes:
            document = without_variations(with_changes(document, changes, source.shape))
        checked = source.check_shape(document)
        section = read_document(checked, "scenario", ValueReader(report))
        fleet = _read_robots(section, source, compile_part, report, parts, robot)
        if fleet is not None:
            scenario = read_scenario(section, fleet, report)
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
            hint="add one of them, or name a robot: thorvaldc sim robot.yaml --scenario FILE",
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
        return (Placement(robot.name, Pose(), replace(robot, namespace=robot.name)),)
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
        report.add(
            "script-log",
            f"there is no file `{log.value}`",
            log.span,
            hint=missing_file_hint(
                source.path.parent, log, LOGS, "the path is relative to the scenario file"
            ),
        )
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
