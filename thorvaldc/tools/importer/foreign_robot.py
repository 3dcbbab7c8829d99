"""Reads a description of others, and the parameters of its controllers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.descriptions.facts import (
    Fact,
    FileDescription,
    ParameterSection,
    UnreadableFileError,
)
from thorvaldc.compiler.descriptions.parameter_files import (
    LEFT,
    RIGHT,
    STEERING,
    TRACTION,
    controller_facts,
    flattened,
    plain_names,
    read_yaml,
    sections,
)
from thorvaldc.compiler.extras import xacro_expand
from thorvaldc.compiler.extras.load_extras import FAILURES, MeshLoader, report_unused_names
from thorvaldc.compiler.extras.plugin_facts import plugin_facts, ros2_control_facts, walk
from thorvaldc.compiler.extras.urdf_reader import UrdfParts, read_urdf
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.readable_folders import real_folders
from thorvaldc.diagnostics import Label, Report, Span, did_you_mean
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.model import Mesh
from thorvaldc.tools.importer import other_formats

MAX_PARAMETER_BYTES = 1_000_000
_MESHES = ("meshes", "assets")
_HINTS = {"argument": "state it after the file: `thorvaldc import {file} {name}:=VALUE -o FOLDER`"}
_EXPAND = "expand it first: `xacro FILE name:=value > robot.urdf`, beside its ROS packages"


@dataclass
class ForeignRobot:
    """A robot of others, as its description and its controllers state it.

    - ``elements``: child elements of ``<robot>``.
    - ``mesh_files``: path of each mesh file by the name of the mesh.
    - ``sources``: path of each file that was read, by its name in spans.
    - ``velocity_joints``, ``position_joints``: joints that something drives or steers.
    - ``limits``: speeds and accelerations of the controllers, such as ``linear.x.max_velocity``.
    """

    description: FileDescription
    elements: Sequence[Element] = ()
    meshes: dict[str, Mesh] = field(default_factory=dict)
    mesh_files: dict[str, Path] = field(default_factory=dict)
    sources: dict[str, Path] = field(default_factory=dict)
    velocity_joints: dict[str, Span] = field(default_factory=dict)
    position_joints: dict[str, Span] = field(default_factory=dict)
    limits: dict[str, float] = field(default_factory=dict)
    controller_types: dict[str, Span] = field(default_factory=dict)


def read_robot(
    path: Path,
    controllers: Path | None,
    report: Report,
    arguments: Mapping[str, str] | None = None,
) -> ForeignRobot:
    """Returns the robot in a URDF, xacro, SDF or MJCF file; what cannot be read is reported.

    ``arguments``: values of the arguments of a xacro file, by name.
    """
    name = path.name.split(".")[0]
    robot = ForeignRobot(
        FileDescription(format="URDF", name=name, file=str(path), path=path.absolute()),
        sources={str(path): path},
    )
    if not path.is_file():
        report.add("file-not-found", f"`{path}` does not exist", Span(str(path)))
        return robot
    stated = dict(arguments or {})
    request = xacro_expand.ExpansionRequest(path.absolute(), stated, {}, source_layout=True)
    folder = "" if str(path.parent) == "." else str(path.parent)
    shown = xacro_expand.DisplayPaths(path.absolute().parent, folder, {})
    search = xacro_expand.search_paths()
    readable = xacro_expand.readable_folders([request], path.absolute().parent, search)
    if path.suffix.lower() not in (".urdf", ".xacro"):
        folders = _mesh_folders(path.absolute().parent.parent)
        readable += real_folders(folders.values())
        loader = MeshLoader(folders, shown, readable, report)
        elements = other_formats.read_elements(robot.description, loader, robot.sources, report)
        _add_elements(robot, elements, loader, report)
        if controllers is not None and robot.description.links:
            _read_controllers(robot, controllers, report)
        return robot
    expanded = xacro_expand.expand([request], shown)[0]
    robot.sources |= expanded.files
    if expanded.failure is not None:
        failure = expanded.failure
        code, message, _ = FAILURES[failure.kind]
        labels = [Label(span, text) for span, text in failure.trail]
        span = failure.span or Span(str(path))
        hint = _HINTS.get(failure.kind, _EXPAND).format(file=path, name=failure.text)
        report.add(code, message.format(text=failure.text), span, hint=hint, labels=labels)
        return robot
    report_unused_names(expanded, "args", request, {}, Span(str(path)), report)
    loader = MeshLoader(expanded.packages, expanded.paths, readable, report)
    _add_elements(robot, expanded.elements, loader, report)
    if controllers is not None and robot.description.links:
        _read_controllers(robot, controllers, report)
    return robot


def _mesh_folders(folder: Path) -> dict[str, str]:
    """Returns the folders beside that of a file that may have its meshes, by name.

    These are folders of meshes by their names, and models of Gazebo; a file of others reads no
    other folder.
    """
    try:
        return {
            entry.name: entry.path
            for entry in os.scandir(folder)
            if entry.is_dir(follow_symlinks=False)
            and (entry.name in _MESHES or os.path.isfile(os.path.join(entry.path, "model.config")))
        }
    except OSError:
        return {}


def _add_elements(
    robot: ForeignRobot, elements: Sequence[Element], loader: MeshLoader, report: Report
) -> None:
    """Adds the robot in the child elements of ``<robot>``."""
    parts = read_urdf(elements, "", loader, report)
    robot.elements, robot.mesh_files = elements, loader.files
    robot.meshes = {mesh.name: mesh for mesh in parts.meshes}
    _add_parts(robot.description, parts, report)
    for element in elements:
        _read_drive(robot, element)


def _add_parts(description: FileDescription, parts: UrdfParts, report: Report) -> None:
    """Adds the links and joints, which must form one tree."""
    description.add_parts(parts.links, parts.joints, parts.places, report)
    description.check_joints(report)
    parents: set[str] = set()
    for joint in parts.joints:
        if joint.child in parents:
            text = f"link `{joint.child}` is the child of two joints"
            report.add("audit-description-broken", text, joint.span)
        parents.add(joint.child)
    roots = [link for link in description.links if link not in parents]
    if len(roots) != 1 and description.links:
        shown = ", ".join(f"`{name}`" for name in roots[:4]) or "none"
        text = f"a robot has one root link, this one has {len(roots)}: {shown}"
        span = description.links[roots[1]].span if len(roots) > 1 else Span(description.file)
        report.add("audit-description-broken", text, span)


# -- who drives which joint ---------------------------------------------------------------


def _read_drive(robot: ForeignRobot, element: Element) -> None:
    """Notes which joints a child element of ``<robot>`` drives or steers."""
    description = robot.description
    if element.tag == "ros2_control":
        description.facts += ros2_control_facts(element)
        for joint in element.children:
            for interface in joint.children:
                if interface.tag == "command_interface":
                    _note(robot, joint, interface.attributes.get("name", ""))
    elif element.tag == "gazebo":
        description.facts += plugin_facts(element)
        for plugin in walk(element):
            if plugin.tag == "plugin":
                name = f"{plugin.attributes.get('name', '')} {plugin.attributes.get('filename')}"
                robot.controller_types.setdefault(name, plugin.span)
                is_publisher = "state" in name.lower()  # of the states of joints
                for fact in plugin_facts(plugin) if not is_publisher else ():
                    if fact.kind == "joint":
                        steers = "steer" in str(fact.value)
                        joints = robot.position_joints if steers else robot.velocity_joints
                        joints.setdefault(str(fact.value), fact.span)
    elif element.tag == "transmission":
        interfaces = [e.text for e in walk(element) if e.tag == "hardwareInterface"]
        for joint in element.children:
            if joint.tag == "joint":
                _note(robot, joint, "".join(interfaces[:1]))


def _note(robot: ForeignRobot, joint: Element, interface: str) -> None:
    steers = "position" in interface.lower()
    joints = robot.position_joints if steers else robot.velocity_joints
    joints.setdefault(joint.attributes.get("name", ""), joint.span)


# Parameters of controllers of ROS 1, beside those of ``ros2_controllers``.
_WHEELS = (*LEFT, *RIGHT, *TRACTION, "front_wheel", "rear_wheel")
_STEERED = (*STEERING, "rear_steering")


def _read_controllers(robot: ForeignRobot, path: Path, report: Report) -> None:
    """Adds the statements of a parameter file of controllers."""
    display = str(path)
    robot.sources[display] = path
    try:
        document = read_yaml(read_bounded(path, MAX_PARAMETER_BYTES), display, report)
    except OSError as error:
        text = f"`{display}` cannot be read: {error.strerror or error}"
        report.add("file-unreadable", text, Span(display))
        return
    except UnreadableFileError as error:
        report.add("import-value", f"`{display}`: {error}", error.span or Span(display))
        return
    known = robot.description.joints
    all_sections = sections(document, display, path) if document is not None else []
    if document is not None and not all_sections:
        all_sections = list(_ros1_sections(document, display, path))
    is_used = False
    for section in all_sections:
        wheels, steered = (plain_names(section, n, known) for n in (_WHEELS, _STEERED))
        for key, node in section.values.items():
            if key.rpartition(".")[2] == "type" and isinstance(node.value, str):
                robot.controller_types.setdefault(node.value, node.span)
        if not wheels and not steered:
            continue
        is_used = True
        facts = controller_facts(section, known)
        robot.description.facts += facts
        for names, joints in ((wheels, robot.velocity_joints), (steered, robot.position_joints)):
            for name in names:
                joints.setdefault(name, section.span)
        for key in section.values:
            value = section.number(key)
            if value is not None and value > 0.0 and "max_" in key:
                robot.limits.setdefault(key, value)
        for fact in facts:
            if fact.kind == "joint" and fact.value not in known:
                _report_unknown(fact, list(known), report)
    if not is_used:
        report.add(
            "import-left-out",
            f"`{display}` names no wheels: it is not used",
            Span(display),
            hint="give the parameters of the controllers: `left_wheel_names` and others",
        )


def _ros1_sections(node: Node, display: str, path: Path) -> Iterator[ParameterSection]:
    """Yields each mapping of a parameter file of ROS 1 that states a controller."""
    for name, child in node.value.items() if isinstance(node.value, dict) else ():
        if isinstance(child.value, dict) and "type" in child.value:
            yield ParameterSection(name, display, path, child.where, flattened(child))
        yield from _ros1_sections(child, display, path)


def _report_unknown(fact: Fact, known: Sequence[str], report: Report) -> None:
    report.add(
        "audit-joint-unknown",
        f"{fact.subject} names joint `{fact.value}`, which the robot does not have",
        fact.span,
        hint=did_you_mean(str(fact.value), known, fixable=False),
    )
