"""A lifecycle node whose control loop no request and no message can end.

An error in a callback of rclpy ends the program that spins the node, and rclpy's own callbacks have
such errors: Jazzy for a transition that the present state does not allow, Jazzy and Kilted for a
parameter of an unknown type and for a negative time on /clock.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode

_LOG_PERIOD = 1.0
"""Shortest real time (s) between two lines in the log."""
_Callback = Callable[[Any, Any], Any]


class GuardedLifecycleNode(LifecycleNode):  # type: ignore[misc]
    """A lifecycle node that refuses a request whose callback fails, and goes on.

    A message whose callback fails is dropped, and ``message_failed`` is called.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        for service in self.services:  # those of rclpy: lifecycle, parameters, loggers
            service.callback = self.guarded(service.srv_name, service.callback)

    def message_failed(self, reason: str) -> None:
        """Reacts to a message whose callback failed for ``reason``."""

    def guarded(self, service: str, callback: _Callback) -> _Callback:
        """Returns a callback of a service that refuses a request if ``callback`` fails."""

        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                refuse(request, response, self._logged(f"a request to {service}", error))
                return response

        return answer

    def create_publisher(self, kind: Any, topic: str, qos: Any, **options: Any) -> Any:
        """Creates a publisher without the events of rclpy.

        Each event costs every wait for a message; a subscriber that is not compatible says so too.
        """
        options.setdefault("event_callbacks", PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(kind, topic, qos, **options)

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, *rest: Any, timed: bool = False, **options: Any
    ) -> Any:
        """Creates a subscription.

        ``timed``: the callback also takes the time (s) since the message was published, by the
        clocks of sender and receiver; 0 if the middleware does not know it.
        """

        # Overridden for the subscription to /clock too, which rclpy creates with `use_sim_time`.
        def take(message: Any, *waited: float) -> None:
            try:
                callback(message, *waited)
            except Exception as error:
                self.message_failed(self._logged(f"a message on {topic}", error))

        # rclpy gives the information to a function with two parameters.
        def take_timed(message: Any, info: Any) -> None:
            sent = info["source_timestamp"] * 1e-9
            take(message, time.time() - sent if sent else 0.0)

        taking = take_timed if timed else take
        return super().create_subscription(kind, topic, taking, *rest, **options)

    def _logged(self, cause: str, error: Exception) -> str:
        reason = f"{cause} failed: {' '.join(str(error).split()) or type(error).__name__}"
        self.get_logger().error(reason, throttle_duration_sec=_LOG_PERIOD)
        self.get_logger().debug(traceback.format_exc())
        return reason


def refuse(request: Any, response: Any, reason: str) -> None:
    """Makes a refusal of the response to a request, with its reason where it has a place for it."""
    if isinstance(response, SetParameters.Response):
        # rclpy sets one after another: those before the wrong one are set.
        missing = len(request.parameters) - len(response.results)
        response.results += [SetParametersResult(successful=False, reason=reason)] * missing
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = SetParametersResult(successful=False, reason=reason)
    elif hasattr(response, "success"):
        response.success = False
        if hasattr(response, "message"):
            response.message = reason
