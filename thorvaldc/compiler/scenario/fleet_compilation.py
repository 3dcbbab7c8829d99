"""Compiles fleet files.  A fleet file names robot files and the pose of each robot."""

from __future__ import annotations

import os
from dataclasses import replace

from thorvaldc.compiler.result.compilation import Compilation, Compile, SourceFile
from thorvaldc.compiler.scenario.fleet_placement import Placements
from thorvaldc.compiler.source.input_file import DOCUMENTS, missing_file_hint
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot


def compile_fleet(source: SourceFile, compile_robot: Compile) -> Compilation:
    """Compiles a fleet file.

    ``compile_robot`` is the function that compiles each robot file of the fleet.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    if source.document is not None:
        checked = source.check_shape(source.document)
        document = read_document(checked, "fleet", ValueReader(report))
        fleet = read_fleet(document, source, compile_robot, report, parts)
        compilation.model = replace(
            fleet, name=document["name"], description=document["description"]
        )
    return compilation.complete(source, report, parts)


def read_fleet(
    document: Section,
    source: SourceFile,
    compile_robot: Compile,
    report: Report,
    parts: dict[str, Compilation],
) -> Fleet:
    """Compiles and places the robots in the section ``robots`` of a fleet or scenario document.

    Robots with errors are left out of the returned fleet.  The function adds the compilation of
    each robot file to ``parts``, by the file name in the fleet document.
    """
    placements = Placements(report)
    for name, entry in document["robots"].items():
        file_node = entry.node.get("robot")
        if file_node is None:
            continue
        file_name = str(file_node.value)
        if file_name not in parts:
            robot_source = open_named_file(source, file_node, report)
            if robot_source is None:
                continue
            # A fleet file must not name a fleet file, because the fleet could contain itself.
            if robot_source.kind != "robot":
                report.add(
                    "fleet-in-fleet",
                    f"`{file_name}` is a {robot_source.kind}; a robot is needed",
                    file_node.span,
                )
                continue
            parts[file_name] = compile_robot(robot_source)
        robot = parts[file_name].model
        if isinstance(robot, Robot):
            placements.add(name, entry, robot)
    return Fleet("", "", tuple(placements.placed))


def open_named_file(source: SourceFile, node: Node, report: Report) -> SourceFile | None:
    """Opens a robot file or fleet file that a document names.

    ``node`` is the YAML node with the path of the file, relative to the folder of ``source``.
    Returns ``None`` and reports an error if the file does not exist.
    """
    name = str(node.value)
    path = source.path.parent / name
    if not os.path.isfile(path):
        report.add(
            "fleet-robot-missing",
            f"there is no file `{name}`",
            node.span,
            hint=missing_file_hint(
                source.path.parent, node, DOCUMENTS, "the path is relative to this file"
            ),
        )
        return None
    return SourceFile(path, name, source.path.parent)
