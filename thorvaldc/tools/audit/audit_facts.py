"""What the readers of the audit learn about a robot: values with the place where they stand.

All values are in SI units.  The readers of URDF, SDF and MJCF return the same ``Description``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.extras.xacro_rules import find_in_sources
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.model import Pose, Vec3


class UnreadableFileError(Exception):
    """Raised if a file cannot be read; ``span`` is the place of the error, if it is known."""

    def __init__(self, reason: str, span: Span | None = None) -> None:
        super().__init__(reason)
        self.span = span


class Fact(NamedTuple):
    """A statement of one file about the robot.

    - ``kind``: what is stated, such as ``wheel radius``.
    - ``subject``: who states it, as in messages, such as ``controller `diff_drive```.
    - ``value``: number, text, flag or a tuple of these.
    - ``span``: place of the value.
    - ``unit``: unit of a number, such as ``m``.
    - ``names``: names of the joints or links that the statement is about.
    """

    kind: str
    subject: str
    value: Any
    span: Span
    unit: str = ""
    names: tuple[str, ...] = ()


class SolidShape(NamedTuple):
    """A shape of a body.

    - ``kind``: box, cylinder, sphere, capsule, ellipsoid, mesh or plane.
    - ``size``: edge lengths of a box; radius and length of a cylinder or capsule; radius of a
      sphere; half axes of an ellipsoid; scale factors of a mesh.  In m.
    - ``pose``: pose of the centre of the shape in the frame of the body.
    - ``collides``: whether it is a collision shape; other shapes are for the eye.
    - ``mesh``: name of the mesh file as written.
    """

    kind: str
    size: tuple[float, ...]
    pose: Pose
    collides: bool
    span: Span
    mesh: str = ""


@dataclass(slots=True)
class Body:
    """A link of a description.

    - ``mass``: mass in kg, or ``None`` if the file does not state it.
    - ``inertia``: ixx, iyy, izz, ixy, ixz, iyz in kg m^2, or ``None``.
    """

    name: str
    span: Span
    mass: float | None = None
    mass_span: Span | None = None
    inertia: tuple[float, ...] | None = None
    inertia_span: Span | None = None
    shapes: list[SolidShape] = field(default_factory=list)


@dataclass(slots=True)
class BodyJoint:
    """A joint of a description; ``pose`` is the pose of the child in the frame of the parent.

    - ``axis``: axis in the frame of the child; ``anchor``: a point on it.
    - ``limits``: facts ``lower``, ``upper``, ``velocity`` and ``effort`` by name.
    """

    name: str
    kind: str
    parent: str
    child: str
    span: Span
    pose: Pose = field(default_factory=Pose)
    axis: Vec3 = (1.0, 0.0, 0.0)
    anchor: Vec3 = (0.0, 0.0, 0.0)
    limits: dict[str, Fact] = field(default_factory=dict)

    @property
    def turns(self) -> bool:
        return self.kind in ("revolute", "continuous", "hinge")


@dataclass(slots=True)
class Description:
    """A robot in URDF, SDF or MJCF.

    - ``format``: URDF, SDF or MJCF.
    - ``file``: name of the file in messages; ``path``: its absolute path.
    - ``frames``: names of frames that are no links, such as MJCF sites.
    - ``facts``: statements of plug-ins and of ``<ros2_control>`` in the file.
    """

    format: str
    name: str
    file: str
    path: Path
    bodies: dict[str, Body] = field(default_factory=dict)
    joints: dict[str, BodyJoint] = field(default_factory=dict)
    frames: set[str] = field(default_factory=set)
    facts: list[Fact] = field(default_factory=list)

    def root_poses(self) -> dict[str, Pose]:
        """Returns the pose of each body in the frame of its root, with all joints at zero."""
        children: dict[str, list[BodyJoint]] = {}
        inner = set()
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
            inner.add(joint.child)
        poses = {name: Pose() for name in self.bodies if name not in inner}
        open_bodies = list(poses)
        while open_bodies:
            parent = open_bodies.pop()
            for joint in children.get(parent, ()):
                if joint.child not in poses:
                    poses[joint.child] = poses[parent] * joint.pose
                    open_bodies.append(joint.child)
        return poses

    def rigid_part(self, body: str) -> Iterator[tuple[Body, Pose]]:
        """Yields a body and the bodies that fixed joints attach to it, with their poses in it."""
        poses = {body: Pose()}
        open_bodies = [body]
        while open_bodies:
            name = open_bodies.pop()
            if name in self.bodies:
                yield self.bodies[name], poses[name]
            for joint in self.joints.values():
                if joint.parent == name and joint.kind == "fixed" and joint.child not in poses:
                    poses[joint.child] = poses[name] * joint.pose
                    open_bodies.append(joint.child)


@dataclass(frozen=True, slots=True)
class ParameterSection:
    """The parameters of one node in a ROS parameter file.

    - ``node``: name of the node, with its name space.
    - ``values``: YAML values by the name of the parameter, such as ``linear.x.max_velocity``.
    """

    node: str
    file: str
    path: Path
    span: Span
    values: Mapping[str, Node]

    @property
    def short_name(self) -> str:
        return self.node.rsplit("/", 1)[-1]

    def number(self, name: str) -> float | None:
        node = self.values.get(name)
        if node is None or isinstance(node.value, bool):
            return None
        return float(node.value) if isinstance(node.value, int | float) else None

    def flag(self, name: str) -> bool | None:
        node = self.values.get(name)
        return node.value if node is not None and isinstance(node.value, bool) else None

    def text(self, name: str) -> str | None:
        node = self.values.get(name)
        return node.value if node is not None and isinstance(node.value, str) else None

    def items(self, name: str) -> tuple[Node, ...]:
        """Returns the values in a list; a value that is no list is a list of one value."""
        node = self.values.get(name)
        if node is None:
            return ()
        return node.value if isinstance(node.value, tuple) else (node,)


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A node that a launch file starts.

    - ``name``: name of the node, or empty text if the launch file does not state a plain text.
    - ``parameters``: parameters in the launch file itself, by name; an unknown value is ``None``.
    - ``parameter_files``: plain names of parameter files, such as ``config/nav2.yaml``.
    - ``remappings``: pairs of names.
    - ``conditional``: whether the node is started only under a condition.
    """

    package: str
    executable: str
    name: str
    namespace: str
    span: Span
    parameters: Mapping[str, Fact]
    parameter_files: tuple[Fact, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    arguments: tuple[str, ...] = ()
    conditional: bool = False


@dataclass(slots=True)
class LaunchFile:
    """A launch file: the nodes that it starts and the launch files that it includes."""

    file: str
    path: Path
    nodes: list[LaunchedNode] = field(default_factory=list)
    includes: list[Fact] = field(default_factory=list)


@dataclass(slots=True)
class Evidence:
    """All that the audit has read.

    - ``facts``: statements of the parameter files, made from ``sections``.
    - ``incomplete``, ``unread_launches``: names of the descriptions and launch files that could
      not be read.
    - ``packages``: folder of each ROS package, by its name.
    """

    descriptions: list[Description] = field(default_factory=list)
    sections: list[ParameterSection] = field(default_factory=list)
    launches: list[LaunchFile] = field(default_factory=list)
    facts: list[Fact] = field(default_factory=list)
    packages: dict[str, Path] = field(default_factory=dict)
    incomplete: list[str] = field(default_factory=list)
    unread_launches: list[str] = field(default_factory=list)

    def stated(self, *kinds: str) -> list[Fact]:
        """Returns the statements of parameter files and launch files of some kinds."""
        return [fact for fact in self.facts if fact.kind in kinds]

    def described(self, *kinds: str) -> list[tuple[Description, Fact]]:
        """Returns the statements in descriptions of some kinds, with their descriptions."""
        return [(d, fact) for d in self.descriptions for fact in d.facts if fact.kind in kinds]

    def file_in_package(self, name: str) -> Path | None:
        """Returns the path of ``package/path``, or ``None`` if the package is not audited."""
        package, _, rest = name.partition("/")
        folder = self.packages.get(package)
        if folder is None or not rest or "\0" in rest:
            return None
        return Path(find_in_sources(str(folder), rest) or folder / rest)

    def related(self, file: str, names: tuple[str, ...] = ()) -> list[Description]:
        """Returns the descriptions to which a file belongs, most probably.

        These are the descriptions with most of the joints or links ``names``; of several, those
        whose paths have most words in common with the path of the file.  A repository can contain
        several robots: `config/burger.yaml` belongs to `urdf/burger.urdf`.
        """
        candidates = self.descriptions
        if names:
            counts = [
                sum(1 for n in names if n in d.joints or n in d.bodies) for d in self.descriptions
            ]
            most = max(counts, default=0)
            if most == 0:
                return []
            candidates = [
                d for d, count in zip(self.descriptions, counts, strict=True) if count == most
            ]
        words = path_words(file)
        affinities = [len(words & path_words(d.file)) for d in candidates]
        best = max(affinities, default=0)
        if any(len(words & path_words(unread)) > best for unread in self.incomplete):
            return []  # it probably belongs to a description that cannot be read
        return [d for d, value in zip(candidates, affinities, strict=True) if value == best]


def is_nearer(file: str, unread: str, other: str) -> bool:
    """Whether a file belongs to ``unread`` at least as probably as to ``other``, by its path."""
    words = path_words(file)
    return len(words & path_words(unread)) >= len(words & path_words(other))


_GENERAL_WORDS = frozenset(
    [
        *("config", "params", "param", "parameters", "urdf", "xacro", "yaml", "yml", "sdf", "mjcf"),
        *("description", "control", "controllers", "launch", "py", "xml", "robot", "robots"),
        *("model", "src"),
    ]
)


def path_words(file: str) -> set[str]:
    """Returns the words of a path that can name a robot."""
    return set(re.findall(r"[a-z0-9]+", file.lower())) - _GENERAL_WORDS


_DISTRIBUTIONS = frozenset(
    ["foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
)


def closest(facts: Sequence[Fact], file: str) -> list[Fact]:
    """Returns the statements whose files have most words in common with the path of a file.

    Files for another distribution of ROS, as in `param/humble/nav2.yaml`, are alternatives.
    """
    words = path_words(file)
    distributions = words & _DISTRIBUTIONS
    candidates = [
        (len(words & path_words(fact.span.file)), fact)
        for fact in facts
        if path_words(fact.span.file) & _DISTRIBUTIONS == distributions
    ]
    best = max((affinity for affinity, _ in candidates), default=0)
    return [fact for affinity, fact in candidates if affinity == best]
