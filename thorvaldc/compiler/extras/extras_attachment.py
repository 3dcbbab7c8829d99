"""Attaches the links and joints of extras to the modules of a robot.

An extra is a URDF or xacro file that the robot document names.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from thorvaldc.compiler.hardware.hardware_reader import Hardware
from thorvaldc.compiler.hardware.robot_parts import RobotParts
from thorvaldc.compiler.modules.module_tree import Instance, References, name_prefix
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose


def add_extras(
    document: Node,
    robot: Instance,
    hardware: Mapping[str, Hardware],
    parts: RobotParts,
    base_dir: Path,
    files: dict[str, Path],
    report: Report,
    trust: bool,
) -> tuple[str, ...]:
    """Adds the links, joints and meshes of the extras to the parts of the robot.

    Returns the other URDF elements of the extras as text.

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
    extras = document.get("extras")
    if extras is None or not isinstance(extras.value, tuple):
        return ()
    from thorvaldc.compiler.extras.load_extras import Attachment, load_extras  # loads xacro

    finder = _AttachmentFinder(document, robot, hardware, parts)

    def attach(reference: str | None) -> Attachment | None:
        if reference is None:
            # The first link after `base_link` is the first link of the root module.
            return Attachment(parts.links[1].name, Pose())
        link_and_pose = finder.find(reference)
        return Attachment(*link_and_pose) if link_and_pose is not None else None

    extra_parts = load_extras(
        items(extras),
        base_dir,
        links={link.name: link.span for link in parts.links},
        joints={joint.name: joint.span for joint in parts.joints},
        attach=attach,
        report=report,
        trust=trust,
    )
    files.update(extra_parts.files)
    parts.links.extend(extra_parts.links)
    parts.joints.extend(extra_parts.joints)
    parts.joint_servos.extend(extra_parts.servos)
    for mesh in extra_parts.meshes:
        parts.meshes[mesh.name] = mesh
    return extra_parts.urdf_extensions


class _AttachmentFinder:
    """Finds the link to which an extra is attached, and the pose of the extra in the link frame."""

    def __init__(
        self,
        document: Node,
        robot: Instance,
        hardware: Mapping[str, Hardware],
        parts: RobotParts,
    ) -> None:
        self.document = document
        self.robot = robot
        self.hardware = hardware
        self.link_names = {link.name for link in parts.links}
        self.first_links = {
            path: f"{name_prefix(path)}_{part.links[0].name}"
            for path, part in hardware.items()
            if part.links
        }

    def find(self, reference: str) -> tuple[str, Pose] | None:
        """Returns the name of the link, and the pose in the link frame, that a reference names.

        A reference in the robot document has the form `link`, `module` or `module.port`.  A
        reference to an assembly names the first module of the assembly that has links.
        """
        if reference in self.link_names:
            return reference, Pose()
        if reference in self.first_links:
            return self.first_links[reference], Pose()
        # References to unknown links or modules are reported when the extras are read.
        references = References(Report())
        node = Node(reference, self.document.span)
        leaf_and_port = references.find_port(self.robot, reference, node)
        if leaf_and_port is not None:
            leaf, port_name = leaf_and_port
            if leaf.type is not None and leaf.path in self.first_links:
                port = leaf.type.section("ports")[port_name]
                link = leaf.scope.text(port.get("link")) or self.hardware[leaf.path].links[0].name
                return f"{name_prefix(leaf.path)}_{link}", leaf.scope.pose(port)
        part_and_rest = references.find(self.robot, reference, node)
        if part_and_rest is not None and not part_and_rest[1]:
            for leaf in part_and_rest[0].leaves():
                if leaf.path in self.first_links:
                    return self.first_links[leaf.path], Pose()
        return None
