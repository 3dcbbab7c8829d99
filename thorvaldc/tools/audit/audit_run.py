"""Audits the files of a robot: finds them, reads them, and applies the rules."""

from __future__ import annotations

import itertools
import os
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.descriptions.facts import FileDescription, UnreadableFileError
from thorvaldc.compiler.descriptions.parameter_files import (
    controller_facts,
    read_yaml,
    sections,
)
from thorvaldc.compiler.extras import xacro_expand
from thorvaldc.compiler.extras.converted_elements import read_xml
from thorvaldc.compiler.extras.load_extras import FAILURES
from thorvaldc.compiler.extras.plugin_facts import walk
from thorvaldc.compiler.extras.xacro_expand import Element, ExpandedFile
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.simulation.physics.mjcf_reader import mujoco_worker
from thorvaldc.tools.audit import (
    body_rules,
    descriptions,
    drive_rules,
    launch_files,
    name_rules,
    parameter_facts,
)
from thorvaldc.tools.audit.audit_facts import Evidence

# A rule compares what the readers have found.
RULES: tuple[Callable[[Evidence, Report], None], ...] = (
    drive_rules.check_wheels,
    drive_rules.check_sides,
    name_rules.check_joint_names,
    name_rules.check_frames,
    name_rules.check_transform_owners,
    drive_rules.check_stamps,
    drive_rules.check_speeds,
    drive_rules.check_wheel_speeds,
    drive_rules.check_descriptions_agree,
    body_rules.check_footprints_agree,
    body_rules.check_footprints_cover,
    body_rules.check_bodies,
    body_rules.check_meshes,
    name_rules.check_launched_files,
)


@dataclass(slots=True)
class Audit:
    """The result of an audit.

    - ``sources``: path of each file by its name in source spans.
    - ``left_out``: folders that a mark such as ``COLCON_IGNORE`` leaves out, with the mark.
    """

    evidence: Evidence = field(default_factory=Evidence)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def skip(self, file: RobotFile, error: UnreadableFileError, unread: list[str]) -> None:
        """Adds the note that a file, or a part of it, is not audited, and its name to a list."""
        text = f"`{file.display}` is not audited: {error}"
        self.report.add("audit-file-skipped", text, error.span or Span(file.display))
        unread.append(file.display)


def audit(names: Sequence[str], *, trust: bool = False) -> Audit:
    """Audits folders and files.

    - ``trust``: whether xacro files are expanded without restrictions.
    """
    result = Audit()
    report, evidence = result.report, result.evidence
    robot_files = survey(list(names), report)
    evidence.packages.update(robot_files.packages)
    result.left_out = robot_files.left_out
    reader = _Reader(robot_files, result)
    for file in robot_files.files:
        result.sources[file.display] = file.path
        if file.path.name != "package.xml":
            reader.read(file)
    reader.read_mjcf_files()
    _Expansion(result, trust).read_files(reader.urdf_files)
    known = {name for description in evidence.descriptions for name in description.joints}
    for section in evidence.sections:
        evidence.facts += controller_facts(section, known)
        evidence.facts += parameter_facts.node_facts(section)
    evidence.facts += parameter_facts.launched_facts(evidence)
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
        self.robot_files, self.result = robot_files, result
        self.evidence, self.report = result.evidence, result.report
        self.urdf_files: list[tuple[RobotFile, bytes]] = []
        self.mjcf_files: dict[str, tuple[RobotFile, Element]] = {}

    def read(self, file: RobotFile) -> None:
        suffix = file.path.suffix.lower()
        try:
            data = self.robot_files.content(file)
            if suffix in (".urdf", ".xacro"):
                self.urdf_files.append((file, data))
            elif suffix in (".yaml", ".yml"):
                self.read_yaml_file(file, data)
            elif suffix == ".py":
                if b"generate_launch_description" in data:
                    launch = launch_files.read_python(data, file.display, file.path)
                    self.evidence.launches.append(launch)
            elif suffix in SUFFIXES:
                self.read_xml_file(file, data)
            else:
                raise UnreadableFileError(f"files with the suffix `{suffix}` are not read")
        except UnreadableFileError as error:
            self.result.skip(file, error, self.evidence.unread_launches if suffix == ".py" else [])

    def read_yaml_file(self, file: RobotFile, data: bytes) -> None:
        is_parameters = b"ros__parameters" in data
        is_launch = b"launch:" in data and ".launch" in file.path.name
        if not is_parameters and not is_launch:
            return
        document = read_yaml(data, file.display, self.report)
        if document is not None and is_parameters:
            self.evidence.sections += sections(document, file.display, file.path)
        elif document is not None:
            self.evidence.launches.append(launch_files.read_yaml(document, file.display, file.path))

    def read_xml_file(self, file: RobotFile, data: bytes) -> None:
        root = read_xml(data, file.display, file.path)
        if root.tag == "sdf":
            models = descriptions.read_sdf(root, file.display, file.path, self.report)
            self.evidence.descriptions += models
        elif root.tag in ("mujoco", "mujocoinclude"):
            self.mjcf_files[os.path.realpath(file.path)] = file, root
        elif root.tag == "launch":
            self.evidence.launches.append(launch_files.read_xml(root, file.display, file.path))
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
        with mujoco_worker() as worker:
            for path, (file, root) in self.mjcf_files.items():
                if root.tag != "mujoco" or file.path.name in included:
                    continue
                try:
                    include = partial(self.included, path)
                    model = descriptions.read_mujoco(root, file.display, include, worker)
                    self.evidence.descriptions += [model] if model.joints else []
                except UnreadableFileError as error:
                    self.result.skip(file, error, self.evidence.incomplete)

    def included(self, top: str, element: Element) -> Element:
        """Returns the root element of the file that an ``<include>`` names."""
        name = element.attributes.get("file", "")
        for start in (top, os.path.realpath(element.file)):
            path = os.path.realpath(os.path.join(os.path.dirname(start), name.replace("\0", "")))
            if path in self.mjcf_files:
                return self.mjcf_files[path][1]
        text = f"the included file `{name}` is not in the audited folders"
        raise UnreadableFileError(text, element.span)


# -- the files in folders, with limits on their number, depth and size -----------------

MAX_FILES = 3000
MAX_ENTRIES = 200_000
MAX_DEPTH = 24
MAX_BYTES = 8_000_000
MAX_TOTAL_BYTES = 200_000_000

SUFFIXES = (
    *(".urdf", ".xacro", ".sdf", ".world", ".xml", ".mjcf"),
    *(".yaml", ".yml", ".py", ".launch"),
)
_IGNORE_MARKS = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")


class RobotFile(NamedTuple):
    """A file to read; ``root`` is the folder that the user named, ``display`` its name there."""

    path: Path
    display: str
    root: Path
    root_display: str


@dataclass(slots=True)
class Survey:
    """The files of the folders that the user named, in the order of their names.

    - ``packages``: folder of each ROS package, by its name.
    - ``left_out``: names of the folders that a mark such as ``COLCON_IGNORE`` leaves out.
    """

    files: list[RobotFile] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    packages: dict[str, Path] = field(default_factory=dict)
    read_bytes: int = 0

    def content(self, file: RobotFile) -> bytes:
        """Returns the bytes of a file.  Raises ``UnreadableFileError``."""
        if self.read_bytes >= MAX_TOTAL_BYTES:
            limit = MAX_TOTAL_BYTES // 1_000_000
            raise UnreadableFileError(f"all files together have more than {limit} MB")
        try:
            data = read_bounded(file.path, MAX_BYTES)
        except (OSError, ValueError) as error:
            raise UnreadableFileError(getattr(error, "strerror", None) or str(error)) from None
        self.read_bytes += len(data)
        return data


def survey(names: list[str], report: Report) -> Survey:
    """Finds the robot files in folders and adds named files; reports names that do not exist."""
    result = Survey()
    for name in names:
        path = Path(name)
        if not path.exists():
            report.add("file-not-found", f"`{name}` does not exist", Span(name))
            continue
        folder = path.absolute() if path.is_dir() else path.absolute().parent
        above = (up for up in (folder, *folder.parents) if (up / "package.xml").is_file())
        for package in itertools.islice(above, 1):
            _read_package(package, result)
        if path.is_dir():
            _walk(folder, name, result, report)
        else:
            result.files.append(RobotFile(path.absolute(), name, folder, str(path.parent)))
    files: dict[str, RobotFile] = {}
    for file in result.files:  # a file that is named twice, also by links, is read once
        files.setdefault(os.path.realpath(file.path), file)
    result.files = list(files.values())
    return result


def _walk(root: Path, display: str, result: Survey, report: Report) -> None:
    """Adds the files below a folder; links to folders are not followed."""
    entries = 0
    for folder, folders, files in os.walk(root):
        entries += len(folders) + len(files)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        shown = os.path.normpath(os.path.join(display, Path(folder).relative_to(root)))
        marks = [mark for mark in _IGNORE_MARKS if mark in files and folder != str(root)]
        if marks:
            result.left_out.append(f"`{shown}` ({marks[0]})")
            folders.clear()
            continue
        if len(Path(folder).relative_to(root).parts) >= MAX_DEPTH and folders:
            _report_limit(shown, f"is more than {MAX_DEPTH} levels deep", report)
            folders.clear()
        if "package.xml" in files:
            _read_package(Path(folder), result)
        for name in sorted(files):
            path = Path(folder, name)
            if not name.endswith(SUFFIXES) or name.startswith("."):
                continue
            shown = os.path.normpath(os.path.join(display, path.relative_to(root)))
            result.files.append(RobotFile(path, shown.replace(os.sep, "/"), root, display))
        if len(result.files) > MAX_FILES or entries > MAX_ENTRIES:
            number = f"{MAX_FILES} robot" if len(result.files) > MAX_FILES else str(MAX_ENTRIES)
            del result.files[MAX_FILES:]
            _report_limit(display, f"contains more than {number} files", report)
            return


def _report_limit(folder: str, problem: str, report: Report) -> None:
    message = f"`{folder}` {problem}; the rest is left out"
    hint = "name the folder of one robot in it"
    report.add("audit-limit", message, Span(folder), hint=hint)


def _read_package(folder: Path, result: Survey) -> None:
    try:
        text = read_bounded(folder / "package.xml", 1_000_000).decode("utf-8", "replace")
    except OSError:
        return
    name = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    if name is not None:
        result.packages.setdefault(name[1], folder)


# -- xacro files, in a contained process and in bounded time ----------------------------

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


class _Job(NamedTuple):
    """A file to expand with some arguments and a call of its macro."""

    file: RobotFile
    data: bytes
    macro: str
    arguments: dict[str, str]
    is_variant: bool = False


class _Expansion:
    """Adds the descriptions in URDF and xacro files to the result of an audit."""

    def __init__(self, result: Audit, trust: bool) -> None:
        self.packages = {name: str(folder) for name, folder in result.evidence.packages.items()}
        self.result, self.evidence, self.report = result, result.evidence, result.report
        self.trust = trust
        self.included: set[Path] = set()

    def read_files(self, files: Sequence[tuple[RobotFile, bytes]]) -> None:
        """Expands the files that describe a robot: those with a name of the robot, and those that
        no other file includes.
        """
        names = {name for _, data in files for name in _INCLUDE.findall(data)}
        patterns = [
            re.sub(r"\$[({][^)}]*[)}]", "*", name.decode("utf-8", "replace")) for name in names
        ]
        ends = {pattern.rpartition("/")[2] for pattern in patterns} - {"", "*"}
        self.included = {
            file.path for file, _ in files if any(fnmatch(file.path.name, end) for end in ends)
        }
        jobs = [
            _Job(file, data, "", {})
            for file, data in files
            if (robot := _ROBOT.search(data)) is not None
            and (re.search(rb"\bname\s*=", robot[1]) or file.path not in self.included)
        ]
        end = time.monotonic() + EXPANSION_SECONDS
        while jobs and time.monotonic() < end:
            first = jobs[0].file
            batch = [j for j in jobs[:FILES_PER_WORKER] if j.file.root == first.root]
            jobs = [job for job in jobs if job not in batch]
            for job, result in zip(batch, self.expand(batch), strict=True):
                self.result.sources.update(result.files)
                jobs += self.read(job, result)
        for job in jobs:
            if not job.is_variant:
                error = UnreadableFileError("the expansion of the other files took too long")
                self.result.skip(job.file, error, self.evidence.incomplete)

    def expand(self, jobs: Sequence[_Job]) -> list[ExpandedFile]:
        """Expands files below one root."""
        file = jobs[0].file
        requests = [
            xacro_expand.ExpansionRequest(
                job.file.path, job.arguments, self.packages, source_layout=True, macro=job.macro
            )
            for job in jobs
        ]
        display = "" if file.root_display == "." else file.root_display
        shown = xacro_expand.DisplayPaths(file.root, display, {})
        return xacro_expand.expand(requests, shown, trust=self.trust)

    def read(self, job: _Job, result: ExpandedFile) -> list[_Job]:
        """Adds the description in an expanded file, and returns what else to expand.

        A flag, such as the choice between a simulated and a real robot, decides on parts of a file;
        each part is read in one of the descriptions.  An argument without a default becomes true.
        A file can define its robot as a macro of its own name without parameters.
        """
        file, failure, stem = job.file, result.failure, job.file.path.name.partition(".")[0]
        if failure is not None and (job.is_variant or file.path in self.included):
            return []
        if failure is not None:
            name = failure.text.split()[-1].strip("`'\"") if failure.kind == "argument" else ""
            is_new = name not in job.arguments and re.fullmatch(r"[\w-]+", name)
            if is_new and len(job.arguments) < MAX_MISSING_ARGUMENTS:
                return [job._replace(arguments={**job.arguments, name: "true"})]
            reason = FAILURES[failure.kind][1].format(text=failure.text)
            error = UnreadableFileError(reason, failure.span)
            self.result.skip(file, error, self.evidence.incomplete)
            return []
        if self.add_description(file, result, Report() if job.is_variant else self.report):
            flags = {n.decode(): v.lower() == b"true" for n, v in _FLAG.findall(job.data)}
            flags |= dict.fromkeys(job.arguments, True)
            known = [name for name in flags if name in result.known_arguments][:MAX_VARIANTS]
            return [
                job._replace(
                    arguments={**job.arguments, name: str(not flags[name]).lower()}, is_variant=True
                )
                for name in (known if not job.is_variant else ())
            ]
        is_macro = any(macro.name == stem and not macro.required for macro in result.macros)
        return [job._replace(macro=stem)] if is_macro and not job.macro else []

    def add_description(self, file: RobotFile, result: ExpandedFile, report: Report) -> bool:
        """Adds the robot in the elements of a file, and returns whether there is one."""
        name, diagnostics = file.path.name, Report()
        robot = FileDescription(format="URDF", name=name, file=file.display, path=file.path)
        descriptions.read_description(robot, result.elements, diagnostics)
        robot.check_joints(diagnostics)
        if diagnostics.has_errors and file.path in self.included:
            return False  # it is a part of the robot that includes it
        report.extend(diagnostics)
        if robot.links and robot not in self.evidence.descriptions:
            self.evidence.descriptions.append(robot)
        return bool(robot.links)
