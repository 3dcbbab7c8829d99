"""Mounts modules on ports of other modules, or at any pose on the surface of another module.

``mounting_ports`` lists the ports of a robot and what is mounted on them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.compiler.modules import module_tree
from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import hint_of_known
from thorvaldc.compiler.source.node import Node, removal
from thorvaldc.compiler.values.document_section import read_pose
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Label, Proposal, Report
from thorvaldc.model import Pose, Robot


class Mounting:
    """Finds the port or link where each module is mounted, and the root module of an assembly."""

    def __init__(self, references: module_tree.References, report: Report) -> None:
        self.references = references
        self.report = report

    def root_of(self, assembly: module_tree.Instance, node: Node) -> module_tree.Instance | None:
        """Returns the root module of an assembly.

        The root module has no `mount` entry and carries the other modules of the assembly.
        Returns ``None`` and reports an error if there is no root module or more than one.
        """
        roots = [
            child
            for child in assembly.children.values()
            if child.is_mechanical and not child.entry.get("mount")
        ]
        if len(roots) == 1:
            root = roots[0]
            return root if root.is_leaf else self.root_of(root, root.entry)
        name = f"`{assembly.path}`" if assembly.path else "the robot"
        if not roots:
            if not assembly.is_complete:
                # The root module of an assembly may be a module that could not be created because
                # of errors.
                return None
            self.report.add(
                "root-missing",
                f"{name} has no root: every module is mounted on another, or there is none",
                node.where if assembly.path else node.span,
                hint="the part that carries the others has no `mount`"
                if assembly.path
                else "the frame has no `mount`",
            )
        else:
            first, second = roots[0], roots[1]
            self.report.add(
                "root-ambiguous",
                f"{name} has two modules without `mount`: "
                f"`{module_tree.last_name(first.path)}` and `{module_tree.last_name(second.path)}`",
                second.entry.where,
                labels=[Label(first.entry.where, "the first one")],
                hint=f"mount it: `mount: {module_tree.last_name(first.path)}.<port>`",
            )
        return None

    def mount_parts(self, assembly: module_tree.Instance) -> None:
        """Sets the attribute ``mount`` of each module of an assembly with a valid `mount` entry."""
        for child in assembly.children.values():
            if not child.is_leaf:
                self.mount_parts(child)
            node = child.entry.get("mount")
            if node is not None:
                # A part that does not fit in an assembly was chosen by a line of the robot file.
                with module_tree.used_by(self.report, child.path, child.span, assembly.scope):
                    self._mount_part(assembly, child, node)

    def _mount_part(
        self, assembly: module_tree.Instance, child: module_tree.Instance, node: Node
    ) -> None:
        if not child.is_mechanical and child.is_complete:
            self.report.add(
                "mount-without-hardware",
                f"`{child.path}` has no body that could be mounted",
                node.where,
                hint=removal("leave `mount` out", child.entry, "mount"),
            )
            return
        mounted_leaf = child if child.is_leaf else self.root_of(child, child.entry)
        if mounted_leaf is not None:
            mount = self._read_mount(assembly, mounted_leaf, node)
            if not self.report.has_error_in(node.span):
                mounted_leaf.mount = mount

    def _read_mount(
        self, inside: module_tree.Instance, mounted_leaf: module_tree.Instance, node: Node
    ) -> module_tree.Mount | None:
        """Reads the `mount` entry of a module.

        Returns ``None`` and reports an error if the `mount` entry is not valid.
        """
        scope = inside.scope
        if isinstance(node.value, dict):
            pose = read_pose(node, scope)
            parent, port = node.get("parent"), node.get("port")
        else:
            pose, parent, port = Pose(), None, node
        if parent is not None:
            return self._free_mount(inside, mounted_leaf, parent, pose)
        if port is None:
            return None
        reference = scope.text(port)
        leaf_and_port = self.references.find_port(inside, reference, port) if reference else None
        if leaf_and_port is None:
            return None
        leaf, port_name = leaf_and_port
        if leaf.type is None:
            return None
        port_section = leaf.type.section("ports")[port_name]
        kind = leaf.scope.text(port_section.get("kind"))
        self._check_kind(mounted_leaf, kind, reference, port, port_section)
        link = leaf.scope.text(port_section.get("link"))
        return module_tree.Mount(leaf, link, read_pose(port_section, leaf.scope) * pose, port.span)

    def _free_mount(
        self,
        inside: module_tree.Instance,
        mounted_leaf: module_tree.Instance,
        parent: Node,
        pose: Pose,
    ) -> module_tree.Mount | None:
        """Reads a `mount` entry that names a module and a pose instead of a port.

        The document of the carrying module must contain the key `free_mount`.
        """
        reference = inside.scope.text(parent)
        part_and_rest = self.references.find(inside, reference, parent) if reference else None
        if part_and_rest is None:
            return None
        part, rest = part_and_rest
        if rest:
            hint = hint_of_known(rest[0], list(part.children), reference)
            key = parent.key_span
            if part.type is not None and rest[0] in part.type.section("ports") and key is not None:
                hint = Proposal(f"`{reference}` is a port: write `port: ...`", "port", span=key)
            self.report.add(
                "module-unknown",
                f"`{part.path}` has no part `{rest[0]}`",
                parent.span,
                hint=hint,
            )
            return None
        leaf = part if part.is_leaf else self.root_of(part, part.entry)
        if leaf is None or leaf.type is None:
            return None
        free = leaf.type.document.get("free_mount")
        if free is None:
            self.report.add(
                "mount-not-free",
                f"`{part.path}` ({leaf.type.name}) offers no free mounting",
                parent.span,
                hint="mount on one of its ports: "
                + ", ".join(f"`{reference}.{p}`" for p in part.type.section("ports"))
                if part.type is not None and part.type.section("ports")
                else "it has no ports either",
            )
            return None
        self._check_kind(mounted_leaf, leaf.scope.text(free.get("kind")), reference, parent, free)
        return module_tree.Mount(
            leaf,
            leaf.scope.text(free.get("link")),
            read_pose(free, leaf.scope) * pose,
            parent.span,
            True,
        )

    def _check_kind(
        self,
        mounted_leaf: module_tree.Instance,
        kind: str,
        reference: str,
        node: Node,
        port_section: Node,
    ) -> None:
        """Checks that the kind of a port fits the mount kinds of the module type."""
        if mounted_leaf.type is None or not kind:
            return
        fitting_kinds = mount_kinds(mounted_leaf.type)
        if kind in fitting_kinds:
            return
        shown_kinds = " or ".join(f"`{k}`" for k in fitting_kinds) or "no port at all"
        hint = f"state `mount: {{kinds: [{kind}], link: LINK}}` in the module"
        self.report.add(
            "port-kind",
            f"`{reference}` is a `{kind}`; "
            f"`{mounted_leaf.path}` ({mounted_leaf.type.name}) fits {shown_kinds}",
            node.span,
            labels=[Label(port_section.where, f"`{kind}` is declared here")],
            hint=None if fitting_kinds else hint,
        )

    def check_places(self, robot: module_tree.Instance) -> None:
        """Reports two modules on the same port or at the same position of a module."""
        first_at: dict[tuple[int, str, Pose], tuple[module_tree.Instance, module_tree.Mount]] = {}
        mounted = [(leaf, leaf.mount) for leaf in robot.leaves() if leaf.mount is not None]
        for leaf, mount in mounted:
            first_at.setdefault(mount.place, (leaf, mount))
        for leaf, mount in mounted:
            first, first_mount = first_at[mount.place]
            if first is leaf or first.type is not leaf.type:
                continue  # modules of different types can share a place, such as a box in a frame
            free = self._free_ports(leaf, mount.leaf, set(first_at))
            hint: str = "mount one of them somewhere else"
            if free and "." not in mount.leaf.path:
                ports = ", ".join(f"`{port}`" for port in free[:3])
                hint = f"mount it on a free port: {ports}"
                if not mount.is_free:
                    hint = Proposal(hint, *free[:3], is_example=True)
            self.report.add(
                "mount-occupied",
                f"`{leaf.path}` is mounted at the same place as `{first.path}`",
                mount.span,
                labels=[Label(first_mount.span, f"`{first.path}` is mounted here")],
                hint=hint,
            )

    def check_sides(self, robot: module_tree.Instance) -> None:
        """Reports modules on ports at the left and at the right of a module that take the same side
        by default, because the ports suggest none."""
        sides: dict[tuple[str, int, str], list[tuple[module_tree.Instance, module_tree.Mount]]] = {}
        for child in robot.children.values():
            leaves = list(child.leaves())
            mounts = (leaf.mount for leaf in leaves)
            mount = next((m for m in mounts if m is not None and m.leaf not in leaves), None)
            if child.type is None or mount is None or mount.is_free:
                continue
            for name, declaration in child.type.section("params").items():
                choices = [node.value for node in items(declaration.get("choices"))]
                if {"left", "right"} <= set(choices) and name not in child.scope.arguments:
                    key = (child.type.name, id(mount.leaf), name)
                    sides.setdefault(key, []).append((child, mount))
        for (_, _, name), mounted in sides.items():
            left, right = (
                [(child, mount) for child, mount in mounted if mount.pose.xyz[1] * sign > 0]
                for sign in (1.0, -1.0)
            )
            if left and right:
                (first, mount), (other, _) = left[0], right[0]
                carrier = mount.leaf
                self.report.add(
                    "side-by-default",
                    f"`{first.path}` at the left and `{other.path}` at the right have the same "
                    f"`{name}` by default: {first.scope[name]}",
                    mount.span,
                    labels=[Label(other.span, f"`{other.path}` is here")],
                    hint=f"state `{name}` in their `params`, or let the ports of "
                    f"`{carrier.type.name if carrier.type else carrier.path}` suggest it: "
                    f"`suggests: {{{name}: ..}}`",
                )

    def _free_ports(
        self,
        mounted: module_tree.Instance,
        carrier: module_tree.Instance,
        occupied: set[tuple[int, str, Pose]],
    ) -> list[str]:
        """Returns the references to the free ports of a module that fit a mounted module."""
        references = []
        for name, section in carrier.type.section("ports").items() if carrier.type else ():
            link, pose = carrier.scope.text(section.get("link")), read_pose(section, carrier.scope)
            mount = module_tree.Mount(carrier, link, pose, section.span)
            kind = carrier.scope.text(section.get("kind"))
            is_present = carrier.scope.boolean(section.get("when"), True)
            if is_present and mount.place not in occupied and kind in mount_kinds(mounted.type):
                references.append(f"{carrier.path}.{name}")
        return references

    def check_no_cycle(self, robot: module_tree.Instance) -> None:
        """Reports modules that are mounted on each other in a cycle.

        A chain of mounts may end at a module with an invalid mount, because the invalid mount has
        already been reported.
        """
        # A chain of mounts leads from a module to the carrying module, and so on.  For each module,
        # the dictionary `chain_ends` contains whether the chain of mounts has an end.
        chain_ends: dict[int, bool] = {}
        for leaf in robot.leaves():
            chain = [leaf]
            while id(chain[-1]) not in chain_ends and (mount := chain[-1].mount) is not None:
                # A chain of mounts that contains a module twice is a cycle.
                chain_ends[id(chain[-1])] = False
                chain.append(mount.leaf)
            ends = chain_ends.get(id(chain[-1]), True)
            chain_ends.update((id(part), ends) for part in chain)
        cycle = [leaf for leaf in robot.leaves() if not chain_ends[id(leaf)]]
        if cycle:
            self.report.add(
                "mount-cycle",
                "these modules are mounted on each other and not on the frame: "
                + ", ".join(f"`{leaf.path}`" for leaf in cycle),
                cycle[0].mount.span if cycle[0].mount is not None else cycle[0].span,
            )


def mount_kinds(module: ModuleType | None) -> list[str]:
    """Returns the kinds of ports that a leaf module fits."""
    mount = module.document.get("mount") if module is not None else None
    kinds = mount.get("kinds") if mount is not None else None
    return [str(kind) for kind in kinds.plain()] if kinds is not None else []


EXTRAS = "extras"


class MountingPort(NamedTuple):
    """A port of a module of the robot.

    - ``name``: path of the module and name of the port, such as ``frame.front_left``.
    - ``kind``: kind of the port, such as ``frame_clamp``.
    - ``link``: link of the robot that the port is fixed to.
    - ``pose``: pose of the port in the frame of the link.
    - ``carries``: paths of the modules on the port, and ``extras`` for an extra; empty if the port
      is free.
    """

    name: str
    kind: str
    link: str
    pose: Pose
    carries: tuple[str, ...]


def mounting_ports(tree: module_tree.Instance, robot: Robot) -> list[MountingPort]:
    """Returns the ports of the modules of a robot without errors.

    ``tree`` is the tree of module instances that the robot was made from.  The ports of an assembly
    are ports of its modules, and have the paths of these.
    """
    references = module_tree.References(Report())
    carried: dict[tuple[str, str], list[str]] = {}
    for inside, name, reference, node in _mounted(tree):
        leaf_and_port = references.find_port(inside, reference, node)
        if leaf_and_port is not None:
            leaf, port = leaf_and_port
            carried.setdefault((leaf.path, port), []).append(name)
    first_links: dict[str, str] = {}
    for link in robot.links:
        first_links.setdefault(link.module, link.name)
    ports = []
    for leaf in tree.leaves():
        if leaf.type is None or leaf.path not in first_links:
            continue
        scope = leaf.scope
        for port, section in leaf.type.section("ports").items():
            if scope.boolean(section.get("when"), True):
                link_name = scope.text(section.get("link"))
                ports.append(
                    MountingPort(
                        f"{leaf.path}.{port}",
                        scope.text(section.get("kind")),
                        f"{module_tree.name_prefix(leaf.path)}_{link_name}"
                        if link_name
                        else first_links[leaf.path],
                        read_pose(section, scope),
                        tuple(carried.get((leaf.path, port), ())),
                    )
                )
    return ports


def _mounted(tree: module_tree.Instance) -> Iterator[tuple[module_tree.Instance, str, str, Node]]:
    """Yields the references to ports in the `mount` entries of modules and in the extras.

    A reference consists of the assembly or robot that it is in, the path of the mounted module, its
    text and its node.
    """
    for child in tree.children.values():
        node = child.entry.get("mount")
        if node is not None and isinstance(node.value, dict):
            node = node.get("port")
        if node is not None and child.is_mechanical:
            yield tree, child.path, tree.scope.text(node), node
        yield from _mounted(child)
    if not tree.path:
        extras = tree.entry.get(EXTRAS)
        for extra in items(extras) if extras is not None else ():
            parent = extra.get("parent")
            if parent is not None:
                yield tree, EXTRAS, tree.scope.text(parent), parent
