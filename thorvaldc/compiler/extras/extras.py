"""Extras: xacro files beside a robot, whose links and joints join the model."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.extras.join_extras import Attach, Attachment, Joined, Placing
from thorvaldc.compiler.extras.urdf_reader import UrdfParts, read_urdf
from thorvaldc.compiler.extras.xacro_expand import (
    Element,
    Expanded,
    Macro,
    Request,
    Shown,
    expand,
    search_paths,
)
from thorvaldc.compiler.extras.xacro_worker import find_package
from thorvaldc.compiler.geometry.meshes import load_mesh
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Joint, Link, Mesh, Pose, Vec3

__all__ = ["Attach", "Attachment", "ExtraParts", "load_extras"]


@dataclass(frozen=True, slots=True)
class ExtraParts:
    """What the extras add to a robot; parents come before their children.

    ``files`` are the files that were read, by their names in spans; their paths begin
    with the folder that was given.
    """

    links: tuple[Link, ...] = ()
    joints: tuple[Joint, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    urdf_extensions: tuple[str, ...] = ()
    files: dict[str, Path] = field(default_factory=dict)


def load_extras(
    entries: Sequence[Node],
    base_dir: Path,
    *,
    links: Mapping[str, Span],
    joints: Mapping[str, Span],
    attach: Attach,
    report: Report,
) -> ExtraParts:
    """Expand, read and attach the entries of a robot's ``extras``.

    ``base_dir`` is the folder of the robot's file; ``links`` and ``joints`` are the
    robot's own by name, with where they come from.  Faults go to ``report``; what
    comes back is whole only where there were none.  No entries cost nothing.
    """
    if not entries:
        return ExtraParts()
    given_dir, base_dir = base_dir, base_dir.absolute()
    display = str(Path(entries[0].span.file).parent)
    shown = Shown(base_dir, "" if display == "." else display, {})
    read = [_Entry.read(node, base_dir, shown, report) for node in entries]
    wanted = [entry for entry in read if entry is not None]
    joined = Joined(dict(links), dict(joints), attach, report)
    expanded = expand([Request(e.file, e.args, e.packages) for e in wanted], shown)
    files: dict[str, Path] = {}
    for entry, expansion in zip(wanted, expanded, strict=True):
        for name, file in expansion.files.items():
            installed = name.startswith("package://")
            files[name] = file if installed else given_dir / os.path.relpath(file, base_dir)
        parts = _read(entry, expansion, report)
        if parts is not None:
            joined.add(entry.place(), parts)
    joined.check_mimics()
    return ExtraParts(
        tuple(joined.new_links),
        tuple(joined.new_joints),
        tuple(joined.meshes.values()),
        tuple(joined.extensions),
        files,
    )


@dataclass(frozen=True, slots=True)
class _Entry:
    """One entry of ``extras``, read."""

    node: Node
    file: Path
    args: dict[str, str]
    packages: dict[str, str]
    parent: Node | None
    pose: Pose
    placed: Node | None  # the first of parent, xyz, rpy that is given

    @property
    def span(self) -> Span:
        named = self.node.get("xacro")
        return named.span if named is not None else self.node.span

    def place(self) -> Placing:
        return Placing(self.span, self.parent, self.pose, self.placed)

    @staticmethod
    def read(node: Node, base_dir: Path, shown: Shown, report: Report) -> _Entry | None:
        named = node.get("xacro")
        if named is None or not isinstance(named.value, str):
            return None  # the schema has said so
        file = base_dir / named.value
        try:
            found = file.is_file()
        except (OSError, ValueError):
            found = False
        if not found:
            report.add(
                "extra-missing",
                f"xacro file `{shown.name(str(file))}` does not exist",
                named.span,
                hint="the path is relative to the robot's file",
            )
            return None
        args = node.get("args")
        packages = node.get("packages")
        return _Entry(
            node,
            file,
            {k: _text(v) for k, v in args.value.items()}
            if args is not None and isinstance(args.value, dict)
            else {},
            _package_folders(packages, base_dir, shown, report),
            node.get("parent"),
            Pose.from_xyz_rpy(
                _vector(node.get("xyz"), "length", report),
                _vector(node.get("rpy"), "angle", report),
            ).clean(),
            node.get("parent") or node.get("xyz") or node.get("rpy"),
        )


def _package_folders(
    packages: Node | None, base_dir: Path, shown: Shown, report: Report
) -> dict[str, str]:
    if packages is None or not isinstance(packages.value, dict):
        return {}
    found: dict[str, str] = {}
    for name, folder in packages.value.items():
        path = base_dir / str(folder.value)
        if not path.is_dir():
            report.add(
                "extra-package",
                f"the folder `{shown.name(str(path))}` of package `{name}` does not exist",
                folder.span,
                hint="the path is relative to the robot's file",
            )
        found[name] = str(path)
    return found


def _text(node: Node) -> str:
    """An argument as xacro reads it."""
    if isinstance(node.value, bool):
        return "true" if node.value else "false"
    return "" if node.value is None else str(node.value)


def _vector(node: Node | None, quantity: str, report: Report) -> Vec3:
    """Three numbers in SI or quantities with a unit; zeros where there are none."""
    if node is None or not isinstance(node.value, tuple) or len(node.value) != 3:
        return (0.0, 0.0, 0.0)
    values: list[float] = []
    for item in node.value:
        if isinstance(item.value, str):
            from thorvaldc.compiler.source.units import UnitError, parse_quantity

            try:
                values.append(parse_quantity(item.value, quantity))
            except UnitError as fault:
                report.add(fault.code, fault.message, item.span, hint=fault.hint)
                values.append(0.0)
        elif isinstance(item.value, (int, float)):
            values.append(float(item.value))
    return (values[0], values[1], values[2]) if len(values) == 3 else (0.0, 0.0, 0.0)


# -- from a file to parts ---------------------------------------------------------


_FAULTS = {
    "xml": ("extra-xml", "xacro file is not well-formed XML: {text}", None),
    "root": ("extra-xml", "the root element of a xacro file is <robot>; here it is {text}", None),
    "limit": (
        "extra-limit",
        "xacro file is given up: {text}",
        "an endless loop or a runaway list in an expression, or a file too large",
    ),
    "argument": (
        "extra-argument",
        "the xacro file needs the argument `{text}`, which is not given",
        "add it to the entry: args: {{{text}: ...}}, or give it a default: "
        '<xacro:arg name="{text}" default="..."/>',
    ),
    "package": (
        "extra-package",
        "the package `{text}` is not found",
        "tell where it lies: packages: {{{text}: path/to/{text}}} in the extras entry",
    ),
    "expression": ("extra-expansion", "xacro: {text}", None),
}


def _read(entry: _Entry, expanded: Expanded, report: Report) -> UrdfParts | None:
    shown = expanded.shown
    named = Label(entry.span, "the file is named here")
    if expanded.fault is not None:
        fault = expanded.fault
        code, message, hint = _FAULTS[fault.kind]
        labels = [Label(span, text) for span, text in fault.trail]
        hint = (
            hint.format(text=fault.text)
            if hint is not None
            else _expression_hint(fault.text, expanded.macros)
        )
        where = fault.span or Span(shown.name(str(entry.file)))
        report.add(code, message.format(text=fault.text), where, hint=hint, labels=[*labels, named])
        return None
    for text, span in expanded.warnings:
        report.add("extra-warning", f"xacro: {text}", span or entry.span, labels=[named])
    for name in expanded.unused_arguments:
        node = entry.node.get("args")
        given = node.get(name) if node is not None else None
        known = list(expanded.known_arguments)
        report.add(
            "extra-argument-unused",
            f"the xacro file does not ask for the argument `{name}`",
            given.where if given is not None else entry.span,
            hint=did_you_mean(name, [a for a in known if a not in entry.args])
            or "it asks for " + (", ".join(f"`{a}`" for a in known) or "none"),
        )
    if not any(e.tag != "material" for e in expanded.elements):
        _report_empty(entry, expanded.macros, report)
        return None
    stem = re.sub(r"\W+", "_", entry.file.name.split(".")[0].lower())
    search = search_paths()

    def load(name: str, element: Element, scale: Vec3) -> Mesh | None:
        path = _mesh_path(name, element, entry, search, report)
        if path is None:
            return None
        return load_mesh(path, element.span, report, display=shown.name(str(path)), scale=scale)

    macros = [macro.name for macro in expanded.macros]
    parts = read_urdf(expanded.elements, f"extras.{stem}", load, report, macros)
    folders = {**expanded.packages, **entry.packages}
    return UrdfParts(
        parts.links,
        parts.joints,
        parts.meshes,
        tuple(_without_folders(xml, folders, shown) for xml in parts.extensions),
    )


def _without_folders(xml: str, packages: Mapping[str, str], shown: Shown) -> str:
    """An extension with ``$(find ..)``'s folders as ``package://``, so that it can move."""
    for name in sorted(packages, key=lambda n: -len(packages[n])):
        for folder in (f"file://{packages[name]}", packages[name]):
            xml = re.sub(re.escape(folder.rstrip("/")) + r"(?=[/\"'<\s])", f"package://{name}", xml)
    return shown.text(xml)


def _mesh_path(
    name: str, element: Element, entry: _Entry, search: dict[str, Sequence[str]], report: Report
) -> Path | None:
    scheme, found, rest = name.partition("://")
    if not found:
        return element.file.parent / name
    if scheme == "file":
        return element.file.parent / rest
    if scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        folder = find_package(package, entry.packages, search, str(element.file))
        if folder is not None:
            return Path(folder) / inside
        code, message, hint = _FAULTS["package"]
        labels = [Label(span, "in the macro called here") for span in element.calls[:4]]
        report.add(
            code,
            message.format(text=package),
            element.span,
            hint=(hint or "").format(text=package),
            labels=[*labels, Label(entry.span, "the file is named here")],
        )
        return None
    report.add(
        "mesh-missing",
        f"mesh file `{name}` is not a file: `{scheme}` is not read",
        element.span,
        hint="use a path relative to the xacro file, package:// or file://",
    )
    return None


def _expression_hint(text: str, macros: Sequence[Macro]) -> str | None:
    unknown = re.search(r"unknown macro name: xacro:(\S+)", text)
    if unknown is None:
        return None
    names = [macro.name for macro in macros]
    if names:
        return did_you_mean(unknown[1], names) or f"there are {', '.join(names)}"
    return "no macro is defined; is the file that defines it included before?"


def _report_empty(entry: _Entry, macros: Sequence[Macro], report: Report) -> None:
    idle = [macro for macro in macros if not macro.called]
    if not idle:
        report.add("extra-empty", "the xacro file adds no links and no joints", entry.span)
        return
    macro = idle[-1]
    values = "".join(f' {p}="..."' for p in macro.needed if not p.startswith("*"))
    blocks = [p.lstrip("*") for p in macro.needed if p.startswith("*")]
    call = f"<xacro:{macro.name}{values}"
    call += f">{''.join(f'<{b} .../>' for b in blocks)}</xacro:{macro.name}>" if blocks else "/>"
    names = ", ".join(f"`{m.name}`" for m in idle)
    labels = [Label(macro.span, "defined here")] if macro.span is not None else []
    report.add(
        "extra-empty",
        f"the xacro file defines the macro{'s' * (len(idle) > 1)} {names} and calls none: "
        "nothing was instantiated",
        entry.span,
        hint=f"name a file that includes it and says {call}",
        labels=labels,
    )
