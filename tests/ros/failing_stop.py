"""Ends two nodes of which one cannot stop its robot: ``failing_stop MODEL_FILE``."""

from __future__ import annotations

import contextlib
import sys

import rclpy
from rclpy.parameter import Parameter

from thorvaldc.ros.base_driver import run_nodes
from thorvaldc.ros.lifecycle_node import BaseDriverNode

OPTIONS = {"model_file": sys.argv[1], "base": "ideal", "stamped": False}


class FailingNode(BaseDriverNode):
    """A node that has an error while it stops its robot."""

    def stop_robot(self) -> None:
        raise RuntimeError("an error of the test")


def main() -> None:
    rclpy.init()
    nodes: list[BaseDriverNode] = []

    def make(kind: type[BaseDriverNode], space: str) -> BaseDriverNode:
        overrides = [Parameter(name, value=value) for name, value in OPTIONS.items()]
        nodes.append(kind(namespace=space, parameter_overrides=overrides))
        return nodes[-1]

    kinds = (BaseDriverNode, FailingNode, BaseDriverNode)
    factories = [lambda i=i, kind=kind: make(kind, f"r{i}") for i, kind in enumerate(kinds)]
    with contextlib.suppress(RuntimeError):
        run_nodes(factories, lambda: all(node.robot is not None for node in nodes))
    assert [node.robot is None for node in nodes] == [True, False, True]
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
