"""Adds the links and joints of xacro files (extras) to the kinematic tree of the robot."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

from thorvaldc.compiler.descriptions.description import Places
from thorvaldc.compiler.extras.urdf_reader import UrdfParts
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.hardware.hardware_reader import Hardware
from thorvaldc.compiler.hardware.robot_parts import RobotParts
from thorvaldc.compiler.modules.module_tree import Instance, References, name_prefix
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import read_pose
from thorvaldc.diagnostics import Label, Report, Span, did_you_mean
from thorvaldc.model import Joint, JointServo, Link, Mesh, Pose

Attachment = tuple[str, Pose]
"""A mounting position on the robot: name of the link, and pose in the link frame."""
# Function that returns the mounting position for the value of the key `parent` in the section
# `extras`.  The value `None` of `parent` selects the root module of the robot.  A robot without a
# module, module port or link with the name in `parent` gives `None`.
FindAttachment = Callable[[str | None], Attachment | None]


class Attachments:
    """Finds the mounting position on the robot that an entry of the section `extras` names."""

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
        # The first link after `base_link` is the first link of the root module.
        self.root_link = parts.links[1].name
        self.link_names = {link.name for link in parts.links}
        self.first_links = {
            path: f"{name_prefix(path)}_{part.links[0].name}"
            for path, part in hardware.items()
            if part.links
        }

    def find(self, reference: str | None) -> Attachment | None:
        """Returns the mounting position that the key `parent` names, or ``None``.

        Without a reference, it is the root module of the robot.  A reference in the robot document
        has the form `link`, `module` or `module.port`.  A reference to an assembly names the first
        module of the assembly that has links.
        """
        if reference is None:
            return self.root_link, Pose()
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
                return f"{name_prefix(leaf.path)}_{link}", read_pose(port, leaf.scope)
        part_and_rest = references.find(self.robot, reference, node)
        if part_and_rest is not None and not part_and_rest[1]:
            for leaf in part_and_rest[0].leaves():
                if leaf.path in self.first_links:
                    return self.first_links[leaf.path], Pose()
        return None


WORLD = "world"
"""Link of the ground in Gazebo, Drake and MuJoCo; a robot with a link of this name cannot move."""
_RESERVED_NAME = re.compile("__.*__")
_PREFIX_ARGUMENT = re.compile(r"(?i)prefix|^(name|robot_name|ns|namespace|device|camera_name)$")


@dataclass(frozen=True, slots=True)
class Placement:
    """Position on the robot at which the root links of a xacro file are mounted.

    - ``span``: source span of the entry in the robot file.
    - ``parent``: value of ``parent`` in the entry, or ``None`` for the root module of the robot.
    - ``pose``: pose of the root links relative to the mounting position of the parent.
    - ``placement_node``: first of the keys ``parent``, ``xyz`` and ``rpy`` that the entry contains.
    - ``arguments``: names of the arguments that the xacro file has.
    """

    span: Span
    parent: Node | None
    pose: Pose
    placement_node: Node | None
    arguments: Sequence[str] = ()

    @property
    def naming_hint(self) -> str:
        """Hint for a name that exists already."""
        prefix = next((name for name in self.arguments if _PREFIX_ARGUMENT.search(name)), None)
        if prefix is None:
            return "rename it; many macros have a parameter for the name or a prefix"
        return f"set the argument `{prefix}` of the xacro file: `args: {{{prefix}: ...}}`"


def has_content(link: Link) -> bool:
    """Returns ``True`` if a link has a mass or a shape; another link only names a frame."""
    return bool(link.inertial or link.visuals or link.collisions)


class ExtrasJoiner:
    """Adds the links and joints of xacro files (extras) to a robot, one file after the other.

    - ``links``: source span of each link of the robot and of the extras already added.
    - ``joints``: source span of each joint of the robot and of the extras already added.

    A xacro file can be mounted on a link of a xacro file that was added earlier.
    """

    def __init__(
        self,
        links: dict[str, Span],
        joints: dict[str, Span],
        attach: FindAttachment,
        report: Report,
    ) -> None:
        self.links = links
        self.joints = joints
        self.attach = attach
        self.report = report
        self.new_links: list[Link] = []
        self.new_joints: list[Joint] = []
        self.meshes: dict[str, Mesh] = {}
        self.extensions: list[str] = []
        self.stated_servos: list[JointServo] = []
        self.controls: list[Element] = []
        self.places: Places = {}

    def add(self, entry: Placement, parts: UrdfParts) -> None:
        """Checks the links and joints of one xacro file, and connects them to the robot.

        - ``entry``: position of the root links on the robot.
        - ``parts``: links, joints and meshes of the file.
        """
        parts, is_mounted = self.without_world(entry, parts)
        links = self.new_file_links(parts.links, entry)
        duplicates = {link.name for link in parts.links if has_content(link)} & self.links.keys()
        joint_to = self.joints_by_child(parts.joints, links, duplicates, entry)
        for mesh in parts.meshes:
            self.meshes.setdefault(mesh.name, mesh)
        self.extensions += parts.extensions
        self.stated_servos += parts.servos
        self.controls += parts.controls
        roots = [link for link in links.values() if link.name not in joint_to]
        mounts = self.mount(entry, roots) if roots or not is_mounted else []
        children: dict[str, list[Joint]] = {}
        for joint in (*mounts, *joint_to.values()):
            children.setdefault(joint.parent, []).append(joint)
        # Depth-first search along the joints of the xacro file, starting at the links of the robot.
        # The depth-first search visits each link after its parent link.
        stack = [
            joint
            for parent in reversed(children)
            if parent not in links
            for joint in reversed(children[parent])
        ]
        reached: set[str] = set()
        while stack:
            joint = stack.pop()
            reached.add(joint.child)
            self.links[joint.child] = links[joint.child].span
            self.joints[joint.name] = joint.span
            self.new_links.append(links[joint.child])
            self.new_joints.append(joint)
            stack += reversed(children.get(joint.child, []))
        unreached = [link for link in links.values() if link.name not in reached]
        # If every root link is mounted on the robot, a link that the search does not reach belongs
        # to a closed loop.
        if unreached and len(mounts) == len(roots):
            self.report_cycle(unreached[0], joint_to)
        self.places |= parts.places

    def without_world(self, entry: Placement, parts: UrdfParts) -> tuple[UrdfParts, bool]:
        """Returns the parts without an empty root link ``world``, and whether there was one.

        Many descriptions of arms begin with this link, so that they can stand alone on the ground.
        On a robot, the link stands for the mounting position: its joints begin there.
        """
        world = next((link for link in parts.links if link.name == WORLD), None)
        if world is None:
            return parts, False
        is_root = all(joint.child != WORLD for joint in parts.joints)
        if not is_root or has_content(world):
            self.report.add(
                "extra-world",
                f"`{WORLD}` is the ground in simulators; a link of this name would fix the robot",
                world.span,
                hint="rename the link; only an empty link without a parent may be named so",
            )
            return parts, False
        attachment = self.attachment(entry)
        if attachment is None:
            return replace(parts, links=(), joints=()), True
        link_name, start = attachment
        joints = tuple(
            replace(joint, parent=link_name, pose=(start * joint.pose).clean())
            if joint.parent == WORLD
            else joint
            for joint in parts.joints
        )
        links = tuple(link for link in parts.links if link.name != WORLD)
        return replace(parts, links=links, joints=joints), True

    def new_file_links(self, links: Sequence[Link], entry: Placement) -> dict[str, Link]:
        """Returns the links that a xacro file adds to the robot, by name.

        A xacro file can refer to a link of the robot by an empty URDF link of the same name.  An
        empty URDF link that refers to a link of the robot does not add a link.
        """
        new: dict[str, Link] = {}
        for link in links:
            if _RESERVED_NAME.fullmatch(link.name):
                self.report_reserved("link", link)
            first = new[link.name].span if link.name in new else self.links.get(link.name)
            if first is None:
                new[link.name] = link
            elif link.name in new or has_content(link):
                self.report.add(
                    "extra-name-duplicate",
                    f"another link has the name `{link.name}`",
                    link.span,
                    hint=entry.naming_hint,
                    labels=[Label(first, "first defined here")],
                )
        return new

    def report_reserved(self, kind: str, part: Link | Joint) -> None:
        self.report.add(
            "extra-name-reserved",
            f"no {kind} of an SDF file may have the name `{part.name}`",
            part.span,
            hint=f"rename the {kind}",
        )

    def joints_by_child(
        self,
        joints: Sequence[Joint],
        links: Mapping[str, Link],
        duplicates: Set[str],
        entry: Placement,
    ) -> dict[str, Joint]:
        """Returns the valid joints of a xacro file by the name of the child link.

        - ``links``: links that the xacro file defines, by name.
        - ``duplicates``: names of links that the xacro file and the robot define.
        """
        joint_to: dict[str, Joint] = {}
        names: dict[str, Span] = {}
        for joint in joints:
            if joint.name == WORLD or _RESERVED_NAME.fullmatch(joint.name):
                self.report_reserved("joint", joint)
            first = names.get(joint.name) or self.joints.get(joint.name)
            names.setdefault(joint.name, joint.span)
            if first is not None:
                self.report.add(
                    "extra-name-duplicate",
                    f"another joint has the name `{joint.name}`",
                    joint.span,
                    hint=entry.naming_hint,
                    labels=[Label(first, "first defined here")],
                )
                continue
            ends_exist = True
            for end, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in links and name not in self.links:
                    ends_exist = False
                    self.report.add(
                        "extra-link-unknown",
                        f"joint `{joint.name}` names the {end} link `{name}`, which does not exist",
                        joint.span,
                        hint=did_you_mean(name, [*links, *self.links], fixable=False)
                        or "links of the robot have names such as frame_body: <module>_<link>",
                    )
            if not ends_exist:
                continue
            if joint.child in duplicates:
                continue  # the name of the link has been reported
            first_parent = joint_to[joint.child].span if joint.child in joint_to else None
            if joint.child not in links:
                first_parent = self.links[joint.child]
            if first_parent is not None:
                self.report.add(
                    "extra-two-parents",
                    f"joint `{joint.name}` gives link `{joint.child}` a second parent",
                    joint.span,
                    hint="a robot is a tree: one joint connects a link to its parent",
                    labels=[Label(first_parent, "the first parent is defined here")],
                )
                continue
            joint_to[joint.child] = joint
        return joint_to

    def attachment(self, entry: Placement) -> Attachment | None:
        """Returns the link and the pose on it where the root links of a xacro file are mounted.

        Returns ``None``, and reports an error, if the robot has no such position.
        """
        text = str(entry.parent.value) if entry.parent is not None else None
        attachment = self.attach(text)
        if attachment is None and text is not None and text in self.links:
            attachment = text, Pose()
        if attachment is None:
            self.report.add(
                "extra-parent",
                f"the robot has no module, port or link `{text}`",
                entry.parent.span if entry.parent is not None else entry.span,
                hint=did_you_mean(text or "", list(self.links)),
            )
            return None
        return attachment[0], attachment[1] * entry.pose

    def mount(self, entry: Placement, roots: Sequence[Link]) -> list[Joint]:
        """Returns the fixed joints that mount the root links of a xacro file on the robot.

        - ``entry``: mounting position that the robot file requests.
        - ``roots``: links of the file without a parent joint.
        """
        if not roots:
            if entry.placement_node is not None:
                self.report.add(
                    "extra-placement-unused",
                    "the joints of the xacro file connect all its links to the robot: "
                    "parent, xyz and rpy have no effect",
                    entry.placement_node.where,
                    hint="remove them, or pass them as args if the file has such arguments",
                )
            return []
        attachment = self.attachment(entry)
        if attachment is None:
            return []
        parent, pose = attachment[0], attachment[1].clean()
        mounts: list[Joint] = []
        for link in roots:
            name = f"{link.name}_mount"
            if name in self.joints:
                self.report.add(
                    "extra-name-duplicate",
                    f"another joint has the name `{name}`, which the mount of this link needs",
                    link.span,
                    labels=[Label(self.joints[name], "first defined here")],
                )
                continue
            mounts.append(Joint(name, link.module, "fixed", parent, link.name, pose, entry.span))
        return mounts

    def report_cycle(self, link: Link, joint_to: Mapping[str, Joint]) -> None:
        """Reports a closed loop of parent and child links in a xacro file.

        The path from ``link`` along the parent links ends in the closed loop.
        """
        path = [link.name]
        while path[-1] not in path[:-1]:
            path.append(joint_to[path[-1]].parent)
        path = path[path.index(path[-1]) :]
        self.report.add(
            "extra-cycle",
            f"the joints of the links {' -> '.join(reversed(path))} form a cycle",
            joint_to[path[0]].span,
            hint="remove one of these joints, or connect it to another link",
        )

    def check_mimics(self) -> None:
        """Checks that the leader joint of each mimic joint exists.

        Call this method after adding the last xacro file, because a later file can define the
        leader joint.
        """
        for joint in self.new_joints:
            if joint.mimic is not None and joint.mimic.joint not in self.joints:
                self.report.add(
                    "extra-link-unknown",
                    f"joint `{joint.name}` mimics `{joint.mimic.joint}`, which does not exist",
                    joint.span,
                    hint=did_you_mean(joint.mimic.joint, list(self.joints), fixable=False),
                )
