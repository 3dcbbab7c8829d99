"""The nodes use no name of the node of rclpy for something of their own."""

from __future__ import annotations

import ast
import inspect

import rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node

from thorvaldc.ros.joint_guard import JointGuard
from thorvaldc.ros.lifecycle_node import BaseDriverNode, GuardedLifecycleNode

OVERRIDDEN = ("__", "on_")
"""What begins so is there to be overridden."""


def names(kind: type) -> set[str]:
    """Returns the names of the methods of a class, and of the attributes that they set."""
    tree = ast.walk(ast.parse(inspect.getsource(kind)))
    attributes = (node for node in tree if isinstance(node, ast.Attribute))
    set_here = {node.attr for node in attributes if isinstance(node.ctx, ast.Store)}
    return set_here | set(vars(kind))


def main() -> None:
    rclpy.init()
    drivers = [GuardedLifecycleNode, BaseDriverNode]
    for base, kinds in ((Node, [JointGuard]), (LifecycleNode, drivers)):
        node = base("node_of_rclpy")
        theirs = {*vars(node), *dir(node)}
        for kind in kinds:
            both = {name for name in names(kind) & theirs if not name.startswith(OVERRIDDEN)}
            assert not both, f"{kind.__name__}: {sorted(both)}"
        node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
