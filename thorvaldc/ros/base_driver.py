"""The programs ``base_driver`` and ``joint_guard``: each runs a ROS 2 node until it is ended.

python -m thorvaldc.ros.base_driver --ros-args -p model_file:=build/robot/model.json -p base:=ideal
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.ros.bases import NodeError
from thorvaldc.runtime.pace import end_signals

LONGEST_WAIT = 0.1
"""Longest real time (s) for which the program waits for messages before it looks at a signal."""
INPUT, OUTSIDE = 1, 3
"""Exit statuses as those of the command ``thorvaldc``: wrong input, failure outside."""


def main(args: Sequence[str] | None = None) -> int:
    """Runs the node ``base_driver`` and returns the exit status.

    ``args``: arguments of the program, by default those of the process.  Errors are one line on
    stderr.
    """
    return _run("thorvaldc.ros.lifecycle_node", "BaseDriverNode", args)


def guard(args: Sequence[str] | None = None) -> int:
    """Runs the node ``joint_guard``, as ``main`` runs ``base_driver``."""
    return _run("thorvaldc.ros.joint_guard", "JointGuard", args)


def _run(module: str, node: str, args: Sequence[str] | None) -> int:
    try:
        import rclpy
        from rclpy.exceptions import ParameterException
        from rclpy.signals import SignalHandlerOptions

        factory = getattr(importlib.import_module(module), node)
    except ModuleNotFoundError as error:
        if str(error.name).startswith("thorvaldc"):
            raise
        return _fail(
            f"the Python package {error.name} of ROS 2 is missing in {sys.executable}: install"
            " ROS 2, and run `source /opt/ros/DISTRO/setup.bash` first",
            OUTSIDE,
        )
    with end_signals() as ended:
        try:
            # The signals end the loop, so that the robot is stopped before ROS is shut down.
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:
            return _fail(str(error), INPUT)
        try:
            return run_nodes([factory], ended)
        except DiagnosticError as error:
            return _fail(error.one_line, INPUT)
        except (NodeError, ParameterException) as error:
            return _fail(str(error), INPUT)
        finally:
            rclpy.try_shutdown()


def run_nodes(factories: Sequence[Callable[[], Any]], ended: Callable[[], bool]) -> int:
    """Creates nodes and runs them in this thread until ``ended()``; stops their robots then.

    ``factories``: functions that return a ``BaseDriverNode``, such as
    ``lambda: BaseDriverNode(namespace="r1", parameter_overrides=[...])``, for several robots in
    one process.  Raises ``NodeError`` if a node cannot start.
    """
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.lifecycle import TransitionCallbackReturn

    executor = SingleThreadedExecutor()
    nodes: list[Any] = []
    with contextlib.ExitStack() as stack:  # it stops every robot, also after an error of one
        stack.callback(executor.shutdown)
        for factory in factories:
            node = factory()
            stack.callback(_end, node, executor)
            nodes.append(node)
            executor.add_node(node)
        for node in nodes:
            if node.values["autostart"]:
                for transition in (node.trigger_configure, node.trigger_activate):
                    if transition() != TransitionCallbackReturn.SUCCESS:
                        raise NodeError(node.problem)
        while not ended():
            wait = min(max(min(node.wait() for node in nodes), 0.0), LONGEST_WAIT)
            longest = nodes[0].await_states(wait) if len(nodes) == 1 else wait
            if longest is not None:
                _run_ready(executor, longest)
            for node in nodes:
                node.run_due()
    return 0


def _run_ready(executor: Any, longest: float) -> None:
    """Waits for messages for at most ``longest`` s, and runs the callbacks of all that are there.

    ``Executor.spin_once`` waits before each callback; a wait costs more than the callback.
    """
    from rclpy.executors import ConditionReachedException, ShutdownException, TimeoutException

    ran = False

    def has_run() -> bool:
        return ran

    while True:
        try:
            handler, _, _ = executor.wait_for_ready_callbacks(longest, None, has_run)
        except (ConditionReachedException, ShutdownException, TimeoutException):
            return
        ran = True
        handler()
        handler.result()  # raises its error


def _end(node: Any, executor: Any) -> None:
    """Stops the robot of a node and removes the node."""
    node.stop_robot()
    executor.remove_node(node)
    node.destroy_node()


def _fail(message: str, status: int) -> int:
    print("error:", " ".join(message.split()), file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
