"""Audits the files of a robot: finds them, reads them, and applies the rules."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import (
    DisplayPaths,
    ExpandedFile,
    ExpansionRequest,
    expand,
)
from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit.audit_facts import Evidence
from thorvaldc.tools.audit.audit_rules import RULES
from thorvaldc.tools.audit.drive_facts import controller_facts
from thorvaldc.tools.audit.folder_survey import RobotFile, Survey, skip, survey
from thorvaldc.tools.audit.parameter_files import UnreadableYaml, parameter_sections, read_yaml
from thorvaldc.tools.audit.urdf_description import read_urdf_description

# Time in s after which no further xacro files are expanded.  An endless file takes 20 s.
EXPANSION_SECONDS = 60.0
_FILES_PER_WORKER = 4


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
    found_files = survey(list(names), report)
    evidence.packages.update(found_files.packages)
    xacro_files: list[tuple[RobotFile, bytes]] = []
    for file in found_files.files:
        result.sources[file.display] = file.path
        if file.path.suffix in (".urdf", ".xacro"):
            data = found_files.content(file, report)
            if data is not None:
                xacro_files.append((file, data))
        elif file.path.suffix in (".yaml", ".yml"):
            _read_parameters(file, found_files, result)
    _read_urdf_files(xacro_files, found_files, result, trust)
    for section in evidence.sections:
        evidence.facts += controller_facts(section)
    if not (evidence.descriptions or evidence.sections or evidence.launches):
        if not report.has_errors:
            shown = ", ".join(f"`{name}`" for name in names)
            report.add("audit-nothing-found", f"{shown} contains no robot files that are read")
        return result
    for rule in RULES:
        rule(evidence, report)
    return result


def _read_parameters(file: RobotFile, found_files: Survey, result: Audit) -> None:
    data = found_files.content(file, result.report)
    if data is None or b"ros__parameters" not in data:
        return
    try:
        document, _ = read_yaml(data, file.display)
    except UnreadableYaml as error:
        diagnostic = error.diagnostic
        skip(file.display, diagnostic.message, result.report, diagnostic.span)
        return
    if document is not None:
        result.evidence.sections += parameter_sections(document, file.display, file.path)


# -- URDF and xacro -------------------------------------------------------------------

_ROBOT = re.compile(rb"<robot\b([^>]*)>")
_INCLUDE = re.compile(rb"<xacro:include\b[^>]*\bfilename\s*=\s*[\"']([^\"']+)[\"']")


def _read_urdf_files(
    files: list[tuple[RobotFile, bytes]], found_files: Survey, result: Audit, trust: bool
) -> None:
    """Expands the files that describe a robot: named ones, and those that no other includes."""
    included = {
        Path(name.decode("utf-8", "replace")).name
        for _, data in files
        for name in _INCLUDE.findall(data)
    }
    tops = []
    for file, data in files:
        robot = _ROBOT.search(data)
        if robot is None:
            continue
        if b"name" in robot[1] or file.path.name not in included:
            tops.append(file)
    packages = {name: str(folder) for name, folder in found_files.packages.items()}
    end = time.monotonic() + EXPANSION_SECONDS
    for start in range(0, len(tops), _FILES_PER_WORKER):
        chunk = tops[start : start + _FILES_PER_WORKER]
        if time.monotonic() > end:
            for file in tops[start:]:
                skip(file.display, "the expansion of the other files took too long", result.report)
                result.evidence.incomplete.append(file.display)
            return
        for file in chunk:
            request = ExpansionRequest(file.path, {}, packages)
            display = "" if file.root_display == "." else file.root_display
            paths = DisplayPaths(file.root, display, {})
            _read_expanded(file, expand([request], paths, trust=trust)[0], result)


def _read_expanded(file: RobotFile, expanded: ExpandedFile, result: Audit) -> None:
    result.sources.update(expanded.files)
    if expanded.failure is not None:
        failure = expanded.failure
        reason = _REASONS.get(failure.kind, "{}").format(failure.text)
        skip(file.display, reason, result.report, failure.span)
        result.evidence.incomplete.append(file.display)
        return
    description = read_urdf_description(expanded.elements, file.display, file.path, result.report)
    if description is not None:
        result.evidence.descriptions.append(description)


_REASONS = {
    "argument": "the xacro argument `{}` has no default",
    "environment": "it reads the environment variable `{}`",
    "package": "the package `{}` is not in the audited folders",
    "xml": "it is not XML: {}",
    "root": "its root element is {}",
}
