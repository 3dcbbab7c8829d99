"""Reads SDF and MJCF files to the elements of URDF, which the import reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.descriptions.facts import FileDescription, UnreadableFileError
from thorvaldc.compiler.extras.converted_elements import UrdfElements, read_xml
from thorvaldc.compiler.extras.load_extras import MeshLoader
from thorvaldc.compiler.extras.plugin_facts import walk
from thorvaldc.compiler.extras.sdf_reader import sdf_models
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.source.readable_folders import is_below, real_folders
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.simulation.physics.mjcf_reader import mujoco_worker, read_mjcf

MAX_BYTES = 8_000_000
# Elements of MJCF that do not change a robot: the world, its picture and its solver, and defaults.
_SILENT = (
    *("option", "size", "statistic", "visual", "custom", "contact", "keyframe", "asset", "light"),
    *("material", "texture", "hfield", "model", "pair", "equality", "tendon", "general", "motor"),
    *(
        "position",
        "velocity",
        "intvelocity",
        "damper",
        "cylinder",
        "muscle",
        "adhesion",
        "lengthrange",
    ),
)


def read_elements(
    description: FileDescription, loader: MeshLoader, sources: dict[str, Path], report: Report
) -> list[Element]:
    """Returns the elements of the robot in an SDF or MJCF file; what cannot be read is reported.

    Sets format and name of the description, and adds the files to ``sources``.
    """
    try:
        root = _read(description.path, description.file)
        if root.tag == "sdf":
            return _with_ball_casters(_sdf_elements(root, description, report))
        if root.tag == "mujoco":
            elements = _mjcf_elements(root, description, loader, sources, report)
            return _with_ball_casters(elements)
        text = f"its root element is <{root.tag}>, not <mujoco> or <sdf>"
        raise UnreadableFileError(text, root.span)
    except UnreadableFileError as error:
        span = error.span or Span(description.file)
        report.add("import-value", f"`{span.file}` cannot be imported: {error}", span)
        return []


def _read(path: Path, display: str) -> Element:
    try:
        return read_xml(read_bounded(path, MAX_BYTES), display, path)
    except (OSError, ValueError) as error:
        raise UnreadableFileError(getattr(error, "strerror", None) or str(error)) from None


def _with_ball_casters(elements: list[Element]) -> list[Element]:
    """Fixes the joints of the type ``ball`` that carry spheres: these are ball casters."""
    links = {e.attributes["name"]: e for e in elements if e.tag == "link"}
    fixed: list[Element] = []
    for element in elements:
        child = element.find("child") if element.attributes.get("type") == "ball" else None
        link = links.get(child.attributes["link"]) if child is not None else None
        shapes = [e for e in walk(link) if e.tag in _SHAPES] if link is not None else []
        is_ball = bool(shapes) and all(shape.tag == "sphere" for shape in shapes)
        kind = {"type": "fixed"} if is_ball else {}
        fixed.append(replace(element, attributes={**element.attributes, **kind}))
    return fixed


_SHAPES = ("box", "cylinder", "sphere", "mesh")


def _sdf_elements(root: Element, description: FileDescription, report: Report) -> list[Element]:
    models = sdf_models(root)
    if not models:
        raise UnreadableFileError("it has no model with joints", root.span)
    robot = models[0]
    description.format, description.name = "SDF", robot.name(robot.model) or description.name
    for other in models[1:]:
        text = f"the model `{other.name(other.model)}` is not imported: a file has one robot"
        report.add("import-left-out", text, other.model.span)
    for element in walk(robot.model):
        if element.tag == "include":
            report.add("import-left-out", "an included model is not imported", element.span)
        if element.tag == "model" and element is not robot.model:
            text = f"the model `{robot.name(element)}` in it is not imported"
            report.add("import-left-out", text, element.span)
    for name, link in robot.links.items():
        if link.find("inertial") is None:
            text = f"link `{name}` has no <inertial>: its mass is taken as 0, in Gazebo it is 1 kg"
            report.add("import-assumed", text, link.span)
    return [*robot.elements(), *robot.sensors()]


def _mjcf_elements(
    root: Element,
    description: FileDescription,
    loader: MeshLoader,
    sources: dict[str, Path],
    report: Report,
) -> list[Element]:
    folder = description.path.parent

    def include(element: Element) -> Element:
        path = folder / element.attributes.get("file", "")
        if not is_below(path, real_folders([folder])):
            text = f"the included file `{path.name}` is not below the folder of the file"
            raise UnreadableFileError(text, element.span)
        display = loader.paths.name(str(path))
        sources[display] = path
        try:
            return _read(path, display)
        except UnreadableFileError as error:
            text = f"the included file `{display}` cannot be read: {error}"
            raise UnreadableFileError(text, error.span or element.span) from None

    # Only what cannot be read is reported: the scale of a mesh is not known yet.
    content = MeshLoader(loader.packages, loader.paths, loader.readable, Report())

    def read_mesh(name: str, element: Element) -> tuple[str, bytes]:
        mesh = content(name, replace(element, file=root.file), (1.0, 1.0, 1.0), True)
        if mesh is None:
            reason = next((d.message for d in content.report), f"`{name}` has an unknown format")
            raise UnreadableFileError(reason, element.span)
        return str(content.files[mesh.name]), mesh.data

    description.format = "MJCF"
    description.name = root.attributes.get("model", description.name)
    with mujoco_worker() as worker:
        parts = read_mjcf(root, include, worker, read_mesh)
    elements = parts.elements
    for other in parts.others:
        if other.tag == "actuator":
            elements += [_drive(actuator) for actuator in other.children]
        elif other.tag not in _SILENT or (other.tag in ("equality", "tendon") and other.children):
            kinds = dict.fromkeys(f"<{e.tag}>" for e in other.children)
            name = f"`{other.attributes['name']}`" if "name" in other.attributes else ""
            shown = name or ", ".join(kinds)
            text = f"<{other.tag}> is not imported: {shown}".removesuffix(": ")
            report.add("import-left-out", text, other.span)
    return elements


def _drive(actuator: Element) -> Element:
    """Returns the element of URDF that states which joint an actuator of MJCF moves."""
    urdf = UrdfElements(actuator)
    kind = "position" if actuator.tag == "position" else "velocity"
    interface = urdf.element("command_interface", name=kind)
    joint = urdf.element("joint", interface, name=_joint_of(actuator))
    return urdf.element("ros2_control", joint)


def _joint_of(actuator: Element) -> str:
    stated = actuator.attributes
    return stated.get("joint") or stated.get("jointinparent", "")
