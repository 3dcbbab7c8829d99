"""The nodes use no name of the node of rclpy for something of their own."""

from __future__ import annotations

import ast
import inspect

import rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node

from thorvaldc.ros.guarded_node import GuardedLifecycleNode
from thorvaldc.ros.joint_guard import JointGuard
from thorvaldc.ros.lifecycle_node import BaseDriverNode


def names(kind: type) -> set[str]:
    """Returns the names of the private methods of a class, and of the attributes that it sets.

    A public method of rclpy may be overridden.
    """
    tree = ast.walk(ast.parse(inspect.getsource(kind)))
    attributes = (node for node in tree if isinstance(node, ast.Attribute))
    set_here = {node.attr for node in attributes if isinstance(node.ctx, ast.Store)}
    return set_here | {name for name in vars(kind) if name[0] == "_" != name[1]}


def main() -> None:
    rclpy.init()
    drivers = [GuardedLifecycleNode, BaseDriverNode]
    for base, kinds in ((Node, [JointGuard]), (LifecycleNode, drivers)):
        node = base("node_of_rclpy")
        theirs = {*vars(node), *dir(node)}
        for kind in kinds:
            both = names(kind) & theirs
            assert not both, f"{kind.__name__}: {sorted(both)}"
        node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
