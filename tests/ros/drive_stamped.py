"""Drives a node with stamped twists from a computer whose clock is not that of the node."""

from __future__ import annotations

import math

from tests.ros.client import Client


def main() -> None:
    client = Client(stamped=True)
    client.wait("odometry", lambda: "base_raw" in client.last)
    client.arm()
    covariance_for_filters(client)
    clock_ahead(client)
    frames(client)
    no_stamp(client)


def covariance_for_filters(client: Client) -> None:
    def counts_lasting_errors() -> bool:
        twist = client.last["base_raw"].twist
        return math.sqrt(twist.covariance[0]) > 0.1 * twist.twist.linear.x > 0.01

    client.drive(0.3)
    client.wait("covariance", counts_lasting_errors, lambda: client.send(0.3))


def clock_ahead(client: Client) -> None:
    client.drive(0.3, age=-0.02)
    assert client.set(max_command_lead=1.5)
    assert client.set(max_command_lead=0.005) == ""
    refused(client, "max_command_lead is 0.005 s", age=-0.02)
    assert client.set(max_command_lead=0.1) == ""


def frames(client: Client) -> None:
    reason = "the twist is in the frame `map`; `base_link` and an empty frame are accepted"
    refused(client, reason, frame="map")
    client.drive(0.3, frame="base_link")


def no_stamp(client: Client) -> None:
    refused(client, "s old; max_command_age is 0.5 s", age=1.0)
    client.drive(0.3, no_stamp=True)


def refused(client: Client, reason: str, **options: object) -> None:
    """Sends twists that the node refuses, until the robot stands and the reason is shown."""
    client.wait(
        reason,
        lambda: (
            abs(client.speed()) < 1e-3
            and client.values("commands").get("auto_nav.reason", "").endswith(reason)
        ),
        lambda: client.send(0.3, **options),  # type: ignore[arg-type]
    )


if __name__ == "__main__":
    main()
