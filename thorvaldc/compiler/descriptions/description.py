"""A description of a robot: its links and joints, with the places of their values.

Compiled robots, extras, and URDF, SDF and MJCF files of others become the same description.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Joint, Link, Pose, Shape


class Place(NamedTuple):
    """The place of a value in a file; ``labels`` show the macro calls that made it."""

    span: Span
    labels: tuple[Label, ...] = ()


Places = dict[tuple[str, str], Place]
"""Places by the name of the link or joint, and the name of the value.

The values of a link are ``mass``, ``inertia``, ``visual 0``, ``visual 1`` ... and ``collision 0``
..., those of a joint ``lower``, ``upper``, ``velocity`` and ``effort``.
"""
Origin = Literal["robot", "extra", "file"]


class PlacedShape(NamedTuple):
    """A shape with its pose in the frame of a link; ``collides`` is false for visual shapes."""

    shape: Shape
    pose: Pose
    collides: bool
    span: Span


@dataclass
class Description:
    """The links and joints of a robot, by name; they do not change after the first question.

    - ``origin``: whether they belong to a compiled robot, to an extra, or to a file of others.  A
      file of others has rounded numbers, and a link without an inertial can have a mass there.
    - ``places``: places of values; a value without a place is at that of its link or joint.
    """

    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    places: Places = field(default_factory=dict)
    origin: Origin = "file"

    @classmethod
    def of(
        cls, links: Sequence[Link], joints: Sequence[Joint], origin: Origin, places: Places
    ) -> Description:
        """Returns the description of links and joints with unique names."""
        by_name = {link.name: link for link in links}
        return cls(by_name, {joint.name: joint for joint in joints}, places, origin)

    def place(self, part: Link | Joint, value: str) -> Place:
        return self.places.get((part.name, value)) or Place(part.span)

    def report(
        self,
        report: Report,
        code: str,
        message: str,
        part: Link | Joint,
        value: str,
        hint: str,
        labels: Sequence[Label] = (),
    ) -> None:
        """Reports a value of a link or joint at its place."""
        place = self.place(part, value)
        report.add(code, message, place.span, hint=hint, labels=[*labels, *place.labels])

    def shapes(self, link: Link) -> Iterator[PlacedShape]:
        """Yields the shapes of a link, first those for collisions."""
        for index, solid in enumerate(link.collisions):
            span = self.place(link, f"collision {index}").span
            yield PlacedShape(solid.shape, solid.pose, True, span)
        for index, visual in enumerate(link.visuals):
            span = self.place(link, f"visual {index}").span
            yield PlacedShape(visual.shape, visual.pose, False, span)

    @cached_property
    def joints_below(self) -> dict[str, list[Joint]]:
        """The joints below each link, by the name of the link."""
        joints: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            joints.setdefault(joint.parent, []).append(joint)
        return joints

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """The pose of each link in the frame of its root, with all joints at 0."""
        inner = {joint.child for joint in self.joints.values() if joint.parent in self.links}
        poses: dict[str, Pose] = {}
        for name in self.links:
            if name not in inner:
                poses |= self._poses_below(name, fixed=False)
        return poses

    def rigid_part(self, link: str) -> dict[str, Pose]:
        """Returns the poses in a link of itself and of all links that fixed joints attach to it."""
        return {n: p for n, p in self._poses_below(link, fixed=True).items() if n in self.links}

    def _poses_below(self, link: str, *, fixed: bool) -> dict[str, Pose]:
        poses = {link: Pose()}
        open_links = [link]
        while open_links:
            name = open_links.pop()
            for joint in self.joints_below.get(name, ()):
                if joint.child not in poses and (joint.type == "fixed" or not fixed):
                    poses[joint.child] = poses[name] * joint.pose
                    open_links.append(joint.child)
        return poses
