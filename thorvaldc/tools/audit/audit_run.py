"""Audits the files of a robot: finds them, reads them, and applies the rules."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit import (
    body_rules,
    footprint_rules,
    limit_rules,
    name_rules,
    transform_rules,
    twist_rules,
    wheel_rules,
)
from thorvaldc.tools.audit.audit_facts import Evidence
from thorvaldc.tools.audit.drive_facts import controller_facts
from thorvaldc.tools.audit.expanded_descriptions import read_urdf_files
from thorvaldc.tools.audit.folder_survey import SUFFIXES, RobotFile, Survey, skip, survey
from thorvaldc.tools.audit.launch_files import (
    is_python_launch,
    read_python_launch,
    read_xml_launch,
    read_yaml_launch,
)
from thorvaldc.tools.audit.mjcf_description import read_mjcf_description
from thorvaldc.tools.audit.node_facts import launched_facts, node_facts
from thorvaldc.tools.audit.parameter_files import (
    UnreadableYaml,
    bus_facts,
    parameter_sections,
    read_yaml,
)
from thorvaldc.tools.audit.sdf_description import read_sdf_descriptions
from thorvaldc.tools.audit.xml_document import XmlError, read_xml, walk

# A rule compares what the readers have found.
RULES: tuple[Callable[[Evidence, Report], None], ...] = (
    wheel_rules.check_wheel_radii,
    wheel_rules.check_wheel_separations,
    name_rules.check_joint_names,
    transform_rules.check_frames,
    transform_rules.check_transform_owners,
    transform_rules.check_state_publishers,
    twist_rules.check_stamps,
    twist_rules.check_speeds,
    twist_rules.check_wheel_speeds,
    limit_rules.check_command_limits,
    limit_rules.check_descriptions_agree,
    footprint_rules.check_footprints_agree,
    footprint_rules.check_footprints_cover,
    body_rules.check_masses,
    body_rules.check_inertias,
    body_rules.check_densities,
    body_rules.check_lengths,
    body_rules.check_angles,
    name_rules.check_launched_files,
    name_rules.check_controller_sections,
    name_rules.check_node_ids,
)


@dataclass(slots=True)
class Audit:
    """The result of an audit.

    - ``sources``: path of each file by its name in source spans.
    """

    evidence: Evidence = field(default_factory=Evidence)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)


def audit(names: Sequence[str], *, trust: bool = False) -> Audit:
    """Audits folders and files.

    - ``trust``: whether xacro files are expanded without restrictions.
    """
    result = Audit()
    report, evidence = result.report, result.evidence
    robot_files = survey(list(names), report)
    evidence.packages.update(robot_files.packages)
    reader = _Reader(robot_files, result)
    for file in robot_files.files:
        result.sources[file.display] = file.path
        reader.read(file)
    reader.read_mjcf_files()
    expanded = read_urdf_files(reader.urdf_files, robot_files.packages, evidence, report, trust)
    result.sources.update(expanded)
    known = {name for description in evidence.descriptions for name in description.joints}
    for section in evidence.sections:
        evidence.facts += controller_facts(section, known) + node_facts(section)
    evidence.facts += launched_facts(evidence)
    read = (evidence.descriptions, evidence.sections, evidence.launches, evidence.facts)
    if not any(read) and not len(report):
        shown = ", ".join(f"`{name}`" for name in names)
        report.add("audit-nothing-found", f"{shown} contains no robot files that are read")
    for rule in RULES:
        rule(evidence, report)
    return result


class _Reader:
    """Chooses the reader of each file by its name and its root element."""

    def __init__(self, robot_files: Survey, result: Audit) -> None:
        self.robot_files = robot_files
        self.evidence = result.evidence
        self.report = result.report
        self.urdf_files: list[tuple[RobotFile, bytes]] = []
        self.mjcf_files: dict[str, tuple[RobotFile, Element]] = {}

    def read(self, file: RobotFile) -> None:
        if file.path.name == "package.xml":
            return
        data = self.robot_files.content(file, self.report)
        if data is None:
            return
        suffix = file.path.suffix.lower()
        if suffix in (".urdf", ".xacro"):
            self.urdf_files.append((file, data))
        elif suffix in (".yaml", ".yml"):
            self.read_yaml_file(file, data)
        elif suffix == ".py":
            if is_python_launch(data):
                try:
                    launch = read_python_launch(data, file.display, file.path)
                except ValueError as error:
                    skip(file.display, str(error), self.report)
                    self.evidence.unread_launches.append(file.display)
                else:
                    self.evidence.launches.append(launch)
        elif suffix in SUFFIXES:
            self.read_xml_file(file, data)
        else:
            skip(file.display, f"files with the suffix `{suffix}` are not read", self.report)

    def read_yaml_file(self, file: RobotFile, data: bytes) -> None:
        is_parameters = b"ros__parameters" in data
        is_launch = b"launch:" in data and ".launch" in file.path.name
        if not is_parameters and not is_launch and b"node_id" not in data:
            return
        try:
            document = read_yaml(data, file.display, self.report)
        except UnreadableYaml as error:
            diagnostic = error.diagnostic
            skip(file.display, diagnostic.message, self.report, diagnostic.span)
            return
        if document is None:
            return
        if is_parameters:
            self.evidence.sections += parameter_sections(document, file.display, file.path)
        elif is_launch:
            self.evidence.launches.append(read_yaml_launch(document, file.display, file.path))
        else:
            self.evidence.facts += bus_facts(document)

    def read_xml_file(self, file: RobotFile, data: bytes) -> None:
        try:
            root = read_xml(data, file.display, file.path)
        except XmlError as error:
            skip(file.display, str(error), self.report, error.span)
            return
        if root.tag == "sdf":
            models = read_sdf_descriptions(root, file.display, file.path, self.report)
            self.evidence.descriptions += models
        elif root.tag in ("mujoco", "mujocoinclude"):
            self.mjcf_files[os.path.realpath(file.path)] = file, root
        elif root.tag == "launch":
            self.evidence.launches.append(read_xml_launch(root, file.display, file.path))
        elif root.tag == "robot":
            self.urdf_files.append((file, data))

    def read_mjcf_files(self) -> None:
        """Reads the MJCF files that no other MJCF file includes."""
        # MuJoCo finds included files from the folder of the main file, or of the including file.
        included = {
            Path(element.attributes.get("file", "")).name
            for _, root in self.mjcf_files.values()
            for element in walk(root)
            if element.tag in ("include", "model")
        }
        for path, (file, root) in self.mjcf_files.items():
            if root.tag != "mujoco" or file.path.name in included:
                continue
            missing: list[str] = []

            def include(
                name: str, element: Element, top: str = path, missing: list[str] = missing
            ) -> Element | None:
                for start in (top, os.path.realpath(element.file)):
                    entry = self.mjcf_files.get(_beside(start, name))
                    if entry is not None:
                        return entry[1]
                missing.append(name)
                return None

            scratch = Report()
            model = read_mjcf_description(root, file.display, file.path, include, scratch)
            if missing:
                text = f"the included file `{missing[0]}` is not in the audited folders"
                skip(file.display, text, self.report)
                self.evidence.incomplete.append(file.display)
            elif model is not None:
                self.report.extend(scratch)
                self.evidence.descriptions.append(model)


def _beside(path: str, name: str) -> str:
    return os.path.realpath(os.path.join(os.path.dirname(path), name)) if "\0" not in name else ""
