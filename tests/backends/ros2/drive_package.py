"""Runs in the Python of ROS 2: drives the base driver of a package with the twists of its sources.

Arguments: name space of the robot with a slash, frames of the robot and of the odometry, and
whether twists are stamped.
"""

from __future__ import annotations

import sys

from tests.ros.client import Client


def main() -> None:
    space, frame, odom, stamped = sys.argv[1:5]
    client = Client(space, stamped == "true")
    client.wait("odometry", lambda: "base_raw" in client.last)
    odometry = client.last["base_raw"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == (odom, frame)
    client.wait("joint states", lambda: "joint_states" in client.last)
    prefix = frame.removesuffix("base_link")
    assert all(name.startswith(prefix) for name in client.last["joint_states"].name)
    client.arm()
    client.drive(0.3, source="teleop_joy")


if __name__ == "__main__":
    main()
