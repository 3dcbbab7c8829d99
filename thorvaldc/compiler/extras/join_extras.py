"""The links and joints of extras, checked against the robot's and hung on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from thorvaldc.compiler.extras.urdf_reader import UrdfParts
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Joint, Link, Mesh, Pose


@dataclass(frozen=True, slots=True)
class Attachment:
    """Where something is mounted: ``pose`` on the link named ``link``."""

    link: str
    pose: Pose


# The text of an entry's `parent` (None: not given, so the robot's root module)
# to the place it means; None where there is no such place.
Attach = Callable[[str | None], Attachment | None]


@dataclass(frozen=True, slots=True)
class Placing:
    """Where an entry puts its file's roots.

    ``span`` is the entry's, ``pose`` its xyz and rpy, ``placed`` the first of
    parent, xyz and rpy that is given.
    """

    span: Span
    parent: Node | None
    pose: Pose
    placed: Node | None


class Joined:
    """The robot's names and what the extras have added so far."""

    def __init__(
        self, links: dict[str, Span], joints: dict[str, Span], attach: Attach, report: Report
    ) -> None:
        self.links = links
        self.joints = joints
        self.attach = attach
        self.report = report
        self.new_links: list[Link] = []
        self.new_joints: list[Joint] = []
        self.meshes: dict[str, Mesh] = {}
        self.extensions: list[str] = []

    def add(self, entry: Placing, parts: UrdfParts) -> None:
        """Check the parts of one file against the robot and hang them on it."""
        own = self.own_links(parts.links)
        parent_of = self.own_joints(parts.joints, own)
        for mesh in parts.meshes:
            self.meshes.setdefault(mesh.name, mesh)
        self.extensions += parts.extensions
        roots = [link for link in own.values() if link.name not in parent_of]
        mounts = self.mount(entry, roots)
        children: dict[str, list[Joint]] = {}
        for joint in (*mounts, *parent_of.values()):
            children.setdefault(joint.parent, []).append(joint)
        # Depth first, in file order, from the links of the robot.
        waiting = [
            j for name in reversed(children) if name not in own for j in reversed(children[name])
        ]
        reached: dict[str, None] = {}
        while waiting:
            joint = waiting.pop()
            reached[joint.child] = None
            self.links[joint.child] = own[joint.child].span
            self.joints[joint.name] = joint.span
            self.new_links.append(own[joint.child])
            self.new_joints.append(joint)
            waiting += reversed(children.get(joint.child, []))
        lost = [link for link in own.values() if link.name not in reached]
        if lost and len(mounts) == len(roots):
            self.report_cycle(lost[0], parent_of)
        self.check_masses(own, children)

    def own_links(self, links: Sequence[Link]) -> dict[str, Link]:
        """The file's links by name, without those that stand for one of the robot's."""
        own: dict[str, Link] = {}
        for link in links:
            first = own[link.name].span if link.name in own else self.links.get(link.name)
            if first is None:
                own[link.name] = link
            elif link.name in own or link.inertial or link.visuals or link.collisions:
                self.report.add(
                    "extra-name-duplicate",
                    f"there is already a link `{link.name}`",
                    link.span,
                    hint="rename it; many macros have a parameter for the name or a prefix",
                    labels=[Label(first, "first defined here")],
                )
        return own

    def own_joints(self, joints: Sequence[Joint], own: Mapping[str, Link]) -> dict[str, Joint]:
        """The file's joints by their child."""
        parent_of: dict[str, Joint] = {}
        names: dict[str, Span] = {}
        for joint in joints:
            first = names.get(joint.name) or self.joints.get(joint.name)
            names.setdefault(joint.name, joint.span)
            if first is not None:
                self.report.add(
                    "extra-name-duplicate",
                    f"there is already a joint `{joint.name}`",
                    joint.span,
                    hint="rename it; many macros have a parameter for the name or a prefix",
                    labels=[Label(first, "first defined here")],
                )
                continue
            known = True
            for end, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in own and name not in self.links:
                    known = False
                    self.report.add(
                        "extra-link-unknown",
                        f"joint `{joint.name}` names the {end} link `{name}`, which does not exist",
                        joint.span,
                        hint=did_you_mean(name, [*own, *self.links])
                        or "the robot's links are named <module>_<link>, as frame_body",
                    )
            if not known:
                continue
            other = parent_of[joint.child].span if joint.child in parent_of else None
            if joint.child not in own:
                other = self.links[joint.child]
            if other is not None:
                self.report.add(
                    "extra-two-parents",
                    f"joint `{joint.name}` gives link `{joint.child}` a second parent",
                    joint.span,
                    hint="a link hangs on one joint; a robot is a tree",
                    labels=[Label(other, "its first is here")],
                )
                continue
            parent_of[joint.child] = joint
        return parent_of

    def mount(self, entry: Placing, roots: Sequence[Link]) -> list[Joint]:
        """Fixed joints that hang the file's roots where the entry says."""
        if not roots:
            if entry.placed is not None:
                self.report.add(
                    "extra-placement-unused",
                    "the xacro file hangs its links on the robot itself: "
                    "parent, xyz and rpy have no effect",
                    entry.placed.where,
                    hint="take them out, or hand them over as args where the file asks for them",
                )
            return []
        text = str(entry.parent.value) if entry.parent is not None else None
        place = self.attach(text)
        if place is None and text is not None and text in self.links:
            place = Attachment(text, Pose())
        if place is None:
            self.report.add(
                "extra-parent",
                f"`{text}` is no module, port or link of the robot",
                entry.parent.span if entry.parent is not None else entry.span,
                hint=did_you_mean(text or "", list(self.links)),
            )
            return []
        mounts: list[Joint] = []
        for link in roots:
            name = f"{link.name}_mount"
            if name in self.joints:
                self.report.add(
                    "extra-name-duplicate",
                    f"there is already a joint `{name}`, the name of this link's mount",
                    link.span,
                    labels=[Label(self.joints[name], "first defined here")],
                )
                continue
            pose = (place.pose * entry.pose).clean()
            mounts.append(
                Joint(name, link.module, "fixed", place.link, link.name, pose, entry.span)
            )
        return mounts

    def report_cycle(self, link: Link, parent_of: Mapping[str, Joint]) -> None:
        path = [link.name]
        while path[-1] not in path[:-1]:
            path.append(parent_of[path[-1]].parent)
        path = path[path.index(path[-1]) :]
        self.report.add(
            "extra-cycle",
            f"the links {' -> '.join(reversed(path))} hang on one another",
            parent_of[path[0]].span,
            hint="one of these joints must go, or hang on another link",
        )

    def check_masses(self, own: Mapping[str, Link], children: Mapping[str, list[Joint]]) -> None:
        """A link that moves needs a mass, its own or that of what is fixed to it."""

        def mass(name: str, seen: tuple[str, ...]) -> float:
            inertial = own[name].inertial
            total = inertial.mass if inertial is not None else 0.0
            for joint in children.get(name, []):
                if joint.type == "fixed" and joint.child not in seen:
                    total += mass(joint.child, (*seen, joint.child))
            return total

        for joints in children.values():
            for joint in joints:
                if joint.type != "fixed" and mass(joint.child, (joint.child,)) <= 0.0:
                    self.report.add(
                        "extra-massless",
                        f"link `{joint.child}` moves on joint `{joint.name}` and has no mass",
                        own[joint.child].span,
                        hint="give it an <inertial>, or make the joint fixed",
                        labels=[Label(joint.span, "the joint")],
                    )

    def check_mimics(self) -> None:
        for joint in self.new_joints:
            if joint.mimic is not None and joint.mimic.joint not in self.joints:
                self.report.add(
                    "extra-link-unknown",
                    f"joint `{joint.name}` mimics `{joint.mimic.joint}`, which does not exist",
                    joint.span,
                    hint=did_you_mean(joint.mimic.joint, list(self.joints)),
                )
