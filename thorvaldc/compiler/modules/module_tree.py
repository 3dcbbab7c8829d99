"""Defines the module instance, which is one use of a module type in a robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Span
from thorvaldc.model import Pose


@dataclass(eq=False)
class Instance:
    """A module instance, or the root of the tree of module instances.

    The root of the tree of module instances represents the whole robot.

    Attributes
    ----------
    path : dotted path of the module, such as ``fl.steering``.  The path of the root is empty.
    type : the module type, or ``None`` for the root.
    scope : values of the module's parameters.
    entry : entry of the robot or assembly document that defines this instance.
    span : span of the entry in the robot file that this instance belongs to.
    parent : the assembly that contains this instance, or ``None`` for the root.
    can : `can` section of this instance or of the assembly that contains the instance.
    children : module instances that an assembly or the robot consists of, by name.
    left_out : names of children whose type is `none` or whose condition `when` is false.
    failed : names of children that could not be created because of reported errors.
    mount : link and pose that this instance is mounted on.
    """

    path: str
    type: ModuleType | None
    scope: Scope
    entry: Node
    span: Span
    parent: Instance | None
    can: Node | None = None
    children: dict[str, Instance] = field(default_factory=dict)
    left_out: set[str] = field(default_factory=set)
    failed: set[str] = field(default_factory=set)
    mount: Mount | None = None

    @property
    def is_leaf(self) -> bool:
        """True if the module instance is neither an assembly nor the whole robot."""
        return self.type is not None and not self.type.is_assembly

    @property
    def is_mechanical(self) -> bool:
        """True if the module instance has links.

        A module type with an optional mount has links only if the module is mounted.
        """
        if self.type is not None and self.is_leaf:
            mount = self.type.document.get("mount")
            is_optional = mount is not None and mount.get("optional") is not None
            if is_optional and self.entry.get("mount") is None:
                return False
            return bool(self.type.section("links"))
        return any(child.is_mechanical for child in self.children.values())

    @property
    def is_complete(self) -> bool:
        """True if all modules inside an assembly or robot could be created."""
        return not self.failed and all(child.is_complete for child in self.children.values())

    @property
    def wiring(self) -> dict[str, Node]:
        """References to the motors of a motor controller, by channel.

        A list in the key `channels` has the motors in the order of the channels of the module type.
        List elements without a channel have their number as a name, for example ``3``.
        """
        channels = self.entry.get("channels")
        if channels is None or not isinstance(channels.value, tuple):
            return entries(channels)
        names = list(self.type.section("channels")) if self.type is not None else []
        return {
            names[i] if i < len(names) else str(i + 1): node
            for i, node in enumerate(channels.value)
        }

    def leaves(self) -> Iterator[Instance]:
        """Yields all modules inside an assembly or robot that are not assemblies, in the order of
        the file.
        """
        if self.is_leaf:
            yield self
        for child in self.children.values():
            yield from child.leaves()


class Mount(NamedTuple):
    """The link and the pose where a module is mounted.

    Attributes
    ----------
    leaf : the leaf module that carries the mounted module.
    link : name of the carrying link in the leaf module.  Empty for the first link.
    pose : pose of the mount in the frame of the carrying link.
    span : span of the `mount` entry.
    """

    leaf: Instance
    link: str
    pose: Pose
    span: Span

    @property
    def place(self) -> tuple[int, str, Pose]:
        """The carrying module, its link and the pose, which two modules cannot share."""
        return id(self.leaf), self.link, self.pose.clean()


def used_by(path: str, span: Span) -> Label:
    """Returns a diagnostic label that names the module of the robot.

    The label is added to each diagnostic about the module document that the module uses.
    """
    return Label(span, f"`{path.split('.', 1)[0]}` uses it")


def last_name(path: str) -> str:
    """Returns the last name of a dotted path, such as ``steering`` of ``fl.steering``."""
    return path.rsplit(".", 1)[-1]


def name_prefix(path: str) -> str:
    """Returns the prefix of the names of a module's links and joints."""
    return path.replace(".", "_")
