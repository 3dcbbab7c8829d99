"""A module instance: one use of a module type in a robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.compiler.library import ModuleType
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Span
from thorvaldc.model.spatial import Pose


@dataclass(eq=False)
class Instance:
    """One use of a module type, or the robot itself.

    Attributes
    ----------
    path : dotted path, such as ``fl.steering``; the robot's is empty.
    type : the module type; ``None`` for the robot.
    scope : values of the module's parameters.
    entry : the entry of the document that contains this part.
    span : the entry of the robot file that this part belongs to.
    can : the part's `can` section, its own or that of its assembly.
    left_out : names of parts whose type is `none` or whose `when` is false.
    failed : names of parts that could not be created; the report contains the errors.
    mount : the link and pose that the part is mounted on.
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
        return self.type is not None and not self.type.is_assembly

    @property
    def is_mechanical(self) -> bool:
        """Whether the part has links.

        A module whose mount is optional has links only if it is mounted.
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
        """Whether all parts could be created."""
        return not self.failed and all(child.is_complete for child in self.children.values())

    def leaves(self) -> Iterator[Instance]:
        """Yields the leaves in model order: file order, depth first."""
        if self.is_leaf:
            yield self
        for child in self.children.values():
            yield from child.leaves()


class Mount(NamedTuple):
    """The leaf and link that carry a part, and the pose of the mount in that link.

    An empty ``link`` is the first link of the leaf.
    """

    leaf: Instance
    link: str
    pose: Pose
    span: Span


def used_by(path: str, span: Span) -> Label:
    """Returns a label for diagnostics in a module document: the robot's module that uses it."""
    return Label(span, f"`{path.split('.', 1)[0]}` uses it")


def last_name(path: str) -> str:
    return path.rsplit(".", 1)[-1]


def name_prefix(path: str) -> str:
    """Returns the prefix of the names of a module's links and joints."""
    return path.replace(".", "_")
