"""Elements that several parts of an SDF file contain."""

from __future__ import annotations

from thorvaldc.backends.xml_writer import Element, number, numbers
from thorvaldc.model import Box, Cylinder, MeshShape, Pose, Shape
from thorvaldc.model.spatial import clean3


def add_system(parent: Element, library: str, name: str) -> Element:
    return parent.add(
        "plugin", filename=f"gz-sim-{library}-system", name=f"gz::sim::systems::{name}"
    )


def add_pose(parent: Element, pose: Pose, relative_to: str | None = None) -> None:
    values = (*clean3(pose.xyz), *clean3(pose.rpy()))
    if any(values) or relative_to is not None:
        parent.add("pose", relative_to=relative_to).text = numbers(values)


def add_geometry(parent: Element, shape: Shape, meshes: str) -> None:
    geometry = parent.add("geometry")
    match shape:
        case Box(size):
            geometry.add("box").add("size").text = numbers(size)
        case Cylinder(radius, length):
            cylinder = geometry.add("cylinder")
            cylinder.add("radius").text = number(radius)
            cylinder.add("length").text = number(length)
        case MeshShape(mesh, scale):
            element = geometry.add("mesh")
            element.add("uri").text = f"{meshes}/{mesh}"
            if scale != (1.0, 1.0, 1.0):
                element.add("scale").text = numbers(scale)
        case _:
            geometry.add("sphere").add("radius").text = number(shape.radius)
