"""Expands xacro files to descriptions, in a contained process and in bounded time."""

from __future__ import annotations

import itertools
import re
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from thorvaldc.compiler.extras.xacro_expand import (
    DisplayPaths,
    ExpandedFile,
    ExpansionRequest,
    expand,
)
from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit.audit_facts import Description, Evidence
from thorvaldc.tools.audit.folder_survey import RobotFile, skip
from thorvaldc.tools.audit.urdf_description import read_urdf_description

# Time in s after which no further xacro files are expanded.  An endless file takes 20 s.
EXPANSION_SECONDS = 60.0
FILES_PER_WORKER = 16
MAX_VARIANTS = 8
MAX_MISSING_ARGUMENTS = 4

_ROBOT = re.compile(rb"<robot\b([^>]*)>")
_INCLUDE = re.compile(rb"<xacro:include\b[^>]*\bfilename\s*=\s*[\"']([^\"']+)[\"']")
_FLAG = re.compile(
    rb"<xacro:arg\b(?=[^>]*\bname\s*=\s*[\"']([\w-]+)[\"'])"
    rb"(?=[^>]*\bdefault\s*=\s*[\"']((?i:true|false))[\"'])"
)


def read_urdf_files(
    files: Sequence[tuple[RobotFile, bytes]],
    packages: Mapping[str, Path],
    evidence: Evidence,
    report: Report,
    trust: bool,
) -> dict[str, Path]:
    """Adds the descriptions in URDF and xacro files to ``evidence``.

    Files that describe a robot are expanded: those with a name of the robot, and those that no
    other file includes.  Returns the path of each file that was read, by its name.
    """
    included = {
        Path(name.decode("utf-8", "replace")).name
        for _, data in files
        for name in _INCLUDE.findall(data)
    }
    expansion = _Expansion(packages, evidence, report, trust)
    tops = [
        (file, data)
        for file, data in files
        if (robot := _ROBOT.search(data)) is not None
        and (re.search(rb"\bname\s*=", robot[1]) or file.path.name not in included)
    ]
    for start in range(0, len(tops), FILES_PER_WORKER):
        expansion.read(tops[start : start + FILES_PER_WORKER])
    return expansion.sources


class _Expansion:
    def __init__(
        self, packages: Mapping[str, Path], evidence: Evidence, report: Report, trust: bool
    ) -> None:
        self.packages = {name: str(folder) for name, folder in packages.items()}
        self.evidence = evidence
        self.report = report
        self.trust = trust
        self.sources: dict[str, Path] = {}
        self.end = time.monotonic() + EXPANSION_SECONDS

    def expand(
        self, file: RobotFile, paths: Sequence[Path], variants: Sequence[dict[str, str]]
    ) -> list[ExpandedFile]:
        """Expands files below the root of ``file`` with the arguments ``variants``."""
        display = "" if file.root_display == "." else file.root_display
        requests = [
            ExpansionRequest(path, args, self.packages, source_layout=True)
            for path, args in zip(paths, variants, strict=True)
        ]
        shown = DisplayPaths(file.root, display, {})
        expanded = expand(requests, shown, trust=self.trust)
        for result in expanded:
            self.sources.update(result.files)
        return expanded

    @property
    def is_over(self) -> bool:
        return time.monotonic() > self.end

    def read(self, files: Sequence[tuple[RobotFile, bytes]]) -> None:
        for root, group in itertools.groupby(files, lambda entry: entry[0].root):
            entries = list(group)
            if self.is_over:
                for file, _ in entries:
                    text = "the expansion of the other files took too long"
                    skip(file.display, text, self.report)
                    self.evidence.incomplete.append(file.display)
                continue
            paths = [file.path for file, _ in entries]
            results = self.expand(entries[0][0], paths, [{}] * len(paths))
            assert all(file.root == root for file, _ in entries)
            for (file, data), result in zip(entries, results, strict=True):
                self.read_result(file, data, result)

    def read_result(self, file: RobotFile, data: bytes, result: ExpandedFile) -> None:
        """Adds the description with the default arguments, and those with other flags.

        A flag, such as the choice between a simulated and a real robot, decides on parts of a file;
        each part is read in one of the descriptions.
        """
        arguments: dict[str, str] = {}
        while (
            result.failure is not None
            and result.failure.kind == "argument"
            and len(arguments) < MAX_MISSING_ARGUMENTS
            and not self.is_over
        ):
            name = result.failure.text.split()[-1].strip("`'\"")
            if name in arguments or not re.fullmatch(r"[\w-]+", name):
                break
            arguments[name] = "true"
            (result,) = self.expand(file, [file.path], [arguments])
        if result.failure is not None:
            failure = result.failure
            reason = _REASONS.get(failure.kind, "{}").format(failure.text)
            skip(file.display, reason, self.report, failure.span)
            self.evidence.incomplete.append(file.display)
            return
        description = self.description(file, result, self.report)
        if description is not None:
            self.evidence.descriptions.append(description)
            self.read_variants(file, data, arguments, result)
        else:
            self.read_macros(file, result)

    def read_variants(
        self, file: RobotFile, data: bytes, arguments: dict[str, str], result: ExpandedFile
    ) -> None:
        flags = {name.decode(): value.lower() == b"true" for name, value in _FLAG.findall(data)}
        flags |= dict.fromkeys(arguments, True)
        known = [(name, value) for name, value in flags.items() if name in result.known_arguments]
        variants = [
            {**arguments, name: "false" if value else "true"}
            for name, value in itertools.islice(known, MAX_VARIANTS)
        ]
        if not variants or self.is_over:
            return
        for other in self.expand(file, [file.path] * len(variants), variants):
            if other.failure is None and other.elements != result.elements:
                description = self.description(file, other, Report())
                if description is not None:
                    self.evidence.descriptions.append(description)

    def read_macros(self, file: RobotFile, result: ExpandedFile) -> None:
        """Adds the robot that a file defines as a macro of its own name without parameters."""
        stem = file.path.name.partition(".")[0]
        macros = [m for m in result.macros if m.name == stem and not m.required]
        if not macros or self.is_over:
            return
        with tempfile.TemporaryDirectory() as folder:
            caller = Path(folder, "caller.urdf.xacro")
            caller.write_text(
                f'<robot name="{stem}" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                f"<xacro:include filename={quoteattr(str(file.path))}/><xacro:{stem}/></robot>",
                encoding="utf-8",
            )
            (expanded,) = self.expand(file, [caller], [{}])
        if expanded.failure is None:
            description = self.description(file, expanded, self.report)
            if description is not None:
                self.evidence.descriptions.append(description)

    def description(
        self, file: RobotFile, result: ExpandedFile, report: Report
    ) -> Description | None:
        return read_urdf_description(result.elements, file.display, file.path, report)


_REASONS = {
    "argument": "the xacro argument `{}` has no default",
    "environment": "it reads the environment variable `{}`",
    "package": "the package `{}` is not in the audited folders",
    "xml": "it is not XML: {}",
    "root": "its root element is {}",
}
