"""The mounting ports of a robot, and the modules that are mounted on them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.port_references import References
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose, Robot

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


def mounting_ports(tree: Instance, robot: Robot) -> list[MountingPort]:
    """Returns the ports of the modules of a robot without errors.

    ``tree`` is the tree of module instances that the robot was made from.  The ports of an assembly
    are ports of its modules, and have the paths of these.
    """
    references = References(Report())
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
                        f"{name_prefix(leaf.path)}_{link_name}"
                        if link_name
                        else first_links[leaf.path],
                        scope.pose(section),
                        tuple(carried.get((leaf.path, port), ())),
                    )
                )
    return ports


def _mounted(tree: Instance) -> Iterator[tuple[Instance, str, str, Node]]:
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
