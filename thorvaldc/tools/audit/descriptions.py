"""Reads URDF elements, SDF and MJCF to descriptions of robots with their plug-ins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.descriptions.facts import FileDescription
from thorvaldc.compiler.extras.plugin_facts import plugin_facts, ros2_control_facts
from thorvaldc.compiler.extras.sdf_reader import sdf_models
from thorvaldc.compiler.extras.urdf_reader import read_urdf
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.sandbox.worker_process import Worker
from thorvaldc.diagnostics import Report
from thorvaldc.model import Mesh, Vec3
from thorvaldc.simulation.physics.mjcf_reader import Include, read_mjcf


def read_description(
    description: FileDescription, elements: Sequence[Element], report: Report
) -> FileDescription:
    """Adds the links, joints and statements in the child elements of ``<robot>``.

    Only what makes the description no tree of known links is reported: values that are missing or
    invalid are left out.
    """
    parts = read_urdf(elements, "", _unread_mesh, Report())
    description.add_parts(parts.links, parts.joints, parts.places, report, is_guessed=True)
    for element in elements:
        if element.tag == "ros2_control":
            description.facts += ros2_control_facts(element)
        elif element.tag == "gazebo":
            description.facts += plugin_facts(element)
    return description


def _unread_mesh(name: str, element: Element, scale: Vec3, is_visual: bool) -> Mesh:
    return Mesh(name, "")


def read_sdf(root: Element, file: str, path: Path, report: Report) -> list[FileDescription]:
    """Returns the models with joints in an ``<sdf>`` document."""
    descriptions: list[FileDescription] = []
    for model in sdf_models(root):
        name = model.name(model.model) or Path(file).name
        description = FileDescription(format="SDF", name=name, file=file, path=path)
        description.frames = model.frames
        read_description(description, model.elements(), report)
        # Links of models inside of this one are not read.
        ends = (end for j in description.joints.values() for end in (j.parent, j.child))
        inner = [end for end in ends if "::" in end]
        description.check_joints(report, [*model.named, "world", *inner])
        for joint in list(description.joints.values()):
            if joint.child not in description.links:
                del description.joints[joint.name]
        descriptions.append(description)
    return descriptions


def read_mujoco(root: Element, file: str, include: Include, worker: Worker) -> FileDescription:
    """Returns the robot of a ``<mujoco>`` document.  Raises ``UnreadableFileError``."""
    parts = read_mjcf(root, include, worker)
    name = root.attributes.get("model", Path(file).name)
    description = FileDescription(format="MJCF", name=name, file=file, path=root.file)
    description.frames = {*parts.frames}
    return read_description(description, parts.elements, Report())
