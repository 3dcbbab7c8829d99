"""Waits for messages without the executor of rclpy, which takes about a millisecond for each wait.

The executor gathers all entities of the node in Python, and makes a task of each callback.  A wait
set with the entities that matter takes a quarter of that time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation


def handle_messages(
    node: Any, subscriptions: Sequence[Any], services: Sequence[Any] = (), longest: float = 0.0
) -> bool:
    """Waits for at most ``longest`` s, and handles a message of each subscription that has one.

    Returns whether one of ``services`` has a request, which is left to the executor.
    """
    size = len(subscriptions), 0, 0, 0, len(services), 0
    wait_set = rclpy_implementation.WaitSet(*size, node.context.handle)
    wait_set.clear_entities()
    for subscription in subscriptions:
        wait_set.add_subscription(subscription.handle)
    for service in services:
        wait_set.add_service(service.handle)
    wait_set.wait(round(longest * 1e9))
    ready = wait_set.get_ready_entities("subscription")
    for subscription in subscriptions:
        if subscription.handle.pointer in ready:
            _handle(subscription)
    return bool(wait_set.get_ready_entities("service"))


def _handle(subscription: Any) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        with_info = subscription._callback_type is subscription.CallbackType.WithMessageInfo
        subscription.callback(*(taken if with_info else taken[:1]))
