"""The tree of module instances of a robot, and dotted references into it such as ``fl.steering``.

A module instance is one use of a module type in a robot.  References name modules, ports and
motors.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.modules.written_keys import written_keys
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Proposal, Report, Span
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
    span : span of the port or of the carrying module in the `mount` entry.
    is_free : whether the mount is a pose on the carrying module, and no port.
    """

    leaf: Instance
    link: str
    pose: Pose
    span: Span
    is_free: bool = False

    @property
    def place(self) -> tuple[int, str, Pose]:
        """The carrying module, its link and the pose, which two modules cannot share."""
        return id(self.leaf), self.link, self.pose.clean()


def used_by(report: Report, path: str, span: Span, scope: Scope) -> AbstractContextManager[None]:
    """Adds labels to the diagnostics of a ``with`` block about the document of a module.

    The labels name the module of the robot, and the keys from which a wrong value follows.
    """
    user = Label(span, f"`{path.split('.', 1)[0]}` uses it")
    return report.used_by(user, partial(written_keys, scope))


def last_name(path: str) -> str:
    """Returns the last name of a dotted path, such as ``steering`` of ``fl.steering``."""
    return path.rsplit(".", 1)[-1]


def name_prefix(path: str) -> str:
    """Returns the prefix of the names of a module's links and joints."""
    return path.replace(".", "_")


# -- references --------------------------------------------------------------------------


def _port_hint(inside: Instance, reference: str) -> Proposal | None:
    """Returns the hint for a reference such as ``front_left``, which lacks the name of a module."""
    for name, child in inside.children.items():
        for port in child.type.section("ports") if child.type is not None else ():
            if reference in (port, f"{name}_{port}", f"{name}{port}"):
                return Proposal(f"did you mean `{name}.{port}`?", f"{name}.{port}")
    return None


def _none_hint(inside: Instance, reference: str, section: str, word: str) -> str:
    """Returns the hint for a reference to a module that has no port or motor at all."""
    others = (
        f"`{name}`"
        for name, child in inside.children.items()
        if child.type is not None and child.type.section(section)
    )
    known = ", ".join(itertools.islice(others, 6))
    return f"`{reference}` has no {word}s" + (f"; modules with {word}s: {known}" if known else "")


class References:
    """Finds the module, port or motor that a dotted reference names.

    The argument ``inside`` of each method is the assembly or robot that contains the first name of
    the reference.  The argument ``reference`` is a dotted reference, such as ``fl.steering``.  The
    argument ``node`` is the YAML node that contains the reference.  A reference to an unknown
    module is reported at the source span of ``node``.
    """

    def __init__(self, report: Report) -> None:
        self.report = report

    def find(
        self, inside: Instance, reference: str, node: Node, *, optional: bool = False
    ) -> tuple[Instance, list[str]] | None:
        """Returns the module that a dotted reference names, and the remaining names after the
        module name.

        Returns ``None`` if the first name of the dotted reference is not the name of a module.  If
        ``optional`` is true, a reference to a module that was left out of the robot is not
        reported.
        """
        names = reference.split(".")
        part = inside
        while names and names[0] in part.children:
            part = part.children[names.pop(0)]
        if part is not inside:
            return part, names
        assembly = f" in `{inside.path}`" if inside.path else ""
        if names[0] in inside.left_out:
            if not optional:
                self.report.add(
                    "module-unknown",
                    f"`{names[0]}` is left out{assembly}",
                    node.span,
                    hint=f"leave out the modules that need it, or choose a module for `{names[0]}`",
                )
        elif names[0] not in inside.failed:
            self.report.add(
                "module-unknown",
                f"there is no module `{names[0]}`{assembly}",
                node.span,
                hint=_port_hint(inside, reference)
                or hint_of_known(names[0], list(inside.children), reference),
            )
        return None

    def find_port(
        self, inside: Instance, reference: str, node: Node
    ) -> tuple[Instance, str] | None:
        """Returns the module that has the port, and the port's name in the module document."""
        return self._find_in_section(inside, reference, node, "ports", "port")

    def find_motor(
        self, inside: Instance, reference: str, node: Node
    ) -> tuple[Instance, str] | None:
        """Returns the module that has the motor, and the motor's name in the module document."""
        return self._find_in_section(inside, reference, node, "motors", "motor")

    def _find_in_section(
        self, inside: Instance, reference: str, node: Node, section: str, word: str
    ) -> tuple[Instance, str] | None:
        """Finds the port or motor that a dotted reference names.

        The sections `ports` and `motors` of an assembly contain references to modules of the
        assembly.  The method follows the references to the module that has the port or motor.
        ``word`` is the word ``port`` or ``motor`` for error messages.
        """
        part_and_rest = self.find(inside, reference, node, optional=section == "motors")
        if part_and_rest is None:
            return None
        part, rest = part_and_rest
        if not rest and part.parent is not None and part.parent is not inside:
            # A module in an assembly and a motor of the assembly may have the same name.  In this
            # case, a reference such as `fl.steering` names the motor.
            name = reference.rpartition(".")[2]
            if part.parent.type is not None and name in part.parent.type.section(section):
                part, rest = part.parent, [name]
        available = part.type.section(section) if part.type is not None else {}
        name, hint = rest[0] if rest else "", None
        if not rest:
            first = next(iter(available), None)
            message = f"`{reference}` is a module, not a {word}"
            hint = _none_hint(inside, reference, section, word)
            if first:
                target_name = f"{reference}.{first}"
                hint = Proposal(f"name its {word}: `{target_name}`", target_name, is_example=True)
        elif len(rest) > 1 and name in available:
            message = f"`{part.path}.{name}` is a {word}; nothing can follow it"
            shorter = reference.removesuffix("." + ".".join(rest[1:]))
            hint = Proposal(f"write `{shorter}`", shorter)
        elif len(rest) > 1:
            message = f"`{part.path}` has no part `{name}`"
            hint = hint_of_known(name, [*part.children, *available], reference)
        elif name not in available:
            type_name = part.type.name if part.type else ""
            message = f"`{part.path}` ({type_name}) has no {word} `{name}`"
            hint = hint_of_known(name, list(available), reference)
        elif not part.is_leaf:
            target = available[name]
            return self._find_in_section(part, str(target.value), target, section, word)
        elif part.scope.boolean(available[name].get("when"), True):
            return part, name
        else:
            message = f"`{part.path}` has no {word} `{name}` with these parameters"
        self.report.add(f"{word}-unknown", message, node.span, hint=hint)
        return None
