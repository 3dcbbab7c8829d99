"""Runs two robots in one process: ``two_nodes MODEL_FILE``, until SIGTERM."""

from __future__ import annotations

import signal
import sys

import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from thorvaldc.ros.base_driver import run_nodes
from thorvaldc.ros.lifecycle_node import BaseDriverNode


def main() -> int:
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: ended.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    values = {"model_file": sys.argv[1], "base": "ideal", "stamped": False}

    def make(space: str) -> BaseDriverNode:
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        return BaseDriverNode(namespace=space, parameter_overrides=overrides)

    try:
        return run_nodes([lambda: make("r1"), lambda: make("r2")], lambda: bool(ended))
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
