"""Loads extras.  An extra is a xacro file that adds links and joints to a robot.

The module ``xacro_expand`` evaluates the macros and expressions of a xacro file.  The module
``urdf_reader`` converts the expanded xacro file to links and joints.  The module ``join_extras``
adds the links and joints of xacro files to the robot.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from thorvaldc.compiler.descriptions.description import Description
from thorvaldc.compiler.descriptions.description_rules import check_description
from thorvaldc.compiler.extras import join_extras, xacro_expand
from thorvaldc.compiler.extras.ros2_controls import check_controls, servos_of
from thorvaldc.compiler.extras.urdf_elements import call_labels
from thorvaldc.compiler.extras.urdf_reader import UrdfParts, read_urdf
from thorvaldc.compiler.extras.xacro_rules import find_package
from thorvaldc.compiler.hardware.hardware_reader import Hardware
from thorvaldc.compiler.hardware.robot_parts import RobotParts
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.compiler.source.input_file import FOLDERS, XACRO_FILES, folder_of, report_missing
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.readable_folders import is_below
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import ValueReader, entries, items
from thorvaldc.diagnostics import Label, Report, Span, did_you_mean
from thorvaldc.diagnostics.report import grouped
from thorvaldc.model import Link, Mesh, Vec3
from thorvaldc.schema import inlined


def add_extras(
    document: Node,
    robot: Instance,
    hardware: Mapping[str, Hardware],
    parts: RobotParts,
    base_dir: Path,
    files: dict[str, Path],
    report: Report,
    trust: bool,
) -> RobotParts:
    """Returns the parts of the robot with the links, joints and meshes of the extras.

    Parameters
    ----------
    document : the robot document, which names the extras.
    robot : the tree of module instances.
    hardware : hardware of the leaf modules, by the path of the leaf.
    parts : links and joints of the robot.
    base_dir : folder of the robot file.
    files : the function adds each file that was read, by the name of the file in spans.
    trust : whether xacro files are expanded without restrictions.
    """
    added = load_extras(
        items(document.get("extras")),
        base_dir,
        links={link.name: link.span for link in parts.links},
        joints={joint.name: joint.span for joint in parts.joints},
        attach=join_extras.Attachments(document, robot, hardware, parts).find,
        files=files,
        report=report,
        trust=trust,
    )
    return RobotParts.joined([parts, added])


def load_extras(
    entries: Sequence[Node],
    base_dir: Path,
    *,
    links: Mapping[str, Span],
    joints: Mapping[str, Span],
    attach: join_extras.FindAttachment,
    files: dict[str, Path],
    report: Report,
    trust: bool = False,
) -> RobotParts:
    """Returns the links, joints, servos, meshes and URDF extensions of xacro files.

    In the list of links, a parent link comes before its child links.  If a xacro file has errors,
    some of its links and joints are missing.

    - ``entries``: entries of the section ``extras`` in the robot file.
    - ``base_dir``: folder of the robot file.
    - ``links``: source span of each link of the robot, by the name of the link.
    - ``joints``: source span of each joint of the robot, by the name of the joint.
    - ``attach``: function that finds the mounting position of an entry.
    - ``files``: the function adds each xacro file, by the name of the file in source spans.  The
      path of a file begins with the folder of the robot file, unless the file belongs to an
      installed ROS package.
    - ``trust``: whether the user trusts the xacro files as he trusts a program.
    """
    relative_dir = folder_of(entries[0], files, base_dir)
    base_dir = relative_dir.absolute()
    display = str(Path(entries[0].span.file).parent)
    paths = xacro_expand.DisplayPaths(base_dir, "" if display == "." else display, {})
    diagnostics = Report()
    all_entries = [_Entry.read(node, base_dir, files, diagnostics) for node in entries]
    valid_entries = [entry for entry in all_entries if entry is not None]
    joiner = join_extras.ExtrasJoiner(dict(links), dict(joints), attach, diagnostics)
    requests = [entry.request for entry in valid_entries]
    folders = (
        None
        if trust
        else xacro_expand.readable_folders(requests, base_dir, xacro_expand.search_paths())
    )
    expanded_files = xacro_expand.expand(requests, paths, trust=trust)
    for entry, expanded_file in zip(valid_entries, expanded_files, strict=True):
        for name, file in expanded_file.files.items():
            installed = name.startswith("package://")
            files[name] = file if installed else relative_dir / os.path.relpath(file, base_dir)
        parts = _read_parts(entry, expanded_file, folders, diagnostics)
        if parts is not None:
            arguments = expanded_file.known_arguments
            joiner.add(replace(entry.placement, arguments=arguments), parts)
    joiner.check_mimics()
    new = Description.of(joiner.new_links, joiner.new_joints, "extra", joiner.places)
    check_description(new, diagnostics)
    check_controls(joiner.controls, joiner.new_joints, joints, diagnostics)
    servos = servos_of(joiner.stated_servos, joiner.new_joints, diagnostics)
    report.extend(grouped(diagnostics))
    return RobotParts(
        links=tuple(map(_without_zero_mass, joiner.new_links)),
        joints=tuple(joiner.new_joints),
        joint_servos=servos,
        meshes=tuple(joiner.meshes.values()),
        urdf_extensions=tuple(joiner.extensions),
    )


def _without_zero_mass(link: Link) -> Link:
    """Returns a link whose stated mass of 0 is left out, as of a frame."""
    has_mass = link.inertial is not None and link.inertial.mass > 0.0
    return link if has_mass else replace(link, inertial=None)


@dataclass(frozen=True, slots=True)
class _Entry:
    """An entry of the section ``extras`` in a robot file, which adds a xacro file to the robot."""

    node: Node
    request: xacro_expand.ExpansionRequest
    placement: join_extras.Placement
    density: float | None  # of links without <inertial>, in kg/m^3

    @property
    def span(self) -> Span:
        return self.placement.span

    @staticmethod
    def read(
        node: Node, base_dir: Path, files: Mapping[str, Path], report: Report
    ) -> _Entry | None:
        file_node = node.get("xacro")
        if file_node is None or not isinstance(file_node.value, str):
            return None  # reported by the schema check
        folder = folder_of(file_node, files, base_dir).absolute()
        file = folder / file_node.value
        try:
            exists = file.is_file()
        except (OSError, ValueError):
            exists = False
        if not exists:
            report_missing("extra-missing", folder, file_node, XACRO_FILES, report)
            return None
        packages = node.get("packages")
        schema = inlined("robot")["properties"]["extras"]["items"]
        values = Section(node, schema, ValueReader(report, on_robot=True))
        args, env = (_texts(node.get(key)) for key in ("args", "env"))
        folders = _package_folders(packages, folder, report)
        parent = node.get("parent")
        placement_node = parent or node.get("xyz") or node.get("rpy")
        return _Entry(
            node,
            xacro_expand.ExpansionRequest(file, args, folders, env),
            join_extras.Placement(file_node.span, parent, values.pose().clean(), placement_node),
            values["density"],
        )


def _package_folders(packages: Node | None, base_dir: Path, report: Report) -> dict[str, str]:
    if packages is None or not isinstance(packages.value, dict):
        return {}
    folders: dict[str, str] = {}
    for name, folder in packages.value.items():
        path = base_dir / str(folder.value)
        if not path.is_dir():
            report_missing("extra-package", base_dir, folder, FOLDERS, report)
        folders[name] = str(path)
    return folders


def _texts(node: Node | None) -> dict[str, str]:
    """Returns the values of xacro arguments or environment variables in the robot file as texts."""
    if node is None or not isinstance(node.value, dict):
        return {}
    return {name: _text(value) for name, value in node.value.items()}


def _text(node: Node) -> str:
    if isinstance(node.value, bool):
        return "true" if node.value else "false"
    return "" if node.value is None else str(node.value)


# -- from an expanded file to parts -------------------------------------------------

# Errors of mesh files.  A mesh that is only for the eye is then replaced.
_UNREADABLE = ("mesh-missing", "mesh-format", "mesh-invalid", "mesh-large", "extra-forbidden")
# Errors of the xacro expansion: kind of error -> (name of the diagnostic code, message, hint).
FAILURES = {
    "xml": ("extra-xml", "the xacro file is not well-formed XML: {text}", None),
    "root": ("extra-xml", "the root element of a xacro file must be <robot>, not {text}", None),
    "limit": (
        "extra-limit",
        "the expansion of the xacro file was stopped: {text}",
        "look for an endless loop or a very long list in an expression, or use a smaller file",
    ),
    "argument": (
        "extra-argument",
        "the xacro file requires the argument `{text}`, which is not set",
        "add it to the entry: args: {{{text}: ...}}, or define a default: "
        '<xacro:arg name="{text}" default="..."/>',
    ),
    "environment": (
        "extra-environment",
        "the xacro file requires the environment variable `{text}`, which is not set",
        "add it to the entry: env: {{{text}: ...}}; the file reads no other environment variables",
    ),
    "package": (
        "extra-package",
        "the package `{text}` cannot be found",
        "set its folder in the extras entry: packages: {{{text}: path/to/{text}}}",
    ),
    "forbidden": (
        "extra-forbidden",
        "not allowed in a xacro file: {text}",
        "ROS packages and the robot's folder may be read; if you trust the authors of the file as "
        "you trust the authors of a program, use the option --trust",
    ),
    "expression": ("extra-expansion", "xacro: {text}", None),
}


def _read_parts(
    entry: _Entry,
    expanded: xacro_expand.ExpandedFile,
    readable: Sequence[str] | None,
    report: Report,
) -> UrdfParts | None:
    """Returns the parts of an expanded file, or ``None`` if there are none.

    - ``readable``: folders from which meshes may be read, or ``None`` for all.
    """
    file_label = Label(entry.span, "the file is named here")
    paths = expanded.paths
    if expanded.failure is not None:
        _report_failure(entry, expanded, expanded.failure, report)
        return None
    for text, span in expanded.warnings:
        report.add("extra-warning", f"xacro: {text}", span or entry.span, labels=[file_label])
    _report_unused(entry, expanded, report)
    if not any(element.tag != "material" for element in expanded.elements):
        _report_empty(entry, expanded.macros, report)
        return None
    stem = re.sub(r"\W+", "_", entry.request.file.name.split(".")[0].lower())
    load = MeshLoader(entry.request.packages, paths, readable, report, (file_label,))
    macros = [macro.name for macro in expanded.macros]
    parts = read_urdf(expanded.elements, f"extras.{stem}", load, report, macros, entry.density)
    folders = {**expanded.packages, **entry.request.packages}
    extensions = tuple(_without_folders(xml, folders, paths) for xml in parts.extensions)
    return replace(parts, extensions=extensions)


class MeshLoader:
    """Loads the mesh files that the elements of an expanded file name.

    - ``packages``: folder of each ROS package that the user names.
    - ``readable``: folders from which meshes may be read, or ``None`` for all.
    - ``labels``: labels of errors about packages.
    - ``files``: path of each mesh file that was read, by the name of the mesh.
    """

    def __init__(
        self,
        packages: Mapping[str, str],
        paths: xacro_expand.DisplayPaths,
        readable: Sequence[str] | None,
        report: Report,
        labels: Sequence[Label] = (),
    ) -> None:
        self.packages, self.paths, self.readable = dict(packages), paths, readable
        self.report, self.labels = report, labels
        self.search = xacro_expand.search_paths()
        self.files: dict[str, Path] = {}

    def __call__(
        self, name: str, element: xacro_expand.Element, scale: Vec3, is_visual: bool
    ) -> Mesh | None:
        path = self._path(name, element)
        if path is None:
            return None
        diagnostics = Report()
        display = self.paths.name(str(path))
        mesh = None
        if self.readable is not None and path.exists() and not is_below(path, self.readable):
            code, message, hint = FAILURES["forbidden"]
            text = f"the mesh file `{display}` is outside of the folders that may be read"
            diagnostics.add(code, message.format(text=text), element.span, hint=hint)
        else:
            mesh = load_mesh(
                path,
                element.span,
                diagnostics,
                display=display,
                scale=scale,
                collides=not is_visual,
            )
        for d in diagnostics:
            if is_visual and d.code.name in _UNREADABLE:
                self.report.add(
                    "extra-visual-mesh",
                    f"{d.message}; the collision shapes of the link or a small box are shown",
                    d.span,
                    hint=d.hint,
                    labels=call_labels(element),
                )
            else:
                self.report.put(d)
        if mesh is not None:
            self.files.setdefault(mesh.name, path)
        return mesh

    def _path(self, name: str, element: xacro_expand.Element) -> Path | None:
        scheme, separator, rest = name.partition("://")
        if not separator:
            return element.file.parent / name
        if scheme == "file":
            return element.file.parent / rest
        if scheme in ("package", "model"):
            package, _, inside = rest.partition("/")
            folder = find_package(package, self.packages, self.search, str(element.file))
            if folder is not None:
                return Path(folder) / inside
            code, message, hint = FAILURES["package"]
            self.report.add(
                code,
                message.format(text=package),
                element.span,
                hint=(hint or "").format(text=package),
                labels=[*call_labels(element), *self.labels],
            )
            return None
        self.report.add(
            "mesh-missing",
            f"mesh file `{name}`: the URL scheme `{scheme}` is not supported",
            element.span,
            hint="use a path relative to the xacro file, package:// or file://",
        )
        return None


def _report_unused(entry: _Entry, expanded: xacro_expand.ExpandedFile, report: Report) -> None:
    """Reports arguments and environment variables of the entry that the xacro file does not use."""
    for key in ("args", "env"):
        spans = {name: node.where for name, node in entries(entry.node.get(key)).items()}
        report_unused_names(expanded, key, entry.request, spans, entry.span, report)


def report_unused_names(
    expanded: xacro_expand.ExpandedFile,
    key: str,
    request: xacro_expand.ExpansionRequest,
    spans: Mapping[str, Span],
    otherwise: Span,
    report: Report,
) -> None:
    """Reports the arguments (``args``) or environment variables (``env``) that a file ignores.

    - ``spans``: places of the names in a file of the user; the others are at ``otherwise``.
    """
    noun, unused, known = {
        "args": ("argument", expanded.unused_arguments, expanded.known_arguments),
        "env": ("environment variable", expanded.unused_environment, expanded.known_environment),
    }[key]
    others = [name for name in known if name not in (*request.args, *request.env)]
    for name in unused:
        report.add(
            "extra-argument-unused",
            f"the xacro file does not use the {noun} `{name}`",
            spans.get(name, otherwise),
            hint=did_you_mean(name, others, fixable=name in spans)
            or f"its {noun}s are " + (", ".join(f"`{a}`" for a in known) or "none"),
        )


def _report_failure(
    entry: _Entry,
    expanded: xacro_expand.ExpandedFile,
    failure: xacro_expand.ExpansionFailure,
    report: Report,
) -> None:
    code, message, hint = FAILURES[failure.kind]
    labels = [Label(span, text) for span, text in failure.trail]
    report.add(
        code,
        message.format(text=failure.text),
        failure.span or Span(expanded.paths.name(str(entry.request.file))),
        hint=hint.format(text=failure.text)
        if hint is not None
        else _expression_hint(failure.text, expanded.macros),
        labels=[*labels, Label(entry.span, "the file is named here")],
    )


def _without_folders(
    xml: str, packages: Mapping[str, str], paths: xacro_expand.DisplayPaths
) -> str:
    """Replaces the absolute paths of ROS packages in a URDF extension by ``package://`` URLs."""
    for name in sorted(packages, key=lambda n: -len(packages[n])):
        for folder in (f"file://{packages[name]}", packages[name]):
            xml = re.sub(re.escape(folder.rstrip("/")) + r"(?=[/\"'<\s])", f"package://{name}", xml)
    return paths.text(xml)


def _expression_hint(text: str, macros: Sequence[xacro_expand.Macro]) -> str | None:
    unknown = re.search(r"unknown macro name: xacro:(\S+)", text)
    if unknown is None:
        return None
    names = [macro.name for macro in macros]
    if names:
        return (
            did_you_mean(unknown[1], names, fixable=False) or f"the macros are {', '.join(names)}"
        )
    return "no macro is defined; include the file that defines it first"


def _report_empty(entry: _Entry, macros: Sequence[xacro_expand.Macro], report: Report) -> None:
    uncalled = [macro for macro in macros if not macro.called]
    if not uncalled:
        report.add("extra-empty", "the xacro file adds no links and no joints", entry.span)
        return
    macro = uncalled[-1]
    values = "".join(f' {p}="..."' for p in macro.required if not p.startswith("*"))
    blocks = [p.lstrip("*") for p in macro.required if p.startswith("*")]
    call = f"<xacro:{macro.name}{values}"
    call += f">{''.join(f'<{b} .../>' for b in blocks)}</xacro:{macro.name}>" if blocks else "/>"
    names = ", ".join(f"`{m.name}`" for m in uncalled)
    labels = [Label(macro.span, "defined here")] if macro.span is not None else []
    report.add(
        "extra-empty",
        f"the xacro file defines the macro{'s' * (len(uncalled) > 1)} {names} but calls none: "
        "it adds nothing to the robot",
        entry.span,
        hint=f"name a file that includes it and contains {call}",
        labels=labels,
    )
