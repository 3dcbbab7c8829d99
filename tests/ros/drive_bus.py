"""Drives a node with a robot on its bus: ``drive_bus [MOVES]``.

With an argument, the robot is left driving; otherwise it must stand, as no person has armed it.
"""

from __future__ import annotations

import sys

from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState

from tests.ros.client import Client


def main() -> None:
    client = Client()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    client.listen(BatteryState, "/battery_data", latched)
    client.wait("ready", lambda: client.status() == "waiting: disarmed")
    assert max(map(abs, client.keep(0.2, 0.6))) < 0.01
    if len(sys.argv) == 1:
        return
    battery = client.wait("battery", lambda: client.last.get("battery_data"))
    assert battery.location
    assert battery.voltage > 10.0
    client.arm()
    client.drive(0.2)
    assert client.values("timing")["cycles"]
    changes = client.values("states")["changes"].split("; ")
    assert len(changes) == 5, changes
    assert changes[-1].endswith("active")
    assert client.values("timing")["events"].split("; ")[-1].endswith("armed")
    values = client.values("driver")
    assert values["supervisor"] in ("ready", "active")
    assert not {"cycles", "overruns"} & set(values)  # in the status `timing`
    assert not [key for key in values if key.startswith(("batteries", "outputs"))]
    assert client.switch("safety_stop") == (True, "")
    client.wait("stop", lambda: abs(client.speed()) < 0.01, lambda: client.send(0.2))
    client.wait("stopped", lambda: "stop" in client.status())
    released = client.switch("safety_stop", False)
    assert released == (True, ""), released
    client.spin(0.6)  # the sources must be silent or zero
    client.wait("reset", lambda: client.trigger("reset_faults")[0])
    assert max(map(abs, client.keep(0.2, 0.5))) < 0.01
    client.arm()
    client.drive(0.2)


if __name__ == "__main__":
    main()
