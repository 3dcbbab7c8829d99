"""Activates a node with an error after its robot was opened: ``failing_activation MODEL_FILE``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import rclpy
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

from thorvaldc.ros.lifecycle_node import BaseDriverNode

OPTIONS = {"model_file": sys.argv[1], "base": "ideal", "stamped": False}


class FailingNode(BaseDriverNode):
    """A node that has an error while it applies its parameters to the robot."""

    fails = False

    def _use_parameters(self, parameter_set: str | None, limits: Mapping[str, Any]) -> None:
        if self.fails:
            assert self.robot is not None
            self.opened = self.robot
            raise RuntimeError("an error of the test")
        super()._use_parameters(parameter_set, limits)


def main() -> None:
    rclpy.init()
    overrides = [Parameter(name, value=value) for name, value in OPTIONS.items()]
    node = FailingNode(parameter_overrides=overrides)
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    node.fails = True
    node.trigger_activate()
    assert node.robot is None, "the robot must not stay open without its node"
    assert not node.opened.armed
    node.fails = False
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    assert node.robot is not None
    node.stop_robot()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
